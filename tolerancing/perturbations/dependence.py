"""What scatters together: groups that move as one, and a Gaussian copula for correlated perturbations.

Both act on probabilities, before distributions turn them into values, so that every perturbation keeps its
own distribution. Correlated probabilities u become normal scores, are mixed by a factor of the correlation
matrix, and become probabilities again (Nelsen, An Introduction to Copulas, Springer 2006, section 2.8); a
coefficient r then shows as a rank correlation of 6/pi asin(r/2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, field_validator, model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.section import Section, rows, tuples
from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import DesignError
from tolerancing.perturbations.draws import LARGEST, SMALLEST
from tolerancing.perturbations.parameters import UNITS, with_unit

Coefficient = Annotated[float, Field(ge=-1.0, le=1.0, allow_inf_nan=False)]

ROUNDING = 1e-9
"""How far the numbers of a correlation matrix may be off before it counts as none."""

SMALLEST_PIVOT = 1e-12
"""Share of its variance below which a perturbation follows from those before it."""


class Correlation(Section):
    """Perturbations whose deviations are correlated; a ``[[correlation]]`` table.

    Attributes
    ----------
    names
        Columns of the perturbations, with or without their unit.
    coefficient
        Correlation of each with each other.
    matrix
        Correlation of each with each other, by rows, in place of one coefficient.
    """

    names: Annotated[tuple[str, ...], Field(min_length=2)]
    coefficient: Coefficient | None = None
    matrix: tuple[tuple[Coefficient, ...], ...] | None = None

    _lists = field_validator("names", mode="before")(tuples)

    _rows = field_validator("matrix", mode="before")(rows)

    @field_validator("names")
    @classmethod
    def _distinct(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        repeated = _repeated(value)
        if repeated:
            raise ValueError(f"{repeated} stands twice")
        return value

    @model_validator(mode="after")
    def _is_correlation(self) -> Correlation:
        if (self.coefficient is None) == (self.matrix is None):
            given = "both are given" if self.matrix is not None else "both are missing"
            raise ValueError(f"give one of coefficient and matrix; {given}")
        if self.coefficient is not None:
            _check_coefficient(self.coefficient, len(self.names))
        else:
            _check_shape(self.matrix or (), len(self.names))
            _check_symmetric(self.full_matrix(), self.names)
            _check_positive(self.full_matrix())
        return self

    def full_matrix(self) -> Array:
        """The correlation matrix, in the order of `names`."""
        if self.matrix is not None:
            return np.array(self.matrix)
        count = len(self.names)
        return np.full((count, count), self.coefficient) + (1.0 - (self.coefficient or 0.0)) * np.eye(count)


@dataclass(frozen=True)
class Dependence:
    """What the columns of a study have to do with each other.

    Attributes
    ----------
    leaders
        Pairs of a column's index and that of the column that it moves with.
    mixtures
        For each correlation the indices of its columns, and its lower triangular factor by rows.
    """

    leaders: tuple[tuple[int, int], ...] = ()
    mixtures: tuple[tuple[tuple[int, ...], tuple[tuple[float, ...], ...]], ...] = ()

    def apply(self, probability: Array) -> Array:
        """Make independent probabilities dependent.

        Parameters
        ----------
        probability
            Shape (trials, columns), each within (0, 1). A trial's result depends on its own row alone.

        Returns
        -------
        ndarray, shape (trials, columns)
            Each column still uniform; those that depend on no other as they were.
        """
        from scipy.special import ndtr, ndtri

        result = np.array(probability, dtype=float)
        for place, leader in self.leaders:
            result[:, place] = probability[:, leader]
        for places, factor in self.mixtures:
            scores = [np.asarray(ndtri(probability[:, place])) for place in places]
            for place, row in zip(places, factor, strict=True):
                # Unlike a matrix product's, these sums come out alike however many trials there are.
                mixed = sum(share * score for share, score in zip(row, scores, strict=True) if share)
                result[:, place] = np.clip(ndtr(mixed), SMALLEST, LARGEST)
        return result


def study_dependence(
    columns: Sequence[str],
    correlations: Sequence[Correlation],
    groups: Mapping[str, Sequence[str]],
) -> Dependence:
    """The dependence of a study's perturbations.

    Parameters
    ----------
    columns
        Columns of the perturbations, in their order.
    correlations
        What is correlated.
    groups
        By the group's name, columns that move together: all take the probability of the first. As in
        `correlations`, a column may be named without its unit.

    Raises
    ------
    DesignError
        If a name is that of no column or of several, or stands in more than one group or correlation, or
        if a group has fewer than two members.
    """
    taken: dict[int, str] = {}
    leaders, mixtures = [], []
    for group, names in groups.items():
        places = _places(names, columns, f"group {group!r}", taken)
        if len(places) < 2:
            has = f"one member, {names[0]!r}" if names else "no members"
            raise DesignError(f"group {group!r}: has {has}: must be at least 2")
        leaders += [(place, places[0]) for place in places[1:]]
    for number, correlation in enumerate(correlations, start=1):
        places = _places(correlation.names, columns, f"correlation {number}", taken)
        factor = lower_factor(correlation.full_matrix())
        mixtures.append((places, tuple(tuple(row) for row in factor.tolist())))
    return Dependence(tuple(leaders), tuple(mixtures))


def lower_factor(matrix: Array) -> Array:
    """Lower triangular factor L of a correlation matrix L L', which may be singular; rows of length 1."""
    count = len(matrix)
    factor = np.zeros((count, count))
    for k in range(count):
        pivot = matrix[k, k] - factor[k, :k] @ factor[k, :k]
        if pivot > SMALLEST_PIVOT:
            factor[k, k] = np.sqrt(pivot)
            for i in range(k + 1, count):
                factor[i, k] = (matrix[i, k] - factor[i, :k] @ factor[k, :k]) / factor[k, k]
    return factor / np.sqrt(np.sum(factor**2, axis=1, keepdims=True))


