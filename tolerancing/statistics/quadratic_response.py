"""What each perturbation does alone: derivatives, changes at the tolerance, and what follows for a yield.

A merit that is even in a perturbation, as the decenter of a centred lens makes most of them, has no
derivative at nominal; so each merit is taken as a parabola of each perturbation, and perturbations add. Of a
root mean square it is the squares that do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from tolerancing.merits.base import Merit
from tolerancing.statistics.yields import Yield, yield_of
from tolerancing.study.sweep import STEPS

NORMAL_KURTOSIS = 3.0
"""Fourth central moment of a normal distribution over its squared variance; a uniform one has 1.8."""


@dataclass(frozen=True)
class Sensitivity:
    """What d perturbations do to m merits, each by itself; units of the merit and of the perturbation.

    Attributes
    ----------
    nominal : ndarray, shape (m,)
        Scores of the nominal lens.
    derivative : ndarray, shape (d, m)
        At nominal; NaN where too few points have a score.
    change : ndarray, shape (d, 4, m)
        Change from nominal at `STEPS` of the tolerance; NaN where there is no score.
    coefficients : ndarray, shape (d, 3, m)
        Of 1, x and x^2 in the parabola fitted to the change over the steps and nominal; NaN with fewer
        than three scores.
    residual : ndarray, shape (d, m)
        Root mean square of what the parabola leaves over. Where it is not small against the change, the
        merit is no parabola within the tolerance, and what follows from one is rough.
    mean_shift, standard_deviation : ndarray, shape (d, m)
        What the perturbation adds to the merit's mean, and the standard deviation it brings, when it
        scatters by its distribution and the merit follows the parabola.
    square_mean_shift, square_standard_deviation : ndarray, shape (d, m)
        The same of the merit's square.
    """

    nominal: Array
    derivative: Array
    change: Array
    coefficients: Array
    residual: Array
    mean_shift: Array
    standard_deviation: Array
    square_mean_shift: Array
    square_standard_deviation: Array

    def worst_change(self, merits: Sequence[Merit]) -> Array:
        """Change for the worse within the tolerance, shape (d, m).

        The smallest change of the merits' margins over the steps, positive where every step helps; minus
        infinity where a step has no score.
        """
        toward_good = np.array([1.0 if merit.at_least is not None else -1.0 for merit in merits])
        harm = np.where(np.isfinite(self.change), self.change * toward_good, -np.inf)
        return np.asarray(harm.min(axis=1))

    def ranking(self, merits: Sequence[Merit]) -> NDArray[np.intp]:
        """Perturbations from the most to the least harmful, shape (m, d): indices, for each merit."""
        return np.argsort(self.worst_change(merits).T, axis=1, kind="stable")


@dataclass(frozen=True)
class Prediction:
    """Root-sum-square prediction of m merits.

    Attributes
    ----------
    merits
        The merits.
    nominal, mean, standard_deviation : ndarray, shape (m,)
        Nominal score, and mean and standard deviation over lenses.
    share : ndarray, shape (m,)
        Predicted yield of each merit, were its scores normally distributed.
    """

    merits: tuple[Merit, ...]
    nominal: Array
    mean: Array
    standard_deviation: Array
    share: Array


@dataclass(frozen=True)
class Comparison:
    """One merit as predicted from sensitivities, and as Monte Carlo trials found it.

    Attributes
    ----------
    merit
        The merit.
    predicted_mean, predicted_standard_deviation, predicted_share
        By root sum square; the share is the yield.
    mean, standard_error, standard_deviation
        Over the trials that have a score; NaN with fewer than two.
    good
        Yield over all trials, with its interval; None without trials.
    """

    merit: Merit
    predicted_mean: float
    predicted_standard_deviation: float
    predicted_share: float
    mean: float
    standard_error: float
    standard_deviation: float
    good: Yield | None


def checked_tolerance(tolerance: ArrayLike) -> Array:
    """Tolerances as an array, shape (d,); an `InputError` where one is not above zero and finite."""
    largest = np.atleast_1d(np.asarray(tolerance, float))
    for index, value in enumerate(largest):
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"tolerance of perturbation {index + 1} = {value:g}: must be above 0 and finite")
    return largest


def fit_sensitivity(
    nominal: ArrayLike,
    scores: ArrayLike,
    tolerance: ArrayLike,
    standard_deviation: ArrayLike,
    mean: ArrayLike = 0.0,
    kurtosis: ArrayLike = NORMAL_KURTOSIS,
) -> Sensitivity:
    """Sensitivities from the scores of each perturbation alone, at `STEPS` of its tolerance.

    The derivative at nominal is the fourth-order central difference over all four steps, the second-order
    one over the inner two where an outer one has no score. With x = mean + e, and e symmetric about 0 with
    standard deviation s and kurtosis k, the parabola c0 + c1 x + c2 x^2 has

    - mean c0 + c1 mean + c2 (mean^2 + s^2),
    - variance (c1 + 2 c2 mean)^2 s^2 + c2^2 (k - 1) s^4.

    Parameters
    ----------
    nominal : array_like, shape (m,)
        Scores of the nominal lens.
    scores : array_like, shape (d, 4, m) or (4 d, m)
        NaN where there is none.
    tolerance, standard_deviation : array_like, shape (d,)
        Of the perturbations.
    mean, kurtosis : array_like, shape (d,)
        Of their distributions, each symmetric about its mean.

    Raises
    ------
    InputError
        If a tolerance is not above zero.
    """
    largest = checked_tolerance(tolerance)
    base = np.atleast_1d(np.asarray(nominal, float))
    change = np.reshape(scores, (len(largest), len(STEPS), len(base))) - base
    unit = largest[:, None]
    # Central differences with steps of half a tolerance.
    inner = change[:, 2] - change[:, 1]
    outer = change[:, 3] - change[:, 0]
    derivative = np.where(np.isfinite(outer), (8.0 * inner - outer) / 6.0, inner) / unit
    per_unit = np.stack([np.ones_like(unit), unit, unit**2], axis=1)
    mu, s, k = (np.broadcast_to(v, largest.shape)[:, None] for v in (mean, standard_deviation, kurtosis))

    def moments(coefficients: Array) -> tuple[Array, Array]:
        c0, c1, c2 = np.moveaxis(coefficients, 1, 0)
        variance = (c1 + 2.0 * c2 * mu) ** 2 * s**2 + c2**2 * (k - 1.0) * s**4
        return c0 + c1 * mu + c2 * (mu**2 + s**2), np.sqrt(variance)

    coefficients, residual = _parabolas(change)
    coefficients = coefficients / per_unit
    shift, deviation = moments(coefficients)
    square_shift, square_deviation = moments(_parabolas((change + base) ** 2 - base**2)[0] / per_unit)
    return Sensitivity(
        nominal=base,
        derivative=derivative,
        change=change,
        coefficients=coefficients,
        residual=residual,
        mean_shift=shift,
        standard_deviation=deviation,
        square_mean_shift=square_shift,
        square_standard_deviation=square_deviation,
    )


def root_sum_square(sensitivity: Sensitivity, merits: Sequence[Merit]) -> Prediction:
    """Mean, standard deviation and yield of each merit, perturbations taken as independent and additive.

    Mean shifts add, standard deviations add in squares, and the yield is that of a normal distribution
    with this mean and deviation. Products of perturbations are left out, and a sum of few squares is not
    normal: hold it against trials with :func:`compare_with_trials`. A merit whose parabola is not known
    for some perturbation has no prediction (NaN).

    Of a merit that adds in squares, squares take the place of scores, and their sum counts as gamma
    distributed (Welch and Satterthwaite), as sums of squares of normal deviations nearly are.
    """
    from scipy.special import ndtr

    mean = sensitivity.nominal + sensitivity.mean_shift.sum(axis=0)
    deviation = np.sqrt(np.sum(sensitivity.standard_deviation**2, axis=0))
    margin = np.array([float(merit.margin(mean[k])) for k, merit in enumerate(merits)])
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(deviation == 0.0, np.where(margin >= 0.0, 1.0, 0.0), ndtr(margin / deviation))
    for k, merit in enumerate(merits):
        if merit.adds_in_squares and merit.at_most is not None:
            mean[k], deviation[k], share[k] = _of_squares(sensitivity, k, merit.at_most)
    return Prediction(tuple(merits), sensitivity.nominal, mean, deviation, share)


def _of_squares(sensitivity: Sensitivity, k: int, limit: float) -> tuple[float, float, float]:
    """Mean, standard deviation and yield of a merit whose square is the sum of its perturbations' squares."""
    from scipy.special import gammainc, gammaln

    square = float(sensitivity.nominal[k] ** 2 + sensitivity.square_mean_shift[:, k].sum())
    variance = float(np.sum(sensitivity.square_standard_deviation[:, k] ** 2))
    if not (square > 0.0 and variance > 0.0):
        root = math.sqrt(max(square, 0.0))
        return root, 0.0 if square >= 0.0 else math.nan, float(root <= limit)
    shape, scale = square**2 / variance, variance / square
    mean = math.sqrt(scale) * math.exp(gammaln(shape + 0.5) - gammaln(shape))
    return mean, math.sqrt(max(square - mean**2, 0.0)), float(gammainc(shape, limit**2 / scale))


