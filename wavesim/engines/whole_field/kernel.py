"""Compiled loops that carry a field from a coarse plane to a fine one and back, making carriers on the way.

Carriers exp(2 pi i phase) of a whole field are too large to be kept. Their phase, in turns, and the edge of
the aperture are smooth: they come on coarse grids of their own, where four samples along each axis tell what
is in between. Loops over a row come one after the other, each of a kind that vector instructions take.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

from numba import njit
from numpy import abs as magnitude
from numpy import complex64, copysign, empty, float32, float64, floor, zeros
from numpy.typing import NDArray

from lensdesign.tracing.kept_kernels import kept_njit

_FAST = {"contract", "reassoc", "nsz", "arcp"}
_jit = kept_njit(nogil=True, fastmath=_FAST, error_model="numpy")

_QUARTER, _ZERO, _ONE = float32(0.25), float32(0.0), float32(1.0)
_S1, _S3, _S5, _S7, _S9, _S11 = (
    float32((-1) ** k * (2.0 * math.pi) ** (2 * k + 1) / math.factorial(2 * k + 1)) for k in range(6)
)


@njit(inline="always", fastmath=_FAST)
def _sine(turns: Any) -> Any:
    """sin(2 pi turns) for up to a quarter of a turn, to 1e-7."""
    x = turns * turns
    return turns * (_S1 + x * (_S3 + x * (_S5 + x * (_S7 + x * (_S9 + x * _S11)))))


@_jit
def _waves(turns: NDArray, edge: NDArray, real: NDArray, imaginary: NDArray, begin: int, end: int) -> None:
    """exp(2 pi i turns), times 3 e^2 - 2 e^3 of an edge e held between 0 (dark) and 1."""
    for j in range(begin, end):
        part = float32(turns[j] - floor(turns[j] + 0.5))
        size = magnitude(part)
        e = min(max(edge[j], _ZERO), _ONE)
        passed = e * e * (float32(3.0) - float32(2.0) * e)
        real[j] = passed * _sine(_QUARTER - size)
        imaginary[j] = passed * _sine(copysign(_QUARTER - magnitude(size - _QUARTER), part))


@_jit
def _row(phase: NDArray, edge: NDArray, first: int, share: NDArray, turns: NDArray, rim: NDArray) -> None:
    """Phase and edge between four rows of their grid."""
    a, b, c, d = share[0], share[1], share[2], share[3]
    for k in range(turns.shape[0]):
        turns[k] = (
            a * phase[first, k] + b * phase[first + 1, k] + c * phase[first + 2, k] + d * phase[first + 3, k]
        )
        rim[k] = float32(
            a * edge[first, k] + b * edge[first + 1, k] + c * edge[first + 2, k] + d * edge[first + 3, k]
        )


@_jit
def _lit(rim: NDArray, first: NDArray) -> tuple[int, int]:
    """From where to where a row has light."""
    low, high = 0, rim.shape[0]
    while low < high and rim[low] <= 0.0:
        low += 1
    while high > low and rim[high - 1] <= 0.0:
        high -= 1
    begin, end = 0, first.shape[0]
    if low == high:
        return 0, 0
    while begin < end and first[begin] + 3 < low:
        begin += 1
    while end > begin and first[end - 1] >= high:
        end -= 1
    return begin, end


@_jit
def _across(
    values: NDArray,
    first: NDArray,
    share: NDArray,
    result: NDArray,
    rim: NDArray,
    edge: NDArray,
    begin: int,
    end: int,
) -> None:
    """Phase and edge between four columns of their grid, for a part of a row."""
    for j in range(begin, end):
        k = first[j]
        a, b, c, d = share[j, 0], share[j, 1], share[j, 2], share[j, 3]
        result[j] = a * values[k] + b * values[k + 1] + c * values[k + 2] + d * values[k + 3]
        edge[j] = float32(a * rim[k] + b * rim[k + 1] + c * rim[k + 2] + d * rim[k + 3])


@_jit
def _carrier_row(
    carrier: tuple[NDArray, ...],
    row: int,
    smooth: tuple[NDArray, NDArray],
    fine: tuple[NDArray, NDArray],
    cosine: NDArray,
    sine: NDArray,
) -> tuple[int, int]:
    """Carrier of one row, and from where to where it has light; `smooth` and `fine` are work space."""
    phase, edge, smooth_y, share_y, smooth_x, share_x = carrier
    turns, rim = smooth
    phases, edges = fine
    _row(phase, edge, smooth_y[row], share_y[row], turns, rim)
    begin, end = _lit(rim, smooth_x)
    _across(turns, smooth_x, share_x, phases, rim, edges, begin, end)
    _waves(phases, edges, cosine, sine, begin, end)
    return begin, end


@_jit
def _room(carrier: tuple[NDArray, ...], count: int) -> tuple[Any, Any, NDArray, NDArray]:
    """Work space for the carrier of a row of so many samples."""
    smooth = carrier[0].shape[1]
    between = empty(smooth, float64), empty(smooth, float32)
    along = empty(count, float64), empty(count, float32)
    return between, along, empty(count, float32), empty(count, float32)


@cache
def expander(taps: int) -> Callable[..., None]:
    """The loop that adds a coarse field, interpolated with so many taps and times its carrier, to a fine one.

    It takes the coarse field; first coarse row and its weights for each fine row, and the same for columns;
    of the carrier phase and edge on their grid, first row and shares, first column and shares; the fine
    field; rows to do.
    """

    @_jit
    def expand(
        coarse: NDArray,
        along_y: tuple[NDArray, NDArray],
        along_x: tuple[NDArray, NDArray],
        carrier: tuple[NDArray, ...],
        result: NDArray,
        start: int,
        stop: int,
    ) -> None:
        (first_y, weight_y), (first_x, weight_x) = along_y, along_x
        width = coarse.shape[1]
        real, imaginary = zeros(width, float32), zeros(width, float32)
        between, along, cosine, sine = _room(carrier, result.shape[1])
        for i in range(start, stop):
            begin, end = _carrier_row(carrier, i, between, along, cosine, sine)
            if begin == end:
                continue
            real[:] = 0.0
            imaginary[:] = 0.0
            for t in range(taps):
                weight, row = weight_y[i, t], first_y[i] + t
                for c in range(width):
                    real[c] += weight * coarse[row, c].real
                    imaginary[c] += weight * coarse[row, c].imag
            for j in range(begin, end):
                first = first_x[j]
                x, y = _ZERO, _ZERO
                for t in range(taps):
                    x += weight_x[j, t] * real[first + t]
                    y += weight_x[j, t] * imaginary[first + t]
                result[i, j] += complex64(complex(cosine[j] * x - sine[j] * y, cosine[j] * y + sine[j] * x))

    return expand


@cache
def collector(taps: int) -> Callable[..., None]:
    """The loop that takes rows of a fine field onto coarse columns: half of the transpose of `expander`'s.

    It takes the fine field, `along_x` and `carrier` as there, the result of shape (fine rows, coarse
    columns), and rows to do.
    """

    @_jit
    def collect(
        field: NDArray,
        along_x: tuple[NDArray, NDArray],
        carrier: tuple[NDArray, ...],
        middle: NDArray,
        start: int,
        stop: int,
    ) -> None:
        first_x, weight_x = along_x
        width = middle.shape[1]
        real, imaginary = zeros(width, float32), zeros(width, float32)
        between, along, cosine, sine = _room(carrier, field.shape[1])
        for i in range(start, stop):
            begin, end = _carrier_row(carrier, i, between, along, cosine, sine)
            real[:] = 0.0
            imaginary[:] = 0.0
            for j in range(begin, end):
                first, value = first_x[j], field[i, j]
                x = cosine[j] * value.real + sine[j] * value.imag
                y = cosine[j] * value.imag - sine[j] * value.real
                for t in range(taps):
                    real[first + t] += weight_x[j, t] * x
                    imaginary[first + t] += weight_x[j, t] * y
            for c in range(width):
                middle[i, c] = complex64(complex(real[c], imaginary[c]))

    return collect
