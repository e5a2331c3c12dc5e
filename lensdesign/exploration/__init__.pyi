from .front import Exploration, ExploredPoint, front_of
from .objectives import OBJECTIVES, Axis, Objective, axes_of

__all__ = [
    "OBJECTIVES",
    "Axis",
    "Exploration",
    "ExploredPoint",
    "Objective",
    "axes_of",
    "front_of",
]
