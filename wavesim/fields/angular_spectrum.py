"""Free space between the same samples of parallel planes: the angular spectrum of plane waves.

:class:`AngularSpectrum` pads the field, so that no light wraps around. :class:`TransferFunction` does not.

The spectrum is band-limited (Matsushima and Shimobaba 2009), also for a laterally shifted window (Matsushima
2010). Evanescent waves are omitted, so that propagation backwards is the exact adjoint of propagation
forwards.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import DTypeLike, NDArray

from lensdesign.errors import InputError
from lensdesign.raytrace.plane_plate import PlanePlate
from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import (
    BandLimit,
    Pad,
    PlaneWaves,
    fft_frequencies,
    padded_shape,
    sampling_windows,
)
from wavesim.runtime.speed import exponential_seconds, fft_seconds, pass_seconds
from wavesim.runtime.threads import for_blocks, rows_in

ComplexArray = NDArray[np.complexfloating[Any, Any]]

COLUMNS = 32
"""Least number of columns that are transformed at a time."""

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
        self,
        source: Grid,
        target: Grid,
        wavelength_um: float,
        index: float,
        pad: Pad,
        band_limit: bool,
        plate: PlanePlate | None = None,
    ) -> None:
        if (source.shape, source.pitch_mm) != (target.shape, target.pitch_mm):
            raise InputError("pad and band_limit: can be set only for grids of the same shape and pitch")
        self.source, self.target = source, target
        self.wavelength_um, self.index, self.plate = wavelength_um, index, plate
        self.distance_mm = target.z_mm - source.z_mm
        self.pad, self.band_limit = pad, band_limit
        if pad == "auto":
            counts = padded_shape(source, target, wavelength_um, index, self.distance_mm, plate)
            self.counts = tuple(scipy.fft.next_fast_len(n) for n in counts)
        elif len(pad) == len(source.shape) and all(n >= m for n, m in zip(pad, source.shape, strict=True)):
            self.counts = pad
        else:
            raise InputError(f"pad = {pad}: must be 'auto' or at least {source.shape} samples")
        self.samples = math.prod(self.counts)

    def forward(self, values: Any) -> Any:
        return self._propagated(values, adjoint=False)

    def adjoint(self, values: Any) -> Any:
        return self._propagated(values, adjoint=True)

    def from_spectrum(self, spectrum: Any) -> Any:
        """Return the field on the target from the padded spectrum of the field on the source."""
        return self._cropped(spectrum * self.factor(spectrum.dtype))

    def factor(self, dtype: Any = None) -> Any:
        """Return the factor of each plane wave, in FFT order."""
        pairs = sampling_windows(self.source, self.target)
        bands = [pair.band_limit(n) for pair, n in zip(pairs, self.counts, strict=True)]
        if not self.band_limit:
            bands = [BandLimit(pair.shift_mm, math.inf, math.inf) for pair in pairs]
        cycles = fft_frequencies(self.counts, self.source.pitch_mm)
        waves = PlaneWaves(cycles, self.wavelength_um, self.index)
        return waves.transfer_function(self.distance_mm, bands, plate=self.plate, dtype=dtype)

    def _propagated(self, values: Any, adjoint: bool) -> Any:
        kind = np.result_type(values.dtype, np.complex64)
        factor = self.factor(kind)
        spectrum = scipy.fft.fftn(values, self.counts, workers=-1)
        spectrum *= np.conj(factor) if adjoint else factor
        return self._cropped(spectrum)

    def _cropped(self, spectrum: Any) -> Any:
        """Return the samples of the grid from a padded spectrum, which is overwritten."""
        values = scipy.fft.ifftn(spectrum, workers=-1, overwrite_x=True)
        return values[tuple(slice(0, n) for n in self.source.shape)]

    @property
    def seconds(self) -> float:
        """Predicted time of one use on this machine."""
        transforms = 2.0 * fft_seconds(self.samples, self.source.is_line)
        return transforms + 4.0 * exponential_seconds(self.samples) + pass_seconds(self.samples)

    @property
    def peak_bytes(self) -> int:
        """Peak memory of one use, without its result."""
        return FACTOR_BYTES * self.samples


class TransferFunction:
    """Free space between the samples of parallel planes, without padding: for light that is measured there.

    The field counts as periodic, so that its spectrum serves many planes. The factor is equal for a
    frequency and its negative along each axis. Only a quarter of it is stored, with the factors of a lateral
    shift along each axis.

    Parameters
    ----------
    grid
        Grid of the field on either plane.
    wavelength_um
        Vacuum wavelength.
    distance_mm
        Distance from the first plane to the second.
    dtype
        Data type of the factor.
    shift_mm : (x, y)
        Offset of the second plane's samples from the first's.

    Attributes
    ----------
    factor : ndarray
        Factors for non-negative frequencies; a single 1 for the identity.
    rows, columns : ndarray of int
        Row and column of the factor for each row and column of a spectrum; a line is one row.
    down, across : ndarray
        Factors of the shift for each row and column; 1 without a shift.
    is_identity, is_shifted : bool
        Whether the transfer function changes nothing, and whether it has a lateral shift.
    """

    def __init__(
        self,
        grid: Grid,
        wavelength_um: float,
        distance_mm: float,
        dtype: DTypeLike,
        shift_mm: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        shape = (1, *grid.shape)[-2:]
        self.down, self.across = (
            np.exp(2j * np.pi / grid.pitch_mm * shift * scipy.fft.fftfreq(n)).astype(dtype)
            for n, shift in zip(shape, reversed(shift_mm), strict=True)
        )
        down, across = (np.arange(n // 2 + 1) / (n * grid.pitch_mm) for n in shape)
        all_propagate = math.hypot(down[-1], across[-1]) < 1e3 / wavelength_um
        self.is_shifted = any(shift_mm)
        self.is_identity = distance_mm == 0.0 and not self.is_shifted and all_propagate
        orders = [np.minimum(np.arange(n), n - np.arange(n)) for n in shape]
        self.rows, self.columns = (np.zeros_like(order) if self.is_identity else order for order in orders)
        self.factor: ComplexArray = np.ones((1, 1) if self.is_identity else (len(down), len(across)), dtype)
        # Rows of a stored transfer function that are computed at a time.
        factor_rows = 16
        for first in range(0, 0 if self.is_identity else len(down), factor_rows):
            rows = slice(first, first + factor_rows)
            waves = PlaneWaves([down[rows, None], across], wavelength_um)
            self.factor[rows] = waves.transfer_function(distance_mm, dtype=np.dtype(dtype))

    def times(self, spectrum: ComplexArray, *, adjoint: bool = False) -> ComplexArray:
        """Propagate a spectrum to the second plane, in place; with `adjoint`, back to the first."""
        if self.is_identity:
            return spectrum
        factor, down, across = self.factor, self.down, self.across
        if adjoint:
            factor, down, across = factor.conj(), down.conj(), across.conj()
        for row, along, values in zip(self.rows, down, np.atleast_2d(spectrum), strict=True):
            values *= along * across * factor[row, self.columns]
        return spectrum

    def forward(self, spectrum: ComplexArray) -> ComplexArray:
        """Return the field on the second plane from its spectrum on the first."""
        return np.asarray(scipy.fft.ifftn(self.times(spectrum.copy()), workers=-1, overwrite_x=True))

    def adjoint(self, values: ComplexArray) -> ComplexArray:
        """Return the spectrum on the first plane from the field on the second, whose array is overwritten."""
        return self.times(np.asarray(scipy.fft.fftn(values, workers=-1, overwrite_x=True)), adjoint=True)

    def propagate(self, field: ComplexArray, result: ComplexArray, *, adjoint: bool = False) -> ComplexArray:
        """Write the field on the second plane to `result`, which may be `field`, and return it.

        Both have the shape (rows, columns). With `adjoint` the field goes back from the second plane to the
        first. Everything along columns is done on a few columns at a time, because strided access to whole
        columns of the field would take longer than the transforms.
        """
        if self.is_identity:
            if result is not field:
                np.copyto(result, field)
            return result

        def transform_rows(start: int, stop: int) -> None:
            result[start:stop] = scipy.fft.fft(field[start:stop], axis=1)

        def propagate_columns(start: int, stop: int) -> None:
            spectrum = scipy.fft.fft(result[:, start:stop], axis=0)
            self._multiply_columns(spectrum, start, adjoint)
            result[:, start:stop] = scipy.fft.ifft(spectrum, axis=0, overwrite_x=True)

        def transform_rows_back(start: int, stop: int) -> None:
            result[start:stop] = scipy.fft.ifft(result[start:stop], axis=1)

        height, width = field.shape
        rows = rows_in(field[0].nbytes)
        for_blocks(transform_rows, height, rows)
        for_blocks(propagate_columns, width, max(COLUMNS, rows_in(field[:, 0].nbytes)))
        for_blocks(transform_rows_back, height, rows)
        return result

    def _multiply_columns(self, spectrum: ComplexArray, first: int, adjoint: bool) -> None:
        """Multiply some columns of a spectrum, from column `first` on, in place."""
        columns = slice(first, first + spectrum.shape[1])
        # The mode "clip" is the fastest one; all indices are valid.
        factor = self.factor.take(self.columns[columns], axis=1, mode="clip")
        factor = factor.conj() if adjoint else factor
        # Rows with negative frequencies follow, in falling order of their moduli.
        half = len(factor)
        spectrum[:half] *= factor
        spectrum[half:] *= factor[1 : len(spectrum) - half + 1][::-1]
        if self.is_shifted:
            shift = self.down[:, None] * self.across[columns]
            spectrum *= shift.conj() if adjoint else shift