def _places(
    names: Sequence[str], columns: Sequence[str], where: str, taken: dict[int, str]
) -> tuple[int, ...]:
    """Indices of named columns, none of which may be taken already; they then are."""
    places = []
    for name in names:
        place = _place(name, columns, where)
        if place in taken:
            before = f"twice in {where}" if taken[place] == where else f"in {taken[place]} and in {where}"
            raise DesignError(
                f"{name!r} stands {before}; a perturbation can depend on others in one way only"
            )
        taken[place] = where
        places.append(place)
    return tuple(places)


def _place(name: str, columns: Sequence[str], where: str) -> int:
    if name in columns:
        return list(columns).index(name)
    meant = [column for column in columns if column in {with_unit(name, unit) for unit in UNITS}]
    if len(meant) == 1:
        return list(columns).index(meant[0])
    if meant:
        raise DesignError(f"{where}: {name!r} may be {' or '.join(meant)}; give the unit too")
    listed = ", ".join(columns) + did_you_mean(name, columns)
    raise DesignError(f"{where}: there is no perturbation {name!r}; allowed: {listed}")


def _check_coefficient(coefficient: float, count: int) -> None:
    lowest = -1.0 / (count - 1)
    if coefficient < lowest - ROUNDING:
        raise ValueError(
            f"coefficient = {coefficient:g}: {count} perturbations cannot all be correlated so; "
            f"allowed: {lowest:.4g} to 1"
        )


def _check_shape(matrix: Sequence[Sequence[float]], count: int) -> None:
    if len(matrix) != count:
        raise ValueError(f"matrix has {len(matrix)} rows; there are {count} names: must be as many")
    for number, row in enumerate(matrix, start=1):
        if len(row) != count:
            raise ValueError(
                f"matrix, row {number}: holds {len(row)} numbers; there are {count} names: must be as many"
            )


def _check_symmetric(matrix: Array, names: Sequence[str]) -> None:
    for i, name in enumerate(names):
        if abs(matrix[i, i] - 1.0) > ROUNDING:
            raise ValueError(f"matrix: {name} with itself is {matrix[i, i]:g}: must be 1")
        for j in range(i):
            if abs(matrix[i, j] - matrix[j, i]) > ROUNDING:
                raise ValueError(
                    f"matrix: {names[j]} with {name} is {matrix[j, i]:g}, but {name} with {names[j]} is "
                    f"{matrix[i, j]:g}: must be equal"
                )


def _check_positive(matrix: Array) -> None:
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if smallest < -ROUNDING:
        share = np.floor(1e4 / (1.0 - smallest)) / 1e4
        raise ValueError(
            f"matrix: nothing can be correlated so: its smallest eigenvalue is {smallest:.4g}: must not be "
            f"negative; with all off the diagonal multiplied by {share:.4f} it is a correlation matrix"
        )


def _repeated(names: Sequence[str]) -> str | None:
    return next((repr(name) for i, name in enumerate(names) if name in names[:i]), None)
