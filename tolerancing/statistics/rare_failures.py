"""Yields of lenses that seldom fail, by importance sampling with a model of the trials.

If all n trials of a plain run pass, the fraction of failures is only known to be below about 3 / n. Here a
second-order model of the merits (:mod:`tolerancing.statistics.response`) is fitted to the existing trials. It
predicts for many more trials, at almost no cost, how likely each is to fail. With m_k the predicted margin of
merit k and s_k the standard deviation of the residuals of the fit,

    p = 1 - prod_k Phi(m_k / s_k).

Trials of the lens itself are drawn from the modelled trials with probabilities q proportional to the square
root of p, which is optimal if p is right. A fixed fraction of them is drawn uniformly, so that no weight
exceeds the inverse of this fraction (Owen and Zhou, J. Am. Stat. Assoc. 95, 135, 2000). With N
modelled trials, n scored trials, and f_i = 1 for a scored trial that fails,

    estimate = (1 / n) sum_i f_i / (N q_i),

which is unbiased for any model. Its variance includes that of the n terms and that of the sample of N trials.
The interval is Wilson's for the number of trials with this variance (Korn and Graubard, Survey Methodology
24, 193, 1998). If no trial failed, only the uniformly drawn trials count.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from lensdesign.common.arrays import Array
from lensdesign.common.text import finite_or_none
from lensdesign.errors import InputError
from tolerancing.merits.base import all_passed
from tolerancing.perturbations.draws import LARGEST, SMALLEST
from tolerancing.statistics.response import Response, fit_response
from tolerancing.statistics.scorer import StudyScorer
from tolerancing.statistics.yields import CONFIDENCE, wilson
from tolerancing.store.store import Store
from tolerancing.study.evaluate import check_trial_memory, context_of
from tolerancing.study.study import Study

UNIFORM_FRACTION = 0.2
"""Fraction of the scored trials that are drawn uniformly."""

FEWEST_TRIALS = 50
"""Smallest number of trials that can be scored."""


@dataclass(frozen=True, eq=False)
class RareYield:
    """A yield from trials that were selected where failures are likely.

    Attributes
    ----------
    study
        The study.
    fraction, low, high
        Yield over all limits (0 to 1), and the ends of its 95 % interval.
    standard_error
        Standard error of the yield.
    trials, failed
        Number of trials of the lens that were scored, and number of those that failed.
    plain_trials
        Number of plain trials whose yield has the same standard error; if no trial failed, the number of
        uniformly drawn trials.
    modelled_yield
        Yield predicted by the model alone.
    cross_validated_r_squared : ndarray, shape (merits,)
        Accuracy of the model for trials that are not in its fit, by merit.
    """

    study: Study
    fraction: float
    low: float
    high: float
    standard_error: float
    trials: int
    failed: int
    plain_trials: float
    modelled_yield: float
    cross_validated_r_squared: Array

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        merits = zip(self.study.merits, self.cross_validated_r_squared.tolist(), strict=True)
        return {
            "yield": {"share": self.fraction, "low": self.low, "high": self.high, "confidence": CONFIDENCE},
            "standard_error": self.standard_error,
            "trials": self.trials,
            "failed": self.failed,
            "plain_trials": self.plain_trials,
            "modelled_yield": self.modelled_yield,
            "cross_validated_r_squared": {merit.column: finite_or_none(r) for merit, r in merits},
        }


def rare_yield(store: Store, trials: int, *, progress: Callable[[int], None] | None = None) -> RareYield:
    """Estimate the yield of a stored study from further trials of its lens where failures are likely.

    Parameters
    ----------
    store
        Open store with enough trials for a model.
    trials
        Number of trials of the lens to score.
    progress
        Called as ``progress(count)`` with the number of trials scored since the last call.

    Returns
    -------
    RareYield
        Yield with its interval.

    Raises
    ------
    InputError
        If `trials` is below `FEWEST_TRIALS`, or the store has too few trials for a model.
    """
    if trials < FEWEST_TRIALS:
        raise InputError(f"trials = {trials}: must be at least {FEWEST_TRIALS}")
    check_trial_memory(store.study, trials)
    loaded, stored = store.loaded, store.trials()
    study, response = loaded.study, fit_response(stored.values, stored.scores)
    rng = np.random.default_rng(np.random.SeedSequence(study.seed, spawn_key=(0, 0, 2)))
    modelled_count = 400_000
    values = modelled_trials(study, modelled_count, rng)
    probabilities = failure_probabilities(study, response, stored.values, stored.scores, values)
    drawn, weights = draw_trials(probabilities, trials, rng)
    scorer = StudyScorer(context_of(loaded.lens, study), study, progress)
    # Shapes of irregularities are drawn by the trial's number; these numbers are beyond those of any store.
    first_number = 1 << 24
    scores = scorer(values[drawn], range(first_number, first_number + trials))
    passed = all_passed(study.merits, scores)
    failures, error, plain = weighted_failures(~passed, weights, modelled_count)
    low, high = wilson(1.0 - failures, plain)
    return RareYield(
        study=study,
        fraction=1.0 - failures,
        low=low,
        high=high,
        standard_error=error,
        trials=trials,
        failed=int(np.count_nonzero(~passed)),
        plain_trials=plain,
        modelled_yield=1.0 - float(np.mean(probabilities)),
        cross_validated_r_squared=response.cross_validated_r_squared,
    )


def modelled_trials(study: Study, count: int, rng: np.random.Generator) -> Array:
    """Draw the deviations of many random trials, shape (count, perturbations)."""
    drawn = np.clip(rng.random((count, len(study.perturbations))), SMALLEST, LARGEST)
    dependent = study.dependence.apply(drawn)
    distributions = [p.distribution for p in study.perturbations]
    return np.column_stack([one.quantile(dependent[:, k]) for k, one in enumerate(distributions)])


def failure_probabilities(
    study: Study, response: Response, values: Array, scores: Array, modelled: Array
) -> Array:
    """Return the probability of each modelled trial to miss a limit.

    Parameters
    ----------
    study
        Study with its merits.
    response
        Model of the merits.
    values, scores : ndarray, shape (n, perturbations) and (n, merits)
        Trials that the model was fitted to; their residuals give its error.
    modelled : ndarray, shape (N, perturbations)
        Deviations of the modelled trials.

    Returns
    -------
    ndarray, shape (N,)
        Probabilities, 0 to 1.
    """
    residuals = scores - response.predict(values)
    # Residuals of fitted trials are smaller than errors of new ones, by the root of the ratio of the
    # variances that the model does not explain in each.
    unexplained = 1.0 - response.r_squared
    ratio = (1.0 - response.cross_validated_r_squared) / np.maximum(unexplained, 1e-12)
    sigma = np.sqrt(np.nanmean(residuals**2, axis=0) * np.maximum(ratio, 1.0))
    predicted, pass_probability = response.predict(modelled), np.ones(len(modelled))
    for k, merit in enumerate(study.merits):
        margin = merit.margin(predicted[:, k])
        pass_probability *= ndtr(margin / sigma[k]) if sigma[k] > 0.0 else margin >= 0.0
    return np.asarray(1.0 - pass_probability)


def draw_trials(probabilities: Array, count: int, rng: np.random.Generator) -> tuple[NDArray[np.intp], Array]:
    """Draw the modelled trials to score, with replacement.

    Parameters
    ----------
    probabilities : ndarray, shape (N,)
        Probability of each modelled trial to fail.
    count
        Number of trials to draw.
    rng
        Random generator.

    Returns
    -------
    indices, weights : ndarray, shape (count,)
        Indices of the trials, and their weights 1 / (N q). The sum of the weights of failing trials, divided
        by `count`, is the fraction of failures.
    """
    likely = np.sqrt(np.clip(probabilities, 0.0, 1.0))
    total, uniform = float(likely.sum()), 1.0 / len(probabilities)
    by_model = likely / total if total > 0.0 else np.full(len(probabilities), uniform)
    q = UNIFORM_FRACTION * uniform + (1.0 - UNIFORM_FRACTION) * by_model
    drawn = rng.choice(len(probabilities), size=count, p=q / q.sum())
    return drawn.astype(np.intp), uniform / q[drawn]


def weighted_failures(failed: NDArray[np.bool_], weights: Array, modelled: int) -> tuple[float, float, float]:
    """Estimate the fraction of failures from weighted trials.

    Parameters
    ----------
    failed : ndarray of bool, shape (n,)
        Whether each scored trial fails.
    weights : ndarray, shape (n,)
        Weights from :func:`draw_trials`.
    modelled
        Number of modelled trials from which they were drawn.

    Returns
    -------
    fraction, standard_error, plain_trials : float
        Fraction of failures, its standard error, and the number of plain trials with the same error. If all
        trials pass or all fail, the error is 0, and the last is the number of uniformly drawn trials.
    """
    n, terms = len(failed), np.where(failed, weights, 0.0)
    fraction = min(float(terms.mean()), 1.0)
    if not 0.0 < fraction < 1.0:
        return fraction, 0.0, UNIFORM_FRACTION * n
    variance = float(terms.var(ddof=1)) / n + fraction * (1.0 - fraction) / modelled
    return fraction, math.sqrt(variance), fraction * (1.0 - fraction) / variance
