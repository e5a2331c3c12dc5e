"""Compiled loops of :mod:`wavesim.fields.resampling`; each does some columns of the fine plane for a thread.

A coarse row comes into the block's columns once: what is left for each fine sample are sums over rows that
lie beside each other in a core's cache. Complex lines come as their float views, real and imaginary part in
turn, where vector instructions take neighbours whatever part they are.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

from numpy import empty, zeros
from numpy.typing import NDArray

from lensdesign.tracing.kept_kernels import kept_njit

_jit = kept_njit(nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")

BLOCK = 256
"""Columns of the fine plane at a time."""


@_jit
def _across(row: NDArray, along_x: tuple[NDArray, NDArray], begin: int, line: NDArray) -> None:
    """A coarse row in the columns of a block."""
    first, weight = along_x
    for j in range(line.shape[0] // 2):
        own, left = weight[begin + j], 2 * first[begin + j]
        real, imaginary = own[0] * row[left], own[0] * row[left + 1]
        for t in range(1, weight.shape[1]):
            real += own[t] * row[left + 2 * t]
            imaginary += own[t] * row[left + 2 * t + 1]
        line[2 * j] = real
        line[2 * j + 1] = imaginary


@_jit
def expand(
    coarse: NDArray,
    along_y: tuple[NDArray, NDArray],
    along_x: tuple[NDArray, NDArray],
    carried: NDArray,
    result: NDArray,
    begin: int,
    end: int,
) -> None:
    """Add columns of a coarse field, interpolated and times a carrier, to those of a fine one.

    `along_y` and `along_x` are the first coarse sample and its weights for each fine one; fields and carrier
    come as their float views.
    """
    first_y, weight_y = along_y
    taps, width, made = weight_y.shape[1], 2 * (end - begin), 0
    rows, line = empty((taps, width), result.dtype), empty(width, result.dtype)
    for i in range(first_y.shape[0]):
        first = first_y[i]
        for k in range(max(made, first), first + taps):
            _across(coarse[k], along_x, begin, rows[k % taps])
        made = first + taps
        line[:] = 0.0
        for t in range(taps):
            weight, row = weight_y[i, t], rows[(first + t) % taps]
            for c in range(width):
                line[c] += weight * row[c]
        wave, onto = carried[i, 2 * begin : 2 * end], result[i, 2 * begin : 2 * end]
        for j in range(end - begin):
            onto[2 * j] += wave[2 * j] * line[2 * j] - wave[2 * j + 1] * line[2 * j + 1]
            onto[2 * j + 1] += wave[2 * j] * line[2 * j + 1] + wave[2 * j + 1] * line[2 * j]


@_jit
def _onto(line: NDArray, back: tuple[NDArray, NDArray, NDArray], left: int, begin: int, row: NDArray) -> None:
    """Columns of a block onto coarse ones from `left` on; leaves 0 of them."""
    first, last, weight = back
    for c in range(row.shape[0] // 2):
        start, stop = max(first[left + c], begin), min(last[left + c], begin + line.shape[0] // 2)
        share, own = weight[left + c, start - first[left + c] :], line[2 * (start - begin) :]
        real = imaginary = line[0] - line[0]
        for n in range(stop - start):
            real += share[n] * own[2 * n]
            imaginary += share[n] * own[2 * n + 1]
        row[2 * c] = real
        row[2 * c + 1] = imaginary
    line[:] = 0.0


@_jit
def collect(
    field: NDArray,
    carried: NDArray,
    along_y: tuple[NDArray, NDArray],
    first_x: NDArray,
    back: tuple[NDArray, NDArray, NDArray],
    rows: int,
    begin: int,
    end: int,
) -> NDArray:
    """The transpose of `expand`: what columns add to the coarse ones from the first that they reach on.

    `back` is the transpose of the weights along x: for each coarse sample the first fine one that counts, one
    past the last, and weights. `rows` is the number of coarse rows; the result is a float view.
    """
    first_y, weight_y = along_y
    taps, width, left, low = weight_y.shape[1], 2 * (end - begin), first_x[begin], first_y[0]
    result = zeros((rows, 2 * (first_x[end - 1] + taps - left)), field.dtype)
    lines, line = zeros((taps, width), field.dtype), empty(width, field.dtype)
    for i in range(first_y.shape[0]):
        first = first_y[i]
        for k in range(low, min(first, low + taps)):
            _onto(lines[k % taps], back, left, begin, result[k])
        low = first
        wave, value = carried[i, 2 * begin : 2 * end], field[i, 2 * begin : 2 * end]
        for j in range(end - begin):
            line[2 * j] = wave[2 * j] * value[2 * j] + wave[2 * j + 1] * value[2 * j + 1]
            line[2 * j + 1] = wave[2 * j] * value[2 * j + 1] - wave[2 * j + 1] * value[2 * j]
        for t in range(taps):
            weight, row = weight_y[i, t], lines[(first + t) % taps]
            for c in range(width):
                row[c] += weight * line[c]
    for k in range(low, low + taps):
        _onto(lines[k % taps], back, left, begin, result[k])
    return result
