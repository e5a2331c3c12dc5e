"""Free space between the same samples of parallel planes: the angular spectrum of plane waves.

The spectrum is band-limited (Matsushima and Shimobaba 2009), also for a laterally shifted window (Matsushima
2010). Evanescent waves are omitted, so that propagation backwards is the exact adjoint of propagation
forwards.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.fft

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid
from wavesim.fields.plane_waves import (
    BandLimit,
    PlaneWaves,
    fast_count,
    fft_frequencies,
    period_counts,
    windows,
)
from wavesim.fields.sampling_checks import Pad, check_propagation, check_sample_count
from wavesim.runtime.speed import exponential_seconds, fft_seconds, pass_seconds

FACTOR_BYTES = 64
"""Bytes for each sample of the spectrum during the computation of its factor."""


class AngularSpectrum:
    """Propagation by Fourier transforms, between grids of equal shape and pitch.

    Attributes
    ----------
    counts : tuple of int
        Samples along each axis, with padding.
    """

    def __init__(
        self, source: Grid, target: Grid, wavelength_um: float, index: float, pad: Pad, band_limit: bool
    ) -> None:
        if (source.shape, source.pitch_mm) != (target.shape, target.pitch_mm):
            raise InputError("pad and band_limit: can be set only for grids of the same shape and pitch")
        self.source, self.target = source, target
        self.wavelength_um, self.index = wavelength_um, index
        self.distance_mm = target.z_mm - source.z_mm
        self.pad, self.band_limit = pad, band_limit
        if pad == "auto":
            counts = period_counts(source, target, wavelength_um, index, self.distance_mm)
            self.counts = tuple(fast_count(n) for n in counts)
        elif len(pad) == len(source.shape) and all(n >= m for n, m in zip(pad, source.shape, strict=True)):
            self.counts = pad
        else:
            raise InputError(f"pad = {pad}: must be 'auto' or at least {source.shape} samples")
        self.samples = math.prod(self.counts)

    def check(self, values: Any, coarse_output: bool) -> None:
        """Warn, or raise SamplingError, where the samples cannot represent the field."""
        far = f"{abs(self.distance_mm):.4g} mm at a pitch of {1e3 * self.source.pitch_mm:.4g} um"
        check_sample_count(self.counts, far)
        field = Field(self.source, values, self.wavelength_um, self.index)
        check_propagation(
            field,
            self.target,
            pad=self.pad,
            band_limit=self.band_limit,
            coarse_output=coarse_output,
        )

    def forward(self, values: Any) -> Any:
        return self._propagated(values, adjoint=False)

    def adjoint(self, values: Any) -> Any:
        return self._propagated(values, adjoint=True)

    def factor(self, dtype: Any = None) -> Any:
        """Return the factor of each plane wave, in FFT order."""
        pairs = windows(self.source, self.target)
        bands = [pair.pass_band(n) for pair, n in zip(pairs, self.counts, strict=True)]
        if not self.band_limit:
            bands = [BandLimit(pair.shift_mm, math.inf, math.inf) for pair in pairs]
        cycles = fft_frequencies(self.counts, self.source.pitch_mm)
        waves = PlaneWaves(cycles, self.wavelength_um, self.index)
        return waves.transfer_function(self.distance_mm, bands, dtype=dtype)

    def _propagated(self, values: Any, adjoint: bool) -> Any:
        kind = np.result_type(values.dtype, np.complex64)
        factor = self.factor(kind)
        spectrum = scipy.fft.fftn(values, self.counts, workers=-1)
        spectrum *= np.conj(factor) if adjoint else factor
        result = scipy.fft.ifftn(spectrum, workers=-1, overwrite_x=True)
        return result[tuple(slice(0, n) for n in self.source.shape)]

    @property
    def seconds(self) -> float:
        """Predicted time of one use on this machine."""
        transforms = 2.0 * fft_seconds(self.samples, self.source.is_line)
        return transforms + 4.0 * exponential_seconds(self.samples) + pass_seconds(self.samples)

    @property
    def peak_bytes(self) -> int:
        """Peak memory of one use, without its result."""
        return FACTOR_BYTES * self.samples
