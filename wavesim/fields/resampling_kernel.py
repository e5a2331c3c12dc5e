"""Compiled loops of :mod:`wavesim.fields.resampling`; each does some columns of the fine plane for a thread.

Along both axes samples are sums of lines that lie beside each other: coarse columns first, which come as the
rows of a transposed field, then what they make down its rows. Complex lines come as their float views, real
and imaginary part in turn, where vector instructions take neighbours whatever part they are.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

from numpy import empty
from numpy.typing import NDArray

from lensdesign.tracing.kept_kernels import kept_njit

_jit = kept_njit(nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")

BLOCK = 256
"""Columns of the fine plane at a time."""

_APART = 16
"""Numbers between lines: lines a power of two apart share few places of a cache."""

_ROOM = 4
"""Fine lines that are held, of those that a coarse one takes."""


@_jit
def _sum_of_lines(lines: NDArray, first: int, count: int, weight: NDArray, line: NDArray) -> None:
    """So many lines from the first on, each times its weight; four at a time, for it waits for loads."""
    line[:] = 0.0
    for t in range(0, count - 3, 4):
        p, q, r, s = weight[t], weight[t + 1], weight[t + 2], weight[t + 3]
        at = first + t
        one, two, three, four = lines[at], lines[at + 1], lines[at + 2], lines[at + 3]
        for c in range(line.shape[0]):
            line[c] += p * one[c] + q * two[c] + r * three[c] + s * four[c]
    for t in range(count - count % 4, count):
        own, one = weight[t], lines[first + t]
        for c in range(line.shape[0]):
            line[c] += own * one[c]


@_jit
def expand(
    columns: NDArray,
    along_y: tuple[NDArray, NDArray],
    along_x: tuple[NDArray, NDArray],
    carried: NDArray,
    plane: NDArray,
    place: tuple[int, int],
    begin: int,
    end: int,
) -> None:
    """Add columns of a coarse field, interpolated and times a carrier, to those of a fine one.

    `columns` is the coarse field transposed; `along_y` and `along_x` are the first coarse sample and its
    weights for each fine one. Fields and carrier come as their float views; `place` is row and column of the
    plane where the fine field begins.
    """
    (first_y, weight_y), (first_x, weight_x) = along_y, along_x
    count, width = columns.shape[1] // 2, 2 * (end - begin)
    rows = empty((count, width + _APART), plane.dtype)
    column, line = empty(2 * count, plane.dtype), empty(width, plane.dtype)
    for j in range(end - begin):
        weight = weight_x[begin + j]
        _sum_of_lines(columns, first_x[begin + j], weight.shape[0], weight, column)
        for k in range(count):
            rows[k, 2 * j] = column[2 * k]
            rows[k, 2 * j + 1] = column[2 * k + 1]
    for i in range(first_y.shape[0]):
        _sum_of_lines(rows, first_y[i], weight_y.shape[1], weight_y[i], line)
        wave = carried[i, 2 * begin : 2 * end]
        onto = plane[place[0] + i, 2 * (place[1] + begin) : 2 * (place[1] + end)]
        for j in range(end - begin):
            onto[2 * j] += wave[2 * j] * line[2 * j] - wave[2 * j + 1] * line[2 * j + 1]
            onto[2 * j + 1] += wave[2 * j] * line[2 * j + 1] + wave[2 * j + 1] * line[2 * j]


@_jit
def collect(
    plane: NDArray,
    place: tuple[int, int],
    carried: NDArray,
    back_y: tuple[NDArray, NDArray, NDArray],
    back_x: tuple[NDArray, NDArray, NDArray],
    left: int,
    right: int,
    begin: int,
    end: int,
) -> NDArray:
    """The transpose of `expand`: what columns add to the coarse ones from `left` to `right`, as their rows.

    `back_y` and `back_x` are the transposes of the weights: for each coarse sample the first fine one that
    counts, one past the last, and weights. The result is a float view.
    """
    (first_y, last_y, weight_y), (first_x, last_x, weight_x) = back_y, back_x
    count, width, room = first_y.shape[0], 2 * (end - begin), _ROOM * weight_y.shape[1]
    fine, line = empty((room, width + _APART), plane.dtype), empty(width, plane.dtype)
    columns = empty((end - begin, 2 * count + _APART), plane.dtype)
    top = made = 0
    for k in range(count):
        first, last = first_y[k], last_y[k]
        if last - top > room:
            for i in range(first, made):
                fine[i - first] = fine[i - top]
            top, made = first, max(made, first)
        for i in range(made, last):
            wave, own = carried[i, 2 * begin : 2 * end], fine[i - top]
            value = plane[place[0] + i, 2 * (place[1] + begin) : 2 * (place[1] + end)]
            for j in range(end - begin):
                own[2 * j] = wave[2 * j] * value[2 * j] + wave[2 * j + 1] * value[2 * j + 1]
                own[2 * j + 1] = wave[2 * j] * value[2 * j + 1] - wave[2 * j + 1] * value[2 * j]
        made = max(made, last)
        _sum_of_lines(fine, first - top, last - first, weight_y[k], line)
        for j in range(end - begin):
            columns[j, 2 * k] = line[2 * j]
            columns[j, 2 * k + 1] = line[2 * j + 1]
    result = empty((right - left, 2 * count), plane.dtype)
    for c in range(left, right):
        start, stop = max(first_x[c], begin), min(last_x[c], end)
        weight = weight_x[c, start - first_x[c] :]
        _sum_of_lines(columns, start - begin, max(stop - start, 0), weight, result[c - left])
    return result
