"""The compiled loop of :mod:`wavesim.rays.edge_diffraction`."""

# mypy: disable-error-code="misc"

from __future__ import annotations

import math

from numpy import empty, int64
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit

_jit = cached_njit(nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")


@_jit
def at_arms(y: NDArray, x: NDArray, arms: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Interpolate x, its limits and the index of the preceding arm at points relative to the pupil's centre.

    The arms are evenly spaced around the centre. Each holds its reach, the depths inside and outside the rim
    up to which rays determine x, two limits of x, and the coefficients of x over the distance from the rim.
    Between arms all values are interpolated linearly.
    """
    count, parts = arms.shape
    found, ends, before = empty(y.shape[0]), empty((2, y.shape[0])), empty(y.shape[0], int64)
    per_turn = count / (2.0 * math.pi)
    for n in range(y.shape[0]):
        position = (math.atan2(y[n], x[n]) * per_turn) % count
        first = int(position) % count
        fraction = position - math.floor(position)
        a, b = arms[first], arms[(first + 1) % count]
        distance = a[0] + fraction * (b[0] - a[0]) - math.sqrt(y[n] * y[n] + x[n] * x[n])
        deep, beyond = a[1] + fraction * (b[1] - a[1]), a[2] + fraction * (b[2] - a[2])
        inside = min(max(distance, -beyond), deep)
        total = 0.0
        for k in range(parts - 1, 4, -1):
            total = total * inside + a[k] + fraction * (b[k] - a[k])
        found[n] = total * inside + (a[5] + fraction * (b[5] - a[5])) * (distance - inside)
        ends[0, n] = a[3] + fraction * (b[3] - a[3])
        ends[1, n] = a[4] + fraction * (b[4] - a[4])
        before[n] = first
    return found, ends, before
