"""Yield: the share of good parts, with its confidence interval.

Trials that stand each for itself have Wilson's interval. Those of a design do not: Latin hypercubes and
Sobol sequences tell a share more sharply than as many independent trials. How much more is told by r
replicates of the design, randomised independently: with s_k good trials of n_k in replicate k, and p their
share over all,

    variance = r / (r - 1) sum_k (s_k - p n_k)^2 / n^2

(the ratio estimator of Cochran, Sampling Techniques, 1977, section 2.11). The interval is Wilson's with as
many independent trials as have that variance, taken less by (z / t)^2, since the variance itself is known
from r - 1 degrees of freedom only (Korn and Graubard, Survey Methodology 24, 193, 1998).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Yield:
    """Share of good parts, with its interval at `CONFIDENCE`.

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


def yield_of(passed: NDArray[np.bool_], replicates: NDArray[np.int64] | None = None) -> Yield | None:
    """Yield with its confidence interval; None of nothing.

    Parameters
    ----------
    passed : ndarray of bool, shape (n,)
        Which trials are good.
    replicates : ndarray of int, shape (n,), optional
        Of which replicate of a design each trial is (:func:`tolerancing.perturbations.replicates`); left out
        where trials are independent.
    """
    total = len(passed)
    if total == 0:
        return None
    good = int(np.count_nonzero(passed))
    share = good / total
    trials = float(total) if replicates is None else _independent_trials(passed, replicates)
    return Yield(good, total, share, *wilson(share, trials))


def _independent_trials(passed: NDArray[np.bool_], replicates: NDArray[np.int64]) -> float:
    """How many independent trials have a share as sure as that of a replicated design's trials."""
    from scipy.special import ndtri, stdtrit

    total, share = len(passed), float(np.mean(passed))
    _, place, counts = np.unique(replicates, return_inverse=True, return_counts=True)
    most = len(counts)
    if most < 2 or share in (0.0, 1.0):
        return float(total)
    away = np.bincount(place, weights=passed) - share * counts
    variance = most / (most - 1) * float(away @ away) / total**2
    # A share of n trials is told in steps of 1 / n, whatever the replicates agree on.
    variance = max(variance, 0.25 / total**2)
    tail = 0.5 + 0.5 * CONFIDENCE
    return share * (1.0 - share) / variance * float(ndtri(tail) / stdtrit(most - 1, tail)) ** 2


def wilson(share: float, n: float) -> tuple[float, float]:
    """Wilson's interval (Wilson 1927), for a number of trials that need not be whole."""
    from scipy.special import ndtri

    z = float(ndtri(0.5 + 0.5 * CONFIDENCE))
    middle = (share + 0.5 * z * z / n) / (1.0 + z * z / n)
    half = z / (1.0 + z * z / n) * math.sqrt(share * (1.0 - share) / n + 0.25 * z * z / n**2)
    # Rounding must not put an end on the wrong side of a share of 0 or 1.
    return min(max(middle - half, 0.0), share), max(min(middle + half, 1.0), share)
