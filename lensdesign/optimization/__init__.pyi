from .search import OptimizationResult, optimize
from .specification import Settings, Specification, load_specification

__all__ = [
    "OptimizationResult",
    "Settings",
    "Specification",
    "load_specification",
    "optimize",
]
