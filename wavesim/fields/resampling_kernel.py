"""Compiled loops of :mod:`wavesim.fields.resampling`; each does some columns of the fine plane for a thread.

Along both axes samples are sums of lines that lie beside each other: of columns first, some rows of them at
a time, then of the rows that these make; back, of rows first. Rows hold real parts before imaginary ones,
columns both in turn: every loop is of a kind that vector instructions take.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

import math

from numpy import empty
from numpy.typing import NDArray

from lensdesign.tracing.kept_kernels import kept_njit

_jit = kept_njit(nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")

BLOCK, BLOCKS = 1024, 2
"""Columns of the fine plane at a time, at most, and what the number of blocks is a multiple of: threads
share them evenly."""

BAND = 32
"""Coarse rows at a time."""

APART = 16
"""Numbers between lines: lines a power of two apart share few places of a cache."""


def block_width(columns: int) -> int:
    """Columns at a time: how many threads there are does not change what is added up in which turn."""
    blocks = BLOCKS * math.ceil(columns / (BLOCKS * BLOCK))
    return math.ceil(columns / blocks) if blocks else 1


@_jit
def sum_of_lines(lines: NDArray, first: int, count: int, weight: NDArray, line: NDArray) -> None:
    """So many lines from the first on, each times its weight; four at a time: it is loads that take time."""
    rest = count % 4
    if rest > 1:
        p, q = weight[0], weight[1]
        for c in range(line.shape[0]):
            line[c] = p * lines[first, c] + q * lines[first + 1, c]
    else:
        line[:] = 0.0
    if rest % 2:
        p, at = weight[rest - 1], first + rest - 1
        for c in range(line.shape[0]):
            line[c] += p * lines[at, c]
    for t in range(rest, count, 4):
        p, q, r, s, at = weight[t], weight[t + 1], weight[t + 2], weight[t + 3], first + t
        for c in range(line.shape[0]):
            line[c] += p * lines[at, c] + q * lines[at + 1, c] + r * lines[at + 2, c] + s * lines[at + 3, c]


@_jit
def make_rows(
    coarse: NDArray,
    low: int,
    high: int,
    along_x: tuple[NDArray, NDArray],
    begin: int,
    end: int,
    rows: NDArray,
    at: int,
) -> None:
    """Coarse rows from `low` to `high` in columns of the fine plane, on lines from `at` on."""
    first, weight = along_x
    left, taps, count = first[begin], weight.shape[1], high - low
    columns = empty((first[end - 1] + taps - left, 2 * count), rows.dtype)
    column = empty(2 * count, rows.dtype)
    for k in range(count):
        for c in range(columns.shape[0]):
            columns[c, 2 * k] = coarse[low + k, 2 * (left + c)]
            columns[c, 2 * k + 1] = coarse[low + k, 2 * (left + c) + 1]
    for j in range(end - begin):
        sum_of_lines(columns, first[begin + j] - left, taps, weight[begin + j], column)
        for k in range(count):
            rows[at + k, j] = column[2 * k]
            rows[at + k, end - begin + j] = column[2 * k + 1]


@_jit
def moved_up(lines: NDArray, first: int, made: int, top: int) -> None:
    """Lines from `first` to `made`, the one at `top` the uppermost, to where the uppermost are."""
    for i in range(first, made):
        lines[i - first] = lines[i - top]


@_jit
def rows_from(
    coarse: NDArray,
    along_x: tuple[NDArray, NDArray],
    begin: int,
    end: int,
    first: int,
    last: int,
    rows: NDArray,
    kept: tuple[int, int],
) -> tuple[int, int]:
    """Make coarse rows in a block's columns, so that those from `first` to `last` are there.

    `kept` is the row on the uppermost line, and the next that is not made; so is what comes back.
    """
    top, made = kept
    if made < first:
        top = made = first
    while made < last:
        if made + BAND - top > rows.shape[0]:
            moved_up(rows, first, made, top)
            top = first
        more = min(made + BAND, coarse.shape[0])
        make_rows(coarse, made, more, along_x, begin, end, rows, made - top)
        made = more
    return top, made


@_jit
def put_row(
    line: NDArray,
    row: int,
    columns: NDArray,
    back_x: tuple[NDArray, NDArray, NDArray],
    left: int,
    begin: int,
    end: int,
    result: NDArray,
) -> None:
    """A coarse row in a block's columns; `BAND` of them at a time, and the last, go onto coarse columns."""
    first, last, weight = back_x
    at, width = row % BAND, end - begin
    for j in range(width):
        columns[j, 2 * at] = line[j]
        columns[j, 2 * at + 1] = line[width + j]
    if at < BAND - 1 and row < result.shape[0] - 1:
        return
    column = empty(2 * (at + 1), result.dtype)
    for c in range(result.shape[1] // 2):
        start, stop = max(first[left + c], begin), min(last[left + c], end)
        own = weight[left + c, start - first[left + c] :]
        sum_of_lines(columns, start - begin, max(stop - start, 0), own, column)
        for k in range(at + 1):
            result[row - at + k, 2 * c] = column[2 * k]
            result[row - at + k, 2 * c + 1] = column[2 * k + 1]


@_jit
def expand(
    coarse: NDArray,
    along_y: tuple[NDArray, NDArray],
    along_x: tuple[NDArray, NDArray],
    carried: NDArray,
    plane: NDArray,
    place: tuple[int, int],
    begin: int,
    end: int,
) -> None:
    """Add columns of a coarse field, interpolated and times a carrier, to those of a fine one.

    `along_y` and `along_x` are the first coarse sample and its weights for each fine one. Fields and carrier
    come as their float views; `place` is row and column of the plane where the fine field begins.
    """
    first_y, weight_y = along_y
    taps, width = weight_y.shape[1], end - begin
    rows = empty((2 * (taps + BAND), 2 * width + APART), plane.dtype)
    line = empty(2 * width, plane.dtype)
    top = made = 0
    for i in range(first_y.shape[0]):
        first = first_y[i]
        top, made = rows_from(coarse, along_x, begin, end, first, first + taps, rows, (top, made))
        sum_of_lines(rows, first - top, taps, weight_y[i], line)
        wave = carried[i, 2 * begin : 2 * end]
        onto = plane[place[0] + i, 2 * (place[1] + begin) : 2 * (place[1] + end)]
        for j in range(width):
            onto[2 * j] += wave[2 * j] * line[j] - wave[2 * j + 1] * line[width + j]
            onto[2 * j + 1] += wave[2 * j] * line[width + j] + wave[2 * j + 1] * line[j]


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
    """The transpose of `expand`: what columns add to the coarse ones from `left` to `right`.

    `back_y` and `back_x` are the transposes of the weights: for each coarse sample the first fine one that
    counts, one past the last, and weights. The result is a float view.
    """
    first_y, last_y, weight_y = back_y
    count, width = first_y.shape[0], end - begin
    fine = empty((2 * (weight_y.shape[1] + BAND), 2 * width + APART), plane.dtype)
    line, columns = empty(2 * width, plane.dtype), empty((width, 2 * BAND + APART), plane.dtype)
    result = empty((count, 2 * (right - left)), plane.dtype)
    top = made = 0
    for k in range(count):
        first, last = first_y[k], last_y[k]
        if last - top > fine.shape[0]:
            moved_up(fine, first, made, top)
            top, made = first, max(made, first)
        for i in range(made, last):
            wave, own = carried[i, 2 * begin : 2 * end], fine[i - top]
            value = plane[place[0] + i, 2 * (place[1] + begin) : 2 * (place[1] + end)]
            for j in range(width):
                own[j] = wave[2 * j] * value[2 * j] + wave[2 * j + 1] * value[2 * j + 1]
                own[width + j] = wave[2 * j] * value[2 * j + 1] - wave[2 * j + 1] * value[2 * j]
        made = max(made, last)
        sum_of_lines(fine, first - top, last - first, weight_y[k], line)
        put_row(line, k, columns, back_x, left, begin, end, result)
    return result
