"""The registry of distributions: a new one is one class and one line here."""

from __future__ import annotations

from tolerancing.perturbations.distributions.base import Distribution
from tolerancing.perturbations.distributions.bounded import EndPoint, Parabolic, Triangular, Uniform
from tolerancing.perturbations.distributions.discrete import Discrete
from tolerancing.perturbations.distributions.empirical import Empirical
from tolerancing.perturbations.distributions.normal import Normal, TruncatedNormal

DISTRIBUTIONS: dict[str, type[Distribution]] = {
    shape.kind: shape
    for shape in (
        Normal,
        TruncatedNormal,
        Uniform,
        Triangular,
        Parabolic,
        EndPoint,
        Empirical,
        Discrete,
    )
}
"""Distributions by their name in a study file."""
