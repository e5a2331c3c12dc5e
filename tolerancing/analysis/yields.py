"""Yield: the share of good parts, with its confidence interval."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Yield:
    """Share of good parts, with the Wilson score interval at `CONFIDENCE`.

    Attributes
    ----------
    passed, total
        Good trials, and all trials.
    share
        Their ratio.
    low, high
        Ends of the confidence interval.
    """

    passed: int
    total: int
    share: float
    low: float
    high: float


def yield_of(passed: NDArray[np.bool_]) -> Yield | None:
    """Yield with its confidence interval; None of nothing."""
    total = len(passed)
    if total == 0:
        return None
    good = int(np.count_nonzero(passed))
    return Yield(good, total, good / total, *wilson(good / total, total))


def wilson(share: float, n: float) -> tuple[float, float]:
    """Wilson's interval (Wilson 1927), for a number of trials that need not be whole."""
    from scipy.special import ndtri

    z = float(ndtri(0.5 + 0.5 * CONFIDENCE))
    middle = (share + 0.5 * z * z / n) / (1.0 + z * z / n)
    half = z / (1.0 + z * z / n) * math.sqrt(share * (1.0 - share) / n + 0.25 * z * z / n**2)
    # Rounding must not put an end on the wrong side of a share of 0 or 1.
    return min(max(middle - half, 0.0), share), max(min(middle + half, 1.0), share)
