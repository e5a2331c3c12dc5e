"""Line search: step lengths that are worth a trial of an expensive cost function."""

from __future__ import annotations

import math

MOST_TRIALS = 5
"""Largest number of trials along a step."""

LARGEST_EXTENSION, SMALLEST_RATIO = 3.0, 0.1
"""Largest ratio of the next length to the longest tried, and smallest ratio to the shortest tried."""

LEAST_GAIN, LEAST_RELATIVE_GAIN = 0.1, 0.01
"""Predicted decreases of the cost that are worth one more trial, relative to the gain of the step, and
to the cost. The larger one counts."""


class LineSearch:
    """Costs at the lengths of a step that were tried; predicts the most promising next length.

    Parameters
    ----------
    cost, slope
        Price at the start of the step, and its derivative with respect to the length.
    first
        Length of the first trial.
    """

    def __init__(self, cost: float, slope: float, first: float) -> None:
        self._costs, self._slope, self._first = {0.0: cost}, slope, first

    @property
    def best(self) -> float:
        """Length with the lowest cost so far."""
        return min(self._costs, key=self._costs.__getitem__)

    def add(self, length: float, cost: float) -> None:
        """Record the cost at a length."""
        self._costs[length] = cost

    def next(self) -> float | None:
        """Return the next length to try, or None if no other length promises a sufficient decrease."""
        costs, best = self._costs, self.best
        if len(costs) == 1:
            return self._first
        length, cost = self._predicted_minimum()
        least_gain = max(LEAST_GAIN * (costs[0.0] - costs[best]), LEAST_RELATIVE_GAIN * costs[best])
        # Relative difference below which two lengths count as the same.
        same_length = 0.05
        is_new = all(abs(length - one) > same_length * length for one in costs)
        return length if len(costs) <= MOST_TRIALS and is_new and costs[best] - cost > least_gain else None

    def _predicted_minimum(self) -> tuple[float, float]:
        """Return the minimum of a parabola about the best length, and its cost."""
        lengths = sorted(self._costs)
        index = lengths.index(self.best)
        if index == 0:
            length, cost = self._parabola_from_slope(lengths[1])
            return max(length, SMALLEST_RATIO * lengths[1]), cost
        if index < len(lengths) - 1:
            return self._parabola_through(*lengths[index - 1 : index + 2])
        length, cost = (
            self._parabola_from_slope(lengths[1]) if index == 1 else self._parabola_through(*lengths[-3:])
        )
        return min(length, LARGEST_EXTENSION * lengths[-1]), cost

    def _parabola_from_slope(self, length: float) -> tuple[float, float]:
        """Return the minimum of the parabola through the start, its slope, and the cost at a length."""
        cost = self._costs[0.0]
        curvature = (self._costs[length] - cost - self._slope * length) / length**2
        if curvature <= 0.0 or self._slope >= 0.0:
            return (math.inf if self._costs[length] < cost else 0.0), 0.0
        return -0.5 * self._slope / curvature, cost - 0.25 * self._slope**2 / curvature

    def _parabola_through(self, low: float, middle: float, high: float) -> tuple[float, float]:
        """Return the minimum of the parabola through the costs at three lengths."""
        cost = self._costs[middle]
        left_slope = (cost - self._costs[low]) / (middle - low)
        right_slope = (self._costs[high] - cost) / (high - middle)
        curvature = (right_slope - left_slope) / (high - low)
        slope = left_slope + curvature * (middle - low)
        if curvature <= 0.0:
            return math.inf, 0.0
        return middle - 0.5 * slope / curvature, cost - 0.25 * slope**2 / curvature
