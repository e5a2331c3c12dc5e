"""How a perturbation scatters: distributions by their quantiles, one class and one registry line each.

A distribution turns a probability into a value. Whatever makes the probabilities (independent draws
today) therefore stays apart from the shapes of the distributions.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lensdesign.system import Finite, Positive, Section

Array = NDArray[np.float64]


class Distribution(Section):
    """A distribution about `mean`; all values in the unit of the parameter that it perturbs.

    Attributes
    ----------
    mean
        Systematic deviation from nominal.
    """

    kind: ClassVar[str]

    mean: Finite = 0.0

    def quantile(self, probability: Array) -> Array:
        """Value below which a share `probability`, within 0 and 1, of all parts lies."""
        raise NotImplementedError

    @property
    def standard_deviation(self) -> float:
        """Standard deviation."""
        raise NotImplementedError


class Normal(Distribution):
    """Normal distribution of standard deviation `sigma`."""

    kind = "normal"

    sigma: Positive

    def quantile(self, probability: Array) -> Array:
        from scipy.special import ndtri

        return self.mean + self.sigma * np.asarray(ndtri(probability))

    @property
    def standard_deviation(self) -> float:
        return self.sigma


class TruncatedNormal(Distribution):
    """Normal distribution of which parts farther than `limit` from the mean are sorted out."""

    kind = "truncated_normal"

    sigma: Positive
    limit: Positive

    def quantile(self, probability: Array) -> Array:
        from scipy.special import ndtr, ndtri

        tail = ndtr(-self.limit / self.sigma)
        inside = tail + probability * (1.0 - 2.0 * tail)
        deviation = self.sigma * np.asarray(ndtri(inside))
        return self.mean + np.clip(deviation, -self.limit, self.limit)

    @property
    def standard_deviation(self) -> float:
        edge = self.limit / self.sigma
        density = math.exp(-0.5 * edge * edge) / math.sqrt(2.0 * math.pi)
        shrink = 1.0 - 2.0 * edge * density / math.erf(edge / math.sqrt(2.0))
        return self.sigma * math.sqrt(max(shrink, 0.0))


class Uniform(Distribution):
    """All values within `half_width` of the mean, alike."""

    kind = "uniform"

    half_width: Positive

    def quantile(self, probability: Array) -> Array:
        return self.mean + self.half_width * (2.0 * probability - 1.0)

    @property
    def standard_deviation(self) -> float:
        return self.half_width / math.sqrt(3.0)


DISTRIBUTIONS: dict[str, type[Distribution]] = {
    shape.kind: shape
    for shape in (
        Normal,
        TruncatedNormal,
        Uniform,
    )
}
"""Distributions by the name that a study file gives."""
