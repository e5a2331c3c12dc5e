"""Compiled loops that carry a field from a coarse plane to a fine one and back, making carriers on the way.

Carriers exp(2 pi i phase) of a whole field are too large to be kept. Their phase, in turns, and the edge of
the aperture are smooth: they come on coarse grids of their own, where four samples along each axis tell what
is in between.

All goes by blocks of the fine plane's columns, so narrow that what is in work stays in a core's cache. Of a
coarse row that a fine one needs the block's columns are made first, once; what is left for each fine sample
are sums down the rows, which lie beside each other: every loop is of a kind that vector instructions take.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

from numba import njit
from numpy import abs as magnitude
from numpy import bool_, complex64, copysign, empty, float32, float64, floor, zeros
from numpy.typing import NDArray

from lensdesign.tracing.kept_kernels import kept_njit

_FAST = {"contract", "reassoc", "nsz", "arcp"}
_jit = kept_njit(nogil=True, fastmath=_FAST, error_model="numpy")
_inline = njit(inline="always", fastmath=_FAST, error_model="numpy")
"""Where the number of taps is a constant of the loop around it: it must be, to unroll what is within."""

BLOCK = 256
"""Columns of the fine plane at a time."""

_BATCH, _KEPT = 16, 40
"""Coarse rows whose columns are made at a time, and for which there is room."""

_SMOOTH = 4
"""Rows, and columns, between which phase and edge are cubic."""

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
    carrier: tuple[NDArray, ...],
    low: int,
    high: int,
    begin: int,
    turns: NDArray,
    rim: NDArray,
    lit: NDArray,
) -> None:
    """Phase and edge of rows of their grid, in a block's columns; every row stands twice."""
    phase, edge, _, _, first, share = carrier
    for k in range(low, high):
        at, most = k % _SMOOTH, _ZERO
        for j in range(turns.shape[1]):
            c = first[begin + j]
            a, b = share[begin + j, 0], share[begin + j, 1]
            g, d = share[begin + j, 2], share[begin + j, 3]
            turns[at, j] = a * phase[k, c] + b * phase[k, c + 1] + g * phase[k, c + 2] + d * phase[k, c + 3]
            e = float32(a * edge[k, c] + b * edge[k, c + 1] + g * edge[k, c + 2] + d * edge[k, c + 3])
            rim[at, j] = e
            most = max(most, e)
        turns[at + _SMOOTH] = turns[at]
        rim[at + _SMOOTH] = rim[at]
        lit[at] = most > _ZERO


@_jit
def _waves(at: int, share: NDArray, turns: NDArray, rim: NDArray, real: NDArray, imaginary: NDArray) -> None:
    """exp(2 pi i turns), times 3 e^2 - 2 e^3 of an edge e held between 0 (dark) and 1, of one fine row."""
    a, b, c, d = share[0], share[1], share[2], share[3]
    p, q, r, s = float32(a), float32(b), float32(c), float32(d)
    for j in range(real.shape[0]):
        turn = a * turns[at, j] + b * turns[at + 1, j] + c * turns[at + 2, j] + d * turns[at + 3, j]
        edge = p * rim[at, j] + q * rim[at + 1, j] + r * rim[at + 2, j] + s * rim[at + 3, j]
        part = float32(turn - floor(turn + 0.5))
        size = magnitude(part)
        e = min(max(edge, _ZERO), _ONE)
        passed = e * e * (float32(3.0) - float32(2.0) * e)
        real[j] = passed * _sine(_QUARTER - size)
        imaginary[j] = passed * _sine(copysign(_QUARTER - magnitude(size - _QUARTER), part))


@_jit
def _room(width: int) -> tuple[Any, ...]:
    """Work space for the carrier of a row of a block: rows of phase and edge, which of them have light."""
    smooth = empty((2 * _SMOOTH, width), float64), empty((2 * _SMOOTH, width), float32)
    return smooth[0], smooth[1], zeros(_SMOOTH, bool_), empty(width, float32), empty(width, float32)


@_jit
def _carrier_row(
    carrier: tuple[NDArray, ...], row: int, made: int, begin: int, room: tuple[Any, ...]
) -> bool:
    """Carrier of one row of a block, if it has light; of its grid's rows those before `made` are made."""
    turns, rim, lit, cosine, sine = room
    first = carrier[2][row]
    _smooth_rows(carrier, max(made, first), first + _SMOOTH, begin, turns, rim, lit)
    if not (lit[0] or lit[1] or lit[2] or lit[3]):
        return False
    _waves(first % _SMOOTH, carrier[3][row], turns, rim, cosine, sine)
    return True


@_inline
def _make_rows(
    taps: int,
    coarse: NDArray,
    low: int,
    along_x: tuple[NDArray, NDArray],
    begin: int,
    room: tuple[Any, ...],
    at: int,
) -> None:
    """Some coarse rows, from `low` on, in the block's columns."""
    first_x, weight_x = along_x
    real, imaginary, one, re, im = room
    left = first_x[begin]
    for q in range(min(_BATCH, coarse.shape[0] - low)):
        for c in range(real.shape[0]):
            real[c, q] = coarse[low + q, left + c].real
            imaginary[c, q] = coarse[low + q, left + c].imag
    for j in range(re.shape[1]):
        first = first_x[begin + j] - left
        for q in range(one.shape[1]):
            x, y = _ZERO, _ZERO
            for t in range(taps):
                x += weight_x[begin + j, t] * real[first + t, q]
                y += weight_x[begin + j, t] * imaginary[first + t, q]
            one[0, q] = x
            one[1, q] = y
        for q in range(one.shape[1]):
            re[at + q, j] = one[0, q]
            im[at + q, j] = one[1, q]


