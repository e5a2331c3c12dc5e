"""Response surface: a second-order model of the merits over all perturbations, fitted to trials.

The model is fast to evaluate, and its error for new trials is known by cross-validation.

References: Box and Wilson 1951 (response surfaces); Hoerl and Kennard 1970 (ridge regression); Allen 1974
(leave-one-out error in closed form, PRESS).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError

Scorer = Callable[[Array], Array]
"""Function from deviations, shape (n, perturbations), to scores, shape (n, merits); NaN without a score."""

TRIALS_PER_TERM = 3
"""Smallest number of trials for each term of a model."""

PENALTIES = tuple(10.0**power for power in range(-8, 2))
"""Candidate ridge penalties, relative to the mean square of the terms."""


@dataclass(frozen=True)
class Response:
    """Model of m merits over d perturbations, with t terms and a constant.

    Attributes
    ----------
    centre, spread : ndarray, shape (d,)
        Mean and standard deviation of the fitted deviations. Terms are made of (x - centre) / spread.
    order
        1 for linear terms, 2 for linear terms and squares, 3 for products of two perturbations as well.
    constant : ndarray, shape (m,)
        Constant of each merit, in the merit's unit.
    coefficients : ndarray, shape (t, m)
        Coefficients of linear terms, squares and products, in this order.
    r_squared : ndarray, shape (m,)
        Fraction of the variance of the fitted scores that the model explains.
    cross_validated_r_squared : ndarray, shape (m,)
        The same fraction for trials that are excluded from the fit one at a time. It is the accuracy to
        expect for new trials. Below 0 the model is worse than the mean.
    used, left_out : ndarray, shape (m,)
        Number of trials in the fit, and number of trials without a score.
    """

    centre: Array
    spread: Array
    order: int
    constant: Array
    coefficients: Array
    r_squared: Array
    cross_validated_r_squared: Array
    used: NDArray[np.intp]
    left_out: NDArray[np.intp]

    def predict(self, values: ArrayLike) -> Array:
        """Return predicted scores, shape (n, m), for deviations of shape (n, d). The method is a `Scorer`."""
        x = (np.atleast_2d(np.asarray(values, float)) - self.centre) / self.spread
        scores = np.empty((len(x), len(self.constant)))
        rows_at_once = 4096  # The terms of all rows together may not fit in memory.
        for first in range(0, len(x), rows_at_once):
            chunk = slice(first, first + rows_at_once)
            scores[chunk] = self.constant + _terms(x[chunk], self.order) @ self.coefficients
        return scores

    def slopes(self, values: ArrayLike) -> Array:
        """Return the derivatives of the scores by the deviations, shape (n, m, d)."""
        x = (np.atleast_2d(np.asarray(values, float)) - self.centre) / self.spread
        linear = self.coefficients[: len(self.centre)].T[None]
        return np.asarray((linear + np.einsum("ni,mij->nmj", x, self._squares, optimize=True)) / self.spread)

    def sizes(self, values: ArrayLike) -> tuple[Array, Array]:
        """Return how large the deviations are on which each merit depends, and derivatives by the deviations.

        Returns
        -------
        sizes : ndarray, shape (n, m)
            Mean square of the deviations relative to their spread in the fitted trials, weighted by the
            variance of the merit that they cause by the model.
        by : ndarray, shape (n, m, d)
            Derivatives by the deviations.
        """
        x = (np.atleast_2d(np.asarray(values, float)) - self.centre) / self.spread
        linear = self.coefficients[: len(self.centre)].T
        variances = linear**2 + 0.5 * np.sum(self._squares**2, axis=2)
        total = variances.sum(axis=1, keepdims=True)
        weights = np.where(total > 0.0, variances / np.where(total > 0.0, total, 1.0), 1.0 / x.shape[1])
        return x**2 @ weights.T, 2.0 * x[:, None] * weights / self.spread

    @property
    def _squares(self) -> Array:
        """Second derivatives of each merit by the standardized deviations, shape (m, d, d)."""
        d, merits = len(self.centre), len(self.constant)
        found = np.zeros((merits, d, d))
        if self.order >= 2:
            found[:, np.arange(d), np.arange(d)] = 2.0 * self.coefficients[d : 2 * d].T
        if self.order >= 3:
            first, second = np.triu_indices(d, 1)
            found[:, first, second] = found[:, second, first] = self.coefficients[2 * d :].T
        return found


def fit_response(values: ArrayLike, scores: ArrayLike) -> Response:
    """Fit a response model to trials.

    Squares, and then products, are included if there are at least `TRIALS_PER_TERM` trials for each term. The
    ridge penalty of each merit is the one of `PENALTIES` with the smallest leave-one-out error, which follows
    in closed form from the hat matrix (Allen 1974).

    Parameters
    ----------
    values : array_like, shape (n, d)
        Deviations from nominal.
    scores : array_like, shape (n, m)
        Scores. Trials with NaN are excluded from the fit of that merit, and counted.

    Returns
    -------
    Response
        The fitted model.

    Raises
    ------
    InputError
        If a merit has too few scores for a linear model, or a value is not finite.
    """
    deltas = np.atleast_2d(np.asarray(values, float))
    columns = np.reshape(scores, (len(deltas), -1)).astype(float)
    if not np.all(np.isfinite(deltas)):
        raise InputError("values of the trials: must be finite")
    known = np.isfinite(columns)
    used = np.count_nonzero(known, axis=0)
    order = _order(deltas.shape[1], used)
    centre, spread = deltas.mean(axis=0), deltas.std(axis=0)
    spread = np.where(spread > 0.0, spread, 1.0)
    terms = _terms((deltas - centre) / spread, order)
    fits = [_ridge(terms[kept], column[kept]) for kept, column in zip(known.T, columns.T, strict=True)]
    constant, coefficients, plain, validated = zip(*fits, strict=True)
    return Response(
        centre=centre,
        spread=spread,
        order=order,
        constant=np.array(constant),
        coefficients=np.stack(coefficients, axis=1),
        r_squared=np.array(plain),
        cross_validated_r_squared=np.array(validated),
        used=used,
        left_out=len(deltas) - used,
    )


def _order(d: int, used: NDArray[np.intp]) -> int:
    """Return the highest order for which the merit with the fewest scores has enough trials."""
    numbers = {3: 1 + 2 * d + d * (d - 1) // 2, 2: 1 + 2 * d, 1: 1 + d}
    fewest = int(np.min(used))
    for order, terms in numbers.items():
        if fewest >= TRIALS_PER_TERM * terms:
            return order
    raise InputError(
        f"merit {int(np.argmin(used)) + 1} has {fewest} scored trials: a linear response over {d} "
        f"perturbations needs {TRIALS_PER_TERM * numbers[1]}"
    )


def _terms(x: Array, order: int) -> Array:
    """Return linear terms, squares and products of standardized values as columns, shape (n, terms)."""
    blocks = [x]
    if order >= 2:
        blocks.append(x * x)
    if order >= 3:
        first, second = np.triu_indices(x.shape[1], 1)
        blocks.append(x[:, first] * x[:, second])
    return np.concatenate(blocks, axis=1)


def _ridge(terms: Array, scores: Array) -> tuple[float, Array, float, float]:
    """Return constant (not penalized), coefficients, R^2 and leave-one-out R^2 at the best penalty."""
    n = len(scores)
    offset, mean = terms.mean(axis=0), float(scores.mean())
    u, s, vt = np.linalg.svd(terms - offset, full_matrices=False)
    y = scores - mean
    # A sum of squares below the rounding error of the scores means that the merit is constant.
    total = float(y @ y)
    if total <= n * (1e-14 * np.max(np.abs(scores))) ** 2:
        return mean, np.zeros(terms.shape[1]), 1.0, 1.0
    projected = u.T @ y
    best: tuple[float, Array, Array] | None = None
    for penalty in PENALTIES:
        shrink = s**2 / (s**2 + penalty * n)
        residuals = y - u @ (shrink * projected)
        leverage = 1.0 / n + (u**2) @ shrink
        press = float(np.sum((residuals / np.maximum(1.0 - leverage, 1e-9)) ** 2))
        if best is None or press < best[0]:
            best = (press, residuals, shrink * projected / np.where(s > 0.0, s, 1.0))
    assert best is not None
    press, residuals, scaled = best
    coefficients = vt.T @ scaled
    # An excluded trial is compared with the mean of the others, which gives the factor n^2 / (n - 1)^2.
    reference = total * (n / (n - 1)) ** 2
    return (
        mean - float(offset @ coefficients),
        coefficients,
        1.0 - float(residuals @ residuals) / total,
        1.0 - press / reference,
    )
