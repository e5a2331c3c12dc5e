"""Normal distribution and truncated normal distribution."""

from __future__ import annotations

import math
from typing import Self

import numpy as np
from pydantic import model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import Positive
from tolerancing.perturbations.distributions.base import Distribution

NARROWEST_LIMIT, WIDEST_LIMIT = 1e-3, 30.0
"""Allowed range of the limit of a truncated normal distribution, in sigma."""


class Normal(Distribution):
    """Normal distribution of standard deviation `sigma`; two sigma count as the tolerance."""

    kind = "normal"
    widths = ("sigma",)

    sigma: Positive

    def quantile(self, probability: Array) -> Array:
        from scipy.special import ndtri

        return self.mean + self.sigma * np.asarray(ndtri(probability))

    @property
    def standard_deviation(self) -> float:
        return self.sigma

    @property
    def largest(self) -> float:
        return 2.0 * self.sigma


class TruncatedNormal(Distribution):
    """Normal distribution without the parts that are farther than `limit` from the mean."""

    kind = "truncated_normal"
    widths = ("sigma", "limit")

    sigma: Positive
    limit: Positive

    @model_validator(mode="after")
    def _truncates(self) -> Self:
        edge = self.limit / self.sigma
        if not NARROWEST_LIMIT <= edge <= WIDEST_LIMIT:
            raise ValueError(
                f"limit = {self.limit:g} is {edge:.3g} sigma; allowed: {NARROWEST_LIMIT:g} to "
                f"{WIDEST_LIMIT:g}; beyond, the distribution is {'uniform' if edge < 1.0 else 'normal'}"
            )
        return self

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

    @property
    def largest(self) -> float:
        return self.limit
