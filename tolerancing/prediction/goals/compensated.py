"""Wavefronts of drawn lenses after compensation, with exact derivatives.

With the amounts a of a lens's perturbations and the values x of the compensators, the mean square at an
object point p is z^T Q_p z, z = (a, x). The compensators minimize z^T C z, the sum over the object points
that determine them, within their limits. Compensators at a limit do not change. The free ones (index f)
satisfy (C z)_f = 0, so a change of the lens changes them by dx_f = -C_ff^-1 (dC z)_f, and

    d(z^T Q_p z) = z^T dQ_p z - 2 l^T dC z,    l_f = C_ff^-1 (Q_p z)_f, 0 elsewhere.

The second term vanishes if Q_p = C (envelope theorem), but not at a single one of several object points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from tolerancing.merits.compensators import regularised
from tolerancing.prediction.compensation import bounded_least_squares
from tolerancing.prediction.goals.joint_yield import WAVEFRONT_SOFTNESS


@dataclass(frozen=True, eq=False)
class CompensatedWaves:
    """Mean squares of t drawn lenses at p object points; d changes, k compensators, v variables.

    Attributes
    ----------
    forms, forms_by : ndarray, shapes (p, d + k, d + k) and (v, p, d + k, d + k)
        Quadratic forms at all object points.
    total, total_by : ndarray, shapes (d + k, d + k) and (v, d + k, d + k)
        Their sum over the object points that determine the compensators.
    amounts : ndarray, shape (t, d)
        Amount of each change in each lens.
    limits : ndarray, shape (k,)
        Largest value of each compensator.
    """

    forms: Array
    forms_by: Array
    total: Array
    total_by: Array
    amounts: Array
    limits: Array

    @cached_property
    def _solved(self) -> tuple[Array, NDArray[np.bool_]]:
        """Amounts and values of the compensators, shape (t, d + k), and which compensators are free."""
        d, limits = self.amounts.shape[1], self.limits
        if not len(limits):
            return self.amounts, np.zeros((len(self.amounts), 0), bool)
        right_side = -(self.amounts @ self.total[:d, d:]) * limits
        fractions, free = bounded_least_squares(self._normal, right_side)
        return np.concatenate([self.amounts, fractions * limits], axis=1), free

    @cached_property
    def _normal(self) -> Array:
        """Matrix of the normal equations for the compensators as fractions of their limits."""
        d = self.amounts.shape[1]
        return regularised(self.total[d:, d:] * self.limits * self.limits[:, None])

    @property
    def together(self) -> Array:
        """Return the amounts of the changes and values of the compensators, shape (t, d + k)."""
        return self._solved[0]

    def squares(self, point: int) -> Array:
        """Return the mean square of each lens at one object point, shape (t,)."""
        return np.asarray(np.sum((self.together @ self.forms[point]) * self.together, axis=1))

    def weighted(self, point: int, weights: Array) -> Array:
        """Return derivatives of the weighted sum of the mean squares by the variables, shape (v,)."""
        together, free = self._solved
        moments = (together.T * weights) @ together
        by = np.tensordot(self.forms_by[:, point], moments, 2)
        if len(self.limits):
            multipliers = self._adjoint(together @ self.forms[point], free)
            crossed = (multipliers.T * weights) @ together
            by = by - 2.0 * np.tensordot(self.total_by[:, -len(self.limits) :], crossed, 2)
        return np.asarray(by)

    def _adjoint(self, response: Array, free: NDArray[np.bool_]) -> Array:
        """Return the vector l of each lens, shape (t, k)."""
        right_side = response[:, -len(self.limits) :] * self.limits
        found = np.zeros_like(right_side)
        patterns, own = np.unique(free, axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            rows = np.flatnonzero(own.ravel() == number)
            if np.any(pattern):
                part = self._normal[np.ix_(pattern, pattern)]
                found[np.ix_(rows, pattern)] = np.linalg.solve(part, right_side[np.ix_(rows, pattern)].T).T
        return found * self.limits


@dataclass(frozen=True, eq=False)
class WavefrontLoads:
    """Loads on a limit of the wavefront at one object point.

    Attributes
    ----------
    waves : CompensatedWaves
    point : int
        Index of the object point.
    limit_waves : float
    """

    waves: CompensatedWaves
    point: int
    limit_waves: float
    softness: float | None = WAVEFRONT_SOFTNESS
    sign: float = 1.0

    @cached_property
    def loads(self) -> Array:
        """Mean squares divided by the square of the limit."""
        return self.waves.squares(self.point) / self.limit_waves**2

    def weighted(self, weights: Array) -> Array:
        """Return derivatives of the weighted sum of the loads by the variables, shape (v,)."""
        return self.waves.weighted(self.point, weights / self.limit_waves**2)
