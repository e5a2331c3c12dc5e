"""Sensitivities: the effect of each perturbation alone, and the yield that follows from their sum.

Many merits are even in a perturbation: the decenter of a centred lens has the same effect in both directions,
so its derivative at nominal is zero. Each merit is therefore modelled as a parabola of each perturbation, and
the effects of perturbations add. For a merit that is a root mean square, the squares add instead.

:func:`fit_sensitivity` and :func:`root_sum_square` work on arrays. :func:`sensitivity` applies them to a
store.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.text import finite_or_none
from lensdesign.errors import InputError
from tolerancing.merits.base import Merit
from tolerancing.perturbations.draws import replicates
from tolerancing.statistics.scorer import scatter_of
from tolerancing.statistics.yields import Yield, yield_of
from tolerancing.store.store import Store
from tolerancing.study.results import StepResults
from tolerancing.study.study import Study
from tolerancing.study.sweep import SENSITIVITY, STEPS, OneAtATime


@dataclass(frozen=True)
class Sensitivity:
    """Effect of d perturbations on m merits, each alone, in the units of the merits and perturbations.

    Attributes
    ----------
    nominal : ndarray, shape (m,)
        Scores of the nominal lens.
    derivative : ndarray, shape (d, m)
        Derivative of each merit at nominal; NaN where too few points have a score.
    change : ndarray, shape (d, 4, m)
        Change from nominal at `STEPS` of the tolerance; NaN where there is no score.
    coefficients : ndarray, shape (d, 3, m)
        Coefficients of 1, x and x^2 in the parabola fitted to the changes at nominal and at the steps; NaN
        with fewer than three scores.
    residual : ndarray, shape (d, m)
        Root mean square deviation of the changes from the parabola. Where it is not small compared with the
        change, the merit is no parabola within the tolerance, and predictions from it are rough.
    mean_shift, standard_deviation : ndarray, shape (d, m)
        Contribution of the perturbation to the merit's mean, and to its standard deviation. The perturbation
        scatters by its distribution, and the merit follows the parabola.
    square_mean_shift, square_standard_deviation : ndarray, shape (d, m)
        The same contributions to the square of the merit.
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
        """Return the most harmful change within the tolerance, shape (d, m).

        The change is that of the merit's margin, at its worst step. It is positive where every step
        improves the merit, and minus infinity where a step has no score.
        """
        toward_good = np.array([1.0 if merit.at_least is not None else -1.0 for merit in merits])
        harm = np.where(np.isfinite(self.change), self.change * toward_good, -np.inf)
        return np.asarray(harm.min(axis=1))

    def ranking(self, merits: Sequence[Merit]) -> NDArray[np.intp]:
        """Return the indices of the perturbations, the most harmful first, for each merit; shape (m, d)."""
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
    yield_fraction : ndarray, shape (m,)
        Predicted yield of each merit, 0 to 1.
    """

    merits: tuple[Merit, ...]
    nominal: Array
    mean: Array
    standard_deviation: Array
    yield_fraction: Array


@dataclass(frozen=True)
class Comparison:
    """Prediction of one merit from sensitivities, and the result of Monte Carlo trials.

    Attributes
    ----------
    merit
        The merit.
    predicted_mean, predicted_standard_deviation, predicted_yield
        Prediction by root sum square.
    mean, standard_error, standard_deviation
        Statistics of the trials that have a score; NaN with fewer than two.
    good
        Yield over all trials, with its interval; None without trials.
    """

    merit: Merit
    predicted_mean: float
    predicted_standard_deviation: float
    predicted_yield: float
    mean: float
    standard_error: float
    standard_deviation: float
    good: Yield | None


@dataclass(frozen=True, eq=False)
class StudySensitivity:
    """Sensitivities of a stored study, and comparison of the yield that they predict with the trials.

    Attributes
    ----------
    study
        The study.
    found
        Effect of each perturbation, varied alone, on each merit.
    compared
        Root-sum-square prediction for each merit, and the result of its trials.

    Examples
    --------
    >>> from tolerancing import load_study, open_store, run_study, sensitivity
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     comparison = sensitivity(store).compared[0]
    >>> round(comparison.predicted_yield, 2), comparison.good.fraction
    (0.44, 0.52)
    """

    study: Study
    found: Sensitivity
    compared: tuple[Comparison, ...]

    def as_dict(self) -> dict[str, list[dict[str, Any]]]:
        """Return plain values for JSON: for each merit's column the perturbations, the most harmful first.

        Numbers that are not known are None.
        """
        ranking = self.found.ranking(self.study.merits)
        return {m.column: [self._row(i, k) for i in ranking[k]] for k, m in enumerate(self.study.merits)}

    def _row(self, i: int, k: int) -> dict[str, Any]:
        found, perturbation = self.found, self.study.perturbations[i]
        return {
            "perturbation": perturbation.column,
            "tolerance": perturbation.distribution.largest,
            "derivative": finite_or_none(float(found.derivative[i, k])),
            "change_at_minus_tolerance": finite_or_none(float(found.change[i, 0, k])),
            "change_at_plus_tolerance": finite_or_none(float(found.change[i, -1, k])),
            "quadratic_coefficients": [finite_or_none(c) for c in found.coefficients[i, :, k].tolist()],
            "residual": finite_or_none(float(found.residual[i, k])),
            "standard_deviation": finite_or_none(float(found.standard_deviation[i, k])),
        }


def sensitivity(store: Store) -> StudySensitivity:
    """Return the effect of each single perturbation of a stored study, and the yield that follows from them.

    The prediction models each merit as a parabola of each perturbation, and adds their effects as a root sum
    of squares.

    Parameters
    ----------
    store
        Open store whose sensitivities have been run.

    Returns
    -------
    StudySensitivity
        Sensitivities, and their prediction together with the results of the trials.

    Raises
    ------
    InputError
        If the study has ``sensitivity = false``, or the run has not finished the sensitivities.

    Examples
    --------
    >>> from tolerancing import load_study, open_store, run_study, sensitivity
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     worst = sensitivity(store).as_dict()["wavefront"][0]
    >>> worst["perturbation"], worst["tolerance"], round(worst["change_at_plus_tolerance"], 2)
    ('lens_tilt_x_deg', 0.06, 0.15)
    """
    study = store.study
    found = study_sensitivities(study, store.nominal(), store.steps())
    predicted = root_sum_square(found, study.merits)
    trials = store.trials()
    replicate_of_trial = replicates(study.draws, trials.trials)
    return StudySensitivity(study, found, compare_with_trials(predicted, trials.scores, replicate_of_trial))


def study_sensitivities(
    study: Study, nominal: Mapping[str, float], steps: Sequence[StepResults]
) -> Sensitivity:
    """Compute sensitivities from the steps that a store holds.

    Parameters
    ----------
    study
        The study.
    nominal
        Scores of the nominal lens, by the merit's label.
    steps
        Steps of the store; those of other series are ignored.

    Raises
    ------
    InputError
        If the study has ``sensitivity = false``, or the run has not finished the sensitivities.
    """
    if not study.sensitivity:
        raise InputError("the study has sensitivity = false: there are no sensitivities")
    own = sorted((s for s in steps if s.series == SENSITIVITY), key=lambda s: s.step)
    required = len(OneAtATime(study.perturbations))
    if len(own) < required:
        raise InputError(
            f"the store holds {len(own)} of {required} steps of the sensitivities: finish its run"
        )
    labels = [m.label for m in study.merits]
    scores = np.array([[step.scores.get(label, np.nan) for label in labels] for step in own], float)
    middle = np.array([nominal.get(label, np.nan) for label in labels], float)
    scores[~np.isfinite(scores)], middle[~np.isfinite(middle)] = np.nan, np.nan
    scatter = scatter_of(study)
    return fit_sensitivity(
        middle,
        scores,
        scatter.tolerance,
        scatter.standard_deviation,
        scatter.mean,
        scatter.kurtosis,
    )


def checked_tolerance(tolerance: ArrayLike) -> Array:
    """Return tolerances as an array of shape (d,).

    Raises
    ------
    InputError
        If a tolerance is not above zero and finite.
    """
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
    kurtosis: ArrayLike = 3.0,
) -> Sensitivity:
    """Compute sensitivities from the scores of each perturbation alone, at `STEPS` of its tolerance.

    The derivative at nominal is the fourth-order central difference over all four steps. Where an outer step
    has no score, it is the second-order difference over the inner two. With x = mean + e, and e symmetric
    about 0 with standard deviation s and kurtosis k, the parabola c0 + c1 x + c2 x^2 has

    - mean c0 + c1 mean + c2 (mean^2 + s^2),
    - variance (c1 + 2 c2 mean)^2 s^2 + c2^2 (k - 1) s^4.

    Parameters
    ----------
    nominal : array_like, shape (m,)
        Scores of the nominal lens.
    scores : array_like, shape (d, 4, m) or (4 d, m)
        Scores at the steps; NaN where there is none.
    tolerance, standard_deviation : array_like, shape (d,)
        Tolerance and standard deviation of each perturbation.
    mean, kurtosis : array_like, shape (d,)
        Mean and kurtosis of each distribution, which is symmetric about its mean. The default kurtosis is
        that of a normal distribution; a uniform one has 1.8.

    Raises
    ------
    InputError
        If a tolerance is not above zero and finite.
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

    coefficients, residual = _fit_parabolas(change)
    coefficients = coefficients / per_unit
    shift, deviation = moments(coefficients)
    square_shift, square_deviation = moments(_fit_parabolas((change + base) ** 2 - base**2)[0] / per_unit)
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
    """Predict mean, standard deviation and yield of each merit from independent, additive perturbations.

    Mean shifts add, and standard deviations add in squares. The yield is that of a normal distribution with
    this mean and deviation. Products of perturbations are neglected, and a sum of few squares is not normal,
    so compare the prediction with trials (:func:`compare_with_trials`).

    For a merit that adds in squares, the squares of scores are added. Their sum is modelled by a gamma
    distribution (Welch and Satterthwaite), which is a close model for sums of squares of normal deviations.

    Parameters
    ----------
    sensitivity
        Effect of each perturbation alone.
    merits
        The m merits of `sensitivity`.

    Returns
    -------
    Prediction
        Prediction for each merit; NaN for a merit whose parabola is not known for some perturbation.
    """
    from scipy.special import ndtr

    mean = sensitivity.nominal + sensitivity.mean_shift.sum(axis=0)
    deviation = np.sqrt(np.sum(sensitivity.standard_deviation**2, axis=0))
    margin = np.array([float(merit.margin(mean[k])) for k, merit in enumerate(merits)])
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = np.where(deviation == 0.0, np.where(margin >= 0.0, 1.0, 0.0), ndtr(margin / deviation))
    for k, merit in enumerate(merits):
        if merit.adds_in_squares and merit.at_most is not None:
            mean[k], deviation[k], fraction[k] = _of_squares(sensitivity, k, merit.at_most)
    return Prediction(tuple(merits), sensitivity.nominal, mean, deviation, fraction)


