"""The proximal map of the total variation: keeps edges and takes noise out.

Source: A. Chambolle, "An algorithm for total variation minimization and applications", J. Math. Imaging Vis.
20, 89 (2004).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.inexact[Any]]

PROX_ITERATIONS = 12
PROX_STEP = 0.248


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
    flow = np.zeros((values.ndim, *values.shape), values.dtype)
    step = PROX_STEP * (2.0 / values.ndim) / 2.0
    for _ in range(iterations):
        slope = _gradient(_divergence(flow) - values / weight)
        modulus = np.sqrt(np.sum(np.abs(slope) ** 2, axis=0))
        flow = (flow + step * slope) / (1.0 + step * modulus)
    return np.asarray(values - weight * _divergence(flow))


def _gradient(values: Values) -> Values:
    result = np.zeros((values.ndim, *values.shape), values.dtype)
    for axis in range(values.ndim):
        result[axis][_part(values.ndim, axis, slice(0, -1))] = np.diff(values, axis=axis)
    return result


def _divergence(flow: Values) -> Values:
    """Negative adjoint of the gradient."""
    dimensions = len(flow)
    result = np.zeros(flow.shape[1:], flow.dtype)
    for axis in range(dimensions):
        inner = flow[axis][_part(dimensions, axis, slice(0, -1))]
        result[_part(dimensions, axis, slice(0, -1))] += inner
        result[_part(dimensions, axis, slice(1, None))] -= inner
    return result


def _part(dimensions: int, axis: int, part: slice) -> tuple[slice, ...]:
    return tuple(part if i == axis else slice(None) for i in range(dimensions))
