"""How far along a step: lengths that are worth a trial."""

from __future__ import annotations

import math

MOST_TRIALS = 5
"""Of one step."""

FARTHER, NEARER = 3.0, 0.1
"""Of a length that was tried, the next one beyond it at most, and before it at least."""

WORTH, WORTH_AT_ALL = 0.1, 0.01
"""What a parabola must promise for one more trial: of what the step has gained, and of the price."""

ALIKE = 0.05
"""Share of a length within which another is no new one."""


class Line:
    """The price along a step, at lengths that were tried, and where it may be least.

    Parameters
    ----------
    price, slope
        At its beginning; the slope for a unit of length.
    first
        Length of the first trial.
    """

    def __init__(self, price: float, slope: float, first: float) -> None:
        self._tried, self._slope, self._first = {0.0: price}, slope, first

    @property
    def best(self) -> float:
        """Length of the least price so far."""
        return min(self._tried, key=self._tried.__getitem__)

    def add(self, length: float, price: float) -> None:
        """What was found at a length."""
        self._tried[length] = price

    def next(self) -> float | None:
        """The length to be tried; None where no other promises much."""
        tried, best = self._tried, self.best
        if len(tried) == 1:
            return self._first
        length, price = self._promising()
        worth = max(WORTH * (tried[0.0] - tried[best]), WORTH_AT_ALL * tried[best])
        is_new = all(abs(length - one) > ALIKE * length for one in tried)
        return length if len(tried) <= MOST_TRIALS and is_new and tried[best] - price > worth else None

    def _promising(self) -> tuple[float, float]:
        """Length of the least of a parabola about the best length, and its price there."""
        lengths = sorted(self._tried)
        place = lengths.index(self.best)
        if place == 0:
            length, price = self._by_slope(lengths[1])
            return max(length, NEARER * lengths[1]), price
        if place < len(lengths) - 1:
            return self._through(*lengths[place - 1 : place + 2])
        length, price = self._by_slope(lengths[1]) if place == 1 else self._through(*lengths[-3:])
        return min(length, FARTHER * lengths[-1]), price

    def _by_slope(self, there: float) -> tuple[float, float]:
        """By the slope and the price at the beginning, and the price at another length."""
        price = self._tried[0.0]
        bend = (self._tried[there] - price - self._slope * there) / there**2
        if bend <= 0.0 or self._slope >= 0.0:
            return (math.inf if self._tried[there] < price else 0.0), 0.0
        return -0.5 * self._slope / bend, price - 0.25 * self._slope**2 / bend

    def _through(self, low: float, middle: float, high: float) -> tuple[float, float]:
        """By the prices at three lengths."""
        price = self._tried[middle]
        before = (price - self._tried[low]) / (middle - low)
        after = (self._tried[high] - price) / (high - middle)
        bend = (after - before) / (high - low)
        slope = before + bend * (middle - low)
        if bend <= 0.0:
            return math.inf, 0.0
        return middle - 0.5 * slope / bend, price - 0.25 * slope**2 / bend
