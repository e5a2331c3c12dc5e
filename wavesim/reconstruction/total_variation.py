"""The proximal map of the total variation: keeps edges and takes noise out.

Source: A. Chambolle, "An algorithm for total variation minimization and applications", J. Math. Imaging Vis.
20, 89 (2004).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavesim.reconstruction.total_variation_kernel import project, slope_line, subtract
from wavesim.runtime.threads import THREADS, for_blocks

Values = NDArray[np.inexact[Any]]

PROX_ITERATIONS = 12
PROX_STEP = 0.248

ROWS = 64


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
    starts = list(range(0, height, max(1, -(-height // THREADS))))
    parts = list(zip(starts, [*starts[1:], height], strict=True))
    # Of the rows at which threads meet; there is none after the last.
    meeting = np.empty((len(parts) + 1, result.shape[1]), result.dtype)
    for _ in range(iterations):
        for line, start in zip(meeting, starts, strict=False):
            slope_line(result, *flow, start, inverse, line)
        for_blocks(
            lambda k, _: project(result, *flow, meeting[k], meeting[k + 1], parts[k], step, inverse),
            len(parts),
            1,
        )
    for_blocks(lambda a, b: subtract(result, *flow, real(weight), inverse, a, b), height, ROWS)
    return result.reshape(values.shape)
