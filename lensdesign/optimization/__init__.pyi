from .asked.sections import Settings
from .asked.specification import Specification, load_specification
from .compliance import check_against
from .plates import FittedSurface, PlateFit, fit_plates, load_plates
from .reach import Reach
from .result import OptimizationResult
from .search import optimize

__all__ = [
    "FittedSurface",
    "OptimizationResult",
    "PlateFit",
    "Reach",
    "Settings",
    "Specification",
    "check_against",
    "fit_plates",
    "load_plates",
    "load_specification",
    "optimize",
]
