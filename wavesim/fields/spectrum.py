"""How far the spectrum of a field reaches; means over blocks (Welch) where it is there only band by band.

Source of the means: P. D. Welch, "The use of fast Fourier transform for the estimation of power spectra",
IEEE Trans. Audio Electroacoust. 15, 70 (1967).
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

BLOCK = 512
"""Samples along each side of a block, at most; blocks overlap by half."""
RADIAL_BINS = 8192
"""Of a spectrum, into which distances from frequency 0 are sorted first."""


class BlockSpectrum:
    """Adds up bands of rows.

    Parameters
    ----------
    pitch_mm : float
        Of the samples.
    """

    def __init__(self, pitch_mm: float) -> None:
        self._pitch_mm = pitch_mm
        self._power: dict[tuple[int, int], NDArray[np.float64]] = {}

    def add(self, band: NDArray[np.complexfloating[Any, Any]]) -> None:
        """Add all blocks of a band; light in its first and last quarter of a block counts less."""
        height, width = (min(BLOCK, count) for count in band.shape)
        taper = np.hanning(height + 1)[:-1, None] * np.hanning(width + 1)[:-1]
        power = self._power.setdefault((height, width), np.zeros((height, width)))
        for top in _starts(band.shape[0], height):
            for left in _starts(band.shape[1], width):
                block = band[top : top + height, left : left + width]
                if np.any(block):
                    spectrum = scipy.fft.fft2((taper * block).astype(np.complex64), workers=-1)
                    power += np.square(np.abs(spectrum), dtype=float) / block.size

    def share_beyond(self, frequency_per_mm: float) -> float:
        """Share of the energy beyond a frequency, in cycles per mm from 0; NaN where nothing was added."""
        beyond = total = 0.0
        for (height, width), power in self._power.items():
            along_y, along_x = (np.fft.fftfreq(count, self._pitch_mm) for count in (height, width))
            radius = np.hypot(along_y[:, None], along_x)
            beyond += float(power[radius > frequency_per_mm].sum())
            total += float(power.sum())
        return beyond / total if total > 0.0 else math.nan


def _starts(count: int, block: int) -> list[int]:
    """First samples of blocks that overlap by half and reach both ends."""
    steps = max(math.ceil(2.0 * (count - block) / block), 0)
    return [round(i * (count - block) / max(steps, 1)) for i in range(steps + 1)]


@dataclass(frozen=True)
class SpectrumSupport:
    """How far a spectrum reaches.

    Attributes
    ----------
    share_beyond : float
        Of the energy, mean taken out, beyond the frequency asked for.
    frequency_within_per_mm : float
        Radius in cycles per mm of the circle about 0 that holds the share of the energy asked for.
    """

    share_beyond: float
    frequency_within_per_mm: float


def spectrum_support(
    values: NDArray[Any], pitch_mm: float, beyond_per_mm: float, share: float = 0.999
) -> SpectrumSupport:
    """How far the spectrum of a field or an intensity reaches.

    The mean is taken out first. The light should end within the window, which is taken to repeat. Samples of
    pitch p hold 1 / (2 p) along each axis: what lies beyond folds back and is not seen, so give a field on a
    grid finer than the limit that is tested. The intensity of a field reaches twice as far as the field.

    Parameters
    ----------
    values
        Complex field or real intensity, on a line or a plane.
    pitch_mm
        Of the samples.
    beyond_per_mm
        Frequency, in cycles per mm, beyond which the share of the energy is told: 1 / (2 pixel pitch) is what
        a sensor holds, 156 per mm at 3.2 um.
    share
        Of the energy, whose circle is told.

    Raises
    ------
    InputError
        If values are not usable, or nothing but their mean is there.
    """
    validate_positive("pitch_mm", pitch_mm)
    validate_positive("beyond_per_mm", beyond_per_mm)
    if not 0.0 < share < 1.0:
        raise InputError(f"share = {share!r}: must lie between 0 and 1")
    if values.ndim not in (1, 2) or not np.all(np.isfinite(values)):
        raise InputError("spectrum_support: values must be finite, on a line or a plane")
    spectrum = scipy.fft.fftn(values - values.mean(), workers=-1, overwrite_x=True)
    cycles = [np.ravel(c) for c in fft_frequencies(values.shape, pitch_mm, np)]
    width = math.hypot(*(float(np.max(np.abs(c))) for c in cycles)) / RADIAL_BINS
    held, beyond = np.zeros(RADIAL_BINS + 1), 0.0
    for radius, power in _spectral_rows(spectrum, cycles):
        held += np.bincount((radius / width).astype(np.int64), power, RADIAL_BINS + 1)[: RADIAL_BINS + 1]
        beyond += float(power[radius > beyond_per_mm].sum())
    total = float(held.sum())
    if not total > 1e-12 * float(np.sum(np.abs(values) ** 2, dtype=float)) * values.size:
        raise InputError("spectrum_support: the values have nothing but their mean")
    before = np.cumsum(held)
    place = int(np.searchsorted(before, share * total))
    radius, power = _within_bin(spectrum, cycles, width, place)
    up_to = before[place] - held[place] + np.cumsum(power)
    within = float(radius[min(int(np.searchsorted(up_to, share * total)), len(radius) - 1)])
    return SpectrumSupport(beyond / total, within)


def _spectral_rows(spectrum: NDArray, cycles: list[Array]) -> Iterator[tuple[Array, Array]]:
    """Distance from frequency 0 and power, row by row: all of a sensor's at once would fill a memory."""
    rows = spectrum.reshape(-1, spectrum.shape[-1])
    for row, other in zip(rows, cycles[0] if spectrum.ndim == 2 else (0.0,), strict=True):
        yield np.hypot(cycles[-1], other), np.square(np.abs(row), dtype=float)


def _within_bin(spectrum: NDArray, cycles: list[Array], width: float, place: int) -> tuple[Array, Array]:
    """Distances from frequency 0 that fall into one bin, ascending, and their powers."""
    found = []
    for radius, power in _spectral_rows(spectrum, cycles):
        inside = (radius / width).astype(np.int64) == place
        found.append(np.stack([radius[inside], power[inside]]))
    radius, power = np.concatenate(found, axis=1)
    order = np.argsort(radius)
    return radius[order], power[order]
