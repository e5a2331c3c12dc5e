"""Compiled loops of :mod:`wavesim.reconstruction.forward_model` and
:mod:`wavesim.reconstruction.recording.pixel_means`.

Each does some rows, or columns, for a thread. All borders are periodic, as those of spectra are.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

from typing import Any

from numpy import conj, empty, sqrt
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit

_jit = cached_njit(nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")


@_jit
def carried_columns(
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
    """Columns of a spectrum on a plane, over their number, and the same half a sample farther."""
    height, width = even.shape
    share = down.dtype.type(1.0 / height)
    line = empty(width, even.dtype)
    for k in range(height // 2 + 1):
        _line(factor, rows[k], columns, across, first, line)
        # The way is the same for a frequency and its negative.
        for side in range(1 if k == 0 or 2 * k == height else 2):
            i = height - k if side else k
            # Slices have no index below 0, which would keep loops from being vectorised.
            source, middle, edge = spectrum[i, first : first + width], even[i], odd[i]
            turned, shift = phase[i], down[i] * share
            for j in range(width):
                value = source[j] * (line[j] * shift)
                middle[j] = value
                edge[j] = value * turned


@_jit
def add_columns(
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
    """The adjoint of `carried_columns`, with half its size."""
    height, width = even.shape
    line = empty(width, even.dtype)
    for k in range(height // 2 + 1):
        _line(factor, rows[k], columns, across, first, line)
        for side in range(1 if k == 0 or 2 * k == height else 2):
            i = height - k if side else k
            result, middle, edge = total[i, first : first + width], even[i], odd[i]
            back, shift = conj(phase[i]), half * conj(down[i])
            for j in range(width):
                result[j] += (middle[j] + back * edge[j]) * (conj(line[j]) * shift)


@_jit
def _line(factor: NDArray, row: int, columns: NDArray, across: NDArray, first: int, line: NDArray) -> None:
    """A way's factors of one row, but for its own shift."""
    along, own = columns[first : first + line.size], across[first : first + line.size]
    for j in range(line.size):
        line[j] = factor[row, along[j]] * own[j]


@_jit
def halves(spectra: NDArray, phase: NDArray, even: NDArray, odd: NDArray) -> None:
    """Spectra along rows, and the same half a sample on."""
    for i in range(spectra.shape[0]):
        for j in range(spectra.shape[1]):
            value = spectra[i, j]
            even[i, j] = value
            odd[i, j] = value * phase[j]


@_jit
def add_halves(even: NDArray, odd: NDArray, phase: NDArray, half: Any, result: NDArray) -> None:
    """The adjoint of `halves`, with half its size."""
    for i in range(even.shape[0]):
        for j in range(even.shape[1]):
            result[i, j] = half * (even[i, j] + conj(phase[j]) * odd[i, j])


@_jit
def means_along_rows(
    even: NDArray, odd: NDArray, other_even: NDArray, other_odd: NDArray, taps: NDArray, result: NDArray
) -> None:
    """Of real products of two fields, from samples in the middles of pixels and at their upper edges."""
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
    """Fill two samples before and one after a line that begins at index 2."""
    for k in (0, 1):
        line[k] = line[2 + (k - 2) % count]
    line[count + 2] = line[2]


@_jit
def means_along_columns(
    even: NDArray, odd: NDArray, taps: NDArray, least: Any, result: NDArray, start: int, stop: int
) -> None:
    """Rows `start` to `stop` of the pixels' means, not below `least`."""
    count = even.shape[0]
    for i in range(start, stop):
        below, under, above = (i - 1) % count, (i - 2) % count, (i + 1) % count
        for j in range(even.shape[1]):
            total = (
                taps[0] * even[i, j]
                + taps[1] * (odd[i, j] + odd[below, j])
                + taps[2] * (even[above, j] + even[below, j])
                + taps[3] * (odd[above, j] + odd[under, j])
            )
            result[i, j] = max(total, least)


@_jit
def multiply_spread(
    even: NDArray, odd: NDArray, factor: NDArray, first: int, between: bool, taps: NDArray
) -> None:
    """Rows of a field times the adjoint of the means of each pixel's factor, such that means remain.

    `first` is the first row's number among the pixels; `between`: the rows lie at the pixels' upper edges.
    `taps` are twice those of the means.
    """
    height, width = factor.shape
    line = empty(width + 4, taps.dtype)
    for i in range(even.shape[0]):
        y = first + i
        below, above, over = (y - 1) % height, (y + 1) % height, (y + 2) % height
        for j in range(width):
            if between:
                value = taps[1] * (factor[y, j] + factor[above, j])
                value += taps[3] * (factor[below, j] + factor[over, j])
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
    """Replace intensities by the weighted relative changes of amplitude that are wanted; gives the misfit.

    That is the weighted sum of squared differences from recorded amplitudes over the scale. Without `sigma`
    (of size 0) all weights are 1. To the modelled intensity comes the background, where there is one (its
    size is not 0).
    """
    missed, weighted, behind, one = 0.0, sigma.size > 0, background.size > 0, least / least
    share = one
    for i in range(intensity.shape[0]):
        row = 0.0
        for j in range(intensity.shape[1]):
            if weighted:
                share = min(least / sigma[i, j], one)
            wanted, seen = amplitude[i, j] / scale, intensity[i, j]
            if behind:
                seen += background[i, j] / (scale * scale)
            off = share * (wanted - sqrt(seen))
            row += off * off
            ratio = sqrt((wanted * wanted + dark) / (seen + dark))
            intensity[i, j] = share * share * (ratio - one)
        missed += row
    return missed


@_jit
def change_samples(
    field: NDArray, amplitude: NDArray, sigma: NDArray, least: Any, scale: Any, background: NDArray
) -> float:
    """Replace a field by the weighted change that gives it the amplitudes wanted; gives the misfit.

    Where there is no light it takes the phase 0. The background is that of `change_pixels`.
    """
    missed, weighted, behind, one = 0.0, sigma.size > 0, background.size > 0, least / least
    share = one
    for i in range(field.shape[0]):
        row = 0.0
        for j in range(field.shape[1]):
            if weighted:
                share = min(least / sigma[i, j], one)
            wanted, value = amplitude[i, j] / scale, field[i, j]
            power = value.real * value.real + value.imag * value.imag
            if behind:
                power += background[i, j] / (scale * scale)
            seen = sqrt(power)
            off = share * (wanted - seen)
            row += off * off
            if seen > 0:
                field[i, j] = value * (share * off / seen)
            else:
                field[i, j] = share * off
        missed += row
    return missed


@_jit
def weighted_products(
    intensity: NDArray, amplitude: NDArray, sigma: NDArray, least: Any
) -> tuple[float, float]:
    """Weighted sums of modelled times recorded amplitudes, and of modelled intensities."""
    met, own, weighted, one = 0.0, 0.0, sigma.size > 0, least / least
    share = one
    for i in range(intensity.shape[0]):
        of_row, own_of_row = 0.0, 0.0
        for j in range(intensity.shape[1]):
            if weighted:
                share = min(least / sigma[i, j], one)
            pull = share * share
            of_row += pull * sqrt(intensity[i, j]) * amplitude[i, j]
            own_of_row += pull * intensity[i, j]
        met, own = met + of_row, own + own_of_row
    return met, own
