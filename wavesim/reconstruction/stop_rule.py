"""Rule by which the iterations of the object solver end: at the noise, or where the misfit has converged.

Iterations end at the noise once the misfit is no more than `AT_NOISE` times that of noise alone (discrepancy
principle), and hardly falls any more. Slowly converging parts, such as smooth phase, still improve there as
long as the misfit falls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

Stop = Literal["noise", "converged", "iterations"]

STOPPED: dict[Stop, str] = {
    "noise": "; stopped because the misfit reached the noise",
    "converged": "; stopped because the misfit converged",
    "iterations": "",
}
"""Text that describes each reason for the end of the iterations."""

AT_NOISE, FAR = 1.01, 1.2
"""Misfit over that of noise alone at which iterations have reached the noise, and above which they are far
from it.
"""

SPAN, SPAN_NEAR_NOISE, SPAN_AT_NOISE, TOLERANCE = 5, 2, 1, 1e-3
"""Convergence: over `SPAN` iterations the misfit changes by less than the fraction `TOLERANCE`. Where
iterations end at the noise, it is `SPAN_NEAR_NOISE` iterations near it, and `SPAN_AT_NOISE` at it; they also
end there if all further iterations together are expected to change the misfit by less than that.
"""

SPAN_AFTER_RISE = 10
"""Iterations over which a misfit that has risen, and is far from the noise, must be flat. The total variation
raises it at first. On dense strokes it then stays within 0.1 % for seven iterations, while the object still
changes by 2 % in each.
"""


def stop_reason(misfits: Sequence[float], noise: float | None, *, until_noise: bool) -> Stop | None:
    """Return the reason to stop, or None if iterations continue.

    Parameters
    ----------
    misfits
        Misfit of every iteration since the search began, or since its last change.
    noise
        Misfit that noise alone would leave; None if it is not known.
    until_noise
        Whether iterations end at the noise.
    """
    if not misfits:
        return None
    over = misfits[-1] / noise if noise else math.inf
    is_at_noise = until_noise and over <= AT_NOISE
    if is_at_noise and (_is_converged(misfits, SPAN_AT_NOISE) or expected_change(misfits) < TOLERANCE):
        return "noise"
    span = SPAN_NEAR_NOISE if until_noise and over <= FAR else SPAN
    if over > FAR and _has_risen(misfits):
        span = SPAN_AFTER_RISE
    return "converged" if len(misfits) > SPAN and _is_converged(misfits, span) else None


def _is_converged(misfits: Sequence[float], iterations: int) -> bool:
    """Return whether the misfit hardly changed over the last iterations.

    Where it has risen, as it does once the total variation begins, its range counts. Around a maximum, first
    and last misfit are equal although it still changes.
    """
    last = misfits[-1 - iterations :]
    change = max(last) - min(last) if _has_risen(misfits) else abs(last[0] - last[-1])
    return len(last) > iterations and change < TOLERANCE * last[-1]


def _has_risen(misfits: Sequence[float]) -> bool:
    return misfits[-1] > misfits[0]


def expected_change(misfits: Sequence[float]) -> float:
    """Return the relative misfit change of further iterations, as a geometric series of the last three."""
    changes = np.abs(np.diff(misfits[-4:]))
    if len(changes) < 3 or not changes[0] > changes[1] > changes[2]:
        return math.inf
    # The larger ratio counts, because a single change is small where the inner iterations end.
    ratio = max(changes[1] / changes[0], changes[2] / changes[1])
    return float(changes[2] * ratio / ((1.0 - ratio) * misfits[-1]))
