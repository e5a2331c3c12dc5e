"""Compiled loops of Appendix A over a block of rows, or a panel of columns, that fits a processor's cache.

Complex rows come as their float views, real and imaginary part in turn, where vector instructions take
neighbours whatever part they are.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

import math
from typing import Any

from numpy import empty, float64
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit, drop_outdated
from wavesim.runtime.fourier import lanes
from wavesim.runtime.fourier.lanes import LANES, alike, load, store

_FAST = {"contract", "reassoc", "nsz", "arcp"}
_jit = cached_njit(nogil=True, fastmath=_FAST, error_model="numpy")

SUMMED = 64
"""Rows of a panel that are added up in its own precision."""

LEAST_SQUARE = 1e-30
"""Of a modulus, that is precise in single precision."""


@_jit
def replace(field: NDArray, amplitude: NDArray, known: NDArray | None) -> None:
    """A2, in place, in pixels that are known; where the field vanishes it takes the phase 0.

    In the field's own precision, but for rows in which squares might vanish.
    """
    rows, columns = amplitude.shape
    for i in range(rows):
        row, wanted = field[i], amplitude[i]
        one = wanted.dtype.type(1.0)
        small, least, vanishing = one - one, wanted.dtype.type(LEAST_SQUARE), one - one
        for j in range(columns):
            square = row[2 * j] * row[2 * j] + row[2 * j + 1] * row[2 * j + 1]
            vanishing += one if square < least else small
        if vanishing > small:
            _replace_exactly(row, wanted, None if known is None else known[i])
            continue
        for j in range(columns):
            real, imaginary = row[2 * j], row[2 * j + 1]
            factor = wanted[j] / math.sqrt(real * real + imaginary * imaginary)
            if known is not None:
                factor = factor if known[i, j] else one
            row[2 * j] = factor * real
            row[2 * j + 1] = factor * imaginary


@_jit
def _replace_exactly(row: NDArray, amplitude: NDArray, known: NDArray | None) -> None:
    for j in range(len(amplitude)):
        if known is not None and not known[j]:
            continue
        real, imaginary = float64(row[2 * j]), float64(row[2 * j + 1])
        modulus = math.sqrt(real * real + imaginary * imaginary)
        if modulus == 0.0:
            real, modulus = float64(1.0), 1.0
        factor = amplitude[j] / modulus
        row[2 * j] = factor * real
        row[2 * j + 1] = factor * imaginary


@_jit
def compare(
    field: NDArray, amplitude: NDArray, known: NDArray | None
) -> tuple[float, float, float, float, float, float, float]:
    """Sums over known pixels of 1, x, y, x x, y y, x y and (x - y)^2: x is the modulus, y the amplitude."""
    rows, columns = amplitude.shape
    count, sx, sy, sxx, syy, sxy, off = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    modulus = empty(columns, amplitude.dtype)
    for i in range(rows):
        row, wanted = field[i], amplitude[i]
        # In a loop of its own: numbers of both sizes in one would keep vectors half empty.
        for j in range(columns):
            modulus[j] = math.sqrt(row[2 * j] * row[2 * j] + row[2 * j + 1] * row[2 * j + 1])
        for j in range(columns):
            share = 1.0 if known is None or known[i, j] else 0.0
            x, y = share * float64(modulus[j]), share * float64(wanted[j])
            count += share
            sx += x
            sy += y
            sxx += x * x
            syy += y * y
            sxy += x * y
            off += (x - y) * (x - y)
    return count, sx, sy, sxx, syy, sxy, off


@_jit
def replaced_power(field: NDArray, amplitude: NDArray, known: NDArray) -> float:
    """Sum of |values|^2 that A2 would leave."""
    rows, columns = amplitude.shape
    power = 0.0
    for i in range(rows):
        row, wanted = field[i], amplitude[i]
        for j in range(columns):
            if known[i, j]:
                power += float64(wanted[j]) * float64(wanted[j])
            else:
                real, imaginary = float64(row[2 * j]), float64(row[2 * j + 1])
                power += real * real + imaginary * imaginary
    return power


@_jit
def carry(spectrum: NDArray, ways: NDArray, back: bool, result: NDArray) -> float:
    """A panel of a spectrum times a carrier, conjugate on the way back.

    Of the carrier one half is given, the same for frequencies of either sign down the columns. All are of
    shape (rows, 2, 16); spectrum and result may be the same. Returns the sum of the result's |values|^2.
    """
    rows = spectrum.shape[0]
    values, carried, way = spectrum.reshape(-1), result.reshape(-1), ways.reshape(-1)
    one = way.dtype.type(1.0)
    sign = alike(-one if back else one)
    sums, power = empty(LANES, way.dtype), 0.0
    for start in range(0, rows, SUMMED):
        total = alike(one - one)
        for i in range(start, min(start + SUMMED, rows)):
            at, k = 2 * LANES * i, 2 * LANES * min(i, rows - i)
            real, imaginary = load(values, at), load(values, at + LANES)
            c, s = load(way, k), sign * load(way, k + LANES)
            straight, across = real * c - imaginary * s, imaginary * c + real * s
            total = total + straight * straight + across * across
            store(carried, at, straight)
            store(carried, at + LANES, across)
        store(sums, 0, total)
        for j in range(LANES):
            power += float64(sums[j])
    return power


@_jit
def _steps(row: NDArray, floor: Any, half_step: Any, result: NDArray) -> None:
    """Half the step of A4 over the modulus plus its floor, twice for each sample."""
    for j in range(row.shape[0] // 2):
        real, imaginary = row[2 * j], row[2 * j + 1]
        step = half_step / (math.sqrt(real * real + imaginary * imaginary) + floor)
        result[2 * j] = step
        result[2 * j + 1] = step


@_jit
def add_smoothed(field: NDArray, first: int, floor: Any, half_step: Any, anew: bool, result: NDArray) -> None:
    """Rows of a field after A4, added to the result or, anew, in place of it; all as float views.

    `first` tells which row of the field is the result's first: neighbours beyond the result's rows are given
    where there are any, and where there are none the border is even. Floor and step are of the field's kind.
    """
    count, width = result.shape
    here, above = empty(width, result.dtype), empty(width, result.dtype)
    zero = half_step - half_step
    above[:] = zero
    if first > 0:
        _steps(field[first - 1], floor, half_step, above)
    for i in range(count):
        row, total = field[first + i], result[i]
        upper = field[max(first + i - 1, 0)]
        lower = field[min(first + i + 1, field.shape[0] - 1)]
        if anew:
            total[:] = zero
        if half_step == zero:
            for j in range(width):
                total[j] += row[j]
            continue
        _steps(row, floor, half_step, here)
        for j in range(2, width - 2):
            down, right = lower[j] - row[j], row[j + 2] - row[j]
            up, left = row[j] - upper[j], row[j] - row[j - 2]
            total[j] += row[j] + here[j] * (down + right) - above[j] * up - here[j - 2] * left
        for j in range(2):
            total[j] += row[j] + here[j] * (lower[j] - row[j]) - above[j] * (row[j] - upper[j])
            if width > 2:
                k = width - 2 + j
                total[j] += here[j] * (row[j + 2] - row[j])
                total[k] += row[k] + here[k] * (lower[k] - row[k]) - above[k] * (row[k] - upper[k])
                total[k] -= here[k - 2] * (row[k] - row[k - 2])
        here, above = above, here


@_jit
def feed_back(mean: NDArray, own: Any, now: NDArray, a: Any, before: NDArray, b: Any) -> None:
    """A5: own * mean - a * now - b * before, in place of `before`; all as float views."""
    rows, width = mean.shape
    for i in range(rows):
        for j in range(width):
            before[i, j] = own * mean[i, j] - a * now[i, j] - b * before[i, j]


drop_outdated(carry, {__name__, lanes.__name__})
