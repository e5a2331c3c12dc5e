"""What every distribution has: quantiles, a centre, a standard deviation and a tolerance.

A distribution turns a probability into a value. Whatever makes the probabilities
(:mod:`tolerancing.perturbations.draws`, :mod:`tolerancing.perturbations.dependence`) therefore stays apart
from the shapes of the distributions.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import ClassVar, Self

from lensdesign.common.arrays import Array
from lensdesign.common.section import Bounded, Section
from lensdesign.errors import InputError


class Distribution(Section):
    """A distribution about `mean`; all values in the unit of the parameter that it perturbs.

    Attributes
    ----------
    mean
        Systematic deviation from nominal.
    """

    kind: ClassVar[str]
    widths: ClassVar[tuple[str, ...]]

    mean: Bounded = 0.0

    @property
    def file_name(self) -> str | None:
        """A file beside the study that holds the distribution."""
        return None

    def loaded(self, folder: Path) -> Self:
        """The distribution with what its file holds; relative to a folder."""
        return self

    def quantile(self, probability: Array) -> Array:
        """Value below which a share `probability`, within 0 and 1, of all parts lies."""
        raise NotImplementedError

    @property
    def standard_deviation(self) -> float:
        """Standard deviation."""
        raise NotImplementedError

    @property
    def largest(self) -> float:
        """Largest deviation from the centre, either way, that counts as the tolerance."""
        raise NotImplementedError

    @property
    def centre(self) -> float:
        """Expected value."""
        return self.mean

    def scaled(self, factor: float) -> Self:
        """The same distribution with its width, but not its centre, multiplied.

        Raises
        ------
        InputError
            If the factor is not a finite number above 0.
        DesignError
            If a width becomes larger or smaller than a width can be.
        """
        check_factor(factor)
        return self.replaced(**{name: factor * getattr(self, name) for name in self.widths})


def check_factor(factor: float) -> None:
    """Refuse what no width can be multiplied by."""
    if not 0.0 < factor < math.inf:
        raise InputError(f"scale = {factor!r}: must be a finite number above 0")
