"""Line search: step lengths that are worth a trial of an expensive cost function ("price")."""

from __future__ import annotations

import math

MOST_TRIALS = 5
"""Largest number of trials along a step."""

LARGEST_EXTENSION, SMALLEST_RATIO = 3.0, 0.1
"""Largest ratio of the next length to the longest tried, and smallest ratio to the shortest tried."""

LEAST_GAIN, LEAST_RELATIVE_GAIN = 0.1, 0.01
"""Predicted decrease of the price for one more trial: over the gain of the step, and over the price."""


class LineSearch:
    """The price along a step, at the lengths that were tried, and the most promising next length.

    Parameters
    ----------
    price, slope
        Price at the start of the step, and its derivative with respect to the length.
    first
        Length of the first trial.
    """

    def __init__(self, price: float, slope: float, first: float) -> None:
        self._prices, self._slope, self._first = {0.0: price}, slope, first

    @property
    def best(self) -> float:
        """Length with the lowest price so far."""
        return min(self._prices, key=self._prices.__getitem__)

    def add(self, length: float, price: float) -> None:
        """Record the price at a length."""
        self._prices[length] = price

    def next(self) -> float | None:
        """Return the next length to try, or None if no other length promises a sufficient decrease."""
        prices, best = self._prices, self.best
        if len(prices) == 1:
            return self._first
        length, price = self._predicted_minimum()
        least_gain = max(LEAST_GAIN * (prices[0.0] - prices[best]), LEAST_RELATIVE_GAIN * prices[best])
        # Relative difference below which two lengths count as the same.
        same_length = 0.05
        is_new = all(abs(length - one) > same_length * length for one in prices)
        return length if len(prices) <= MOST_TRIALS and is_new and prices[best] - price > least_gain else None

    def _predicted_minimum(self) -> tuple[float, float]:
        """Return the minimum of a parabola about the best length, and its price."""
        lengths = sorted(self._prices)
        index = lengths.index(self.best)
        if index == 0:
            length, price = self._parabola_from_slope(lengths[1])
            return max(length, SMALLEST_RATIO * lengths[1]), price
        if index < len(lengths) - 1:
            return self._parabola_through(*lengths[index - 1 : index + 2])
        length, price = (
            self._parabola_from_slope(lengths[1]) if index == 1 else self._parabola_through(*lengths[-3:])
        )
        return min(length, LARGEST_EXTENSION * lengths[-1]), price

    def _parabola_from_slope(self, length: float) -> tuple[float, float]:
        """Return the minimum of the parabola through the start, its slope, and the price at a length."""
        price = self._prices[0.0]
        curvature = (self._prices[length] - price - self._slope * length) / length**2
        if curvature <= 0.0 or self._slope >= 0.0:
            return (math.inf if self._prices[length] < price else 0.0), 0.0
        return -0.5 * self._slope / curvature, price - 0.25 * self._slope**2 / curvature

    def _parabola_through(self, low: float, middle: float, high: float) -> tuple[float, float]:
        """Return the minimum of the parabola through the prices at three lengths."""
        price = self._prices[middle]
        left_slope = (price - self._prices[low]) / (middle - low)
        right_slope = (self._prices[high] - price) / (high - middle)
        curvature = (right_slope - left_slope) / (high - low)
        slope = left_slope + curvature * (middle - low)
        if curvature <= 0.0:
            return math.inf, 0.0
        return middle - 0.5 * slope / curvature, price - 0.25 * slope**2 / curvature
