"""Compiled loops of Appendix A over a block of rows, or a panel of columns, that fits a processor's cache.

Complex rows are passed as float views with alternating real and imaginary parts, so that vector instructions
process neighbouring values of either part.
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

_jit = cached_njit(nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")

SUMMED_ROWS = 64
"""Rows of a panel that are added in the panel's own precision."""

LEAST_SQUARE = 1e-30
"""Smallest squared modulus with full relative precision in single precision."""


@_jit
def replace(field: NDArray, amplitude: NDArray, known: NDArray | None) -> None:
    """Do A2 in place in valid pixels; where the field vanishes it gets the phase 0.

    Rows in which squares might underflow are processed in double precision.
    """
    rows, columns = amplitude.shape
    for i in range(rows):
        row, target = field[i], amplitude[i]
        one = target.dtype.type(1.0)
        small, least, vanishing = one - one, target.dtype.type(LEAST_SQUARE), one - one
        for j in range(columns):
            square = row[2 * j] * row[2 * j] + row[2 * j + 1] * row[2 * j + 1]
            vanishing += one if square < least else small
        if vanishing > small:
            _replace_exactly(row, target, None if known is None else known[i])
            continue
        for j in range(columns):
            real, imaginary = row[2 * j], row[2 * j + 1]
            factor = target[j] / math.sqrt(real * real + imaginary * imaginary)
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
    """Return sums over valid pixels of 1, x, y, x x, y y, x y and (x - y)^2: x is the modulus, y the
    amplitude.
    """
    rows, columns = amplitude.shape
    count, sx, sy, sxx, syy, sxy, squared_difference = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    modulus = empty(columns, amplitude.dtype)
    for i in range(rows):
        row, target = field[i], amplitude[i]
        # A separate loop for single precision keeps vector registers full.
        for j in range(columns):
            modulus[j] = math.sqrt(row[2 * j] * row[2 * j] + row[2 * j + 1] * row[2 * j + 1])
        for j in range(columns):
            weight = 1.0 if known is None or known[i, j] else 0.0
            x, y = weight * float64(modulus[j]), weight * float64(target[j])
            count += weight
            sx += x
            sy += y
            sxx += x * x
            syy += y * y
            sxy += x * y
            squared_difference += (x - y) * (x - y)
    return count, sx, sy, sxx, syy, sxy, squared_difference


@_jit
def replaced_power(field: NDArray, amplitude: NDArray, known: NDArray) -> float:
    """Return the sum of |values|^2 after A2."""
    rows, columns = amplitude.shape
    power = 0.0
    for i in range(rows):
        row, target = field[i], amplitude[i]
        for j in range(columns):
            if known[i, j]:
                power += float64(target[j]) * float64(target[j])
            else:
                real, imaginary = float64(row[2 * j]), float64(row[2 * j + 1])
                power += real * real + imaginary * imaginary
    return power


@_jit
def apply_transfer(spectrum: NDArray, carrier: NDArray, conjugate: bool, result: NDArray) -> float:
    """Multiply a panel of a spectrum by a transfer function or its conjugate; return the sum of |values|^2.

    Only one half of the transfer function is stored, because it is the same for frequencies of either sign
    down the columns. All arrays have the shape (rows, 2, 16); spectrum and result may be the same.
    """
    rows = spectrum.shape[0]
    values, output, transfer = spectrum.reshape(-1), result.reshape(-1), carrier.reshape(-1)
    one = transfer.dtype.type(1.0)
    sign = alike(-one if conjugate else one)
    sums, power = empty(LANES, transfer.dtype), 0.0
    for start in range(0, rows, SUMMED_ROWS):
        total = alike(one - one)
        for i in range(start, min(start + SUMMED_ROWS, rows)):
            at, k = 2 * LANES * i, 2 * LANES * min(i, rows - i)
            real, imaginary = load(values, at), load(values, at + LANES)
            c, s = load(transfer, k), sign * load(transfer, k + LANES)
            product_real, product_imaginary = real * c - imaginary * s, imaginary * c + real * s
            total = total + product_real * product_real + product_imaginary * product_imaginary
            store(output, at, product_real)
            store(output, at + LANES, product_imaginary)
        store(sums, 0, total)
        for j in range(LANES):
            power += float64(sums[j])
    return power


@_jit
def _steps(row: NDArray, floor: Any, half_step: Any, result: NDArray) -> None:
    """Write half the step of A4 over the modulus plus a floor, twice for each sample."""
    for j in range(row.shape[0] // 2):
        real, imaginary = row[2 * j], row[2 * j + 1]
        step = half_step / (math.sqrt(real * real + imaginary * imaginary) + floor)
        result[2 * j] = step
        result[2 * j + 1] = step


@_jit
def add_smoothed(
    field: NDArray, first: int, floor: Any, half_step: Any, overwrite: bool, result: NDArray
) -> None:
    """Add rows of a field after A4 to the result, or overwrite it; all arrays are float views.

    `first` is the row of the field that is the result's first. The field contains neighbouring rows beyond
    those of the result where there are any; elsewhere the border is constant.
    """
    count, width = result.shape
    steps, upper_steps = empty(width, result.dtype), empty(width, result.dtype)
    zero = half_step - half_step
    upper_steps[:] = zero
    if first > 0:
        _steps(field[first - 1], floor, half_step, upper_steps)
    for i in range(count):
        row, total = field[first + i], result[i]
        upper = field[max(first + i - 1, 0)]
        lower = field[min(first + i + 1, field.shape[0] - 1)]
        if overwrite:
            total[:] = zero
        if half_step == zero:
            for j in range(width):
                total[j] += row[j]
            continue
        _steps(row, floor, half_step, steps)
        for j in range(2, width - 2):
            down, right = lower[j] - row[j], row[j + 2] - row[j]
            up, left = row[j] - upper[j], row[j] - row[j - 2]
            total[j] += row[j] + steps[j] * (down + right) - upper_steps[j] * up - steps[j - 2] * left
        for j in range(2):
            total[j] += row[j] + steps[j] * (lower[j] - row[j]) - upper_steps[j] * (row[j] - upper[j])
            if width > 2:
                k = width - 2 + j
                total[j] += steps[j] * (row[j + 2] - row[j])
                total[k] += row[k] + steps[k] * (lower[k] - row[k]) - upper_steps[k] * (row[k] - upper[k])
                total[k] -= steps[k - 2] * (row[k] - row[k - 2])
        steps, upper_steps = upper_steps, steps


@_jit
def feed_back(mean: NDArray, factor: Any, now: NDArray, a: Any, previous: NDArray, b: Any) -> None:
    """Write A5, factor * mean - a * now - b * previous, to `previous`; all arrays are float views."""
    rows, width = mean.shape
    for i in range(rows):
        for j in range(width):
            previous[i, j] = factor * mean[i, j] - a * now[i, j] - b * previous[i, j]


drop_outdated(apply_transfer, {__name__, lanes.__name__})
