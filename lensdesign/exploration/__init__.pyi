from .front import Exploration, Explored, front_of
from .objectives import OBJECTIVES, Axis, Objective, axes_of

__all__ = [
    "OBJECTIVES",
    "Axis",
    "Exploration",
    "Explored",
    "Objective",
    "axes_of",
    "front_of",
]
