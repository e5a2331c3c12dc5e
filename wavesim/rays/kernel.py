"""Compiled loop over the rows of a grid inside a closed border."""

# mypy: disable-error-code="misc"

from __future__ import annotations

from numpy import empty, inf, searchsorted
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit


@cached_njit(nogil=True, error_model="numpy")
def row_ends(border: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
    """Return where rows at increasing y enter a closed border of points (y, x), and last leave it."""
    low, high = empty(len(y)), empty(len(y))
    low[:], high[:] = inf, -inf
    for arm in range(len(border)):
        y0, x0 = border[arm - 1]
        y1, x1 = border[arm]
        for row in range(searchsorted(y, min(y0, y1)), searchsorted(y, max(y0, y1))):
            cut = x0 + (x1 - x0) * (y[row] - y0) / (y1 - y0)
            low[row], high[row] = min(low[row], cut), max(high[row], cut)
    return low, high
