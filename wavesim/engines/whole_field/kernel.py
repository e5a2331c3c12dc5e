"""Compiled loops that carry a field from a coarse plane to a fine one and back, making carriers on the way.

Carriers exp(2 pi i phase) of a whole field are too large to be kept. Their phase, in turns, and the edge of
the aperture are smooth: they come on coarse grids of their own, where four samples along each axis tell what
is in between. Fields go as :mod:`wavesim.fields.resampling_kernel` has it.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

import math
from typing import Any

from numba import njit
from numpy import abs as magnitude
from numpy import bool_, copysign, empty, float32, float64, floor, int64, zeros
from numpy.typing import NDArray

from lensdesign.tracing.kept_kernels import drop_outdated, kept_njit
from wavesim.fields import resampling_kernel
from wavesim.fields.resampling_kernel import APART, BAND, moved_up, put_row, rows_from, sum_of_lines

_FAST = {"contract", "reassoc", "nsz", "arcp"}
_jit = kept_njit(nogil=True, fastmath=_FAST, error_model="numpy")

_SMOOTH = 4
"""Rows, and columns, between which phase and edge are cubic."""

_KEPT = 2 * BAND
"""Rows of phase and edge for which there is room."""

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
    """Rows of phase, or of the edge, from `low` to `high` in a block's columns, on lines from `at` on."""
    first, share = along_x
    left, right = first[begin], first[end - 1] + _SMOOTH
    columns, column = empty((right - left, high - low), rows.dtype), empty(high - low, rows.dtype)
    for k in range(high - low):
        for c in range(right - left):
            columns[c, k] = smooth[low + k, left + c]
    for j in range(end - begin):
        sum_of_lines(columns, first[begin + j] - left, _SMOOTH, share[begin + j], column)
        for k in range(high - low):
            rows[at + k, j] = column[k]


@_jit
def _waves(share: NDArray, turns: NDArray, rim: NDArray, at: int, real: NDArray, imaginary: NDArray) -> None:
    """exp(2 pi i turns), times 3 e^2 - 2 e^3 of an edge e held between 0 (dark) and 1, of one fine row."""
    a, b, c, d = share[0], share[1], share[2], share[3]
    one, two, three, four = turns[at], turns[at + 1], turns[at + 2], turns[at + 3]
    # In a loop of its own: numbers of both sizes in one would keep vectors half empty.
    for j in range(real.shape[0]):
        turn = a * one[j] + b * two[j] + c * three[j] + d * four[j]
        real[j] = float32(turn - floor(turn + 0.5))
    p, q, r, s = float32(a), float32(b), float32(c), float32(d)
    near, far, farther, farthest = rim[at], rim[at + 1], rim[at + 2], rim[at + 3]
    for j in range(real.shape[0]):
        edge = p * near[j] + q * far[j] + r * farther[j] + s * farthest[j]
        e = min(max(edge, _ZERO), _ONE)
        passed = e * e * (float32(3.0) - float32(2.0) * e)
        part = real[j]
        size = magnitude(part)
        real[j] = passed * _sine(_QUARTER - size)
        imaginary[j] = passed * _sine(copysign(_QUARTER - magnitude(size - _QUARTER), part))


@_jit
def _room(width: int) -> tuple[Any, ...]:
    """Work space for the carrier of a block: rows of phase and edge, which have light, and what they make.

    The last counts rows: of the first for which there is room, and of the next that is not made.
    """
    return (
        empty((_KEPT, width + APART), float64),
        empty((_KEPT, width + APART), float32),
        zeros(_KEPT, bool_),
        empty(width, float32),
        empty(width, float32),
        zeros(2, int64),
    )


@_jit
def _carrier_row(carrier: tuple[NDArray, ...], row: int, begin: int, room: tuple[Any, ...]) -> bool:
    """Carrier of one row of a block, if it has light; rows come in turn."""
    phase, edge, first_y, share_y, first_x, share_x, single_x = carrier
    turns, rim, lit, cosine, sine, rows = room
    first, end = first_y[row], begin + cosine.shape[0]
    if rows[1] < first:
        rows[:] = first
    while rows[1] < first + _SMOOTH:
        if rows[1] + BAND - rows[0] > _KEPT:
            moved_up(turns, first, rows[1], rows[0])
            moved_up(rim, first, rows[1], rows[0])
            for k in range(first, rows[1]):
                lit[k - first] = lit[k - rows[0]]
            rows[0] = first
        low, high, at = rows[1], min(rows[1] + BAND, phase.shape[0]), rows[1] - rows[0]
        _smooth_rows(phase, low, high, (first_x, share_x), begin, end, turns, at)
        _smooth_rows(edge, low, high, (first_x, single_x), begin, end, rim, at)
        for k in range(high - low):
            lit[at + k] = rim[at + k, : end - begin].max() > _ZERO
        rows[1] = high
    at = first - rows[0]
    if not (lit[at] or lit[at + 1] or lit[at + 2] or lit[at + 3]):
        return False
    _waves(share_y[row], turns, rim, at, cosine, sine)
    return True


