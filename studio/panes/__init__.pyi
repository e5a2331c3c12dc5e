from .comparison import compare
from .front import explore
from .manufacture import export
from .rays import footprint, layout, spread
from .results import result_folder_pane
from .search import optimize
from .summary import as_built, findings
from .trials import tolerances
from .values import surfaces, what_if
from .waves import contrast, patch, wavefront

__all__ = [
    "as_built",
    "compare",
    "contrast",
    "explore",
    "export",
    "findings",
    "footprint",
    "layout",
    "optimize",
    "patch",
    "result_folder_pane",
    "spread",
    "surfaces",
    "tolerances",
    "wavefront",
    "what_if",
]
