"""The proximal map of the total variation, which preserves edges and suppresses noise.

Chambolle's dual projection iterates a flow p with one component along each axis. The compiled loops process
some rows on each thread. A sweep goes up the rows with two lines of div p - values / weight. The upper line
is computed before any value that it needs is changed, so that the flow is updated in place.

References
----------
A. Chambolle, "An algorithm for total variation minimization and applications", J. Math. Imaging Vis. 20, 89
(2004).
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

SAMPLES_PER_THREAD = 2**15
"""Smallest number of samples on a thread. With fewer, threads wait for each other longer than they work."""

_jit = cached_njit(nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")


@_jit
def _slope_line(
    values: NDArray, along_y: NDArray, along_x: NDArray, y: int, inverse: Any, line: NDArray
) -> None:
    """Write div p - values / weight for a row."""
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
    """Project rows once, given the lines of the first row and of the row after the last."""
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
            scale = one / (one + step * sqrt(size))
            along_y[y, x] = scale * (along_y[y, x] + step * up)
            along_x[y, x] = scale * (along_x[y, x] + step * right)
        up = above[width - 1] - line[width - 1]
        scale = one / (one + step * sqrt(up.real * up.real + up.imag * up.imag))
        along_y[y, width - 1] = scale * (along_y[y, width - 1] + step * up)
        line, above = above, line


@_jit
def _subtract(
    values: NDArray, along_y: NDArray, along_x: NDArray, weight: Any, inverse: Any, start: int, stop: int
) -> None:
    """Write rows of values less the weight times div p, in place."""
    line = empty(values.shape[1], values.dtype)
    for y in range(start, stop):
        _slope_line(values, along_y, along_x, y, inverse, line)
        for x in range(values.shape[1]):
            values[y, x] = -weight * line[x]


def prox_tv(values: Values, weight: float, iterations: int = 12) -> Values:
    """Minimize half the squared distance to values, plus a weight times the isotropic total variation.

    Parameters
    ----------
    values
        Real or complex values, shape (n,) or (ny, nx). The gradients of real and imaginary part are coupled.
    weight
        Weight of the total variation; 0 returns the values themselves.
    iterations
        Number of iterations of Chambolle's dual projection.

    Returns
    -------
    ndarray
        The minimizer, of the shape and type of `values`.

    Examples
    --------
    A step lower than its noise is flattened, a large one stays:

    >>> import numpy as np
    >>> from wavesim.reconstruction import prox_tv
    >>> prox_tv(np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]), 0.3, 200).round(2).tolist()
    [0.1, 0.1, 0.1, 0.9, 0.9, 0.9]
    """
    if weight == 0.0:
        return values
    result = np.array(values, ndmin=2, order="C")
    flow = tuple(np.zeros_like(result) for _ in range(2))
    real = result.real.dtype.type
    step, inverse = real(0.248 / values.ndim), real(1.0 / weight)
    height = len(result)
    threads = min(THREADS, max(1, result.size // SAMPLES_PER_THREAD))
    starts = list(range(0, height, max(1, -(-height // threads))))
    parts = list(zip(starts, [*starts[1:], height], strict=True))
    # Lines of the first rows of each thread; there is none after the last thread.
    meeting = np.empty((len(parts) + 1, result.shape[1]), result.dtype)
    for _ in range(iterations):
        for line, start in zip(meeting, starts, strict=False):
            _slope_line(result, *flow, start, inverse, line)
        for_blocks(
            lambda k, _: _project(result, *flow, meeting[k], meeting[k + 1], parts[k], step, inverse),
            len(parts),
            1,
        )
    for_blocks(lambda a, b: _subtract(result, *flow, real(weight), inverse, a, b), height, 64)
    return result.reshape(values.shape)
