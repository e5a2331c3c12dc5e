"""Wavefronts of drawn lenses once compensators are taken out, with exact derivatives.

With the amounts a of a lens's perturbations and the values x of the compensators, the mean square at an
object point p is z^T Q_p z, z = (a, x). The compensators make the sum over the object points that determine
them, z^T C z, as small as it gets within their limits. Those at a limit stay there; for the free ones
(C z)_f = 0, so a change of the lens moves them by dx_f = -C_ff^-1 (dC z)_f, and

    d(z^T Q_p z) = z^T dQ_p z - 2 l^T dC z,    l_f = C_ff^-1 (Q_p z)_f, 0 elsewhere.

Where Q_p is C itself the second term vanishes (the envelope theorem); at a single object point it does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from tolerancing.merits.compensators import steadied
from tolerancing.wavefronts.goals.joint import WAVEFRONT_SOFTNESS

MOST_PIVOTS = 60
"""Exchanges between free and bound compensators; a few suffice, and each lens ends where it has come to."""

ALL_AT_ONCE = 10
"""Exchanges after which compensators change over one at a time, which ends surely (Murty, 1974)."""


@dataclass(frozen=True, eq=False)
class CompensatedWaves:
    """Mean squares of drawn lenses at object points; t lenses, d changes, k compensators, v variables.

    Attributes
    ----------
    forms, forms_by : ndarray, shapes (p, d + k, d + k) and (v, p, d + k, d + k)
        Quadratic forms at all object points.
    total, total_by : ndarray, shapes (d + k, d + k) and (v, d + k, d + k)
        Their sum over the object points that determine the compensators.
    amounts : ndarray, shape (t, d)
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
        """Amounts and compensators' values, shape (t, d + k), and which of the latter are free."""
        d, limits = self.amounts.shape[1], self.limits
        if not len(limits):
            return self.amounts, np.zeros((len(self.amounts), 0), bool)
        wanted = -(self.amounts @ self.total[:d, d:]) * limits
        shares, free = bounded_least_squares(self._normal, wanted)
        return np.concatenate([self.amounts, shares * limits], axis=1), free

    @cached_property
    def _normal(self) -> Array:
        """Normal equations of the compensators' values as fractions of their limits."""
        d = self.amounts.shape[1]
        return steadied(self.total[d:, d:] * self.limits * self.limits[:, None])

    @property
    def together(self) -> Array:
        """Amounts of the changes and values of the compensators, shape (t, d + k)."""
        return self._solved[0]

    def squares(self, point: int) -> Array:
        """Mean square of each lens at one object point, shape (t,)."""
        return np.asarray(np.sum((self.together @ self.forms[point]) * self.together, axis=1))

    def weighted(self, point: int, weights: Array) -> Array:
        """Derivatives of the sum of the mean squares with these weights, shape (v,)."""
        together, free = self._solved
        moments = (together.T * weights) @ together
        by = np.einsum("vde,de->v", self.forms_by[:, point], moments)
        if len(self.limits):
            pulled = self._adjoint(together @ self.forms[point], free)
            crossed = (pulled.T * weights) @ together
            by -= 2.0 * np.einsum("vde,de->v", self.total_by[:, -len(self.limits) :], crossed)
        return np.asarray(by)

    def _adjoint(self, response: Array, free: NDArray[np.bool_]) -> Array:
        """The vectors l of each lens, shape (t, k)."""
        wanted = response[:, -len(self.limits) :] * self.limits
        found = np.zeros_like(wanted)
        patterns, own = np.unique(free, axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            rows = np.flatnonzero(own.ravel() == number)
            if np.any(pattern):
                part = self._normal[np.ix_(pattern, pattern)]
                found[np.ix_(rows, pattern)] = np.linalg.solve(part, wanted[np.ix_(rows, pattern)].T).T
        return found * self.limits


@dataclass(frozen=True, eq=False)
class WavefrontLoads:
    """Loads on a limit of the wavefront at one object point.

    Attributes
    ----------
    waves : CompensatedWaves
    point : int
        Which of its object points.
    limit_waves : float
    """

    waves: CompensatedWaves
    point: int
    limit_waves: float
    softness: float | None = WAVEFRONT_SOFTNESS
    sign: float = 1.0

    @cached_property
    def loads(self) -> Array:
        """Mean squares over the limit's square."""
        return self.waves.squares(self.point) / self.limit_waves**2

    def weighted(self, weights: Array) -> Array:
        """Derivatives of the sum of the loads with these weights, shape (v,)."""
        return self.waves.weighted(self.point, weights / self.limit_waves**2)


def bounded_least_squares(matrix: Array, wanted: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Minimize x^T N x / 2 - w^T x within -1 and 1 for many w at once.

    Block principal pivoting (Portugal, Judice and Vicente, Math. Comp. 63, 625, 1994): bound variables whose
    gradient points inwards are freed and free ones beyond a bound are bound, until there are none.

    Parameters
    ----------
    matrix : ndarray, shape (k, k)
        Positive definite.
    wanted : ndarray, shape (t, k)

    Returns
    -------
    values : ndarray, shape (t, k)
    free : ndarray of bool, shape (t, k)
    """
    count = wanted.shape[1]
    bound = np.zeros(wanted.shape)  # -1, 1 where bound, 0 where free
    values = np.zeros(wanted.shape)
    left = np.arange(len(wanted))
    for turn in range(MOST_PIVOTS):
        patterns, own = np.unique(bound[left], axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            rows, free = left[own.ravel() == number], pattern == 0.0
            values[rows] = pattern
            if np.any(free):
                rest = wanted[np.ix_(rows, free)] - pattern[~free] @ matrix[np.ix_(~free, free)]
                part = matrix[np.ix_(free, free)]
                values[np.ix_(rows, free)] = np.linalg.solve(part, rest.T).T
        at, slope = bound[left], wanted[left] - values[left] @ matrix
        beyond = np.where((at == 0.0) & (np.abs(values[left]) > 1.0), np.sign(values[left]), 0.0)
        inward = (at != 0.0) & (slope * at < 0.0)
        wrong = (beyond != 0.0) | inward
        going = np.any(wrong, axis=1)
        if not np.any(going):
            break
        if turn >= ALL_AT_ONCE:
            last = count - 1 - np.argmax(wrong[:, ::-1], axis=1)
            wrong &= np.arange(count) == last[:, None]
        bound[left] = np.where(wrong, beyond, at)
        left = left[going]
    return np.clip(values, -1.0, 1.0), bound == 0.0
