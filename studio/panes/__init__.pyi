from .rays import footprint, layout, spread
from .told import as_built, findings
from .values import surfaces, what_if
from .waves import contrast, patch, wavefront

__all__ = [
    "as_built",
    "contrast",
    "findings",
    "footprint",
    "layout",
    "patch",
    "spread",
    "surfaces",
    "wavefront",
    "what_if",
]
