"""Effect of compensators on predicted wavefronts.

A compensator adapts the reconstruction's model, whose path is subtracted from that of the lens as built. The
derivatives of the model by its compensators are therefore appended to those of the lens by its perturbations,
with the opposite sign and without products of both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from tolerancing.merits.compensators import GAUSS_NEWTON_STEPS, regularised
from tolerancing.prediction.derivatives import FieldDifferentials
from tolerancing.prediction.system import pair_places


@dataclass(frozen=True, eq=False)
class Compensation:
    """The k compensators of lenses whose wavefronts are predicted, for d changes of the lens.

    Attributes
    ----------
    limits : ndarray, shape (k,)
        Largest absolute value of each compensator.
    fields, models : tuple of FieldDifferentials
        Derivatives by the changes of the lens and by the compensators of the model, at the object points that
        determine the compensators.
    """

    limits: Array
    fields: tuple[FieldDifferentials, ...]
    models: tuple[FieldDifferentials, ...]

    def values(self, amounts: Array) -> Array:
        """Return the values that minimise the wavefronts of trials within the limits, shape (trials, k).

        :func:`tolerancing.merits.compensators.compensate` fits the same values to a trial's pupils.

        Parameters
        ----------
        amounts : ndarray, shape (trials, d)
            Amount of each change in each trial.
        """
        shares = np.zeros((len(amounts), len(self.limits)))
        if not len(self.limits):
            return shares
        slopes = [model.registered * self.limits for model in self.models]
        matrix = np.sum(
            [(own.T * m.weights) @ own for own, m in zip(slopes, self.models, strict=True)], axis=0
        )
        steady = regularised(matrix)
        waves = [field.waves(amounts) for field in self.fields]
        for _ in range(GAUSS_NEWTON_STEPS):
            right_side = np.zeros_like(shares)
            for whole, model, own in zip(waves, self.models, slopes, strict=True):
                right_side += (whole - model.waves(shares * self.limits)) * model.weights @ own
            shares, _ = bounded_least_squares(steady, right_side + shares @ steady)
        return shares * self.limits

    def following(self, count: int) -> Array:
        """Return the first-order response of lens and compensators to the changes, shape (d + k, d)."""
        changes = np.eye(count)
        if not len(self.limits):
            return changes
        pairs = list(zip(self.fields, self.models, strict=True))
        matrix = np.sum([(m.registered.T * m.weights) @ m.registered for _, m in pairs], axis=0)
        right_side = np.sum([(m.registered.T * m.weights) @ f.registered for f, m in pairs], axis=0)
        return np.concatenate([changes, np.linalg.solve(regularised(matrix), right_side)])


def less_model(field: FieldDifferentials, model: FieldDifferentials) -> FieldDifferentials:
    """Return derivatives by d changes of the lens, followed by those by k compensators of the model."""
    d, k = field.first.shape[1], model.first.shape[1]
    first = np.concatenate([field.first, -model.first], axis=1)
    if not field.second.shape[1]:
        return replace(field, first=first)
    second = np.zeros((len(first), (d + k) * (d + k + 1) // 2))
    i, j = np.triu_indices(d)
    second[:, pair_places(d + k, i, j)] = field.second
    i, j = np.triu_indices(k)
    second[:, pair_places(d + k, d + i, d + j)] = -model.second
    return replace(field, first=first, second=second)


def bounded_least_squares(matrix: Array, right_side: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Minimize x^T N x / 2 - w^T x within -1 and 1 for many w at once.

    Block principal pivoting (Portugal, Judice and Vicente, Math. Comp. 63, 625, 1994): bound variables whose
    gradient points inwards are freed, and free variables beyond a bound are bound, until neither occurs.

    Parameters
    ----------
    matrix : ndarray, shape (k, k)
        Positive definite.
    right_side : ndarray, shape (t, k)

    Returns
    -------
    values : ndarray, shape (t, k)
    free : ndarray of bool, shape (t, k)
    """
    count = right_side.shape[1]
    bound = np.zeros(right_side.shape)  # -1, 1 where bound, 0 where free
    values = np.zeros(right_side.shape)
    left = np.arange(len(right_side))
    # Largest number of exchanges between free and bound compensators.
    most_pivots = 60
    # Number of exchanges after which only one compensator changes at a time, which converges (Murty, 1974).
    all_at_once = 10
    for turn in range(most_pivots):
        patterns, own = np.unique(bound[left], axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            rows, free = left[own.ravel() == number], pattern == 0.0
            values[rows] = pattern
            if np.any(free):
                rest = right_side[np.ix_(rows, free)] - pattern[~free] @ matrix[np.ix_(~free, free)]
                part = matrix[np.ix_(free, free)]
                values[np.ix_(rows, free)] = np.linalg.solve(part, rest.T).T
        at, slope = bound[left], right_side[left] - values[left] @ matrix
        beyond = np.where((at == 0.0) & (np.abs(values[left]) > 1.0), np.sign(values[left]), 0.0)
        inward = (at != 0.0) & (slope * at < 0.0)
        wrong = (beyond != 0.0) | inward
        going = np.any(wrong, axis=1)
        if not np.any(going):
            break
        if turn >= all_at_once:
            last = count - 1 - np.argmax(wrong[:, ::-1], axis=1)
            wrong &= np.arange(count) == last[:, None]
        bound[left] = np.where(wrong, beyond, at)
        left = left[going]
    return np.clip(values, -1.0, 1.0), bound == 0.0