def compare_with_trials(
    prediction: Prediction, scores: ArrayLike, replicates: NDArray[np.int64] | None = None
) -> tuple[Comparison, ...]:
    """The prediction beside Monte Carlo trials, merit by merit.

    Parameters
    ----------
    prediction
        From :func:`root_sum_square`.
    scores : array_like, shape (trials, m)
        NaN for a trial that cannot be scored; it counts as bad.
    replicates
        As of :func:`tolerancing.statistics.yield_of`.
    """
    columns = np.reshape(scores, (-1, len(prediction.merits))).T
    return tuple(
        _comparison(prediction, k, merit, column, replicates)
        for k, (merit, column) in enumerate(zip(prediction.merits, columns, strict=True))
    )


def _comparison(
    prediction: Prediction, k: int, merit: Merit, scores: Array, replicates: NDArray[np.int64] | None
) -> Comparison:
    known = scores[np.isfinite(scores)]
    deviation = float(known.std(ddof=1)) if len(known) > 1 else math.nan
    return Comparison(
        merit=merit,
        predicted_mean=float(prediction.mean[k]),
        predicted_standard_deviation=float(prediction.standard_deviation[k]),
        predicted_share=float(prediction.share[k]),
        mean=float(known.mean()) if len(known) > 1 else math.nan,
        standard_error=deviation / math.sqrt(len(known)) if len(known) > 1 else math.nan,
        standard_deviation=deviation,
        good=yield_of(merit.passed(scores), replicates),
    )


def _parabolas(change: Array) -> tuple[Array, Array]:
    """Coefficients, shape (d, 3, m), and residuals, shape (d, m), in fractions of the tolerance."""
    d, steps, m = change.shape
    u = np.array([*STEPS, 0.0])
    terms = np.stack([np.ones_like(u), u, u**2], axis=1)
    columns = np.concatenate([change, np.zeros((d, 1, m))], axis=1)
    coefficients = np.full((d, 3, m), np.nan)
    known = np.isfinite(columns)
    for pattern in np.unique(np.moveaxis(known, 1, 2).reshape(-1, steps + 1), axis=0):
        if np.count_nonzero(pattern) < 3:
            continue
        rows, merits = np.nonzero(np.all(known == pattern[None, :, None], axis=1))
        fit = np.linalg.pinv(terms[pattern]) @ columns[rows, :, merits].T[pattern]
        coefficients[rows, :, merits] = fit.T
    left = np.where(known, columns - np.einsum("pt,dtm->dpm", terms, coefficients), 0.0)
    return coefficients, np.sqrt(np.sum(left**2, axis=1) / np.maximum(known.sum(axis=1), 1))
