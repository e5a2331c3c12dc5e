from .base import Distribution
from .bounded import EndPoint, Parabolic, Triangular, Uniform
from .discrete import Discrete
from .empirical import Empirical
from .normal import Normal, TruncatedNormal
from .registry import DISTRIBUTIONS

__all__ = [
    "DISTRIBUTIONS",
    "Discrete",
    "Distribution",
    "Empirical",
    "EndPoint",
    "Normal",
    "Parabolic",
    "Triangular",
    "TruncatedNormal",
    "Uniform",
]
