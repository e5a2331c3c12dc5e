from .limits.feasible_limits import FeasibilityLimit
from .limits.limited_quantities import LimitedQuantity
from .limits.search import Limit, LimitsInterrupted, find_limits
from .result import OptimizationResult
from .search import SearchInterrupted, optimize
from .specification.sections import Settings
from .specification.specification import Specification, load_specification
from .specification_check import check_against
from .testplates import FittedSurface, PlateFit, fit_plates, load_plates

__all__ = [
    "FeasibilityLimit",
    "FittedSurface",
    "Limit",
    "LimitedQuantity",
    "LimitsInterrupted",
    "OptimizationResult",
    "PlateFit",
    "SearchInterrupted",
    "Settings",
    "Specification",
    "check_against",
    "find_limits",
    "fit_plates",
    "load_plates",
    "load_specification",
    "optimize",
]
