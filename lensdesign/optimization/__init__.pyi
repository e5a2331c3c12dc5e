from .asked.sections import Settings
from .asked.specification import Specification, load_specification
from .compliance import check_against
from .reach import Reach
from .result import OptimizationResult
from .search import optimize

__all__ = [
    "OptimizationResult",
    "Reach",
    "Settings",
    "Specification",
    "check_against",
    "load_specification",
    "optimize",
]
