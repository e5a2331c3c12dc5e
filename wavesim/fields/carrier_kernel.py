"""Compiled loops that compute carriers of a fine plane from their phase on a coarse grid.

Carriers exp(2 pi i phase) of a whole field are too large to be stored. Their phase, in turns, and the edge of
the aperture are smooth. Both are given on coarse grids of their own, from which four samples along each axis
interpolate the values in between. Between four rows, the phase is that of one row, reduced in float64, plus
weighted differences to the other rows, a few turns, in float32. The loops of
:mod:`wavesim.fields.resampling_kernel` use some rows of the carrier at a time.
"""

# mypy: disable-error-code="misc, operator"

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy import cos, empty, float32, float64, floor, int64, pi, sin, sqrt, zeros
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit, drop_outdated
from wavesim.runtime.fourier import lanes
from wavesim.runtime.fourier.lanes import (
    LANES,
    alike,
    larger,
    lines_for,
    load,
    moved_up,
    smaller,
    store,
    whole,
)

_FAST = {"contract", "reassoc", "nsz", "arcp"}
_jit = cached_njit(nogil=True, fastmath=_FAST, error_model="numpy")
_inlined = cached_njit(nogil=True, fastmath=_FAST, error_model="numpy", inline="always")

_SMOOTH = 4
"""Rows, and columns, of the cubic interpolation of phase and edge."""

_BAND = 2 * LANES
"""Rows of phase and edge that are computed at a time."""

_KEPT = 2 * _BAND
"""Rows of phase and edge that the buffer holds."""

DARK, _PARTLY, OPEN = 0, 1, 2
"""Light of a row: none, partly stopped, or all."""

_ROUNDER = float32(1.5 * 2**23)
"""Constant that rounds to whole numbers when it is added and subtracted."""

_FULL = 1.0 - 1e-4
"""Value of the edge from which on 3 e^2 - 2 e^3 is 1 in single precision."""

_ZERO, _ONE, _TWO, _THREE = float32(0.0), float32(1.0), float32(2.0), float32(3.0)


def _polynomial(function: Callable[[Any], Any]) -> tuple[float32, ...]:
    """Return the coefficients of a function of t^2 for t up to half a turn, accurate to 5e-8."""
    return tuple(map(float32, Chebyshev.interpolate(function, 4, [0.0, 0.25]).convert(kind=Polynomial).coef))


_S0, _S1, _S2, _S3, _S4 = _polynomial(lambda x: sin(pi * sqrt(x)) / sqrt(x))
_C0, _C1, _C2, _C3, _C4 = _polynomial(lambda x: cos(pi * sqrt(x)))


@_jit
def _smooth_rows(
    smooth: NDArray,
    low: int,
    high: int,
    along_x: tuple[NDArray, NDArray],
    begin: int,
    end: int,
    rows: NDArray,
    at: int,
) -> None:
    """Interpolate rows of phase, or of the edge, from `low` to `high` along x, to lines from `at` on."""
    first, weights = along_x
    first_column, past_column, count = first[begin], first[end - 1] + _SMOOTH, high - low
    columns, column = empty((past_column - first_column, count), rows.dtype), empty(count, rows.dtype)
    for k in range(count):
        for c in range(past_column - first_column):
            columns[c, k] = smooth[low + k, first_column + c]
    for j in range(end - begin):
        c, weight = first[begin + j] - first_column, weights[begin + j]
        p, q, r, s = weight[0], weight[1], weight[2], weight[3]
        for k in range(count):
            column[k] = (
                p * columns[c, k] + q * columns[c + 1, k] + r * columns[c + 2, k] + s * columns[c + 3, k]
            )
        for k in range(count):
            rows[at + k, j] = column[k]


@_jit
def _differences(phase_waves: NDArray, at: int, width: int, parts: NDArray) -> None:
    """Split four rows of phase into the second one, within half a turn, and the differences to it."""
    one, two, three, four = phase_waves[at], phase_waves[at + 1], phase_waves[at + 2], phase_waves[at + 3]
    for j in range(width):
        middle = two[j]
        parts[0, j] = float32(middle - floor(middle + 0.5))
        parts[1, j] = float32(one[j] - middle)
        parts[2, j] = float32(three[j] - middle)
        parts[3, j] = float32(four[j] - middle)


@_jit
def carrier_buffers(width: int) -> tuple[Any, ...]:
    """Return the buffers for the carrier of a block.

    They hold rows of phase and edge, the least and largest edge of each row, the split phases of four rows,
    and three row indices: of the first row in the buffer, of the next row to compute, and of the first of the
    split rows.
    """
    like = zeros(1, float32)
    rim, parts = lines_for(_KEPT, width, like), lines_for(_SMOOTH, width, like)
    rim[:], parts[:] = _ZERO, _ZERO
    rows = zeros(3, int64)
    rows[2] = -1
    return lines_for(_KEPT, width, zeros(1, float64)), rim, zeros((2, _KEPT), float32), parts, rows


