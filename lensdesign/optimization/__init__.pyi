from .asked.sections import Settings
from .asked.specification import Specification, load_specification
from .compliance import check_against
from .limits.kinds import Kind
from .limits.reach import Reach
from .limits.search import Limit, LimitsInterrupted, find_limits
from .plates import FittedSurface, PlateFit, fit_plates, load_plates
from .result import OptimizationResult
from .search import SearchInterrupted, optimize

__all__ = [
    "FittedSurface",
    "Kind",
    "Limit",
    "LimitsInterrupted",
    "OptimizationResult",
    "PlateFit",
    "Reach",
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
