from .base import Distribution
from .bounded import EndPoint, Parabolic, Triangular, Uniform
from .empirical import Empirical
from .normal import Normal, TruncatedNormal
from .registry import DISTRIBUTIONS

__all__ = [
    "DISTRIBUTIONS",
    "Distribution",
    "Empirical",
    "EndPoint",
    "Normal",
    "Parabolic",
    "Triangular",
    "TruncatedNormal",
    "Uniform",
]
