from .comparison import compare
from .front import explore
from .manufacture import export
from .rays import footprint, layout, spread
from .results import result_folder_pane
from .search import optimize
from .strip import deviations
from .summary import as_built, findings
from .table import surface_table
from .trials import tolerances
from .values import surfaces, what_if
from .waves import contrast, modulation, patch, point_spread, wavefront

__all__ = [
    "as_built",
    "compare",
    "contrast",
    "deviations",
    "explore",
    "export",
    "findings",
    "footprint",
    "layout",
    "modulation",
    "optimize",
    "patch",
    "point_spread",
    "result_folder_pane",
    "spread",
    "surface_table",
    "surfaces",
    "tolerances",
    "wavefront",
    "what_if",
]