def _of_squares(sensitivity: Sensitivity, k: int, limit: float) -> tuple[float, float, float]:
    """Return mean, standard deviation and yield of a merit whose square is a sum of squares."""
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
    """Compare a prediction with Monte Carlo trials, merit by merit.

    Parameters
    ----------
    prediction
        Result of :func:`root_sum_square`.
    scores : array_like, shape (trials, m)
        Scores of the trials. A trial that cannot be scored has NaN and counts as bad.
    replicates
        Replicate of the design to which each trial belongs; see :func:`tolerancing.statistics.yield_of`.

    Returns
    -------
    tuple of Comparison
        One comparison for each merit.
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
        predicted_yield=float(prediction.yield_fraction[k]),
        mean=float(known.mean()) if len(known) > 1 else math.nan,
        standard_error=deviation / math.sqrt(len(known)) if len(known) > 1 else math.nan,
        standard_deviation=deviation,
        good=yield_of(merit.passed(scores), replicates),
    )


def _fit_parabolas(change: Array) -> tuple[Array, Array]:
    """Fit parabolas over fractions of the tolerance; return coefficients (d, 3, m) and residuals (d, m)."""
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
    residuals = np.where(known, columns - np.einsum("pt,dtm->dpm", terms, coefficients), 0.0)
    return coefficients, np.sqrt(np.sum(residuals**2, axis=1) / np.maximum(known.sum(axis=1), 1))