@_jit
def expand(
    coarse: NDArray,
    along_y: tuple[NDArray, NDArray],
    along_x: tuple[NDArray, NDArray],
    carrier: tuple[NDArray, ...],
    plane: NDArray,
    place: tuple[int, int],
    begin: int,
    end: int,
) -> None:
    """Add columns of a coarse field, interpolated and times its carrier, to those of a fine one.

    Parameters
    ----------
    coarse
        Its float view.
    along_y, along_x
        First coarse sample and its weights for each fine one.
    carrier
        Phase and edge on their grid; first row and shares, first column and shares, these in float32 too.
    plane
        Its float view.
    place
        Its row and column where the fine field begins.
    begin, end
        Columns of the fine field.
    """
    first_y, weight_y = along_y
    taps, width = weight_y.shape[1], end - begin
    rows = empty((2 * (taps + BAND), 2 * width + APART), float32)
    line, waves = empty(2 * width, float32), _room(width)
    cosine, sine = waves[3], waves[4]
    top = made = 0
    for i in range(first_y.shape[0]):
        if not _carrier_row(carrier, i, begin, waves):
            continue
        first = first_y[i]
        top, made = rows_from(coarse, along_x, begin, end, first, first + taps, rows, (top, made))
        sum_of_lines(rows, first - top, taps, weight_y[i], line)
        onto = plane[place[0] + i, 2 * (place[1] + begin) : 2 * (place[1] + end)]
        for j in range(width):
            onto[2 * j] += cosine[j] * line[j] - sine[j] * line[width + j]
            onto[2 * j + 1] += cosine[j] * line[width + j] + sine[j] * line[j]


@_jit
def collect(
    plane: NDArray,
    place: tuple[int, int],
    back_y: tuple[NDArray, NDArray, NDArray],
    back_x: tuple[NDArray, NDArray, NDArray],
    carrier: tuple[NDArray, ...],
    left: int,
    right: int,
    begin: int,
    end: int,
) -> NDArray:
    """The transpose of `expand`: what columns add to the coarse ones from `left` to `right`.

    `back_y` and `back_x` are the transposes of the weights: for each coarse sample the first fine one that
    counts, one past the last, and weights. The result is a float view.
    """
    first_y, last_y, weight_y = back_y
    count, width = first_y.shape[0], end - begin
    fine = empty((2 * (weight_y.shape[1] + BAND), 2 * width + APART), float32)
    line, columns = empty(2 * width, float32), zeros((width, 2 * BAND + APART), float32)
    waves, result = _room(width), empty((count, 2 * (right - left)), float32)
    cosine, sine = waves[3], waves[4]
    top = made = light = dark = 0  # from where to where there is light
    for k in range(count):
        first, last = first_y[k], last_y[k]
        if last - top > fine.shape[0]:
            moved_up(fine, first, made, top)
            top, made = first, max(made, first)
        for i in range(made, last):
            own = fine[i - top]
            if not _carrier_row(carrier, i, begin, waves):
                own[:] = 0.0
                continue
            light, dark = light if dark else i, i + 1
            value = plane[place[0] + i, 2 * (place[1] + begin) : 2 * (place[1] + end)]
            for j in range(width):
                own[j] = cosine[j] * value[2 * j] + sine[j] * value[2 * j + 1]
                own[width + j] = cosine[j] * value[2 * j + 1] - sine[j] * value[2 * j]
        made = max(made, last)
        start, stop = max(first, light), min(last, dark)
        sum_of_lines(fine, start - top, max(stop - start, 0), weight_y[k, start - first :], line)
        put_row(line, k, columns, back_x, left, begin, end, result)
    return result


drop_outdated(expand, {__name__, resampling_kernel.__name__})
