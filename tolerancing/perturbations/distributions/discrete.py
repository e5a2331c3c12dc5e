"""Discrete values of equal probability."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import FiniteNumber
from tolerancing.perturbations.distributions.base import Distribution, check_factor


class Discrete(Distribution):
    """Discrete values of equal probability; `mean` shifts all of them.

    Attributes
    ----------
    values
        Two or more values in increasing order.
    """

    kind = "discrete"
    widths = ()

    values: Annotated[tuple[FiniteNumber, ...], Field(min_length=2, max_length=1000)]

    @model_validator(mode="after")
    def _increasing(self) -> Discrete:
        if list(self.values) != sorted(set(self.values)):
            raise ValueError(f"values = {list(self.values)}: must be increasing")
        return self

    @property
    def levels(self) -> tuple[float, ...]:
        """The values, shifted by the mean."""
        return tuple(self.mean + value for value in self.values)

    def quantile(self, probability: Array) -> Array:
        index = np.floor(np.asarray(probability) * len(self.values)).astype(int)
        return np.asarray(self.levels)[np.clip(index, 0, len(self.values) - 1)]

    @property
    def standard_deviation(self) -> float:
        return float(np.std(self.values))

    @property
    def largest(self) -> float:
        return float(np.max(np.abs(np.asarray(self.values) - np.mean(self.values))))

    @property
    def centre(self) -> float:
        return float(np.mean(self.levels))

    def scaled(self, factor: float) -> Discrete:
        check_factor(factor)
        middle = float(np.mean(self.values))
        return self.replaced(values=tuple(middle + factor * (value - middle) for value in self.values))
