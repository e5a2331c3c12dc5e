"""The compiled loop of :mod:`wavesim.rays.edges`."""

# mypy: disable-error-code="misc"

from __future__ import annotations

import math

from numpy import empty, int64
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit

_jit = cached_njit(nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")


@_jit
def at_arms(y: NDArray, x: NDArray, arms: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """The detour's x at points from the centre of a plane's pupil, where it ends, and the arms before them.

    Of each arm, evenly around the centre, there are the reach, how far within the rim and beyond it rays
    tell the detour, two ends, and the coefficients of x over the way from the rim; in between all is linear.
    """
    count, parts = arms.shape
    found, ends, before = empty(y.shape[0]), empty((2, y.shape[0])), empty(y.shape[0], int64)
    per_turn = count / (2.0 * math.pi)
    for n in range(y.shape[0]):
        place = (math.atan2(y[n], x[n]) * per_turn) % count
        first = int(place) % count
        share = place - math.floor(place)
        a, b = arms[first], arms[(first + 1) % count]
        way = a[0] + share * (b[0] - a[0]) - math.sqrt(y[n] * y[n] + x[n] * x[n])
        deep, seen = a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])
        inside = min(max(way, -seen), deep)
        total = 0.0
        for k in range(parts - 1, 4, -1):
            total = total * inside + a[k] + share * (b[k] - a[k])
        found[n] = total * inside + (a[5] + share * (b[5] - a[5])) * (way - inside)
        ends[0, n] = a[3] + share * (b[3] - a[3])
        ends[1, n] = a[4] + share * (b[4] - a[4])
        before[n] = first
    return found, ends, before
