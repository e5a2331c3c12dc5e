"""Control variates: many cheap trials and a few dear ones tell more than either alone.

All N trials have a cheap score. The dear model scores the K of them that look worst, so that the tail is
known for certain, and n drawn at random from the others, which tell how the two models differ there.

For the mean, with W the worst, R the others, S the random ones of R, c cheap and d dear scores, and b the
slope of d against c in S (the regression estimator: Cochran, Sampling Techniques, 1977, chapter 7; control
variates: Owen, Monte Carlo theory, methods and examples, 2013, section 8.9),

    estimate = (sum_W d + N_R [mean_S(d) + b (mean_R(c) - mean_S(c))]) / N,
    variance = (N_R / N)^2 (1 - n / N_R) v_S + s_d^2 / N.

The first term is that of the draw of S from the N trials. v_S = sum_S (g e / (1 - h))^2 with weights g of
the regression estimator, residuals e and leverages h (Saerndal, Swensson and Wretman, Model Assisted Survey
Sampling, 1992, section 6.6; the jackknife-like correction for leverage of MacKinnon and White 1985). The
second term is that of the N trials themselves, as in double sampling (Cochran, chapter 12).

For the yield the control is the chance p(c) that a trial of cheap margin c passes, a logistic curve through
all dear trials (fitted as Firth 1993 does, which stays finite where passing and failing trials do not mix):

    estimate = (good of W + N_R [mean_R(p) + mean_S(good - p)]) / N,
    variance = (N_R / N)^2 (1 - n / N_R) v / n + share (1 - share) / N

(logistic generalised regression: Lehtonen and Veijanen 1998). Wherever the curve lies the estimate has no
bias, for the random trials correct it. v is the larger of mean_R(p (1 - p)) and of the mean square of
good - p in S: a sample in which no trial contradicts the curve does not make the variance zero. The interval
is Wilson's with as many trials as make a share's variance this large (Korn and Graubard 1998), so that it
keeps a width, and stays within 0 and 1, where all trials pass. It does trust the curve where no random trial
failed: failures of which the cheap score knows nothing, rarer than some 3 / n, may stay unseen;
it covers too seldom then (measured: 68 % where 2 % fail so and n = 60). A second interval therefore takes
from the random trials no more than their count (Clopper and Pearson 1934), joined with that of the N trials
by the method of variance estimates recovery (Zou and Donner 2008).
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
"""Random trials needed to fit a line and tell how far trials lie from it."""

NEWTON_STEPS, LONGEST_STEP = 50, 3.0
"""Of the fit of the logistic curve; the step in its two coefficients, the margins standardized."""


class TrialChoice(NamedTuple):
    """Trials for the dear model: indices of the worst, worst first, and of the random ones, ascending."""

    worst: Indices
    random: Indices

    @property
    def all(self) -> Indices:
        """Both together, in the order in which dear scores are given to the estimators."""
        return np.concatenate([self.worst, self.random])


class Seconds(NamedTuple):
    """Computing time of one trial by each merit."""

    cheap: float
    dear: float


@dataclass(frozen=True)
class ControlVariateEstimate:
    """A mean or a yield with its 95 % interval, for the population that the cheap trials were drawn from.

    Attributes
    ----------
    estimate, standard_error
        The estimate and its standard deviation over repetitions.
    low, high
        Ends of the interval.
    correlation
        Between the two merits over all trials, for a yield that of passing; NaN where one does not vary.
    narrower_than_dear
        Width of the interval of as many dear trials alone, over this one's.
    narrower_than_same_time
        Width of the interval of plain dear trials that take as long as both merits, over this one's.
    cheap_trials, dear_trials
        Number of trials that were used.
    left_out
        Number of dear trials without a score, which a mean leaves out.
    by_counts
        Interval of a yield that does not trust the cheap score beyond the choice of the worst trials.
    """

    estimate: float
    standard_error: float
    low: float
    high: float
    correlation: float
    narrower_than_dear: float
    narrower_than_same_time: float
    cheap_trials: int
    dear_trials: int
    left_out: int = 0
    by_counts: tuple[float, float] | None = None


def choose_trials(cheap_margin: ArrayLike, seed: int, worst: int, random: int) -> TrialChoice:
    """Which trials to give to the dear model.

    Parameters
    ----------
    cheap_margin : array_like, shape (N,)
        How far the cheap scores lie on the good side of their limits; NaN, first of the worst, where there
        is no score.
    seed
        The random trials follow from it alone.
    worst, random
        How many of each.

    Raises
    ------
    InputError
        If there are fewer trials, or a number is negative.
    """
    margin = np.asarray(cheap_margin, float)
    if worst < 0 or random < 0 or worst + random > len(margin):
        raise InputError(
            f"worst = {worst}, random = {random}: allowed: 0 or more each, and together "
            f"at most {len(margin)}, the number of cheap trials"
        )
    order = np.argsort(np.where(np.isnan(margin), -np.inf, margin), kind="stable")
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    return TrialChoice(order[:worst], np.sort(rng.choice(order[worst:], size=random, replace=False)))


def best_narrowing(correlation: float, cost_ratio: float) -> float:
    """How much narrower the interval of a mean gets at the same time, with the best share of cheap trials.

    With rho the correlation, and a dear trial r times as expensive as a cheap one, the variance times the
    time is smallest for N / n = rho sqrt(r / (1 - rho^2)), and the interval is narrower than that of plain
    dear trials by 1 / (sqrt(1 - rho^2) + rho / sqrt(r)) (Cochran section 12.3; Peherstorfer, Willcox and
    Gunzburger 2016). Below 1 the plain trials are better. Three times narrower asks for rho = 0.994 at
    r = 20, 0.972 at r = 100, 0.943 at any cost ratio; one third of the variance asks for 0.930 at r = 20.
    """
    rho = abs(correlation)
    return 1.0 / (math.sqrt(1.0 - rho * rho) + rho / math.sqrt(cost_ratio))


def combined_mean(
    cheap: ArrayLike, chosen: TrialChoice, dear: ArrayLike, seconds: Seconds
) -> ControlVariateEstimate:
    """Mean of the dear score over the trials that can be scored, with Student's interval.

    Degrees of freedom by Satterthwaite 1946 from the n - 2 of the regression and those of the trials' own
    spread.

    Parameters
    ----------
    cheap : array_like, shape (N,)
        Cheap scores; NaN where there is none.
    chosen
        From :func:`choose_trials`.
    dear : array_like, shape (K + n,)
        Dear scores in the order of ``chosen.all``.
    seconds
        Time of a trial by each merit.

    Raises
    ------
    InputError
        If arrays do not match, or too few random trials are scored.
    """
    from scipy.special import stdtrit

    c, d_worst, d_random, rest = _arrays(np.asarray(cheap, float), chosen, np.asarray(dear, float))
    known = np.isfinite(d_random) & np.isfinite(c[chosen.random])
    x, y, worst = c[chosen.random][known], d_random[known], d_worst[np.isfinite(d_worst)]
    others = c[rest][np.isfinite(c[rest])]
    if len(y) < min(FEWEST_RANDOM, len(others)):
        raise InputError(f"{len(y)} random trials have a score: a mean needs at least {FEWEST_RANDOM}")
    # As many of the others have a dear score, in proportion, as of the random trials.
    n_rest = len(others) * len(y) / max(int(np.count_nonzero(np.isfinite(c[chosen.random]))), 1)
    total = len(worst) + n_rest
    mean_rest, drawn = _regression(x, y, float(others.mean()) if len(others) else 0.0)
    estimate = (worst.sum() + n_rest * mean_rest) / total
    weights = np.concatenate([np.ones(len(worst)), np.full(len(y), n_rest / max(len(y), 1))])
    spread = _weighted_variance(np.concatenate([worst, y]), weights)
    within = (n_rest / total) ** 2 * (1.0 - len(y) / max(n_rest, 1.0)) * drawn
    own, dear_trials = spread / total, len(worst) + len(y)
    freedom = (within + own) ** 2 / max(
        within**2 / max(len(y) - 2, 1) + own**2 / max(dear_trials - 1, 1), np.finfo(float).tiny
    )
    half = float(stdtrit(max(freedom, 1.0), 0.5 + 0.5 * CONFIDENCE)) * math.sqrt(within + own)

    def plain(trials: float) -> float:
        return float(stdtrit(max(trials - 1.0, 1.0), 0.5 + 0.5 * CONFIDENCE)) * math.sqrt(spread / trials)

    same_time = (len(c) * seconds.cheap + len(chosen.all) * seconds.dear) / seconds.dear
    correlation = _correlation(
        np.concatenate([c[chosen.worst][np.isfinite(d_worst)], x]), np.concatenate([worst, y]), weights
    )
    return ControlVariateEstimate(
        estimate=float(estimate),
        standard_error=math.sqrt(within + own),
        low=float(estimate - half),
        high=float(estimate + half),
        correlation=correlation,
        narrower_than_dear=_ratio(plain(dear_trials), half),
        narrower_than_same_time=_ratio(plain(same_time), half),
        cheap_trials=len(c),
        dear_trials=dear_trials,
        left_out=len(chosen.all) - dear_trials,
    )


def combined_yield(
    cheap_margin: ArrayLike, chosen: TrialChoice, dear_passed: ArrayLike, seconds: Seconds
) -> ControlVariateEstimate:
    """Yield of the dear model; a trial that cannot be scored has not passed.

    Parameters
    ----------
    cheap_margin : array_like, shape (N,)
        Cheap margins; where there is none, the smallest of the others stands in for it.
    chosen
        From :func:`choose_trials`.
    dear_passed : array_like of bool, shape (K + n,)
        Which dear trials keep all limits, in the order of ``chosen.all``.
    seconds
        Time of a trial by each merit.

    Raises
    ------
    InputError
        If arrays do not match, or there are too few random trials.
    """
    margin, worst, random, rest = _arrays(
        np.asarray(cheap_margin, float), chosen, np.asarray(dear_passed, bool)
    )
    total, n_rest, n = len(margin), int(np.count_nonzero(rest)), len(random)
    if n < min(FEWEST_RANDOM, n_rest):
        raise InputError(f"{n} random trials: a yield needs at least {FEWEST_RANDOM}")
    good = np.concatenate([worst, random]).astype(float)
    chance = _chances(margin, chosen.all, good)
    left = good[len(worst) :] - chance[chosen.random]
    by_curve = (worst.sum() + chance[rest].sum()) / total
    estimate = float(by_curve + n_rest / total * left.mean()) if n else float(by_curve)
    estimate = min(max(estimate, 0.0), 1.0)
    drawn = 0.0
    if 0 < n < n_rest:
        spread = max(float(np.mean((chance * (1.0 - chance))[rest])), float(left @ left) / max(n - 1, 1))
        drawn = (n_rest / total) ** 2 * (1.0 - n / n_rest) * spread / n
    share = max(float(by_curve * (1.0 - by_curve)), estimate * (1.0 - estimate))
    variance = drawn + share / total
    low, high = wilson(estimate, share / variance if variance > 0.0 else total)

    def plain(trials: float) -> float:
        ends = wilson(estimate, trials)
        return ends[1] - ends[0]

    same_time = (total * seconds.cheap + len(good) * seconds.dear) / seconds.dear
    weights = np.concatenate([np.ones(len(worst)), np.full(n, n_rest / max(n, 1))])
    return ControlVariateEstimate(
        estimate=estimate,
        standard_error=math.sqrt(variance),
        low=low,
        high=high,
        correlation=_correlation((margin >= 0.0)[chosen.all].astype(float), good, weights),
        narrower_than_dear=_ratio(plain(len(good)), high - low),
        narrower_than_same_time=_ratio(plain(same_time), high - low),
        cheap_trials=total,
        dear_trials=len(good),
        by_counts=_by_counts(worst, random, total),
    )


def _by_counts(worst: NDArray[np.bool_], random: NDArray[np.bool_], total: int) -> tuple[float, float]:
    """Interval of a yield from the worst trials and the number of good random ones alone."""
    from scipy.special import betaincinv

    n, rest = len(random), (total - len(worst)) / total
    share = float(random.mean()) if n else 0.0
    estimate = float(np.count_nonzero(worst)) / total + rest * share
    low, high = wilson(estimate, total)
    below, above = estimate - low, high - estimate
    if 0 < n < total - len(worst):
        good = int(np.count_nonzero(random))
        least = float(betaincinv(good, n - good + 1, 0.5 - 0.5 * CONFIDENCE)) if good else 0.0
        most = float(betaincinv(good + 1, n - good, 0.5 + 0.5 * CONFIDENCE)) if good < n else 1.0
        part = rest * math.sqrt(1.0 - n / (total - len(worst)))
        below = math.hypot(below, part * (share - least))
        above = math.hypot(above, part * (most - share))
    return max(estimate - below, 0.0), min(estimate + above, 1.0)


def _arrays(
    cheap: NDArray, chosen: TrialChoice, dear: NDArray
) -> tuple[NDArray, NDArray, NDArray, NDArray[np.bool_]]:
    """Cheap values, dear ones of the worst and of the random trials, and which are not of the worst."""
    every = chosen.all
    if cheap.ndim != 1 or dear.shape != every.shape:
        raise InputError(f"dear scores: {dear.size} for {len(every)} chosen trials; one each is needed")
    if not len(cheap):
        raise InputError("cheap scores: there are none")
    if len(np.unique(every)) < len(every) or np.any((every < 0) | (every >= len(cheap))):
        raise InputError(f"chosen trials: must be different and within the {len(cheap)} cheap trials")
    rest = np.ones(len(cheap), bool)
    rest[chosen.worst] = False
    return cheap, dear[: len(chosen.worst)], dear[len(chosen.worst) :], rest


def _regression(x: Array, y: Array, mean_x: float) -> tuple[float, float]:
    """Regression estimate of the mean of y where the mean of x is known, and its variance."""
    n = len(y)
    if n == 0:
        return 0.0, 0.0
    away = x - x.mean()
    squares = float(away @ away)
    varies = n > 2 and squares > 0.0
    tilt = away / squares if varies else np.zeros(n)
    slope = float(tilt @ y)
    left = y - y.mean() - slope * away
    leverage = 1.0 / n + tilt * away
    shares = 1.0 / n + (mean_x - x.mean()) * tilt
    variance = float(np.sum((shares * left / np.maximum(1.0 - leverage, 1e-9)) ** 2))
    return float(y.mean() + slope * (mean_x - x.mean())), variance


def _chances(margin: Array, seen: Indices, good: Array) -> Array:
    """Chance of every trial to pass, from a logistic curve of good against the margins of the seen trials."""
    from scipy.special import expit

    known = np.isfinite(margin)
    lowest = float(margin[known].min()) if known.any() else 0.0
    filled = np.where(known, margin, lowest)
    spread = float(filled.std())
    x = np.column_stack([np.ones(len(filled)), (filled - filled.mean()) / (spread if spread > 0.0 else 1.0)])
    seen_x, beta = x[seen], np.zeros(2)
    for _ in range(NEWTON_STEPS):
        p = np.asarray(expit(seen_x @ beta))
        weight = p * (1.0 - p)
        inverse = np.linalg.inv(seen_x.T @ (seen_x * weight[:, None]) + 1e-9 * np.eye(2))
        leverage = weight * np.einsum("ij,jk,ik->i", seen_x, inverse, seen_x)
        step = inverse @ (seen_x.T @ (good - p + leverage * (0.5 - p)))
        longest = float(np.max(np.abs(step)))
        beta = beta + step * min(1.0, LONGEST_STEP / max(longest, 1e-300))
        if longest < 1e-8:
            break
    return np.asarray(expit(x @ beta))


def _weighted_variance(values: Array, weights: Array) -> float:
    """Variance of the population that the weighted values stand for."""
    if len(values) < 2:
        return 0.0
    spread = np.cov(values, aweights=weights, bias=True)
    return float(spread) * len(values) / (len(values) - 1)


def _correlation(x: Array, y: Array, weights: Array) -> float:
    """Weighted correlation; NaN where one of both does not vary."""
    if not weights.sum() > 0.0:
        return math.nan
    (xx, xy), (_, yy) = np.cov(x, y, aweights=weights, bias=True).tolist()
    return xy / math.sqrt(xx * yy) if xx * yy > 0.0 else math.nan


def _ratio(wide: float, narrow: float) -> float:
    return wide / narrow if narrow > 0.0 else math.nan
