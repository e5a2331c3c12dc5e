"""Base class of distributions: quantiles, a centre, a standard deviation and a tolerance.

A distribution turns a probability into a value. The modules that make the probabilities
(:mod:`tolerancing.perturbations.draws`, :mod:`tolerancing.perturbations.dependence`) therefore do not depend
on the shapes of the distributions.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import ClassVar, Self

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import FiniteNumber, FrozenModel
from lensdesign.errors import InputError


class Distribution(FrozenModel):
    """Base class of the distributions of a perturbation's deviations.

    All values are in the unit of the perturbed parameter. :data:`tolerancing.perturbations.DISTRIBUTIONS`
    lists the distributions.

    Attributes
    ----------
    mean
        Systematic deviation from nominal, about which the parts scatter.

    Examples
    --------
    >>> from tolerancing.perturbations.distributions import Uniform
    >>> thickness = Uniform(half_width=0.02)
    >>> thickness.quantile(0.75), round(thickness.standard_deviation, 4)
    (0.01, 0.0115)
    """

    kind: ClassVar[str]
    widths: ClassVar[tuple[str, ...]]

    mean: FiniteNumber = 0.0

    @property
    def file_name(self) -> str | None:
        """Name of the file that the distribution reads, relative to the study; None if it reads no file."""
        return None

    def loaded(self, folder: Path) -> Self:
        """Return the distribution with the data of its file, read relative to `folder`."""
        return self

    def quantile(self, probability: Array) -> Array:
        """Return the value below which a fraction `probability` (0 to 1) of all parts lies."""
        raise NotImplementedError

    @property
    def standard_deviation(self) -> float:
        """Standard deviation."""
        raise NotImplementedError

    @property
    def largest(self) -> float:
        """Largest deviation from the centre, of either sign, that counts as the tolerance."""
        raise NotImplementedError

    @property
    def centre(self) -> float:
        """Expected value."""
        return self.mean

    def scaled(self, factor: float) -> Self:
        """Return the same distribution with its width multiplied and its centre unchanged.

        Raises
        ------
        InputError
            If the factor is not a finite number above 0.
        DesignError
            If a width leaves its allowed range.
        """
        check_factor(factor)
        return self.replaced(**{name: factor * getattr(self, name) for name in self.widths})


def check_factor(factor: float) -> None:
    """Raise an InputError unless `factor` is a finite number above 0."""
    if not 0.0 < factor < math.inf:
        raise InputError(f"scale = {factor!r}: must be a finite number above 0")
