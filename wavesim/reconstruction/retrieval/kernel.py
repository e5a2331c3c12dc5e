"""Compiled loops of Appendix A over a block of rows or columns that fits a processor's cache.

Complex blocks come as their float views, real and imaginary part in turn, where vector instructions take
neighbours whatever part they are.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

import math
from typing import Any

from numpy import empty, float64
from numpy.typing import NDArray

from lensdesign.tracing.kept_kernels import kept_njit

_FAST = {"contract", "reassoc", "nsz", "arcp"}
_jit = kept_njit(nogil=True, fastmath=_FAST, error_model="numpy")


@_jit
def replace(field: NDArray, amplitude: NDArray, known: NDArray | None) -> None:
    """A2, in place, in pixels that are known; where the field vanishes it takes the phase 0."""
    rows, columns = field.shape
    for i in range(rows):
        for j in range(columns):
            if known is not None and not known[i, j]:
                continue
            real, imaginary = float64(field[i, j].real), float64(field[i, j].imag)
            modulus = math.sqrt(real * real + imaginary * imaginary)
            if modulus == 0.0:
                real, modulus = float64(1.0), 1.0
            factor = amplitude[i, j] / modulus
            field[i, j] = complex(factor * real, factor * imaginary)


@_jit
def compare(
    field: NDArray, amplitude: NDArray, known: NDArray | None
) -> tuple[float, float, float, float, float, float, float]:
    """Sums over known pixels of 1, x, y, x x, y y, x y and (x - y)^2: x is the modulus, y the amplitude."""
    rows, columns = field.shape
    count, sx, sy, sxx, syy, sxy, off = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(rows):
        for j in range(columns):
            share = 1.0 if known is None or known[i, j] else 0.0
            real, imaginary = float64(field[i, j].real), float64(field[i, j].imag)
            x = share * math.sqrt(real * real + imaginary * imaginary)
            y = share * float64(amplitude[i, j])
            count += share
            sx += x
            sy += y
            sxx += x * x
            syy += y * y
            sxy += x * y
            off += (x - y) * (x - y)
    return count, sx, sy, sxx, syy, sxy, off


@_jit
def replaced_power(field: NDArray, amplitude: NDArray, known: NDArray | None) -> float:
    """Sum of |values|^2 that A2 would leave."""
    rows, columns = field.shape
    power = 0.0
    for i in range(rows):
        for j in range(columns):
            if known is None or known[i, j]:
                wanted = float64(amplitude[i, j])
                power += wanted * wanted
            else:
                real, imaginary = float64(field[i, j].real), float64(field[i, j].imag)
                power += real * real + imaginary * imaginary
    return power


@_jit
def carry(
    spectrum: NDArray,
    quarter: NDArray,
    fold_y: NDArray,
    fold_x: NDArray,
    back: bool,
    result: NDArray,
) -> float:
    """Spectrum times a carrier, conjugate on the way back; returns the sum of the result's |values|^2.

    Of the carrier a quarter is given, the same for frequencies of either sign; the folds tell where in it.
    All but the folds are float views.
    """
    columns = len(fold_x)
    ways = empty((quarter.shape[0], 2 * columns), quarter.dtype)
    for k in range(ways.shape[0]):
        for j in range(columns):
            ways[k, 2 * j] = quarter[k, 2 * fold_x[j]]
            turn = quarter[k, 2 * fold_x[j] + 1]
            ways[k, 2 * j + 1] = -turn if back else turn
    power, zero = 0.0, ways[0, 0] - ways[0, 0]
    for i in range(spectrum.shape[0]):
        way, values, carried, here = ways[fold_y[i]], spectrum[i], result[i], zero
        for j in range(columns):
            real = values[2 * j] * way[2 * j] - values[2 * j + 1] * way[2 * j + 1]
            imaginary = values[2 * j + 1] * way[2 * j] + values[2 * j] * way[2 * j + 1]
            here += real * real + imaginary * imaginary
            carried[2 * j] = real
            carried[2 * j + 1] = imaginary
        power += float64(here)  # of few columns: there is no vector of numbers of two sizes
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
