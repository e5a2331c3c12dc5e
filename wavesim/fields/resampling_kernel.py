"""Compiled loops of :mod:`wavesim.fields.resampling`; each does some columns of the fine plane for a thread.

Along both axes samples are sums of lines that lie beside each other: of columns first, some rows of them at
a time, then of the rows that these make; back, of rows first. Four sums at a time share the lines that they
read, for it is reading that takes time. Rows and columns hold real parts before imaginary ones, in whole
vectors each; what these hold beyond a row's end may be any numbers.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

import math

from numpy import empty, int64
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit, drop_outdated
from wavesim.runtime.fourier import lanes
from wavesim.runtime.fourier.lanes import (
    LANES,
    alike,
    evens,
    fetch,
    lines_for,
    load,
    more_pairs,
    odds,
    pairs,
    store,
    transpose,
    whole,
)

_jit = cached_njit(nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")

BLOCK, BLOCKS = 1024, 2
"""Columns of the fine plane at a time, at most, and what the number of blocks is a multiple of: threads
share them evenly."""

BAND = 2 * LANES
"""Coarse rows at a time."""

FOUR = 4
"""Sums at a time."""


def block_width(columns: int) -> int:
    """Columns at a time: how many threads there are does not change what is added up in which turn."""
    blocks = BLOCKS * math.ceil(columns / (BLOCKS * BLOCK))
    return math.ceil(columns / blocks) if blocks else 1


@_jit
def weights_for_four(
    number: int,
    first: NDArray,
    last: NDArray,
    weight: NDArray,
    low: int,
    high: int,
    room: NDArray,
) -> tuple[int, int]:
    """Weights of four sums, from one number on, of all lines that any of them takes; 0 where one takes none.

    `first` and `last` say of which lines, between `low` and `high`, each is a sum. Returns the first line of
    all, and their number.
    """
    stop = min(number + FOUR, len(first))
    start = max(first[number], low)
    count = max(min(last[stop - 1], high) - start, 0)
    room[:, :count] = 0.0
    for k in range(number, stop):
        own = max(first[k], low)
        for t in range(own, min(last[k], high)):
            room[k - number, t - start] = weight[k, t - first[k]]
    return start, count


@_jit
def most_of_four(first: NDArray, last: NDArray) -> int:
    """Lines that any four sums take together, at most."""
    most = 0
    for k in range(len(first)):
        most = max(most, last[min(k + FOUR, len(first)) - 1] - first[k])
    return most


@_jit
def all_fours(
    first: NDArray, last: NDArray, weight: NDArray, low: int, high: int
) -> tuple[NDArray, NDArray, NDArray]:
    """What :func:`weights_for_four` gives for every four sums: first lines, numbers of lines, weights."""
    count = (len(first) + FOUR - 1) // FOUR
    starts, several = empty(count, int64), empty(count, int64)
    rooms = empty((count, FOUR, most_of_four(first, last)), weight.dtype)
    for number in range(count):
        found = weights_for_four(number * FOUR, first, last, weight, low, high, rooms[number])
        starts[number], several[number] = found
    return starts, several, rooms


@_jit
def sums_of_lines(
    lines: NDArray, first: int, count: int, weight: NDArray, numbers: int, sums: NDArray
) -> None:
    """Four sums of so many lines from the first on; their numbers fill two vectors, or twice as many."""
    flat, taking, step, across = lines.reshape(-1), sums.reshape(-1), lines.shape[1], sums.shape[1]
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
        store(taking, c, a)
        store(taking, c + LANES, p)
        store(taking, across + c, b)
        store(taking, across + c + LANES, q)
        store(taking, 2 * across + c, d)
        store(taking, 2 * across + c + LANES, r)
        store(taking, 3 * across + c, e)
        store(taking, 3 * across + c + LANES, s)


@_jit
def add_turned(
    lines: NDArray, waves: NDArray, plane: NDArray, at: int, step: int, width: int, first: int, stop: int
) -> None:
    """Add lines times complex factors to rows of so many samples, from the first to one before `stop`.

    The first line goes to the row that begins at `at` of a flat plane, whose rows are `step` apart. Lines and
    factors hold real parts, then imaginary ones, in whole vectors; rows hold both in turn.
    """
    half, across, some = whole(width), lines.shape[1], empty(2 * LANES, plane.dtype)
    line, wave = lines.reshape(-1), waves.reshape(-1)
    for row in range(first, stop):
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
def take_turned(
    plane: NDArray,
    at: int,
    step: int,
    waves: NDArray,
    width: int,
    lines: NDArray,
    first: int,
    to: int,
    count: int,
) -> None:
    """The transpose of :func:`add_turned`, of so many rows, onto lines from `to` on."""
    half, across, some = whole(width), lines.shape[1], empty(2 * LANES, plane.dtype)
    line, wave = lines.reshape(-1), waves.reshape(-1)
    some[:] = 0.0
    for row in range(count):
        here, there = (first + row) * waves.shape[1], (to + row) * across
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
            store(line, there + j, cosine * real + sine * imaginary)
            store(line, there + half + j, cosine * imaginary - sine * real)


@_jit
def take_parts(rows: NDArray, begin: int, end: int, first: int, count: int, lines: NDArray) -> None:
    """Real, then imaginary parts of some columns of so many rows, from the first on, in whole vectors."""
    half, across, some = whole(end - begin), lines.shape[1], empty(2 * LANES, rows.dtype)
    flat, line = rows.reshape(-1), lines.reshape(-1)
    some[:] = 0.0
    for row in range(count):
        at, there = (first + row) * rows.shape[1] + 2 * begin, row * across
        for j in range(0, end - begin, LANES):
            if j + LANES <= end - begin:
                one, other = load(flat, at + 2 * j), load(flat, at + 2 * j + LANES)
            else:
                for k in range(2 * (end - begin - j)):
                    some[k] = flat[at + 2 * j + k]
                one, other = load(some, 0), load(some, LANES)
            store(line, there + j, evens(one, other))
            store(line, there + half + j, odds(one, other))


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
    """Coarse rows from `low` to `high` in so many columns of the fine plane, on lines from `at` on.

    Of these there are `BAND`; those beyond the rows that are made may be any.
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
    given, taking, step = sums.reshape(-1), rows.reshape(-1), sums.shape[1]
    for j in range(0, width, LANES):
        for four in range(j, min(j + LANES, width), FOUR):
            n = four // FOUR
            taking_four = sums[four - j : four - j + FOUR]
            sums_of_lines(columns, starts[n] - left, several[n], weights[n], 2 * BAND, taking_four)
        for part in range(2):
            to = at * rows.shape[1] + part * whole(width) + j
            for k in range(0, BAND, LANES):
                transpose(given, part * BAND + k, step, taking, to + k * rows.shape[1], rows.shape[1])


