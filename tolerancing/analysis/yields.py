"""Yield: the share of good parts, with its confidence interval."""

from __future__ import annotations

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
    """Yield with its confidence interval (Wilson 1927); None of nothing."""
    from scipy.stats import binomtest

    total = len(passed)
    if total == 0:
        return None
    good = int(np.count_nonzero(passed))
    interval = binomtest(good, total).proportion_ci(CONFIDENCE, method="wilson")
    return Yield(good, total, good / total, float(interval.low), float(interval.high))
