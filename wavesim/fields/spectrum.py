"""Extent of the spectrum of a field, also as a mean over blocks (Welch) where the field comes in bands of
rows.

Reference: P. D. Welch, "The use of fast Fourier transform for the estimation of power spectra", IEEE Trans.
Audio Electroacoust. 15, 70 (1967).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive
from wavesim.fields.plane_waves import fft_frequencies


class BlockSpectrum:
    """Mean power spectrum of a field that comes in bands of rows.

    Parameters
    ----------
    pitch_mm : float
        Pitch of the samples.
    """

    def __init__(self, pitch_mm: float) -> None:
        self._pitch_mm = pitch_mm
        self._power: dict[tuple[int, int], NDArray[np.float64]] = {}

    def add(self, band: NDArray[np.complexfloating[Any, Any]]) -> None:
        """Add all blocks of a band. The taper reduces the weight of its first and last quarter of a block."""
        # Most samples along each side of a block; blocks overlap by half.
        most_samples = 512
        height, width = (min(most_samples, count) for count in band.shape)
        taper = np.hanning(height + 1)[:-1, None] * np.hanning(width + 1)[:-1]
        power = self._power.setdefault((height, width), np.zeros((height, width)))
        for top in _starts(band.shape[0], height):
            for left in _starts(band.shape[1], width):
                block = band[top : top + height, left : left + width]
                if np.any(block):
                    spectrum = scipy.fft.fft2((taper * block).astype(np.complex64), workers=-1)
                    power += np.square(np.abs(spectrum), dtype=float) / block.size

    def fraction_beyond(self, frequency_per_mm: float) -> float:
        """Return the fraction of the energy beyond a radial frequency; NaN before anything was added."""
        beyond = total = 0.0
        for (height, width), power in self._power.items():
            along_y, along_x = (np.fft.fftfreq(count, self._pitch_mm) for count in (height, width))
            radius = np.hypot(along_y[:, None], along_x)
            beyond += float(power[radius > frequency_per_mm].sum())
            total += float(power.sum())
        return beyond / total if total > 0.0 else math.nan


def _starts(count: int, block: int) -> list[int]:
    """Return the first samples of blocks that overlap by half and include both ends."""
    steps = max(math.ceil(2.0 * (count - block) / block), 0)
    return [round(i * (count - block) / max(steps, 1)) for i in range(steps + 1)]


@dataclass(frozen=True)
class SpectrumSupport:
    """Extent of a spectrum.

    Attributes
    ----------
    fraction_beyond : float
        Fraction of the energy, without the mean, beyond the given frequency.
    frequency_within_per_mm : float
        Radius in cycles per mm of the circle about 0 that contains the given fraction of the energy.
    """

    fraction_beyond: float
    frequency_within_per_mm: float


def spectrum_support(
    values: NDArray[Any], pitch_mm: float, beyond_per_mm: float, fraction: float = 0.999
) -> SpectrumSupport:
    """Measure the extent of the spectrum of a field or an intensity.

    The mean is subtracted first. The light should end within the window, which counts as periodic. Samples of
    pitch p represent frequencies up to 1 / (2 p) along each axis. Higher frequencies are aliased and remain
    unnoticed, so use a grid finer than the tested limit. The spectrum of an intensity extends twice as far as
    that of the field.

    Parameters
    ----------
    values
        Complex field or real intensity, on a line or a plane.
    pitch_mm
        Pitch of the samples.
    beyond_per_mm
        Frequency, in cycles per mm, beyond which the energy is measured. The Nyquist frequency of a sensor is
        1 / (2 pixel pitch), 156 per mm at 3.2 um.
    fraction
        Fraction of the energy whose circle is measured.

    Raises
    ------
    InputError
        If an argument is not usable, or the values are constant.

    Examples
    --------
    >>> import numpy as np
    >>> from wavesim.fields import spectrum_support
    >>> x = np.arange(1000) * 1e-3
    >>> found = spectrum_support(np.cos(2 * np.pi * 40.0 * x), 1e-3, 50.0)
    >>> round(found.frequency_within_per_mm, 6), found.fraction_beyond < 1e-12
    (40.0, True)
    """
    validate_positive("pitch_mm", pitch_mm)
    validate_positive("beyond_per_mm", beyond_per_mm)
    if not 0.0 < fraction < 1.0:
        raise InputError(f"fraction = {fraction!r}: must lie between 0 and 1")
    if values.ndim not in (1, 2) or not np.all(np.isfinite(values)):
        raise InputError("spectrum_support: values must be finite, on a line or a plane")
    spectrum = scipy.fft.fftn(values - values.mean(), workers=-1, overwrite_x=True)
    cycles = [np.ravel(c) for c in fft_frequencies(values.shape, pitch_mm)]
    # Bins of a spectrum by the distance from frequency 0, for the first pass of a search.
    radial_bins = 8192
    width = math.hypot(*(float(np.max(np.abs(c))) for c in cycles)) / radial_bins
    binned, beyond = np.zeros(radial_bins + 1), 0.0
    for radius, power in _spectral_rows(spectrum, cycles):
        binned += np.bincount((radius / width).astype(np.int64), power, radial_bins + 1)[: radial_bins + 1]
        beyond += float(power[radius > beyond_per_mm].sum())
    total = float(binned.sum())
    if not total > 1e-12 * float(np.sum(np.abs(values) ** 2, dtype=float)) * values.size:
        raise InputError("spectrum_support: the values are constant, so their spectrum without the mean is 0")
    cumulative = np.cumsum(binned)
    crossing = int(np.searchsorted(cumulative, fraction * total))
    radius, power = _within_bin(spectrum, cycles, width, crossing)
    up_to = cumulative[crossing] - binned[crossing] + np.cumsum(power)
    within = float(radius[min(int(np.searchsorted(up_to, fraction * total)), len(radius) - 1)])
    return SpectrumSupport(beyond / total, within)


def _spectral_rows(spectrum: NDArray, cycles: list[Array]) -> Iterator[tuple[Array, Array]]:
    """Yield distance from frequency 0 and power row by row, to limit the memory for whole sensors."""
    rows = spectrum.reshape(-1, spectrum.shape[-1])
    for row, other in zip(rows, cycles[0] if spectrum.ndim == 2 else (0.0,), strict=True):
        yield np.hypot(cycles[-1], other), np.square(np.abs(row), dtype=float)


def _within_bin(spectrum: NDArray, cycles: list[Array], width: float, index: int) -> tuple[Array, Array]:
    """Return the distances from frequency 0 that fall into one bin, ascending, and their powers."""
    found = []
    for radius, power in _spectral_rows(spectrum, cycles):
        inside = (radius / width).astype(np.int64) == index
        found.append(np.stack([radius[inside], power[inside]]))
    radius, power = np.concatenate(found, axis=1)
    order = np.argsort(radius)
    return radius[order], power[order]
