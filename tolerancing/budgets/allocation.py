"""Allocation of tolerances: the scales of least cost whose predicted yield meets a requirement.

The cost of a lens with s_i times the tolerances of the study is sum w_i / s_i, the reciprocal cost-tolerance
model (Chase and Greenwood 1988; Wu, ElMaraghy and ElMaraghy 1988 compare it with others).
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


class ScoreModel(Protocol):
    """Scores of n drawn lenses by m merits as a function of the scales of d tolerances."""

    def scores(self, scales: Array) -> Array:
        """Return the scores, shape (n, m); NaN if missing."""

    def slopes(self, scales: Array) -> tuple[Array, Array]:
        """Return the scores, shape (n, m), and their derivatives by the scales, shape (n, m, d)."""


@dataclass(frozen=True)
class Budget:
    """Tolerances that meet a yield, as scales of the tolerances of the study.

    Attributes
    ----------
    scales : ndarray, shape (d,)
        Factors that multiply the deviations of each perturbation from its mean.
    predicted_yield, predicted_yield_before
        Fraction of the model's lenses that are good with these tolerances, and with those of the study.
    cost, cost_before
        Sum of w_i / s_i for these tolerances, and for those of the study.
    uniform_scale, uniform_cost
        Largest common scale of all tolerances that meets the yield, and its cost; None if there is none.
    evaluations
        Number of evaluations of all lenses, or of fewer in the first step.
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
    coarse: ScoreModel | None = None,
    start: Array | None = None,
) -> Budget:
    """Find the scales of least cost with which the model's lenses meet the required yield.

    1. A logistic function of each merit's margin replaces pass and fail. SLSQP minimizes the cost over the
       logarithms of the scales, starting at the largest common scale that meets the yield. A model of few
       lenses is sufficient for this step.
    2. The effect of the smoothing is measured with true pass and fail and corrects the target yield. The
       search is repeated with less smoothing, and with all lenses.
    3. A common factor is bisected until the true yield just meets the requirement, with every scale within
       its range.

    The result is the solution of least cost among this solution, the best common scale, and the study's own
    tolerances if they meet the yield.

    Parameters
    ----------
    model
        Scores of drawn lenses.
    merits
        The m merits. A lens is good if it meets all limits.
    required
        Required yield, above 0 and below 1.
    low, high : array_like, shape (d,)
        Ranges of the scales.
    weights : array_like, shape (d,)
        Weights w_i of the cost, above 0.
    coarse
        Scores of fewer lenses, for the first step (default: `model`).
    start : ndarray, shape (d,)
        Scales that a search for almost the same yield has found. The first step is then omitted.

    Returns
    -------
    Budget
        The scales, with yields and costs.

    Raises
    ------
    InputError
        If the smallest scales do not meet the yield, or an argument is out of range.
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
    search = _Search(
        model, model if coarse is None else coarse, tuple(merits), required, lowest, highest, weight
    )
    smallest = search.count(lowest)
    if smallest < required:
        raise InputError(
            f"required yield = {required:g}: cannot be reached; even with the smallest scales the "
            f"predicted yield is {smallest:.4g}"
        )
    return search.run(start)


def check_required(required: float) -> None:
    """Raise an InputError unless a yield is between 0 and 1."""
    if not 0.0 < required < 1.0:
        raise InputError(f"required yield = {required:g}: must be above 0 and below 1")


class _Search:
    """Search for the scales of least cost; it remembers the best scales that meet the yield."""

    def __init__(
        self,
        model: ScoreModel,
        coarse: ScoreModel,
        merits: tuple[Merit, ...],
        required: float,
        low: Array,
        high: Array,
        weights: Array,
    ) -> None:
        self.model, self.coarse, self.merits, self.required = model, coarse, merits, required
        self.low, self.high, self.weights = low, high, weights
        self.evaluations = 0
        self.best: tuple[float, Array, float] | None = None
        self.last: tuple[tuple[int, bytes], Array] | None = None

    def run(self, start: Array | None) -> Budget:
        """Return the scales of least cost that meet the yield, by a search from some scales.

        Without a start, the search begins at the best common scale, with few lenses.
        """
        ones = np.ones_like(self.low)
        before = self.count(ones)
        uniform = self.largest_factor(ones)
        # Widths of the logistic function, in standard deviations of the scores.
        wide, narrow = 0.1, 0.05
        if start is None:
            found = self.smoothed_search(self.coarse, np.clip(uniform, self.low, self.high), wide)
        else:
            found = np.clip(start, self.low, self.high)
        self.largest_factor(self.smoothed_search(self.model, found, narrow))
        assert self.best is not None  # the smallest scales meet the yield
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

    def scores(self, model: ScoreModel, scales: Array) -> Array:
        """Return the scores of a model's lenses; those of the last scales are kept."""
        key = (id(model), scales.tobytes())
        if self.last is None or self.last[0] != key:
            self.evaluations += 1
            self.last = key, model.scores(scales)
        return self.last[1]

    def good(self, model: ScoreModel, scales: Array) -> float:
        """Return the fraction of a model's lenses that are good."""
        return float(np.mean(all_passed(self.merits, self.scores(model, scales))))

    def count(self, scales: Array) -> float:
        """Return the fraction of good lenses, and remember the scales of least cost that meet the yield."""
        good, cost = self.good(self.model, scales), self.cost(scales)
        allowed = bool(np.all((scales >= self.low) & (scales <= self.high)))
        if good >= self.required and allowed and (self.best is None or cost < self.best[0]):
            self.best = (cost, scales, good)
        return good

    def widths(self, model: ScoreModel, scales: Array, smoothing: float) -> Array:
        """Return the width of each merit's logistic function, a fraction of the spread of its scores."""
        known = [column[np.isfinite(column)] for column in self.scores(model, scales).T]
        spread = np.array([column.std() if len(column) else 0.0 for column in known])
        return np.where(spread > 0.0, smoothing * spread, 1.0)

    def smooth_yield(self, model: ScoreModel, scales: Array, widths: Array) -> float:
        passes = self.smooth_passes(self.scores(model, scales), widths)
        return float(np.mean(np.prod(passes, axis=1)))

    def smooth_passes(self, scores: Array, widths: Array) -> Array:
        """Return the logistic function that replaces pass and fail, shape (n, m); 0 for missing scores."""
        from scipy.special import expit

        margins = np.stack([merit.margin(scores[:, k]) for k, merit in enumerate(self.merits)], axis=1)
        return np.nan_to_num(expit(margins / widths), nan=0.0)

    def smoothed_search(self, model: ScoreModel, start: Array, smoothing: float) -> Array:
        """Return the scales of least cost by a model whose smoothed yield is corrected for the smoothing."""
        found, widths, target = start, self.widths(model, start, smoothing), self.required
        # Largest error of the yield that the common factor then corrects, at almost no cost.
        small_error = 0.01 * (1.0 - self.required)
        for _ in range(3):
            found = self.search(model, found, widths, min(target, 1.0 - 1e-4))
            error = self.good(model, found) - self.required
            if abs(error) <= small_error:
                break
            target = self.smooth_yield(model, found, widths) - error
        return found

    def search(self, model: ScoreModel, start: Array, widths: Array, target: float) -> Array:
        """Return the scales of least cost whose smoothed yield reaches the target, by SLSQP."""
        base, span = np.log(self.low), np.log(self.high / self.low)
        free = np.flatnonzero(span > 0.0)
        if not free.size:
            return self.low
        unit = self.cost(start)
        toward_good = np.array([1.0 if merit.at_least is not None else -1.0 for merit in self.merits])

        def scales_at(point: Array) -> Array:
            full = np.zeros_like(base)
            full[free] = point
            return np.exp(base + span * full)

        def evaluate(point: Array) -> Evaluation:
            self.evaluations += 1
            scales = scales_at(point)
            scores, slopes = model.slopes(scales)
            passes = self.smooth_passes(scores, widths)
            lens = np.prod(passes, axis=1)
            by_score = np.nan_to_num(lens[:, None] * (1.0 - passes) * toward_good / widths)
            by_scale = np.einsum("nm,nmd->d", by_score, np.nan_to_num(slopes)) / len(lens)
            slope = (by_scale * scales * span)[free]
            # The constraint is scaled by the allowed fraction of bad lenses.
            allowed = 1.0 - target
            return Evaluation(
                goals=np.array([self.cost(scales) / unit]),
                goals_by=-(self.weights / scales * span)[None, free] / unit,
                constraints=np.array([(target - float(np.mean(lens))) / allowed]),
                constraints_by=-slope[None, :] / allowed,
            )

        first = np.clip(np.log(start / self.low)[free] / span[free], 0.0, 1.0)
        most_seconds, most_evaluations = 120.0, 60
        outcome = minimize(evaluate, first, "slsqp", most_seconds, most_evaluations)
        return scales_at(outcome.point)

    def largest_factor(self, scales: Array) -> Array:
        """Return the scales times the largest common factor that meets the yield, each within its range.

        The yield is assumed to fall with the factor.
        """

        def times(logarithm: float) -> Array:
            return np.clip(np.exp(logarithm) * scales, self.low, self.high)

        smallest, largest = np.min(np.log(self.low / scales)), np.max(np.log(self.high / scales))
        # The factor is near 1 after a search.
        step = 0.02
        if self.count(times(0.0)) >= self.required:
            smallest = 0.0
            while step < largest and self.count(times(step)) >= self.required:
                smallest, step = step, 4.0 * step
            if step >= largest and self.count(times(largest)) >= self.required:
                return times(largest)
            largest = min(largest, step)
        else:
            largest = 0.0
            while -step > smallest and self.count(times(-step)) < self.required:
                largest, step = -step, 4.0 * step
            smallest = max(smallest, -step)
        # Precision of the logarithm, which is that of the cost.
        precision = 1e-5
        while largest - smallest > precision:
            middle = 0.5 * (smallest + largest)
            if self.count(times(middle)) >= self.required:
                smallest = middle
            else:
                largest = middle
        return times(smallest)