@_inline
def _add_row(
    taps: int,
    at: int,
    weight: NDArray,
    re: NDArray,
    im: NDArray,
    cosine: NDArray,
    sine: NDArray,
    row: NDArray,
) -> None:
    for j in range(cosine.shape[0]):
        x, y = _ZERO, _ZERO
        for t in range(taps):
            x += weight[t] * re[at + t, j]
            y += weight[t] * im[at + t, j]
        row[2 * j] += cosine[j] * x - sine[j] * y
        row[2 * j + 1] += cosine[j] * y + sine[j] * x


@cache
def expander(taps: int) -> Callable[..., None]:
    """The loop that adds a coarse field, interpolated with so many taps and times its carrier, to a fine one.

    It takes the coarse field; first coarse row and its weights for each fine row, and the same for columns;
    of the carrier phase and edge on their grid, first row and shares, first column and shares; the plane, of
    which real and imaginary parts lie beside each other along its rows; row and column where the fine field
    begins there; columns of the fine field to do.
    """

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
        (first_y, weight_y), (first_x, _) = along_y, along_x
        columns = first_x[end - 1] + taps - first_x[begin]
        re, im = empty((_KEPT, end - begin), float32), empty((_KEPT, end - begin), float32)
        batch = zeros((columns, _BATCH), float32), zeros((columns, _BATCH), float32)
        room = (batch[0], batch[1], empty((2, _BATCH), float32), re, im)
        waves = _room(end - begin)
        top = made = smooth = 0
        for i in range(first_y.shape[0]):
            lit = _carrier_row(carrier, i, smooth, begin, waves)
            smooth = carrier[2][i] + _SMOOTH
            if not lit:
                continue
            first = first_y[i]
            if made < first:
                top = made = first
            while made < first + taps:
                if made - top + _BATCH > _KEPT:
                    for r in range(first, made):
                        re[r - first] = re[r - top]
                        im[r - first] = im[r - top]
                    top = first
                _make_rows(taps, coarse, made, along_x, begin, room, made - top)
                made += _BATCH
            row = plane[place[0] + i, 2 * (place[1] + begin) : 2 * (place[1] + end)]
            _add_row(taps, first - top, weight_y[i], re, im, waves[3], waves[4], row)

    return expand


@_inline
def _finish(
    taps: int,
    low: int,
    high: int,
    back: tuple[NDArray, NDArray, NDArray],
    left: int,
    begin: int,
    re: NDArray,
    im: NDArray,
    strip: NDArray,
) -> None:
    """Coarse rows to which no more fine rows add, from the block's columns onto coarse ones."""
    first, last, weight = back
    for r in range(low, high):
        at = r % taps
        for c in range(strip.shape[1]):
            start, stop = max(first[left + c], begin), min(last[left + c], begin + re.shape[1])
            share = weight[left + c, start - first[left + c] :]
            real, imaginary = re[at, start - begin :], im[at, start - begin :]
            x, y = _ZERO, _ZERO
            for n in range(stop - start):
                x += share[n] * real[n]
                y += share[n] * imaginary[n]
            strip[r, c] = complex64(complex(x, y))
        re[at] = 0.0
        im[at] = 0.0


@_inline
def _take_row(
    taps: int,
    first: int,
    weight: NDArray,
    re: NDArray,
    im: NDArray,
    waves: tuple[Any, ...],
    row: NDArray,
    own: NDArray,
) -> None:
    cosine, sine, xs, ys = waves[3], waves[4], own[0], own[1]
    for j in range(cosine.shape[0]):
        x, y = row[2 * j], row[2 * j + 1]
        xs[j] = cosine[j] * x + sine[j] * y
        ys[j] = cosine[j] * y - sine[j] * x
    for t in range(taps):
        real, imaginary = re[(first + t) % taps], im[(first + t) % taps]
        for j in range(cosine.shape[0]):
            real[j] += weight[t] * xs[j]
            imaginary[j] += weight[t] * ys[j]


@cache
def collector(taps: int) -> Callable[..., NDArray]:
    """The loop that takes columns of a fine field onto a coarse one: the transpose of `expander`'s.

    It takes the plane, where the fine field begins on it, `along_y` and `along_x` as there; of the latter's
    transpose the first fine column and weights for each coarse one, and one past the last; `carrier` as
    there; the number of coarse rows; columns to do. It gives what these add to coarse columns from the first
    that they reach.
    """

    @_jit
    def collect(
        plane: NDArray,
        place: tuple[int, int],
        along_y: tuple[NDArray, NDArray],
        along_x: tuple[NDArray, NDArray],
        back: tuple[NDArray, NDArray, NDArray],
        carrier: tuple[NDArray, ...],
        rows: int,
        begin: int,
        end: int,
    ) -> NDArray:
        (first_y, weight_y), (first_x, _) = along_y, along_x
        left = first_x[begin]
        strip = zeros((rows, first_x[end - 1] + taps - left), complex64)
        re, im = zeros((taps, end - begin), float32), zeros((taps, end - begin), float32)
        waves, own = _room(end - begin), empty((2, end - begin), float32)
        low = high = smooth = 0
        for i in range(first_y.shape[0]):
            lit = _carrier_row(carrier, i, smooth, begin, waves)
            smooth = carrier[2][i] + _SMOOTH
            if not lit:
                continue
            first = first_y[i]
            _finish(taps, low, min(first, high), back, left, begin, re, im, strip)
            low, high = first, first + taps
            row = plane[place[0] + i, 2 * (place[1] + begin) : 2 * (place[1] + end)]
            _take_row(taps, first, weight_y[i], re, im, waves, row, own)
        _finish(taps, low, high, back, left, begin, re, im, strip)
        return strip

    return collect