@_jit
def _more_rows(
    carrier: tuple[NDArray, ...], begin: int, end: int, first: int, buffers: tuple[Any, ...]
) -> None:
    """Compute a band of rows of phase and edge in a block's columns; rows before `first` are dropped."""
    phase, edge, _, __, first_x, weight_of_x, single_x = carrier
    turns, rim, ends, ___, rows = buffers
    if rows[1] < first:
        rows[:2] = first
    if rows[1] + _BAND - rows[0] > _KEPT:
        moved_up(turns, first, rows[1], rows[0])
        moved_up(rim, first, rows[1], rows[0])
        for k in range(first, rows[1]):
            ends[:, k - first] = ends[:, k - rows[0]]
        rows[0] = first
    low, high, at = rows[1], min(rows[1] + _BAND, phase.shape[0]), rows[1] - rows[0]
    _smooth_rows(phase, low, high, (first_x, weight_of_x), begin, end, turns, at)
    _smooth_rows(edge, low, high, (first_x, single_x), begin, end, rim, at)
    for k in range(at, at + high - low):
        ends[0, k], ends[1, k] = rim[k, : end - begin].min(), rim[k, : end - begin].max()
    rows[1] = high


@_jit
def _light_between(ends: NDArray, at: int, weights: NDArray) -> int:
    """Return the light of a row between four rows whose least and largest edges are given."""
    least, most, negative = ends[0, at], ends[1, at], -min(weights[0], 0.0)
    for k in range(1, _SMOOTH):
        least, most = min(least, ends[0, at + k]), max(most, ends[1, at + k])
        negative -= min(weights[k], 0.0)
    if most <= _ZERO:
        return DARK
    # This is a lower bound of the values between four rows.
    return OPEN if least - negative * (most - least) >= _FULL else _PARTLY


@_jit
def make_waves(
    carrier: tuple[NDArray, ...],
    row: int,
    stop: int,
    begin: int,
    end: int,
    buffers: tuple[Any, ...],
    waves: NDArray,
    light: NDArray,
) -> bool:
    """Compute the carrier of up to four rows of a block and their light; rows must be ascending.

    On each line cosines come before sines. The result states whether any row has light.
    """
    first_y, weight_of_y = carrier[2], carrier[3]
    turns, _, ends, parts, rows = buffers
    some = False
    for i in range(row, stop):
        first = first_y[i]
        while rows[1] < first + _SMOOTH:
            _more_rows(carrier, begin, end, first, buffers)
        at, number = first - rows[0], i - row
        light[number] = _light_between(ends, at, weight_of_y[i])
        if light[number] == DARK:
            continue
        if rows[2] != first:
            _differences(turns, at, end - begin, parts)
            rows[2] = first
        _fill(light[number], weight_of_y[i], buffers, at, end - begin, waves, number)
        some = True
    return some


@_inlined
def _wave(split_phases: NDArray, step: int, j: int, a: Any, c: Any, d: Any) -> tuple[Any, Any]:
    """Return exp(2 pi i turns) for a vector of a fine row from sample j on, from weighted split phases."""
    turn = load(split_phases, j) + a * load(split_phases, step + j)
    turn = turn + c * load(split_phases, 2 * step + j) + d * load(split_phases, 3 * step + j)
    rounder = alike(_ROUNDER)
    turn = turn - ((turn + rounder) - rounder)
    x = turn * turn
    half = alike(_S2) + x * (alike(_S3) + x * alike(_S4))
    half = turn * (alike(_S0) + x * (alike(_S1) + x * half))
    other = alike(_C2) + x * (alike(_C3) + x * alike(_C4))
    other = alike(_C0) + x * (alike(_C1) + x * other)
    two = alike(_TWO) * half
    return alike(_ONE) - two * half, two * other


@_inlined
def _passed(rim: NDArray, step: int, at: int, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return 3 e^2 - 2 e^3 of an edge e, limited to 0 (dark) to 1; the first of its four rows is at `at`."""
    e = a * load(rim, at) + b * load(rim, at + step)
    e = e + c * load(rim, at + 2 * step) + d * load(rim, at + 3 * step)
    e = smaller(larger(e, alike(_ZERO)), alike(_ONE))
    return e * e * (alike(_THREE) - alike(_TWO) * e)


@_jit
def _fill(
    light: int, weights: NDArray, buffers: tuple[Any, ...], at: int, width: int, waves: NDArray, number: int
) -> None:
    """Compute the carrier of a fine row, on a line; `at` is the first of its four coarse rows."""
    part, step, edge, apart = (
        buffers[3].reshape(-1),
        buffers[3].shape[1],
        buffers[1].reshape(-1),
        buffers[1].shape[1],
    )
    line, here, half = waves.reshape(-1), number * waves.shape[1], whole(width)
    a, b, c, d = (
        alike(float32(weights[0])),
        alike(float32(weights[1])),
        alike(float32(weights[2])),
        alike(float32(weights[3])),
    )
    if light == OPEN:
        for j in range(0, width, LANES):
            cosine, sine = _wave(part, step, j, a, c, d)
            store(line, here + j, cosine)
            store(line, here + half + j, sine)
        return
    for j in range(0, width, LANES):
        cosine, sine = _wave(part, step, j, a, c, d)
        passed = _passed(edge, apart, at * apart + j, a, b, c, d)
        store(line, here + j, passed * cosine)
        store(line, here + half + j, passed * sine)


drop_outdated(make_waves, {__name__, lanes.__name__})
