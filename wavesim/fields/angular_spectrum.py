"""Free space between the same samples of parallel planes: the angular spectrum of plane waves.

Band-limited (Matsushima and Shimobaba 2009), also onto a window beside the input's (Matsushima 2010). Waves
that decay along z are left out, so that carrying a field back is the exact adjoint of carrying it forward.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid
from wavesim.fields.guards import Pad, check_propagation, check_sample_count
from wavesim.fields.plane_waves import (
    BandLimit,
    fast_count,
    fft_frequencies,
    period_counts,
    transfer,
    windows,
)
from wavesim.runtime.arrays import array_module, fftn, ifftn
from wavesim.runtime.speed import exponential_seconds, fft_seconds, pass_seconds

FACTOR_BYTES = 64
"""For each sample of the spectrum, while its factor is made."""


class AngularSpectrum:
    """A passage by Fourier transforms, between grids of equal shape and pitch.

    Attributes
    ----------
    counts : tuple of int
        Samples along each axis, with padding.
    """

    def __init__(
        self, source: Grid, target: Grid, wavelength_um: float, index: float, pad: Pad, band_limit: bool
    ) -> None:
        if (source.shape, source.pitch_mm) != (target.shape, target.pitch_mm):
            raise InputError("padding and band limit are chosen for grids of the same shape and pitch alone")
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
            raise InputError(f"pad = {pad}: must be 'auto', or at least {source.shape} samples")
        self.samples = math.prod(self.counts)

    def check(self, values: Any, coarse_output: bool) -> None:
        """Warn, or refuse, where samples cannot hold the field."""
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
        return self._carried(values, back=False)

    def adjoint(self, values: Any) -> Any:
        return self._carried(values, back=True)

    def factor(self, dtype: Any = None, xp: Any = np) -> Any:
        """Of each plane wave, in FFT order."""
        pairs = windows(self.source, self.target)
        bands = [pair.pass_band(n) for pair, n in zip(pairs, self.counts, strict=True)]
        if not self.band_limit:
            bands = [BandLimit(pair.shift_mm, math.inf, math.inf) for pair in pairs]
        cycles = fft_frequencies(self.counts, self.source.pitch_mm, xp)
        return transfer(cycles, self.wavelength_um, self.index, self.distance_mm, bands, dtype=dtype, xp=xp)

    def _carried(self, values: Any, back: bool) -> Any:
        xp = array_module(values)
        kind = xp.result_type(values.dtype, xp.complex64)
        factor = self.factor(kind, xp)
        spectrum = fftn(values, self.counts)
        spectrum *= xp.conj(factor) if back else factor
        carried = ifftn(spectrum, overwrite=True)
        return carried[tuple(slice(0, n) for n in self.source.shape)]

    @property
    def seconds(self) -> float:
        """What one use takes on this machine."""
        transforms = 2.0 * fft_seconds(self.samples, self.source.is_line)
        return transforms + 4.0 * exponential_seconds(self.samples) + pass_seconds(self.samples)

    @property
    def peak_bytes(self) -> int:
        """Most memory of one use, its result not counted."""
        return FACTOR_BYTES * self.samples
