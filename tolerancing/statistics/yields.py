"""Yield, the fraction of lenses that keep all limits, with its confidence interval.

For independent trials, the interval is Wilson's. Trials of a Latin hypercube or a Sobol sequence estimate a
fraction more precisely than the same number of independent trials. The gain is estimated from r replicates of
the design that are randomized independently. With s_k good trials of n_k in replicate k, n trials in all, and
p the fraction of good ones,

    variance = r / (r - 1) sum_k (s_k - p n_k)^2 / n^2

(ratio estimator: Cochran, Sampling Techniques, 1977, section 2.11). The interval is then Wilson's for the
number of independent trials that has this variance. That number is reduced by (z / t)^2, because the variance
itself is estimated with only r - 1 degrees of freedom (Korn and Graubard, Survey Methodology 24, 193, 1998).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Yield:
    """Fraction of good lenses, with its confidence interval (Wilson's, for independent trials).

    Attributes
    ----------
    passed, total
        Number of good trials, and number of all trials.
    fraction
        `passed` / `total` (0 to 1).
    low, high
        Ends of the 95 % confidence interval.

    References
    ----------
    E. B. Wilson, "Probable inference, the law of succession, and statistical inference", J. Am. Stat. Assoc.
    22, 209 (1927). For trials that are not independent see :mod:`tolerancing.statistics.yields`.

    Examples
    --------
    >>> import numpy as np
    >>> from tolerancing.statistics import yield_of
    >>> found = yield_of(np.array([True] * 45 + [False] * 5))
    >>> found.fraction, round(found.low, 2), round(found.high, 2)
    (0.9, 0.79, 0.96)
    """

    passed: int
    total: int
    fraction: float
    low: float
    high: float

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "passed": self.passed,
            "total": self.total,
            "share": self.fraction,
            "low": self.low,
            "high": self.high,
        }


def yield_of(passed: NDArray[np.bool_], replicates: NDArray[np.int64] | None = None) -> Yield | None:
    """Return the yield of trials with its confidence interval.

    Parameters
    ----------
    passed : ndarray of bool, shape (n,)
        Whether each trial is good.
    replicates : ndarray of int, shape (n,), optional
        Replicate of the design to which each trial belongs (:func:`tolerancing.perturbations.replicates`).
        Default: the trials are independent.

    Returns
    -------
    Yield or None
        None if there are no trials.

    Examples
    --------
    >>> import numpy as np
    >>> found = yield_of(np.array([True] * 9 + [False]))
    >>> found.fraction, round(found.low, 3), round(found.high, 3)
    (0.9, 0.596, 0.982)
    """
    total = len(passed)
    if total == 0:
        return None
    good = int(np.count_nonzero(passed))
    fraction = good / total
    trials = float(total) if replicates is None else _independent_trials(passed, replicates)
    return Yield(good, total, fraction, *wilson(fraction, trials))


def _independent_trials(passed: NDArray[np.bool_], replicates: NDArray[np.int64]) -> float:
    """Return how many independent trials estimate the yield as precisely as the trials of this design."""
    from scipy.special import ndtri, stdtrit

    total, fraction = len(passed), float(np.mean(passed))
    _, membership, counts = np.unique(replicates, return_inverse=True, return_counts=True)
    count = len(counts)
    if count < 2 or fraction in (0.0, 1.0):
        return float(total)
    deviations = np.bincount(membership, weights=passed) - fraction * counts
    variance = count / (count - 1) * float(deviations @ deviations) / total**2
    # A fraction of n trials has a resolution of 1 / n, even if all replicates agree.
    variance = max(variance, 0.25 / total**2)
    tail = 0.5 + 0.5 * CONFIDENCE
    return fraction * (1.0 - fraction) / variance * float(ndtri(tail) / stdtrit(count - 1, tail)) ** 2


def wilson(fraction: float, n: float) -> tuple[float, float]:
    """Return Wilson's 95 % confidence interval of a fraction (Wilson 1927).

    Parameters
    ----------
    fraction
        Observed fraction, 0 to 1.
    n
        Number of independent trials; need not be a whole number.

    Returns
    -------
    tuple of float
        Lower and upper end of the interval.
    """
    from scipy.special import ndtri

    z = float(ndtri(0.5 + 0.5 * CONFIDENCE))
    middle = (fraction + 0.5 * z * z / n) / (1.0 + z * z / n)
    half = z / (1.0 + z * z / n) * math.sqrt(fraction * (1.0 - fraction) / n + 0.25 * z * z / n**2)
    # Rounding must not put an end on the wrong side of a fraction of 0 or 1.
    return min(max(middle - half, 0.0), fraction), max(min(middle + half, 1.0), fraction)
