"""Yields of lenses that seldom fail: importance sampling, with failures proposed by a model of the trials.

A plain run of n trials that all pass says no more than that fewer than some 3 / n fail. Here a second-order
model of the merits (:mod:`tolerancing.statistics.response`), fitted to trials that there are, tells of many
more trials, which cost nothing, how likely each is to fail: with m_k the model's margin of merit k, and s_k
the standard deviation of the scores that the fit leaves,

    p = 1 - prod_k Phi(m_k / s_k).

Trials for the lens itself are drawn from these with chances q that go as the root of p, which is best where
p is right, and a share of them evenly, lest failures of which the model knows nothing weigh much (Owen and
Zhou, J. Am. Stat. Assoc. 95, 135, 2000). With N modelled trials, n scored ones, and f_i = 1 where a scored
one fails,

    estimate = (1 / n) sum_i f_i / (N q_i),

which has no bias whatever the model says. Its variance is that of the n terms, and that of the N trials
themselves, which are a sample too. The interval is Wilson's with as many trials as have that variance (Korn
and Graubard, Survey Methodology 24, 193, 1998); where no trial failed it is that of the evenly drawn ones.
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

MODELLED = 400_000
EVEN_SHARE = 0.2
FEWEST_TRIALS = 50

FIRST_TRIAL = 1 << 24
"""Number of the first scored trial, by which figures of irregularities are drawn; beyond any store's."""


@dataclass(frozen=True, eq=False)
class RareYield:
    """A yield from trials that were chosen where failures are likely.

    Attributes
    ----------
    study
        Whose yield it is.
    share, low, high
        Yield over all limits, and the ends of its 95 % interval.
    standard_error
        Of the yield.
    trials, failed
        Trials of the lens that were scored, and those of them that failed.
    plain_trials
        How many plain trials have an interval as narrow.
    modelled_share
        Yield as the model alone has it.
    cross_validated_r_squared : ndarray, shape (merits,)
        How well the model predicts trials that it was not fitted to.
    """

    study: Study
    share: float
    low: float
    high: float
    standard_error: float
    trials: int
    failed: int
    plain_trials: float
    modelled_share: float
    cross_validated_r_squared: Array

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        merits = zip(self.study.merits, self.cross_validated_r_squared.tolist(), strict=True)
        return {
            "yield": {"share": self.share, "low": self.low, "high": self.high, "confidence": CONFIDENCE},
            "standard_error": self.standard_error,
            "trials": self.trials,
            "failed": self.failed,
            "plain_trials": self.plain_trials,
            "modelled_yield": self.modelled_share,
            "cross_validated_r_squared": {merit.column: finite_or_none(r) for merit, r in merits},
        }


def rare_yield(store: Store, trials: int, *, report: Callable[[int], None] | None = None) -> RareYield:
    """Yield of a stored study from further trials of its lens, most of them where failures are likely.

    Parameters
    ----------
    store
        An open store with enough trials for a model.
    trials
        Number of trials of the lens to score.
    report
        Called with the number of trials scored after each part.

    Raises
    ------
    InputError
        If there are fewer than `FEWEST_TRIALS` trials to score, or the store has too few for a model.
    """
    if trials < FEWEST_TRIALS:
        raise InputError(f"trials = {trials}: must be at least {FEWEST_TRIALS}")
    check_trial_memory(store.study, trials)
    loaded, held = store.loaded, store.trials()
    study, response = loaded.study, fit_response(held.values, held.scores)
    rng = np.random.default_rng(np.random.SeedSequence(study.seed, spawn_key=(0, 0, 2)))
    values = modelled_trials(study, MODELLED, rng)
    chances = failure_chances(study, response, held.values, held.scores, values)
    drawn, weights = proposed(chances, trials, rng)
    scorer = StudyScorer(context_of(loaded.lens, study), study, report)
    scores = scorer(values[drawn], range(FIRST_TRIAL, FIRST_TRIAL + trials))
    kept = all_passed(study.merits, scores)
    share, error, plain = weighted_failures(~kept, weights, MODELLED)
    low, high = wilson(1.0 - share, plain)
    return RareYield(
        study=study,
        share=1.0 - share,
        low=low,
        high=high,
        standard_error=error,
        trials=trials,
        failed=int(np.count_nonzero(~kept)),
        plain_trials=plain,
        modelled_share=1.0 - float(np.mean(chances)),
        cross_validated_r_squared=response.cross_validated_r_squared,
    )


def modelled_trials(study: Study, count: int, rng: np.random.Generator) -> Array:
    """Deltas of many random trials, shape (count, perturbations)."""
    drawn = np.clip(rng.random((count, len(study.perturbations))), SMALLEST, LARGEST)
    dependent = study.dependence.apply(drawn)
    shapes = [p.distribution for p in study.perturbations]
    return np.column_stack([shape.quantile(dependent[:, k]) for k, shape in enumerate(shapes)])


def failure_chances(study: Study, response: Response, values: Array, scores: Array, asked: Array) -> Array:
    """Chance of each of the asked trials to miss a limit, by a model and what it leaves of known scores."""
    left = scores - response.predict(values)
    # Left out, not fitted, a trial lies farther from the model by the root of the ratio of both R^2.
    missed = 1.0 - response.r_squared
    worse = (1.0 - response.cross_validated_r_squared) / np.maximum(missed, 1e-12)
    spread = np.sqrt(np.nanmean(left**2, axis=0) * np.maximum(worse, 1.0))
    predicted, good = response.predict(asked), np.ones(len(asked))
    for k, merit in enumerate(study.merits):
        margin = merit.margin(predicted[:, k])
        good *= ndtr(margin / spread[k]) if spread[k] > 0.0 else margin >= 0.0
    return np.asarray(1.0 - good)


def proposed(chances: Array, count: int, rng: np.random.Generator) -> tuple[NDArray[np.intp], Array]:
    """Which modelled trials to score, drawn with replacement, and what each stands for.

    Returns
    -------
    indices, weights : ndarray, shape (count,)
        1 / (N q): the mean of the weights of those that fail is the share of failures.
    """
    likely = np.sqrt(np.clip(chances, 0.0, 1.0))
    total, even = float(likely.sum()), 1.0 / len(chances)
    rest = likely / total if total > 0.0 else np.full(len(chances), even)
    q = EVEN_SHARE * even + (1.0 - EVEN_SHARE) * rest
    drawn = rng.choice(len(chances), size=count, p=q / q.sum())
    return drawn.astype(np.intp), even / q[drawn]


def weighted_failures(failed: NDArray[np.bool_], weights: Array, modelled: int) -> tuple[float, float, float]:
    """Share of failures, its standard error, and how many plain trials have that.

    Parameters
    ----------
    failed : ndarray of bool, shape (n,)
        Which scored trials fail.
    weights : ndarray, shape (n,)
        From :func:`proposed`.
    modelled
        Number of trials that they were drawn from.
    """
    n, terms = len(failed), np.where(failed, weights, 0.0)
    share = min(float(terms.mean()), 1.0)
    if not 0.0 < share < 1.0:
        return share, 0.0, EVEN_SHARE * n
    variance = float(terms.var(ddof=1)) / n + share * (1.0 - share) / modelled
    if variance == 0.0:
        return share, 0.0, float(n)
    return share, math.sqrt(variance), share * (1.0 - share) / variance
