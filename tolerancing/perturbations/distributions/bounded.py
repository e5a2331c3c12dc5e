"""Symmetric distributions whose values all lie within a half width of the mean."""

from __future__ import annotations

import math

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import Positive
from tolerancing.perturbations.distributions.base import Distribution


class BoundedDistribution(Distribution):
    """A symmetric distribution within `half_width` of the mean."""

    widths = ("half_width",)

    half_width: Positive

    @property
    def largest(self) -> float:
        return self.half_width


class Uniform(BoundedDistribution):
    """Uniform distribution within `half_width` of the mean."""

    kind = "uniform"

    def quantile(self, probability: Array) -> Array:
        return self.mean + self.half_width * (2.0 * probability - 1.0)

    @property
    def standard_deviation(self) -> float:
        return self.half_width / math.sqrt(3.0)


class Triangular(BoundedDistribution):
    """Density that falls linearly from the mean to zero at `half_width`."""

    kind = "triangular"

    def quantile(self, probability: Array) -> Array:
        side, tail = _side_and_tail(probability)
        return self.mean + self.half_width * side * (1.0 - np.sqrt(2.0 * tail))

    @property
    def standard_deviation(self) -> float:
        return self.half_width / math.sqrt(6.0)


class Parabolic(BoundedDistribution):
    """Density proportional to 1 - (deviation / half_width)^2."""

    kind = "parabolic"

    def quantile(self, probability: Array) -> Array:
        # The fraction beyond t, (2 - 3 t + t^3) / 4, is sin^2 angle where t = 2 cos((pi + 2 angle) / 3).
        side, tail = _side_and_tail(probability)
        angle = np.arcsin(np.sqrt(tail)) * (2.0 / 3.0)
        return self.mean + self.half_width * side * (np.cos(angle) - math.sqrt(3.0) * np.sin(angle))

    @property
    def standard_deviation(self) -> float:
        return self.half_width / math.sqrt(5.0)


class EndPoint(BoundedDistribution):
    """Half of the parts at the lower end of the tolerance, half at the upper."""

    kind = "end_point"

    def quantile(self, probability: Array) -> Array:
        return self.mean + np.where(np.asarray(probability) < 0.5, -self.half_width, self.half_width)

    @property
    def standard_deviation(self) -> float:
        return self.half_width


def _side_and_tail(probability: Array) -> tuple[Array, Array]:
    """Return the side of the mean (-1 or 1) of each value, and the fraction of parts beyond the value."""
    probability = np.asarray(probability)
    lower = probability < 0.5
    return np.where(lower, -1.0, 1.0), np.where(lower, probability, 1.0 - probability)