@_jit
def moved_up(lines: NDArray, first: int, made: int, top: int) -> None:
    """Lines from `first` to `made`, the one at `top` the uppermost, to where the uppermost are."""
    for i in range(first, made):
        lines[i - first] = lines[i - top]


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
    """Coarse rows, a band's at most, from so many columns of the fine plane onto coarse ones."""
    half, across = whole(width), result.shape[1] // 2
    starts, several, weights = fours_x
    columns, given = lines_for(half, 2 * BAND, lines), lines.reshape(-1)
    taking, step = columns.reshape(-1), columns.shape[1]
    for part in range(2):
        for k in range(0, BAND, LANES):
            at, to = k * lines.shape[1] + part * half, part * BAND + k
            for j in range(0, half, LANES):
                transpose(given, at + j, lines.shape[1], taking, to + j * step, step)
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
    width, half, last_y = end - begin, whole(end - begin), first_y + weight_y.shape[1]
    most = most_of_four(first_y, last_y)
    rows, lines = lines_for(2 * (most + BAND), 2 * half, plane), lines_for(FOUR, 2 * half, plane)
    room, waves = empty((FOUR, most), plane.dtype), lines_for(FOUR, 2 * half, plane)
    onto, step = plane.reshape(-1), plane.shape[1]
    first_x, weight_x = along_x[0][begin:end], along_x[1][begin:end]
    fours_x = all_fours(first_x, first_x + weight_x.shape[1], weight_x, 0, coarse.shape[1] // 2)
    top = made = 0
    for four in range(0, len(first_y), FOUR):
        first, count = weights_for_four(four, first_y, last_y, weight_y, 0, coarse.shape[0], room)
        top, made = rows_from(coarse, fours_x, width, first, first + count, rows, (top, made))
        sums_of_lines(rows, first - top, count, room, 2 * half, lines)
        several, at = min(FOUR, len(first_y) - four), (place[0] + four) * step + 2 * (place[1] + begin)
        take_parts(carried, begin, end, four, several, waves)
        add_turned(lines, waves, onto, at, step, width, 0, several)


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
    count, most = len(first_y), most_of_four(first_y, last_y)
    width, half = end - begin, whole(end - begin)
    fine, lines = lines_for(most + BAND, 2 * half, plane), lines_for(BAND, 2 * half, plane)
    room, result = empty((FOUR, most), plane.dtype), empty((count, 2 * (right - left)), plane.dtype)
    waves, given, step = lines_for(FOUR, 2 * half, plane), plane.reshape(-1), plane.shape[1]
    lines[:] = 0.0
    fours_x = all_fours(back_x[0][left:right], back_x[1][left:right], back_x[2][left:right], begin, end)
    top = made = 0
    for four in range(0, count, FOUR):
        first, several = weights_for_four(four, first_y, last_y, weight_y, 0, carried.shape[0], room)
        if first + several - top > fine.shape[0]:
            moved_up(fine, first, made, top)
            top, made = first, max(made, first)
        while made < first + several:
            more = min(FOUR, first + several - made)
            take_parts(carried, begin, end, made, more, waves)
            start = (place[0] + made) * step + 2 * (place[1] + begin)
            take_turned(given, start, step, waves, width, fine, 0, made - top, more)
            made += more
        at = four % BAND
        sums_of_lines(fine, first - top, several, room, 2 * half, lines[at : at + FOUR])
        if at + FOUR == BAND or four + FOUR >= count:
            put_band(lines, four - at, min(BAND, count - four + at), fours_x, begin, width, result)
    return result


drop_outdated(expand, {__name__, lanes.__name__})
