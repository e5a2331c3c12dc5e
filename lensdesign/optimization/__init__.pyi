from .compliance import check_against
from .reach import Reach
from .result import OptimizationResult
from .search import optimize
from .specification import Settings, Specification, load_specification

__all__ = [
    "OptimizationResult",
    "Reach",
    "Settings",
    "Specification",
    "check_against",
    "load_specification",
    "optimize",
]
