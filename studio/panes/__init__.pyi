from .beside import compare
from .making import export
from .rays import footprint, layout, spread
from .search import optimize
from .told import as_built, findings
from .trials import tolerances
from .values import surfaces, what_if
from .waves import contrast, patch, wavefront

__all__ = [
    "as_built",
    "compare",
    "contrast",
    "export",
    "findings",
    "footprint",
    "layout",
    "optimize",
    "patch",
    "spread",
    "surfaces",
    "tolerances",
    "wavefront",
    "what_if",
]
