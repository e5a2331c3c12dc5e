"""Tolerance budgets: the loosest tolerances that keep a required yield.

The cost of making a part to tolerances s_i times those of the study is sum w_i / s_i, the reciprocal
cost-tolerance model (Chase and Greenwood 1988; Wu, ElMaraghy and ElMaraghy 1988 compare it with others).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.optimization.nlopt_driver import Evaluation, minimize
from tolerancing.analysis.response import Scorer
from tolerancing.analysis.yields import CONFIDENCE, Yield, yield_of
from tolerancing.merits.base import Merit

Bound = Literal["low", "share"]

SMOOTHING = 0.1
"""Width of the logistic function that stands in for pass or fail, in standard deviations of the scores."""

STEP = 1e-5
"""Relative step of the scales in numerical derivatives."""

ROUNDS = 3
"""How often the search is repeated with its aim corrected for what the smoothing does to the yield."""

EVALUATIONS_PER_ROUND = 100
SECONDS_PER_ROUND = 120.0

HALVINGS = 12
"""Of the bracket of the common factor at the end."""

MOST_COUNTS = 3 + ROUNDS + HALVINGS
"""How often all draws are counted by `verify`, at most."""


@dataclass(frozen=True)
class Budget:
    """Tolerances that keep a yield, as scales of those of the study.

    Attributes
    ----------
    scales : ndarray, shape (d,)
        By which each perturbation's deviations from its mean are to be multiplied.
    good
        Yield with these, and its interval.
    before
        Yield with the study's own tolerances.
    cost, cost_before
        sum w_i / s_i, and the same with all scales 1.
    evaluations
        How often all trials were scored, derivatives included.
    """

    scales: Array
    good: Yield
    before: Yield
    cost: float
    cost_before: float
    evaluations: int


class SearchInterrupted(KeyboardInterrupt):
    """A search that was interrupted; `budget` keeps the yield, if one was known that does."""

    def __init__(self, budget: Budget | None) -> None:
        super().__init__("interrupted")
        self.budget = budget


def loosest_tolerances(
    scorer: Scorer,
    merits: Sequence[Merit],
    mean: ArrayLike,
    deviations: ArrayLike,
    required: float,
    *,
    low: ArrayLike = 0.25,
    high: ArrayLike = 4.0,
    weights: ArrayLike = 1.0,
    bound: Bound = "low",
    verify: Scorer | None = None,
) -> Budget:
    """Scales of the tolerances with the least cost that keep the required yield.

    The same draws serve all scales (common random numbers): values = mean + scale * deviation. For the
    search each merit's pass or fail is replaced by a logistic function of its margin; SLSQP then minimises
    the cost over the scales' logarithms. What the smoothing does to the yield is measured on true pass and
    fail at the end, the aim corrected by it, and the search repeated. Last, a common factor is bisected
    until the true yield just meets the requirement; every scale stays within its range.

    The search scores all draws (1 + d) times an evaluation, some thousand times in all for 10 perturbations:
    give it a response model or a fast scorer. The true yield is counted some twenty times, with `verify`. On
    the draws that it was found with it is a little too good (by less than 0.01 with 2000 draws); fresh
    draws tell.

    Parameters
    ----------
    scorer
        Scores of deltas from nominal.
    merits
        A part is good if it keeps all their limits.
    mean : array_like, shape (d,)
        Of the perturbations; not scaled.
    deviations : array_like, shape (n, d)
        Draws at scale 1, less the mean.
    required
        Yield, above 0 and below 1.
    low, high : array_like, shape (d,)
        Ranges of the scales.
    weights : array_like, shape (d,)
        w_i, above 0.
    bound
        What must reach the requirement: the ``low`` end of the yield's interval, or the ``share`` itself.
    verify
        Scorer that tells good parts from bad where `scorer` is a model of it; left out: `scorer`.

    Returns
    -------
    Budget

    Raises
    ------
    InputError
        If even the smallest scales miss the yield, if the draws are too few to show it, or if an argument
        is out of range.
    SearchInterrupted
        If it is interrupted.
    """
    problem = _Problem(scorer, merits, mean, deviations, required, low, high, weights, bound, verify)
    tightest = problem.count(problem.low)
    if tightest < problem.needed:
        share = tightest / problem.n
        raise InputError(
            f"required yield = {required:g}: out of reach; even the smallest scales give {share:.4g} "
            f"({tightest} of {problem.n} draws, {problem.needed} needed)"
        )
    before = problem.count(np.ones(problem.d))
    try:
        problem.seek()
    except KeyboardInterrupt:
        raise SearchInterrupted(problem.budget(before)) from None
    return problem.budget(before)


class _Problem:
    """The draws, the limits, and how often they were scored."""

    def __init__(
        self,
        scorer: Scorer,
        merits: Sequence[Merit],
        mean: ArrayLike,
        deviations: ArrayLike,
        required: float,
        low: ArrayLike,
        high: ArrayLike,
        weights: ArrayLike,
        bound: Bound,
        verify: Scorer | None,
    ) -> None:
        self.scorer, self.merits, self.verify = scorer, tuple(merits), verify or scorer
        self.deviations = np.atleast_2d(np.asarray(deviations, float))
        self.n, self.d = self.deviations.shape
        self.mean, self.low, self.high, self.weights = (
            np.broadcast_to(np.asarray(v, float), (self.d,)) for v in (mean, low, high, weights)
        )
        for name, values in (("weights", self.weights), ("low", self.low)):
            if not np.all(np.isfinite(values) & (values > 0.0)):
                raise InputError(f"{name} = {values.tolist()}: must be above 0 and finite")
        if not np.all(np.isfinite(self.high) & (self.high >= self.low)):
            raise InputError(f"high = {self.high.tolist()}: must be finite and not below low")
        self.needed = draws_needed(self.n, required, bound)
        self.evaluations = 0
        self.kept: tuple[Array, int] = (self.low, 0)

    def seek(self) -> None:
        """Search, round by round, then for the largest common factor."""
        found = np.clip(np.ones(self.d), self.low, self.high)
        widths, aim = self.widths(found), self.needed / self.n
        for _ in range(ROUNDS):
            found = self.search(found, widths, min(aim, 1.0 - 0.5 / self.n))
            aim = (self.needed - self.count(found)) / self.n + self.smooth(found, widths)
        self.count_largest_factor(found)

    def budget(self, before: int) -> Budget:
        """The cheapest scales that were counted and keep the yield."""
        scales, passed = self.kept
        return Budget(
            scales,
            self.as_yield(passed),
            self.as_yield(before),
            self.cost(scales),
            float(self.weights.sum()),
            self.evaluations,
        )

    def cost(self, scales: Array) -> float:
        return float(np.sum(self.weights / scales))

    def as_yield(self, passed: int) -> Yield:
        good = yield_of(np.arange(self.n) < passed)
        assert good is not None  # there is a draw
        return good

    def scores(self, scales: Array, scorer: Scorer) -> Array:
        self.evaluations += 1
        return np.asarray(scorer(self.mean + scales * self.deviations), float)

    def count(self, scales: Array) -> int:
        """Number of good parts; the cheapest scales that have enough are remembered."""
        scores = self.scores(scales, self.verify)
        kept = [merit.passed(scores[:, k]) for k, merit in enumerate(self.merits)]
        passed = int(np.count_nonzero(np.all(kept, axis=0)))
        allowed = bool(np.all((scales >= self.low) & (scales <= self.high)))
        cheaper = not self.kept[1] or self.cost(scales) < self.cost(self.kept[0])
        if passed >= self.needed and allowed and cheaper:
            self.kept = (scales, passed)
        return passed

    def widths(self, scales: Array) -> Array:
        """Width of each merit's logistic function: a part of the spread of its scores."""
        scores = self.scores(scales, self.scorer)
        known = [column[np.isfinite(column)] for column in scores.T]
        spread = np.array([column.std() if len(column) else 0.0 for column in known])
        return np.where(spread > 0.0, SMOOTHING * spread, 1.0)

    def smooth(self, scales: Array, widths: Array) -> float:
        """Yield with the logistic function in place of pass and fail."""
        from scipy.special import expit

        scores = self.scores(scales, self.scorer)
        share = np.ones(self.n)
        for k, merit in enumerate(self.merits):
            share *= np.nan_to_num(expit(merit.margin(scores[:, k]) / widths[k]), nan=0.0)
        return float(share.mean())

    def search(self, start: Array, widths: Array, aim: float) -> Array:
        """Scales of least cost whose smoothed yield reaches the aim, by SLSQP over their logarithms."""
        base, reach = np.log(self.low), np.log(self.high / self.low)
        free = np.flatnonzero(reach > 0.0)
        if not free.size:
            return self.low
        unit = self.cost(start)

        def scales_at(point: Array) -> Array:
            full = np.zeros(self.d)
            full[free] = point
            return np.exp(base + reach * full)

        def evaluate(point: Array) -> Evaluation:
            scales = scales_at(point)
            value = self.smooth(scales, widths)
            slope = np.empty(len(free))
            for j, i in enumerate(free):
                near = scales.copy()
                near[i] *= 1.0 + STEP
                slope[j] = (self.smooth(near, widths) - value) / np.log1p(STEP) * reach[i]
            # A missed share of bad parts counts in units of the share allowed, so that both are about 1.
            allowed = max(1.0 - aim, 1.0 / self.n)
            return Evaluation(
                goals=np.array([self.cost(scales) / unit]),
                goals_by=-(self.weights / scales * reach)[None, free] / unit,
                constraints=np.array([(aim - value) / allowed]),
                constraints_by=-slope[None, :] / allowed,
            )

        first = np.clip(np.log(start / self.low)[free] / reach[free], 0.0, 1.0)
        outcome = minimize(evaluate, first, "slsqp", SECONDS_PER_ROUND, EVALUATIONS_PER_ROUND)
        return scales_at(outcome.point)

    def count_largest_factor(self, scales: Array) -> None:
        """Seek the largest common factor that keeps the yield, each scale within its range."""

        def times(logarithm: float) -> Array:
            return np.clip(np.exp(logarithm) * scales, self.low, self.high)

        smallest, largest = np.min(np.log(self.low / scales)), np.max(np.log(self.high / scales))
        if self.count(times(largest)) >= self.needed:
            return
        for _ in range(HALVINGS):
            middle = 0.5 * (smallest + largest)
            if self.count(times(middle)) >= self.needed:
                smallest = middle
            else:
                largest = middle


def draws_needed(n: int, required: float, bound: Bound) -> int:
    """Smallest number of good draws of n that shows the required yield.

    Raises
    ------
    InputError
        If the requirement or the bound is out of range, or n draws cannot show it.
    """
    if not 0.0 < required < 1.0:
        raise InputError(f"required yield = {required:g}: must be above 0 and below 1")
    if bound == "share":
        return int(np.ceil(required * n - 1e-9))
    if bound != "low":
        raise InputError(f"bound = {bound!r}: allowed: low, share")
    from scipy.special import ndtri

    # Where the Wilson interval begins at the requirement r, (share - r)^2 = z^2 r (1 - r) / n.
    z = float(ndtri(0.5 + 0.5 * CONFIDENCE))
    needed = int(np.ceil(n * required + z * np.sqrt(n * required * (1.0 - required))))
    if needed > n:
        raise InputError(
            f"required yield = {required:g}: {n} draws cannot show it, even if all are good; "
            "draw more, or judge by the share"
        )
    return needed
