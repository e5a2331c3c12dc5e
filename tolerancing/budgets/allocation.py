"""The search for the loosest tolerances whose predicted yield meets a requirement.

The cost of making a part to tolerances s_i times those of the study is sum w_i / s_i, the reciprocal
cost-tolerance model (Chase and Greenwood 1988; Wu, ElMaraghy and ElMaraghy 1988 compare it with others).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.optimization.nlopt_driver import Evaluation, minimize
from tolerancing.merits.base import Merit, all_passed

SMOOTHING = (0.1, 0.05)
"""Widths of the logistic function that replaces pass or fail, in standard deviations of the scores."""

ROUNDS = 3
"""How often a search is repeated for each width, its aim corrected for the effect of the smoothing."""

EVALUATIONS_PER_ROUND = 60
SECONDS_PER_ROUND = 120.0

HALVINGS = 24
"""Of the bracket of a common factor."""


class ScoreModel(Protocol):
    """Scores of drawn lenses as a function of the scales of d tolerances; n lenses, m merits."""

    def scores(self, scales: Array) -> Array:
        """Scores, shape (n, m); NaN where a lens has none."""

    def slopes(self, scales: Array) -> tuple[Array, Array]:
        """Scores, shape (n, m), and their derivatives by the scales, shape (n, m, d)."""


@dataclass(frozen=True)
class Budget:
    """Tolerances that keep a yield, as scales of those of the study.

    Attributes
    ----------
    scales : ndarray, shape (d,)
        Factors by which each perturbation's deviations from its mean are multiplied.
    predicted_yield, predicted_yield_before
        Fraction of the model's lenses that are good with these tolerances, and with the study's own.
    cost, cost_before
        Sum of w_i / s_i, and the same with all scales 1.
    uniform_scale, uniform_cost
        The largest common scale of all tolerances that keeps the yield, and its cost; None where none does.
    evaluations
        How often all lenses were scored.
    """

    scales: Array
    predicted_yield: float
    predicted_yield_before: float
    cost: float
    cost_before: float
    uniform_scale: float | None
    uniform_cost: float | None
    evaluations: int


def allocate_tolerances(
    model: ScoreModel,
    merits: Sequence[Merit],
    required: float,
    *,
    low: ArrayLike,
    high: ArrayLike,
    weights: ArrayLike = 1.0,
) -> Budget:
    """Find the scales of least cost with which the model's lenses keep the required yield.

    For the search each merit's pass or fail is replaced by a logistic function of its margin. SLSQP then
    minimizes the cost over the logarithms of the scales, from the largest common scale that keeps the yield.
    The effect of the smoothing on the yield is measured on true pass and fail, the aim is corrected by it,
    and the search is repeated with less smoothing. Finally a common factor is bisected until the true yield
    just meets the requirement; every scale stays within its range. The result is the cheapest of this, of the
    best common scale, and of the study's own tolerances if they keep the yield.

    Parameters
    ----------
    model
        Scores of drawn lenses.
    merits
        A lens is good if it keeps the limits of all m of them.
    required
        Yield, above 0 and below 1.
    low, high : array_like, shape (d,)
        Ranges of the scales.
    weights : array_like, shape (d,)
        w_i, above 0.

    Raises
    ------
    InputError
        If even the smallest scales miss the yield, or an argument is out of range.
    """
    lowest, highest, weight = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(v, float)) for v in (low, high, weights))
    )
    for name, values in (("weights", weight), ("low", lowest)):
        if not np.all(np.isfinite(values) & (values > 0.0)):
            raise InputError(f"{name} = {values.tolist()}: must be above 0 and finite")
    if not np.all(np.isfinite(highest) & (highest >= lowest)):
        raise InputError(f"high = {highest.tolist()}: must be finite and not below low")
    check_required(required)
    search = _Search(model, tuple(merits), required, lowest, highest, weight)
    smallest = search.count(lowest)
    if smallest < required:
        raise InputError(
            f"required yield = {required:g}: out of reach; even with the smallest scales the predicted yield "
            f"is {smallest:.4g}"
        )
    return search.run()


def check_required(required: float) -> None:
    """Refuse a yield that is not between 0 and 1, with an InputError."""
    if not 0.0 < required < 1.0:
        raise InputError(f"required yield = {required:g}: must be above 0 and below 1")


class _Search:
    def __init__(
        self,
        model: ScoreModel,
        merits: tuple[Merit, ...],
        required: float,
        low: Array,
        high: Array,
        weights: Array,
    ) -> None:
        self.model, self.merits, self.required = model, merits, required
        self.low, self.high, self.weights = low, high, weights
        self.evaluations = 0
        self.best: tuple[float, Array, float] | None = None

    def run(self) -> Budget:
        """Search from the best common scale; the cheapest scales that keep the yield count."""
        ones = np.ones_like(self.low)
        before = self.count(ones)
        uniform = self.largest_factor(ones)
        found = np.clip(uniform, self.low, self.high)
        for smoothing in SMOOTHING:
            widths, aim = self.widths(found, smoothing), self.required
            for _ in range(ROUNDS):
                found = self.search(found, widths, min(aim, 1.0 - 1e-4))
                aim = self.required + self.smooth_yield(found, widths) - self.count(found)
            found = self.largest_factor(found)
        assert self.best is not None  # the smallest scales keep the yield
        cost, scales, good = self.best
        common = np.unique(uniform[self.low < self.high])
        free = len(common) == 1
        return Budget(
            scales,
            good,
            before,
            cost,
            self.cost(ones),
            float(common[0]) if free else None,
            self.cost(uniform) if free else None,
            self.evaluations,
        )

    def cost(self, scales: Array) -> float:
        return float(np.sum(self.weights / scales))

    def count(self, scales: Array) -> float:
        """Fraction of good lenses; the cheapest scales that keep the yield are remembered."""
        self.evaluations += 1
        scores = self.model.scores(scales)
        good = float(np.mean(all_passed(self.merits, scores)))
        cost = self.cost(scales)
        allowed = bool(np.all((scales >= self.low) & (scales <= self.high)))
        if good >= self.required and allowed and (self.best is None or cost < self.best[0]):
            self.best = (cost, scales, good)
        return good

    def widths(self, scales: Array, smoothing: float) -> Array:
        """Width of each merit's logistic function: a part of the spread of its scores."""
        self.evaluations += 1
        known = [column[np.isfinite(column)] for column in self.model.scores(scales).T]
        spread = np.array([column.std() if len(column) else 0.0 for column in known])
        return np.where(spread > 0.0, smoothing * spread, 1.0)

    def smooth_yield(self, scales: Array, widths: Array) -> float:
        self.evaluations += 1
        return float(np.mean(np.prod(self.smooth_passes(self.model.scores(scales), widths), axis=1)))

    def smooth_passes(self, scores: Array, widths: Array) -> Array:
        """The logistic function in place of pass and fail, shape (n, m); 0 where there is no score."""
        from scipy.special import expit

        margins = np.stack([merit.margin(scores[:, k]) for k, merit in enumerate(self.merits)], axis=1)
        return np.nan_to_num(expit(margins / widths), nan=0.0)

    def search(self, start: Array, widths: Array, aim: float) -> Array:
        """Scales of least cost whose smoothed yield reaches the aim, by SLSQP over their logarithms."""
        base, reach = np.log(self.low), np.log(self.high / self.low)
        free = np.flatnonzero(reach > 0.0)
        if not free.size:
            return self.low
        unit = self.cost(start)
        toward_good = np.array([1.0 if merit.at_least is not None else -1.0 for merit in self.merits])

        def scales_at(point: Array) -> Array:
            full = np.zeros_like(base)
            full[free] = point
            return np.exp(base + reach * full)

        def evaluate(point: Array) -> Evaluation:
            self.evaluations += 1
            scales = scales_at(point)
            scores, slopes = self.model.slopes(scales)
            passes = self.smooth_passes(scores, widths)
            lens = np.prod(passes, axis=1)
            pull = np.nan_to_num(lens[:, None] * (1.0 - passes) * toward_good / widths)
            by_scale = np.einsum("nm,nmd->d", pull, np.nan_to_num(slopes)) / len(lens)
            slope = (by_scale * scales * reach)[free]
            # A missing fraction of good lenses counts in units of the fraction of bad ones that is allowed.
            allowed = 1.0 - aim
            return Evaluation(
                goals=np.array([self.cost(scales) / unit]),
                goals_by=-(self.weights / scales * reach)[None, free] / unit,
                constraints=np.array([(aim - float(np.mean(lens))) / allowed]),
                constraints_by=-slope[None, :] / allowed,
            )

        first = np.clip(np.log(start / self.low)[free] / reach[free], 0.0, 1.0)
        outcome = minimize(evaluate, first, "slsqp", SECONDS_PER_ROUND, EVALUATIONS_PER_ROUND)
        return scales_at(outcome.point)

    def largest_factor(self, scales: Array) -> Array:
        """The scales times the largest common factor that keeps the yield, each within its range."""

        def times(logarithm: float) -> Array:
            return np.clip(np.exp(logarithm) * scales, self.low, self.high)

        smallest, largest = np.min(np.log(self.low / scales)), np.max(np.log(self.high / scales))
        if self.count(times(largest)) >= self.required:
            return times(largest)
        for _ in range(HALVINGS):
            middle = 0.5 * (smallest + largest)
            if self.count(times(middle)) >= self.required:
                smallest = middle
            else:
                largest = middle
        return times(smallest)
