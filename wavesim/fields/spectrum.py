"""The power spectrum of a field that is there only band by band: means over blocks (Welch).

Source: P. D. Welch, "The use of fast Fourier transform for the estimation of power spectra", IEEE Trans.
Audio Electroacoust. 15, 70 (1967).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

BLOCK = 512
"""Samples along each side of a block, at most; blocks overlap by half."""


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
