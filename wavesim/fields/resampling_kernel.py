"""Compiled loops of :mod:`wavesim.fields.resampling`; each does some rows, or columns, for a thread."""

# mypy: disable-error-code="misc"

from __future__ import annotations

from numpy import conj, zeros
from numpy.typing import NDArray

from lensdesign.tracing.kept_kernels import kept_njit

_jit = kept_njit(nogil=True, fastmath={"contract", "reassoc", "nsz"})


@_jit
def expand(
    coarse: NDArray,
    first_y: NDArray,
    weight_y: NDArray,
    first_x: NDArray,
    weight_x: NDArray,
    carried: NDArray,
    result: NDArray,
    start: int,
    stop: int,
) -> None:
    """Rows `start` to `stop` of the fine plane."""
    taps, width = weight_y.shape[1], coarse.shape[1]
    line = zeros(width, coarse.dtype)
    for i in range(start, stop):
        line[:] = 0.0
        for t in range(taps):
            weight, row = weight_y[i, t], coarse[first_y[i] + t]
            for c in range(width):
                line[c] += weight * row[c]
        for j in range(carried.shape[1]):
            factor = carried[i, j]
            if factor != 0.0:
                total = weight_x[j, 0] * line[first_x[j]]
                for t in range(1, taps):
                    total += weight_x[j, t] * line[first_x[j] + t]
                result[i, j] += factor * total


@_jit
def collect_along_x(
    field: NDArray,
    carried: NDArray,
    first_x: NDArray,
    weight_x: NDArray,
    middle: NDArray,
    start: int,
    stop: int,
) -> None:
    """Rows `start` to `stop` of the fine plane onto coarse columns."""
    for i in range(start, stop):
        for j in range(carried.shape[1]):
            factor = carried[i, j]
            if factor != 0.0:
                value = conj(factor) * field[i, j]
                for t in range(weight_x.shape[1]):
                    middle[i, first_x[j] + t] += weight_x[j, t] * value


@_jit
def collect_along_y(
    middle: NDArray, first_y: NDArray, weight_y: NDArray, coarse: NDArray, start: int, stop: int
) -> None:
    """Fine rows onto coarse rows, in the columns `start` to `stop`."""
    for i in range(len(middle)):
        for t in range(weight_y.shape[1]):
            weight, row = weight_y[i, t], coarse[first_y[i] + t]
            for c in range(start, stop):
                row[c] += weight * middle[i, c]
