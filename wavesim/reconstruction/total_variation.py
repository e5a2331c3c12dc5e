"""The proximal map of the total variation: keeps edges and takes noise out.

Source: A. Chambolle, "An algorithm for total variation minimization and applications", J. Math. Imaging Vis.
20, 89 (2004).

Compiled loops do some rows for each thread. The flow p has a part along each axis. A sweep goes up the rows
with two lines of div p - values / weight, the line above computed before anything that it needs is changed:
so the flow is changed in place.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

from typing import Any

import numpy as np
from numpy import empty, sqrt
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit
from wavesim.runtime.threads import THREADS, for_blocks

Values = NDArray[np.inexact[Any]]

PROX_ITERATIONS = 12
PROX_STEP = 0.248

ROWS = 64

SAMPLES_PER_THREAD = 2**15
"""At least: with fewer, threads wait for each other longer than they work."""

_FAST = {"contract", "reassoc", "nsz", "arcp"}
_jit = cached_njit(nogil=True, fastmath=_FAST, error_model="numpy")


@_jit
def _slope_line(
    values: NDArray, along_y: NDArray, along_x: NDArray, y: int, inverse: Any, line: NDArray
) -> None:
    """div p - values / weight in a row."""
    width = values.shape[1]
    for x in range(width):
        line[x] = along_y[y, x] + along_x[y, x] - inverse * values[y, x]
    for x in range(1, width):
        line[x] -= along_x[y, x - 1]
    if y > 0:
        for x in range(width):
            line[x] -= along_y[y - 1, x]


@_jit
def _project(
    values: NDArray,
    along_y: NDArray,
    along_x: NDArray,
    first: NDArray,
    after: NDArray,
    rows: tuple[int, int],
    step: Any,
    inverse: Any,
) -> None:
    """One projection of rows, given the lines of the first and of the one after the last."""
    start, stop = rows
    height, width = values.shape
    one = step / step
    line, above = first.copy(), empty(width, values.dtype)
    for y in range(start, stop):
        if y + 1 == height:
            above[:] = line
        elif y + 1 == stop:
            above[:] = after
        else:
            _slope_line(values, along_y, along_x, y + 1, inverse, above)
        for x in range(width - 1):
            up, right = above[x] - line[x], line[x + 1] - line[x]
            size = up.real * up.real + up.imag * up.imag + right.real * right.real + right.imag * right.imag
            share = one / (one + step * sqrt(size))
            along_y[y, x] = share * (along_y[y, x] + step * up)
            along_x[y, x] = share * (along_x[y, x] + step * right)
        up = above[width - 1] - line[width - 1]
        share = one / (one + step * sqrt(up.real * up.real + up.imag * up.imag))
        along_y[y, width - 1] = share * (along_y[y, width - 1] + step * up)
        line, above = above, line


@_jit
def _subtract(
    values: NDArray, along_y: NDArray, along_x: NDArray, weight: Any, inverse: Any, start: int, stop: int
) -> None:
    """Rows of values less the weight times div p, in place."""
    line = empty(values.shape[1], values.dtype)
    for y in range(start, stop):
        _slope_line(values, along_y, along_x, y, inverse, line)
        for x in range(values.shape[1]):
            values[y, x] = -weight * line[x]


def prox_tv(values: Values, weight: float, iterations: int = PROX_ITERATIONS) -> Values:
    """Minimize half the squared distance to values, plus a weight times the isotropic total variation.

    Parameters
    ----------
    values
        Real or complex, on a line or a plane; real and imaginary part are taken together.
    weight
        0 leaves the values as they are.
    iterations
        Of Chambolle's dual projection.
    """
    if weight == 0.0:
        return values
    result = np.array(values, ndmin=2, order="C")
    flow = tuple(np.zeros_like(result) for _ in range(2))
    real = result.real.dtype.type
    step, inverse = real(PROX_STEP / values.ndim), real(1.0 / weight)
    height = len(result)
    threads = min(THREADS, max(1, result.size // SAMPLES_PER_THREAD))
    starts = list(range(0, height, max(1, -(-height // threads))))
    parts = list(zip(starts, [*starts[1:], height], strict=True))
    # Of the rows at which threads meet; there is none after the last.
    meeting = np.empty((len(parts) + 1, result.shape[1]), result.dtype)
    for _ in range(iterations):
        for line, start in zip(meeting, starts, strict=False):
            _slope_line(result, *flow, start, inverse, line)
        for_blocks(
            lambda k, _: _project(result, *flow, meeting[k], meeting[k + 1], parts[k], step, inverse),
            len(parts),
            1,
        )
    for_blocks(lambda a, b: _subtract(result, *flow, real(weight), inverse, a, b), height, ROWS)
    return result.reshape(values.shape)
