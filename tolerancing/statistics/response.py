"""A second-order model of the merits over all perturbations, fitted to trials: cheap, and says how good.

Response surfaces: Box and Wilson 1951. Ridge regression: Hoerl and Kennard 1970.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError

Scorer = Callable[[Array], Array]
"""Deltas from nominal, shape (n, perturbations), to scores, shape (n, merits); NaN where there is none."""

TRIALS_PER_TERM = 3
"""A model has at most one term for so many trials."""

PENALTIES = tuple(10.0**power for power in range(-8, 2))
"""Ridge penalties that are tried, relative to the mean square of the terms."""

ROWS_PER_CHUNK = 4096


@dataclass(frozen=True)
class Response:
    """Model of m merits over d perturbations; t terms beside the constant.

    Attributes
    ----------
    centre, spread : ndarray, shape (d,)
        Mean and standard deviation of the values it was fitted to; terms are made of (x - centre) / spread.
    order
        1: linear terms; 2: squares too; 3: products of two perturbations too.
    constant : ndarray, shape (m,)
    coefficients : ndarray, shape (t, m)
        Of linear terms, squares, products.
    r_squared : ndarray, shape (m,)
        Share of the variance of the fitted scores that the model explains.
    cross_validated_r_squared : ndarray, shape (m,)
        The same for trials that are left out of the fit, one at a time: what to expect of new trials.
        Below 0 the model is worse than the mean.
    used, left_out : ndarray, shape (m,)
        Number of trials it was fitted to, and of those without a score.
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
        """Scores, shape (n, m), for deltas of shape (n, d); itself a `Scorer`."""
        x = (np.atleast_2d(np.asarray(values, float)) - self.centre) / self.spread
        scores = np.empty((len(x), len(self.constant)))
        for first in range(0, len(x), ROWS_PER_CHUNK):
            chunk = slice(first, first + ROWS_PER_CHUNK)
            scores[chunk] = self.constant + _terms(x[chunk], self.order) @ self.coefficients
        return scores


def fit_response(values: ArrayLike, scores: ArrayLike) -> Response:
    """Fit a response model to trials.

    Terms of the second order are taken as far as there are `TRIALS_PER_TERM` trials for each: squares
    first, then products. The ridge penalty of each merit is that of `PENALTIES` with the smallest error on
    trials left out, in closed form from the hat matrix (Allen 1974, PRESS).

    Parameters
    ----------
    values : array_like, shape (n, d)
        Deltas from nominal.
    scores : array_like, shape (n, m)
        Trials without a score are left out of that merit's fit, and counted.

    Returns
    -------
    Response

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
    """The highest order that the merit with the fewest scores bears."""
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
    """Columns of linear terms, squares and products of standardized values, shape (n, terms)."""
    blocks = [x]
    if order >= 2:
        blocks.append(x * x)
    if order >= 3:
        first, second = np.triu_indices(x.shape[1], 1)
        blocks.append(x[:, first] * x[:, second])
    return np.concatenate(blocks, axis=1)


def _ridge(terms: Array, scores: Array) -> tuple[float, Array, float, float]:
    """Constant (not penalised), coefficients, R^2 and leave-one-out R^2, at the best penalty."""
    n = len(scores)
    offset, mean = terms.mean(axis=0), float(scores.mean())
    u, s, vt = np.linalg.svd(terms - offset, full_matrices=False)
    y = scores - mean
    # Rounding of the scores themselves, squared and summed: below it a merit is constant.
    total = float(y @ y)
    if total <= n * (1e-14 * np.max(np.abs(scores))) ** 2:
        return mean, np.zeros(terms.shape[1]), 1.0, 1.0
    projected = u.T @ y
    best: tuple[float, Array, Array] | None = None
    for penalty in PENALTIES:
        shrink = s**2 / (s**2 + penalty * n)
        left = y - u @ (shrink * projected)
        leverage = 1.0 / n + (u**2) @ shrink
        press = float(np.sum((left / np.maximum(1.0 - leverage, 1e-9)) ** 2))
        if best is None or press < best[0]:
            best = (press, left, shrink * projected / np.where(s > 0.0, s, 1.0))
    assert best is not None
    press, left, scaled = best
    coefficients = vt.T @ scaled
    # A trial left out is held against the mean of the others: total n^2 / (n - 1)^2.
    against = total * (n / (n - 1)) ** 2
    return (
        mean - float(offset @ coefficients),
        coefficients,
        1.0 - float(left @ left) / total,
        1.0 - press / against,
    )
