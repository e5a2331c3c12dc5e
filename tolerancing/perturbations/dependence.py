"""Dependent perturbations: groups that share one draw, and a Gaussian copula for correlations.

Both act on probabilities, before distributions turn them into values, so every perturbation keeps its own
distribution. For a correlation, probabilities become normal scores, a factor of the correlation matrix mixes
the scores, and the results become probabilities again (Nelsen, An Introduction to Copulas, Springer 2006,
section 2.8). A coefficient r then gives a rank correlation of 6/pi asin(r/2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, field_validator, model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import FrozenModel
from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import DesignError
from tolerancing.perturbations.draws import LARGEST, SMALLEST, probabilities
from tolerancing.perturbations.parameters import UNITS, Perturbation, with_unit

Coefficient = Annotated[float, Field(ge=-1.0, le=1.0, allow_inf_nan=False)]

ROUNDING = 1e-9
"""Rounding error of the entries of a correlation matrix that is accepted."""


class Correlation(FrozenModel):
    """Perturbations whose deviations are correlated; a ``[[correlation]]`` table.

    Attributes
    ----------
    names
        Columns of the perturbations, with or without their unit.
    coefficient
        Correlation coefficient of every pair.
    matrix
        Correlation matrix by rows, in place of a single coefficient.

    Examples
    --------
    >>> Correlation(names=("a", "b"), coefficient=0.5).full_matrix()
    array([[1. , 0.5],
           [0.5, 1. ]])
    """

    names: Annotated[tuple[str, ...], Field(min_length=2)]
    coefficient: Coefficient | None = None
    matrix: tuple[tuple[Coefficient, ...], ...] | None = None

    @field_validator("names")
    @classmethod
    def _distinct(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        repeated = _repeated(value)
        if repeated:
            raise ValueError(f"{repeated} is given twice; give each perturbation once")
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
        """Return the correlation matrix, in the order of `names`."""
        if self.matrix is not None:
            return np.array(self.matrix)
        count = len(self.names)
        return np.full((count, count), self.coefficient) + (1.0 - (self.coefficient or 0.0)) * np.eye(count)


@dataclass(frozen=True)
class Dependence:
    """Dependences between the columns of a study.

    Attributes
    ----------
    leaders
        Pairs of a column's index and the index of the column whose draw it shares.
    mixtures
        For each correlation the indices of its columns and its lower triangular factor by rows.
    """

    leaders: tuple[tuple[int, int], ...] = ()
    mixtures: tuple[tuple[tuple[int, ...], tuple[tuple[float, ...], ...]], ...] = ()

    def apply(self, probability: Array) -> Array:
        """Make independent probabilities dependent.

        Parameters
        ----------
        probability
            Shape (trials, columns), each within (0, 1). A trial's result depends only on its own row.

        Returns
        -------
        ndarray, shape (trials, columns)
            Dependent probabilities. Each column is still uniform; independent columns are unchanged.
        """
        from scipy.special import ndtr, ndtri

        result = np.array(probability, dtype=float)
        for column, leader in self.leaders:
            result[:, column] = probability[:, leader]
        for columns, factor in self.mixtures:
            scores = [np.asarray(ndtri(probability[:, column])) for column in columns]
            for column, row in zip(columns, factor, strict=True):
                # Unlike a matrix product, these sums round alike for any number of trials.
                mixed = sum(weight * score for weight, score in zip(row, scores, strict=True) if weight)
                result[:, column] = np.clip(ndtr(mixed), SMALLEST, LARGEST)
        return result


def study_dependence(
    columns: Sequence[str],
    correlations: Sequence[Correlation],
    groups: Mapping[str, Sequence[str]],
) -> Dependence:
    """Return the dependence of a study's perturbations.

    Parameters
    ----------
    columns
        Columns of the perturbations, in their order.
    correlations
        Correlations of the study.
    groups
        Names of groups and the columns of each group, which share the draw of the first. As in
        `correlations`, a column may be named without its unit.

    Raises
    ------
    DesignError
        If a name matches no column or several, or is in more than one group or correlation, or if a group has
        fewer than two members.
    """
    used_by: dict[int, str] = {}
    leaders, mixtures = [], []
    for group, names in groups.items():
        indices = _column_indices(names, columns, f"group {group!r}", used_by)
        if len(indices) < 2:
            has = f"one member, {names[0]!r}" if names else "no members"
            raise DesignError(f"group {group!r}: has {has}: must be at least 2")
        leaders += [(index, indices[0]) for index in indices[1:]]
    for number, correlation in enumerate(correlations, start=1):
        indices = _column_indices(correlation.names, columns, f"correlation {number}", used_by)
        factor = lower_factor(correlation.full_matrix())
        mixtures.append((indices, tuple(tuple(row) for row in factor.tolist())))
    return Dependence(tuple(leaders), tuple(mixtures))


def lower_factor(matrix: Array) -> Array:
    """Return the Cholesky factor of a correlation matrix that may be singular; its rows have length 1."""
    count = len(matrix)
    factor = np.zeros((count, count))
    for k in range(count):
        pivot = matrix[k, k] - factor[k, :k] @ factor[k, :k]
        # With a smaller fraction of its variance left, a perturbation follows from those before it.
        if pivot > 1e-12:
            factor[k, k] = np.sqrt(pivot)
            for i in range(k + 1, count):
                factor[i, k] = (matrix[i, k] - factor[i, :k] @ factor[k, :k]) / factor[k, k]
    return factor / np.sqrt(np.sum(factor**2, axis=1, keepdims=True))


def _column_indices(
    names: Sequence[str], columns: Sequence[str], source: str, used_by: dict[int, str]
) -> tuple[int, ...]:
    """Return the indices of named columns and mark them as used by `source`."""
    indices = []
    for name in names:
        index = _column_index(name, columns, source)
        if index in used_by:
            both = (
                f"twice in {source}" if used_by[index] == source else f"in {used_by[index]} and in {source}"
            )
            raise DesignError(
                f"{name!r} is given {both}; a perturbation can be in one group or correlation only"
            )
        used_by[index] = source
        indices.append(index)
    return tuple(indices)


def _column_index(name: str, columns: Sequence[str], source: str) -> int:
    if name in columns:
        return list(columns).index(name)
    matches = [column for column in columns if column in {with_unit(name, unit) for unit in UNITS}]
    if len(matches) == 1:
        return list(columns).index(matches[0])
    if matches:
        raise DesignError(f"{source}: {name!r} may be {' or '.join(matches)}; give the unit too")
    listed = ", ".join(columns) + did_you_mean(name, columns)
    raise DesignError(f"{source}: there is no perturbation {name!r}; allowed: {listed}")


def _check_coefficient(coefficient: float, count: int) -> None:
    lowest = -1.0 / (count - 1)
    if coefficient < lowest - ROUNDING:
        raise ValueError(
            f"coefficient = {coefficient:g}: impossible for every pair of {count} perturbations; "
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
        factor = np.floor(1e4 / (1.0 - smallest)) / 1e4
        raise ValueError(
            f"matrix: is not a correlation matrix: its smallest eigenvalue is {smallest:.4g}: must not be "
            f"negative; multiply all entries off the diagonal by {factor:.4f}"
        )


def _repeated(names: Sequence[str]) -> str | None:
    return next((repr(name) for i, name in enumerate(names) if name in names[:i]), None)


def sample_values(
    perturbations: Sequence[Perturbation],
    dependence: Dependence,
    draws: str,
    seed: int,
    trials: Sequence[int],
    planned: int,
) -> Array:
    """Return the deviations of trials, shape (trials, perturbations).

    Parameters
    ----------
    perturbations, dependence
        Distributions, and dependences between them.
    draws, seed, planned
        Sampling method, seed and number of trials of the study.
    trials
        Numbers of the trials.
    """
    drawn = dependence.apply(probabilities(draws, seed, trials, len(perturbations), planned))
    return np.column_stack([p.distribution.quantile(drawn[:, k]) for k, p in enumerate(perturbations)])
