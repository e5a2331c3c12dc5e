"""Control variates: estimates from many low-fidelity and a few high-fidelity trials.

All N trials have a low-fidelity score. The high-fidelity model scores the K trials that look worst, so that
the tail is known for certain. It also scores n trials drawn at random from the others, which show how the two
models differ there.

For the mean, let W be the worst trials, R the others, S the random sample of R, c and d the low- and
high-fidelity scores, and b the slope of d against c in S. The regression estimator (Cochran, Sampling
Techniques, 1977, chapter 7; control variates: Owen, Monte Carlo theory, methods and examples, 2013, section
8.9) is

    estimate = (sum_W d + N_R [mean_S(d) + b (mean_R(c) - mean_S(c))]) / N,
    variance = (N_R / N)^2 (1 - n / N_R) v_S + s_d^2 / N.

The first term of the variance comes from the sampling of S. v_S = sum_S (g e / (1 - h))^2 with weights g of
the regression estimator, residuals e and leverages h (Saerndal, Swensson and Wretman, Model Assisted Survey
Sampling, 1992, section 6.6; correction for leverage: MacKinnon and White 1985). The second term comes from
the N trials themselves, as in double sampling (Cochran, chapter 12).

For the yield, the control is the probability p(c) that a trial with low-fidelity margin c passes. It is a
logistic curve through all high-fidelity trials. Firth's fit (1993) stays finite even if passing and failing
trials do not overlap. The estimator is logistic generalized regression (Lehtonen and Veijanen 1998),

    estimate = (good of W + N_R [mean_R(p) + mean_S(good - p)]) / N,
    variance = (N_R / N)^2 (1 - n / N_R) v / n + f (1 - f) / N,

with f the yield. The random trials correct errors of the curve, so the estimate has no bias for any curve. v
is the larger of mean_R(p (1 - p)) and the mean square of good - p in S. Therefore the variance is not zero
when no trial of the sample contradicts the curve. The interval is Wilson's for the number of trials that
gives a fraction this variance (Korn and Graubard 1998). It has a width, and stays within 0 and 1, even if all
trials pass.

This interval relies on the curve where no random trial failed. Failures that are unrelated to the
low-fidelity score and rarer than about 3 / n may be missed. Its coverage is then too low (measured: 68 % if 2
% fail in this way and n = 60). A second interval therefore uses only the count of good random trials (Clopper
and Pearson 1934). It is combined with the interval of the N trials by variance estimates recovery (Zou and
Donner 2008).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from tolerancing.statistics.yields import CONFIDENCE, wilson

Indices = NDArray[np.intp]

FEWEST_RANDOM = 4
"""Smallest number of random trials for a regression line and the scatter about it."""


class TrialChoice(NamedTuple):
    """Indices of the trials for the high-fidelity model: the worst first, then random ones in order."""

    worst: Indices
    random: Indices

    @property
    def all(self) -> Indices:
        """Indices, in the order in which the estimators expect high-fidelity scores."""
        return np.concatenate([self.worst, self.random])


class Seconds(NamedTuple):
    """Computing time of one trial by each of the two merits (s)."""

    low_fidelity: float
    high_fidelity: float


@dataclass(frozen=True)
class ControlVariateEstimate:
    """A mean or a yield of the population of low-fidelity trials, with its 95 % interval.

    Attributes
    ----------
    estimate, standard_error
        Estimate, and its standard deviation over repetitions.
    low, high
        Ends of the interval.
    correlation
        Correlation of the two merits over all trials, or of passing for a yield; NaN if one does not vary.
    narrower_than_high_fidelity
        Width of the interval from the same high-fidelity trials alone, divided by the width of this one.
    narrower_than_same_time
        Width of the interval from plain high-fidelity trials that take the same total time, divided by the
        width of this one.
    low_fidelity_trials, high_fidelity_trials
        Number of trials that were used.
    left_out
        Number of high-fidelity trials without a score; a mean excludes them.
    by_counts
        Interval of a yield that uses the low-fidelity score only for the selection of the worst trials.
    """

    estimate: float
    standard_error: float
    low: float
    high: float
    correlation: float
    narrower_than_high_fidelity: float
    narrower_than_same_time: float
    low_fidelity_trials: int
    high_fidelity_trials: int
    left_out: int = 0
    by_counts: tuple[float, float] | None = None


def choose_trials(low_fidelity_margin: ArrayLike, seed: int, worst: int, random: int) -> TrialChoice:
    """Select the trials for the high-fidelity model.

    Parameters
    ----------
    low_fidelity_margin : array_like, shape (N,)
        Distance of each low-fidelity score from its limit, positive on the good side. Trials without a score
        have NaN and count as the worst.
    seed
        Seed of the random trials.
    worst, random
        Number of the worst trials, and of random other trials.

    Returns
    -------
    TrialChoice
        Indices of the selected trials.

    Raises
    ------
    InputError
        If there are fewer trials, or a number is negative.
    """
    margin = np.asarray(low_fidelity_margin, float)
    if worst < 0 or random < 0 or worst + random > len(margin):
        raise InputError(
            f"worst = {worst}, random = {random}: allowed: 0 or more each, and together "
            f"at most {len(margin)}, the number of low-fidelity trials"
        )
    order = np.argsort(np.where(np.isnan(margin), -np.inf, margin), kind="stable")
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    return TrialChoice(order[:worst], np.sort(rng.choice(order[worst:], size=random, replace=False)))


def combined_mean(
    low_fidelity: ArrayLike, chosen: TrialChoice, high_fidelity: ArrayLike, seconds: Seconds
) -> ControlVariateEstimate:
    """Return the mean of the high-fidelity score over the trials that can be scored, with Student's interval.

    The degrees of freedom (Satterthwaite 1946) combine the n - 2 of the regression with those of the spread
    of the trials.

    Parameters
    ----------
    low_fidelity : array_like, shape (N,)
        Low-fidelity scores; NaN where there is none.
    chosen
        Selection by :func:`choose_trials`.
    high_fidelity : array_like, shape (K + n,)
        High-fidelity scores in the order of ``chosen.all``.
    seconds
        Time of a trial by each merit.

    Returns
    -------
    ControlVariateEstimate
        Mean with its interval.

    Raises
    ------
    InputError
        If the shapes of the arrays do not match, or fewer than four random trials have a score.
    """
    from scipy.special import stdtrit

    c, d_worst, d_random, is_other = _arrays(
        np.asarray(low_fidelity, float), chosen, np.asarray(high_fidelity, float)
    )
    known = np.isfinite(d_random) & np.isfinite(c[chosen.random])
    x, y, worst = c[chosen.random][known], d_random[known], d_worst[np.isfinite(d_worst)]
    others = c[is_other][np.isfinite(c[is_other])]
    if len(y) < min(FEWEST_RANDOM, len(others)):
        raise InputError(f"{len(y)} random trials have a score: a mean needs at least {FEWEST_RANDOM}")
    # The fraction of the others that can be scored is estimated from the random trials.
    n_other = len(others) * len(y) / max(int(np.count_nonzero(np.isfinite(c[chosen.random]))), 1)
    total = len(worst) + n_other
    mean_other, drawn = _regression(x, y, float(others.mean()) if len(others) else 0.0)
    estimate = (worst.sum() + n_other * mean_other) / total
    weights = np.concatenate([np.ones(len(worst)), np.full(len(y), n_other / max(len(y), 1))])
    spread = _weighted_variance(np.concatenate([worst, y]), weights)
    within = (n_other / total) ** 2 * (1.0 - len(y) / max(n_other, 1.0)) * drawn
    own, high_fidelity_trials = spread / total, len(worst) + len(y)
    freedom = (within + own) ** 2 / max(
        within**2 / max(len(y) - 2, 1) + own**2 / max(high_fidelity_trials - 1, 1), np.finfo(float).tiny
    )
    half = float(stdtrit(max(freedom, 1.0), 0.5 + 0.5 * CONFIDENCE)) * math.sqrt(within + own)

    def plain(trials: float) -> float:
        return float(stdtrit(max(trials - 1.0, 1.0), 0.5 + 0.5 * CONFIDENCE)) * math.sqrt(spread / trials)

    same_time = _trials_in_same_time(len(c), len(chosen.all), seconds)
    correlation = _correlation(
        np.concatenate([c[chosen.worst][np.isfinite(d_worst)], x]), np.concatenate([worst, y]), weights
    )
    return ControlVariateEstimate(
        estimate=float(estimate),
        standard_error=math.sqrt(within + own),
        low=float(estimate - half),
        high=float(estimate + half),
        correlation=correlation,
        narrower_than_high_fidelity=_ratio(plain(high_fidelity_trials), half),
        narrower_than_same_time=_ratio(plain(same_time), half),
        low_fidelity_trials=len(c),
        high_fidelity_trials=high_fidelity_trials,
        left_out=len(chosen.all) - high_fidelity_trials,
    )


def combined_yield(
    low_fidelity_margin: ArrayLike, chosen: TrialChoice, high_fidelity_passed: ArrayLike, seconds: Seconds
) -> ControlVariateEstimate:
    """Return the yield of the high-fidelity model. A trial that cannot be scored has not passed.

    Parameters
    ----------
    low_fidelity_margin : array_like, shape (N,)
        Low-fidelity margins. The smallest of the others replaces a margin that is NaN.
    chosen
        Selection by :func:`choose_trials`.
    high_fidelity_passed : array_like of bool, shape (K + n,)
        Whether each high-fidelity trial keeps all limits, in the order of ``chosen.all``.
    seconds
        Time of a trial by each merit.

    Returns
    -------
    ControlVariateEstimate
        Yield with its intervals.

    Raises
    ------
    InputError
        If the shapes of the arrays do not match, or there are fewer than four random trials.
    """
    margin, worst, random, is_other = _arrays(
        np.asarray(low_fidelity_margin, float), chosen, np.asarray(high_fidelity_passed, bool)
    )
    total, n_other, n = len(margin), int(np.count_nonzero(is_other)), len(random)
    if n < min(FEWEST_RANDOM, n_other):
        raise InputError(f"{n} random trials: a yield needs at least {FEWEST_RANDOM}")
    good = np.concatenate([worst, random]).astype(float)
    probability = _pass_probabilities(margin, chosen.all, good)
    residuals = good[len(worst) :] - probability[chosen.random]
    by_curve = (worst.sum() + probability[is_other].sum()) / total
    estimate = float(by_curve + n_other / total * residuals.mean()) if n else float(by_curve)
    estimate = min(max(estimate, 0.0), 1.0)
    drawn = 0.0
    if 0 < n < n_other:
        of_curve = float(np.mean((probability * (1.0 - probability))[is_other]))
        spread = max(of_curve, float(residuals @ residuals) / max(n - 1, 1))
        drawn = (n_other / total) ** 2 * (1.0 - n / n_other) * spread / n
    binomial = max(float(by_curve * (1.0 - by_curve)), estimate * (1.0 - estimate))
    variance = drawn + binomial / total
    low, high = wilson(estimate, binomial / variance if variance > 0.0 else total)

    def plain(trials: float) -> float:
        ends = wilson(estimate, trials)
        return ends[1] - ends[0]

    same_time = _trials_in_same_time(total, len(good), seconds)
    weights = np.concatenate([np.ones(len(worst)), np.full(n, n_other / max(n, 1))])
    return ControlVariateEstimate(
        estimate=estimate,
        standard_error=math.sqrt(variance),
        low=low,
        high=high,
        correlation=_correlation((margin >= 0.0)[chosen.all].astype(float), good, weights),
        narrower_than_high_fidelity=_ratio(plain(len(good)), high - low),
        narrower_than_same_time=_ratio(plain(same_time), high - low),
        low_fidelity_trials=total,
        high_fidelity_trials=len(good),
        by_counts=_by_counts(worst, random, total),
    )


def _trials_in_same_time(low_fidelity_trials: int, high_fidelity_trials: int, seconds: Seconds) -> float:
    """Return how many plain high-fidelity trials take as long as the trials by both merits."""
    both = low_fidelity_trials * seconds.low_fidelity + high_fidelity_trials * seconds.high_fidelity
    return both / seconds.high_fidelity


def _by_counts(worst: NDArray[np.bool_], random: NDArray[np.bool_], total: int) -> tuple[float, float]:
    """Return the interval of a yield from the worst trials and the count of good random trials alone."""
    from scipy.special import betaincinv

    n, other = len(random), (total - len(worst)) / total
    fraction = float(random.mean()) if n else 0.0
    estimate = float(np.count_nonzero(worst)) / total + other * fraction
    low, high = wilson(estimate, total)
    below, above = estimate - low, high - estimate
    if 0 < n < total - len(worst):
        good = int(np.count_nonzero(random))
        least = float(betaincinv(good, n - good + 1, 0.5 - 0.5 * CONFIDENCE)) if good else 0.0
        most = float(betaincinv(good + 1, n - good, 0.5 + 0.5 * CONFIDENCE)) if good < n else 1.0
        factor = other * math.sqrt(1.0 - n / (total - len(worst)))
        below = math.hypot(below, factor * (fraction - least))
        above = math.hypot(above, factor * (most - fraction))
    return max(estimate - below, 0.0), min(estimate + above, 1.0)


def _arrays(
    low: NDArray, chosen: TrialChoice, high: NDArray
) -> tuple[NDArray, NDArray, NDArray, NDArray[np.bool_]]:
    """Return low-fidelity values, high-fidelity ones of worst and random trials, and a mask of the others."""
    every = chosen.all
    if low.ndim != 1 or high.shape != every.shape:
        raise InputError(
            f"high-fidelity scores: {high.size} for {len(every)} chosen trials; each trial needs one score"
        )
    if not len(low):
        raise InputError("low-fidelity scores: there are none; at least one is needed")
    if len(np.unique(every)) < len(every) or np.any((every < 0) | (every >= len(low))):
        raise InputError(f"chosen trials: must be different, and numbers from 0 to {len(low) - 1}")
    is_other = np.ones(len(low), bool)
    is_other[chosen.worst] = False
    return low, high[: len(chosen.worst)], high[len(chosen.worst) :], is_other


def _regression(x: Array, y: Array, mean_x: float) -> tuple[float, float]:
    """Return the regression estimate of the mean of y for a known mean of x, and its variance."""
    n = len(y)
    if n == 0:
        return 0.0, 0.0
    deviations = x - x.mean()
    squares = float(deviations @ deviations)
    varies = n > 2 and squares > 0.0
    slope_weights = deviations / squares if varies else np.zeros(n)
    slope = float(slope_weights @ y)
    residuals = y - y.mean() - slope * deviations
    leverage = 1.0 / n + slope_weights * deviations
    weights = 1.0 / n + (mean_x - x.mean()) * slope_weights
    variance = float(np.sum((weights * residuals / np.maximum(1.0 - leverage, 1e-9)) ** 2))
    return float(y.mean() + slope * (mean_x - x.mean())), variance


def _pass_probabilities(margin: Array, scored: Indices, good: Array) -> Array:
    """Return the probability of every trial to pass, from a logistic fit to the scored trials (Firth)."""
    from scipy.special import expit

    known = np.isfinite(margin)
    lowest = float(margin[known].min()) if known.any() else 0.0
    filled = np.where(known, margin, lowest)
    spread = float(filled.std())
    x = np.column_stack([np.ones(len(filled)), (filled - filled.mean()) / (spread if spread > 0.0 else 1.0)])
    scored_x, beta = x[scored], np.zeros(2)
    longest_step = 3.0  # In the two coefficients, for standardized margins.
    for _ in range(50):
        p = np.asarray(expit(scored_x @ beta))
        weight = p * (1.0 - p)
        inverse = np.linalg.inv(scored_x.T @ (scored_x * weight[:, None]) + 1e-9 * np.eye(2))
        leverage = weight * np.einsum("ij,jk,ik->i", scored_x, inverse, scored_x)
        step = inverse @ (scored_x.T @ (good - p + leverage * (0.5 - p)))
        longest = float(np.max(np.abs(step)))
        beta = beta + step * min(1.0, longest_step / max(longest, 1e-300))
        if longest < 1e-8:
            break
    return np.asarray(expit(x @ beta))


def _weighted_variance(values: Array, weights: Array) -> float:
    """Return the variance of the population that the weighted values represent."""
    if len(values) < 2:
        return 0.0
    spread = np.cov(values, aweights=weights, bias=True)
    return float(spread) * len(values) / (len(values) - 1)


def _correlation(x: Array, y: Array, weights: Array) -> float:
    """Return the weighted correlation; NaN if one of the two does not vary."""
    if not weights.sum() > 0.0:
        return math.nan
    (xx, xy), (_, yy) = np.cov(x, y, aweights=weights, bias=True).tolist()
    return xy / math.sqrt(xx * yy) if xx * yy > 0.0 else math.nan


def _ratio(wide: float, narrow: float) -> float:
    return wide / narrow if narrow > 0.0 else math.nan
