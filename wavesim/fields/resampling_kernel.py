"""Compiled loops of :mod:`wavesim.fields.resampling`. Each call handles some columns of the fine plane in a
thread.

Along both axes an output line is a weighted sum of neighbouring input lines. The forward loop sums columns
first, some rows of them at a time, then the resulting rows; the adjoint loop sums rows first. Four sums at a
time share the lines that they read, since memory traffic limits the speed. Rows and columns hold real parts
before imaginary ones, padded to whole vectors; the padding may hold any numbers.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

import math

from numpy import empty, full, int64
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit, drop_outdated
from wavesim.fields import carrier_kernel
from wavesim.fields.carrier_kernel import DARK, OPEN, carrier_buffers, make_waves
from wavesim.runtime.fourier import lanes
from wavesim.runtime.fourier.lanes import (
    LANES,
    alike,
    evens,
    fetch,
    lines_for,
    load,
    more_pairs,
    moved_up,
    odds,
    pairs,
    store,
    transpose,
    whole,
)

_jit = cached_njit(nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")

BLOCK, BLOCKS = 1024, 2
"""Most columns of a block of the fine plane, and a divisor of the number of blocks, so that threads share
them evenly."""

BAND = 2 * LANES
"""Coarse rows that are computed at a time."""

FOUR = 4
"""Sums that are computed at a time."""


def block_width(columns: int) -> int:
    """Return the columns of a block; the number of threads does not change the order of summation."""
    blocks = BLOCKS * math.ceil(columns / (BLOCKS * BLOCK))
    return math.ceil(columns / blocks) if blocks else 1


@_jit
def weights_for_four(
    index: int,
    first: NDArray,
    last: NDArray,
    weight: NDArray,
    low: int,
    high: int,
    buffer: NDArray,
) -> tuple[int, int]:
    """Gather the weights of four sums, from one index on, for all lines that any of them uses; 0 elsewhere.

    `first` and `last` are the range of lines of each sum, limited to `low` and `high`. Returns the first line
    and the number of lines.
    """
    stop = min(index + FOUR, len(first))
    start = max(first[index], low)
    count = max(min(last[stop - 1], high) - start, 0)
    buffer[:, :count] = 0.0
    for k in range(index, stop):
        own = max(first[k], low)
        for t in range(own, min(last[k], high)):
            buffer[k - index, t - start] = weight[k, t - first[k]]
    return start, count


@_jit
def most_of_four(first: NDArray, last: NDArray) -> int:
    """Return the largest number of lines that four successive sums use together."""
    most = 0
    for k in range(len(first)):
        most = max(most, last[min(k + FOUR, len(first)) - 1] - first[k])
    return most


@_jit
def all_fours(
    first: NDArray, last: NDArray, weight: NDArray, low: int, high: int
) -> tuple[NDArray, NDArray, NDArray]:
    """Return the results of :func:`weights_for_four` for all sums: first lines, numbers of lines, weights."""
    count = (len(first) + FOUR - 1) // FOUR
    starts, several = empty(count, int64), empty(count, int64)
    buffers = empty((count, FOUR, most_of_four(first, last)), weight.dtype)
    for index in range(count):
        found = weights_for_four(index * FOUR, first, last, weight, low, high, buffers[index])
        starts[index], several[index] = found
    return starts, several, buffers


@_jit
def sums_of_lines(
    lines: NDArray, first: int, count: int, weight: NDArray, numbers: int, sums: NDArray
) -> None:
    """Compute four weighted sums of `count` lines from `first` on, each of `numbers` values."""
    flat, target, step, across = lines.reshape(-1), sums.reshape(-1), lines.shape[1], sums.shape[1]
    zero = alike(weight.dtype.type(0.0))
    for c in range(0, numbers, 2 * LANES):
        a, b, d, e = zero, zero, zero, zero
        p, q, r, s = zero, zero, zero, zero
        for t in range(count):
            at = (first + t) * step + c
            left, right = load(flat, at), load(flat, at + LANES)
            one, two = alike(weight[0, t]), alike(weight[1, t])
            three, four = alike(weight[2, t]), alike(weight[3, t])
            a, b, d, e = a + one * left, b + two * left, d + three * left, e + four * left
            p, q, r, s = p + one * right, q + two * right, r + three * right, s + four * right
        store(target, c, a)
        store(target, c + LANES, p)
        store(target, across + c, b)
        store(target, across + c + LANES, q)
        store(target, 2 * across + c, d)
        store(target, 2 * across + c + LANES, r)
        store(target, 3 * across + c, e)
        store(target, 3 * across + c + LANES, s)


@_jit
def add_modulated(
    lines: NDArray, waves: NDArray, light: NDArray, plane: NDArray, at: int, step: int, width: int, count: int
) -> None:
    """Add `count` lines times complex factors to rows of `width` samples, except for dark lines.

    The first line goes to the row that begins at `at` of a flat plane, whose rows are `step` apart. Lines and
    factors hold real parts before imaginary ones, in whole vectors; the plane's rows interleave them.
    """
    half, across, some = whole(width), lines.shape[1], empty(2 * LANES, plane.dtype)
    line, wave = lines.reshape(-1), waves.reshape(-1)
    for row in range(count):
        if light[row] == DARK:
            continue
        here = row * across
        for j in range(0, width, LANES):
            cosine, sine = load(wave, here + j), load(wave, here + half + j)
            real, imaginary = load(line, here + j), load(line, here + half + j)
            one, other = cosine * real - sine * imaginary, cosine * imaginary + sine * real
            to = at + row * step + 2 * j
            if j + LANES <= width:
                fetch(plane, to + step)
                fetch(plane, to + step + LANES)
                store(plane, to, load(plane, to) + pairs(one, other))
                store(plane, to + LANES, load(plane, to + LANES) + more_pairs(one, other))
            else:
                store(some, 0, pairs(one, other))
                store(some, LANES, more_pairs(one, other))
                for k in range(2 * (width - j)):
                    plane[to + k] += some[k]


@_jit
def take_modulated(
    plane: NDArray,
    at: int,
    step: int,
    waves: NDArray,
    light: NDArray,
    width: int,
    lines: NDArray,
    to: int,
    count: int,
) -> None:
    """Transpose of :func:`add_modulated`, onto lines from `to` on; dark lines become 0."""
    half, across, some = whole(width), lines.shape[1], empty(2 * LANES, plane.dtype)
    line, wave = lines.reshape(-1), waves.reshape(-1)
    some[:] = 0.0
    for row in range(count):
        if light[row] == DARK:
            lines[to + row] = 0.0
            continue
        here, target = row * waves.shape[1], (to + row) * across
        for j in range(0, width, LANES):
            start = at + row * step + 2 * j
            if j + LANES <= width:
                fetch(plane, start + step)
                fetch(plane, start + step + LANES)
                one, other = load(plane, start), load(plane, start + LANES)
            else:
                for k in range(2 * (width - j)):
                    some[k] = plane[start + k]
                one, other = load(some, 0), load(some, LANES)
            real, imaginary = evens(one, other), odds(one, other)
            cosine, sine = load(wave, here + j), load(wave, here + half + j)
            store(line, target + j, cosine * real + sine * imaginary)
            store(line, target + half + j, cosine * imaginary - sine * real)


@_jit
def take_parts(rows: NDArray, begin: int, end: int, first: int, count: int, lines: NDArray) -> None:
    """Copy columns of `count` rows from `first` on to lines, real parts before imaginary ones."""
    half, across, some = whole(end - begin), lines.shape[1], empty(2 * LANES, rows.dtype)
    flat, line = rows.reshape(-1), lines.reshape(-1)
    some[:] = 0.0
    for row in range(count):
        at, target = (first + row) * rows.shape[1] + 2 * begin, row * across
        for j in range(0, end - begin, LANES):
            if j + LANES <= end - begin:
                one, other = load(flat, at + 2 * j), load(flat, at + 2 * j + LANES)
            else:
                for k in range(2 * (end - begin - j)):
                    some[k] = flat[at + 2 * j + k]
                one, other = load(some, 0), load(some, LANES)
            store(line, target + j, evens(one, other))
            store(line, target + half + j, odds(one, other))


@_jit
def make_rows(
    coarse: NDArray,
    low: int,
    high: int,
    fours_x: tuple[NDArray, NDArray, NDArray],
    width: int,
    rows: NDArray,
    at: int,
) -> None:
    """Interpolate coarse rows from `low` to `high` along x, into `BAND` lines from `at` on.

    Lines beyond the given rows may hold any numbers.
    """
    starts, several, weights = fours_x
    left, count = starts[0], high - low
    columns = lines_for(starts[-1] + several[-1] - left, 2 * BAND, rows)
    sums = lines_for(LANES, 2 * BAND, rows)
    sums[:] = 0.0
    if count < BAND:
        columns[:] = 0.0
    for k in range(count):
        for c in range(columns.shape[0]):
            columns[c, k] = coarse[low + k, 2 * (left + c)]
            columns[c, BAND + k] = coarse[low + k, 2 * (left + c) + 1]
    source, target, step = sums.reshape(-1), rows.reshape(-1), sums.shape[1]
    for j in range(0, width, LANES):
        for four in range(j, min(j + LANES, width), FOUR):
            n = four // FOUR
            four_sums = sums[four - j : four - j + FOUR]
            sums_of_lines(columns, starts[n] - left, several[n], weights[n], 2 * BAND, four_sums)
        for part in range(2):
            to = at * rows.shape[1] + part * whole(width) + j
            for k in range(0, BAND, LANES):
                transpose(source, part * BAND + k, step, target, to + k * rows.shape[1], rows.shape[1])


@_jit
def rows_from(
    coarse: NDArray,
    fours_x: tuple[NDArray, NDArray, NDArray],
    width: int,
    first: int,
    last: int,
    rows: NDArray,
    kept: tuple[int, int],
) -> tuple[int, int]:
    """Interpolate coarse rows along x until those from `first` to `last` are in the buffer.

    `kept`, and the result, are the row on the first line of the buffer and the next row to compute.
    """
    top, made = kept
    if made < first:
        top = made = first
    while made < last:
        if made + BAND - top > rows.shape[0]:
            moved_up(rows, first, made, top)
            top = first
        more = min(made + BAND, coarse.shape[0])
        make_rows(coarse, made, more, fours_x, width, rows, made - top)
        made = more
    return top, made


@_jit
def put_band(
    lines: NDArray,
    row: int,
    count: int,
    fours_x: tuple[NDArray, NDArray, NDArray],
    begin: int,
    width: int,
    result: NDArray,
) -> None:
    """Interpolate the transpose along x: rows of a band from fine columns to coarse ones."""
    half, across = whole(width), result.shape[1] // 2
    starts, several, weights = fours_x
    columns, source = lines_for(half, 2 * BAND, lines), lines.reshape(-1)
    target, step = columns.reshape(-1), columns.shape[1]
    for part in range(2):
        for k in range(0, BAND, LANES):
            at, to = k * lines.shape[1] + part * half, part * BAND + k
            for j in range(0, half, LANES):
                transpose(source, at + j, lines.shape[1], target, to + j * step, step)
    sums = lines_for(FOUR, 2 * BAND, lines)
    for four in range(0, across, FOUR):
        n = four // FOUR
        sums_of_lines(columns, starts[n] - begin, several[n], weights[n], 2 * BAND, sums)
        for c in range(four, min(four + FOUR, across)):
            for k in range(count):
                result[row + k, 2 * c] = sums[c - four, k]
                result[row + k, 2 * c + 1] = sums[c - four, BAND + k]


@_jit
def expand(
    coarse: NDArray,
    along_y: tuple[NDArray, NDArray],
    along_x: tuple[NDArray, NDArray],
    carrier: NDArray | None,
    smooth_carrier: tuple[NDArray, ...] | None,
    plane: NDArray,
    origin: tuple[int, int],
    begin: int,
    end: int,
) -> None:
    """Add columns of a coarse field, interpolated and times a carrier, to those of a fine plane.

    Fields and the carrier are given as their float views. One of both carriers is None, and Numba compiles a
    loop without it.

    Parameters
    ----------
    coarse
        Coarse field.
    along_y, along_x
        First coarse sample and its weights for each fine one.
    carrier
        Carrier at each fine sample; None if it is smooth.
    smooth_carrier
        Arrays of :mod:`wavesim.fields.carrier_kernel`; None if the carrier is stored.
    plane
        Fine plane.
    origin
        Row and column of the plane at which the fine field begins.
    begin, end
        Columns of the fine field.
    """
    first_y, weight_y = along_y
    width, half, last_y = end - begin, whole(end - begin), first_y + weight_y.shape[1]
    most = most_of_four(first_y, last_y)
    rows, lines = lines_for(2 * (most + BAND), 2 * half, plane), lines_for(FOUR, 2 * half, plane)
    buffer, waves = empty((FOUR, most), plane.dtype), lines_for(FOUR, 2 * half, plane)
    onto, step, light, some = plane.reshape(-1), plane.shape[1], full(FOUR, OPEN), True
    if smooth_carrier is not None:
        kept = carrier_buffers(width)
    first_x, weight_x = along_x[0][begin:end], along_x[1][begin:end]
    fours_x = all_fours(first_x, first_x + weight_x.shape[1], weight_x, 0, coarse.shape[1] // 2)
    top = made = 0
    for four in range(0, len(first_y), FOUR):
        stop = min(four + FOUR, len(first_y))
        if carrier is not None:
            take_parts(carrier, begin, end, four, stop - four, waves)
        if smooth_carrier is not None:
            some = make_waves(smooth_carrier, four, stop, begin, end, kept, waves, light)
        if not some:
            continue
        first, count = weights_for_four(four, first_y, last_y, weight_y, 0, coarse.shape[0], buffer)
        top, made = rows_from(coarse, fours_x, width, first, first + count, rows, (top, made))
        sums_of_lines(rows, first - top, count, buffer, 2 * half, lines)
        at = (origin[0] + four) * step + 2 * (origin[1] + begin)
        add_modulated(lines, waves, light, onto, at, step, width, stop - four)


@_jit
def collect(
    plane: NDArray,
    origin: tuple[int, int],
    carrier: NDArray | None,
    smooth_carrier: tuple[NDArray, ...] | None,
    adjoint_y: tuple[NDArray, NDArray, NDArray],
    adjoint_x: tuple[NDArray, NDArray, NDArray],
    first_column: int,
    past_column: int,
    begin: int,
    end: int,
) -> NDArray:
    """Transpose of `expand`: the contribution of fine columns to a range of coarse ones.

    `adjoint_y` and `adjoint_x` are the transposed weights: for each coarse sample the first fine one that
    contributes, one past the last, and weights. The result is a float view.
    """
    first_y, last_y, weight_y = adjoint_y
    count, most = len(first_y), most_of_four(first_y, last_y)
    width, half = end - begin, whole(end - begin)
    fine, lines = lines_for(most + BAND, 2 * half, plane), lines_for(BAND, 2 * half, plane)
    buffer = empty((FOUR, most), plane.dtype)
    result = empty((count, 2 * (past_column - first_column)), plane.dtype)
    waves, source, step = lines_for(FOUR, 2 * half, plane), plane.reshape(-1), plane.shape[1]
    light = full(FOUR, OPEN)
    if smooth_carrier is not None:
        kept = carrier_buffers(width)
    lines[:] = 0.0
    fours_x = all_fours(
        adjoint_x[0][first_column:past_column],
        adjoint_x[1][first_column:past_column],
        adjoint_x[2][first_column:past_column],
        begin,
        end,
    )
    top = made = bright = dark = 0  # range of rows with light
    for four in range(0, count, FOUR):
        first, last = first_y[four], last_y[min(four + FOUR, count) - 1]
        if last - top > fine.shape[0]:
            moved_up(fine, first, made, top)
            top, made = first, max(made, first)
        while made < last:
            stop = min(made + FOUR, last)
            if carrier is not None:
                take_parts(carrier, begin, end, made, stop - made, waves)
            if smooth_carrier is not None:
                make_waves(smooth_carrier, made, stop, begin, end, kept, waves, light)
            at = (origin[0] + made) * step + 2 * (origin[1] + begin)
            take_modulated(source, at, step, waves, light, width, fine, made - top, stop - made)
            for i in range(made, stop):
                if light[i - made] != DARK:
                    bright, dark = bright if dark else i, i + 1
            made = stop
        start, several = weights_for_four(four, first_y, last_y, weight_y, bright, dark, buffer)
        at = four % BAND
        sums_of_lines(fine, start - top, several, buffer, 2 * half, lines[at : at + FOUR])
        if at + FOUR == BAND or four + FOUR >= count:
            put_band(lines, four - at, min(BAND, count - four + at), fours_x, begin, width, result)
    return result


drop_outdated(expand, {__name__, carrier_kernel.__name__, lanes.__name__})
