"""Compiled loops of :mod:`wavesim.forward.channel_model` and
:mod:`wavesim.forward.pixel_means`.

Each loop processes some rows or columns on one thread. All borders are periodic, as those of spectra are.
"Middle" samples lie in the centers of pixels, "edge" samples half a pixel farther along x, in
their row.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

from typing import Any

from numpy import conj, empty, sqrt
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit

_jit = cached_njit(nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")


@_jit
def propagate_columns(
    spectrum: NDArray,
    first: int,
    factor: NDArray,
    rows: NDArray,
    columns: NDArray,
    down: NDArray,
    across: NDArray,
    phase: NDArray,
    even: NDArray,
    odd: NDArray,
) -> None:
    """Propagate columns of a spectrum to a plane, and to points half a sample farther down, over their
    count.
    """
    height, width = even.shape
    fraction = down.dtype.type(1.0 / height)
    line = empty(width, even.dtype)
    for k in range(height // 2 + 1):
        _transfer_row(factor, rows[k], columns, across, first, line)
        # The transfer function is the same for a frequency and its negative.
        for side in range(1 if k == 0 or 2 * k == height else 2):
            i = height - k if side else k
            # Slices avoid negative indices, which would prevent vectorized loops.
            source, middle, edge = spectrum[i, first : first + width], even[i], odd[i]
            half_shift, shift = phase[i], down[i] * fraction
            for j in range(width):
                value = source[j] * (line[j] * shift)
                middle[j] = value
                edge[j] = value * half_shift


@_jit
def add_columns_adjoint(
    even: NDArray,
    odd: NDArray,
    first: int,
    factor: NDArray,
    rows: NDArray,
    columns: NDArray,
    down: NDArray,
    across: NDArray,
    phase: NDArray,
    half: Any,
    total: NDArray,
) -> None:
    """Add half of the adjoint of `propagate_columns` to a spectrum."""
    height, width = even.shape
    line = empty(width, even.dtype)
    for k in range(height // 2 + 1):
        _transfer_row(factor, rows[k], columns, across, first, line)
        for side in range(1 if k == 0 or 2 * k == height else 2):
            i = height - k if side else k
            result, middle, edge = total[i, first : first + width], even[i], odd[i]
            conjugate_shift, shift = conj(phase[i]), half * conj(down[i])
            for j in range(width):
                result[j] += (middle[j] + conjugate_shift * edge[j]) * (conj(line[j]) * shift)


@_jit
def _transfer_row(
    factor: NDArray, row: int, columns: NDArray, across: NDArray, first: int, line: NDArray
) -> None:
    """Write one row of a transfer function without the shift along y."""
    along, local_across = columns[first : first + line.size], across[first : first + line.size]
    for j in range(line.size):
        line[j] = factor[row, along[j]] * local_across[j]


@_jit
def halves(spectra: NDArray, phase: NDArray, even: NDArray, odd: NDArray) -> None:
    """Copy spectra of rows, and write the same rows shifted by half a sample."""
    for i in range(spectra.shape[0]):
        for j in range(spectra.shape[1]):
            value = spectra[i, j]
            even[i, j] = value
            odd[i, j] = value * phase[j]


@_jit
def add_halves(even: NDArray, odd: NDArray, phase: NDArray, half: Any, result: NDArray) -> None:
    """Write the adjoint of `halves`, times the factor `half`."""
    for i in range(even.shape[0]):
        for j in range(even.shape[1]):
            result[i, j] = half * (even[i, j] + conj(phase[j]) * odd[i, j])


@_jit
def means_along_rows(
    even: NDArray, odd: NDArray, other_even: NDArray, other_odd: NDArray, taps: NDArray, result: NDArray
) -> None:
    """Write weighted means along rows of the real products of two fields.

    The samples lie in the middles of pixels (even) and between them (odd).
    """
    count = even.shape[1]
    middle, edge = empty(count + 3, taps.dtype), empty(count + 3, taps.dtype)
    for i in range(even.shape[0]):
        for j in range(count):
            value, other = even[i, j], other_even[i, j]
            middle[j + 2] = value.real * other.real + value.imag * other.imag
            value, other = odd[i, j], other_odd[i, j]
            edge[j + 2] = value.real * other.real + value.imag * other.imag
        _wrap(middle, count)
        _wrap(edge, count)
        for j in range(count):
            result[i, j] = (
                taps[0] * middle[j + 2]
                + taps[1] * (edge[j + 2] + edge[j + 1])
                + taps[2] * (middle[j + 3] + middle[j + 1])
                + taps[3] * (edge[j + 3] + edge[j])
            )


@_jit
def _wrap(line: NDArray, count: int) -> None:
    """Fill two samples before and one after a periodic line that begins at index 2."""
    for k in (0, 1):
        line[k] = line[2 + (k - 2) % count]
    line[count + 2] = line[2]


@_jit
def means_along_columns(
    even: NDArray, odd: NDArray, taps: NDArray, least: Any, result: NDArray, start: int, stop: int
) -> None:
    """Write rows `start` to `stop` of the means over pixels, which are at least `least`."""
    count = even.shape[0]
    for i in range(start, stop):
        below, second_below, above = (i - 1) % count, (i - 2) % count, (i + 1) % count
        for j in range(even.shape[1]):
            total = (
                taps[0] * even[i, j]
                + taps[1] * (odd[i, j] + odd[below, j])
                + taps[2] * (even[above, j] + even[below, j])
                + taps[3] * (odd[above, j] + odd[second_below, j])
            )
            result[i, j] = max(total, least)


@_jit
def multiply_spread(
    even: NDArray, odd: NDArray, factor: NDArray, first: int, between: bool, taps: NDArray
) -> None:
    """Multiply rows of a field by the adjoint of the pixel means of a factor per pixel.

    `first` is the index of the first row among the pixels. `between` states that the rows lie at the upper
    edges of pixels. `taps` are twice those of the means.
    """
    height, width = factor.shape
    line = empty(width + 4, taps.dtype)
    for i in range(even.shape[0]):
        y = first + i
        below, above, second_above = (y - 1) % height, (y + 1) % height, (y + 2) % height
        for j in range(width):
            if between:
                value = taps[1] * (factor[y, j] + factor[above, j])
                value += taps[3] * (factor[below, j] + factor[second_above, j])
            else:
                value = taps[0] * factor[y, j] + taps[2] * (factor[below, j] + factor[above, j])
            line[j + 1] = value
        line[0] = line[width]
        for k in (1, 2):
            line[width + k] = line[1 + (k - 1) % width]
        for j in range(width):
            even[i, j] *= taps[0] * line[j + 1] + taps[2] * (line[j] + line[j + 2])
            odd[i, j] *= taps[1] * (line[j + 1] + line[j + 2]) + taps[3] * (line[j] + line[j + 3])


@_jit
def change_pixels(
    intensity: NDArray,
    amplitude: NDArray,
    sigma: NDArray,
    least: Any,
    scale: Any,
    dark: Any,
    background: NDArray,
) -> float:
    """Replace mean intensities by the weighted relative change of amplitude; return the squared misfit.

    The misfit is the weighted sum of squared differences from the measured amplitudes, divided by the scale.
    Without `sigma` (size 0) all weights are 1. The background, if any (size not 0), is added to the modelled
    intensity.
    """
    squared_misfit, has_sigma, has_background, one = 0.0, sigma.size > 0, background.size > 0, least / least
    fraction = one
    for i in range(intensity.shape[0]):
        row = 0.0
        for j in range(intensity.shape[1]):
            if has_sigma:
                fraction = min(least / sigma[i, j], one)
            target, modelled = amplitude[i, j] / scale, intensity[i, j]
            if has_background:
                modelled += background[i, j] / (scale * scale)
            difference = fraction * (target - sqrt(modelled))
            row += difference * difference
            ratio = sqrt((target * target + dark) / (modelled + dark))
            intensity[i, j] = fraction * fraction * (ratio - one)
        squared_misfit += row
    return squared_misfit


@_jit
def change_samples(
    field: NDArray, amplitude: NDArray, sigma: NDArray, least: Any, scale: Any, background: NDArray
) -> float:
    """Replace a field by the weighted change that gives it the measured amplitudes; return the squared
    misfit.

    A sample without light gets the phase 0. The background is treated as in `change_pixels`.
    """
    squared_misfit, has_sigma, has_background, one = 0.0, sigma.size > 0, background.size > 0, least / least
    fraction = one
    for i in range(field.shape[0]):
        row = 0.0
        for j in range(field.shape[1]):
            if has_sigma:
                fraction = min(least / sigma[i, j], one)
            target, value = amplitude[i, j] / scale, field[i, j]
            power = value.real * value.real + value.imag * value.imag
            if has_background:
                power += background[i, j] / (scale * scale)
            modelled = sqrt(power)
            difference = fraction * (target - modelled)
            row += difference * difference
            if modelled > 0:
                field[i, j] = value * (fraction * difference / modelled)
            else:
                field[i, j] = fraction * difference
        squared_misfit += row
    return squared_misfit


@_jit
def weighted_products(
    intensity: NDArray, amplitude: NDArray, sigma: NDArray, least: Any
) -> tuple[float, float]:
    """Return weighted sums of modelled times measured amplitudes, and of modelled intensities."""
    cross, power, has_sigma, one = 0.0, 0.0, sigma.size > 0, least / least
    fraction = one
    for i in range(intensity.shape[0]):
        cross_of_row, power_of_row = 0.0, 0.0
        for j in range(intensity.shape[1]):
            if has_sigma:
                fraction = min(least / sigma[i, j], one)
            squared_weight = fraction * fraction
            cross_of_row += squared_weight * sqrt(intensity[i, j]) * amplitude[i, j]
            power_of_row += squared_weight * intensity[i, j]
        cross, power = cross + cross_of_row, power + power_of_row
    return cross, power
