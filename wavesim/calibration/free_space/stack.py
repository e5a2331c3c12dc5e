"""Amplitudes of a stack of planes, on samples as coarse as their bandwidth allows, with a margin around
them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.fields.field import Grid
from wavesim.sensor.measurement import Measurement

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]

RINGS, SIGNAL_RATIO = 50, 2.0
"""Rings of a spectrum up to half a cycle per pixel, and power over that of noise above which a ring has
signal.
"""


@dataclass(frozen=True, eq=False)
class Stack:
    """Measured planes, ready for a descent.

    Attributes
    ----------
    grid : Grid
        Grid of the field on z = 0: the frames' window and a margin.
    recorded : tuple of Measurement
        Amplitudes on that grid in units of their rms, at their distances from the object; unknown in the
        margin.
    window : (slice, slice)
        Window of the frames in the grid.
    binning : int
        Pixels along a side of a sample.
    band : ndarray of bool
        Frequencies, in FFT order, that the field may contain.
    aperture : float
        Numerical aperture of that band.
    noise : float
        Relative misfit that the frames' noise leaves.
    unit : float
        Measured amplitude that corresponds to 1.
    wavelength_um : float
        Wavelength of the light in um.
    """

    grid: Grid
    recorded: tuple[Measurement, ...]
    window: tuple[slice, slice]
    binning: int
    band: NDArray[np.bool_]
    aperture: float
    noise: float
    unit: float
    wavelength_um: float

    @property
    def distances_mm(self) -> Array:
        """Stated distances of the planes in mm."""
        return np.array([plane.distance_mm for plane in self.recorded])

    def limited(self, field: ComplexArray) -> ComplexArray:
        """Return a field within the band."""
        spectrum = scipy.fft.fft2(field, workers=-1)
        spectrum *= self.band
        return np.asarray(scipy.fft.ifft2(spectrum, workers=-1, overwrite_x=True))

    def on_pixels(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values of the grid on the frames' pixels."""
        return _upsampled(values[self.window], self.binning)


def stack_of(
    recorded: Sequence[Measurement],
    pitch_mm: float,
    wavelength_um: float,
    aperture: float | None = None,
) -> Stack:
    """Return the stack of measured amplitudes.

    Parameters
    ----------
    recorded
        Measured amplitudes of two or more planes, at distances from the object.
    pitch_mm, wavelength_um
        Pitch of the pixels in mm, and wavelength in um.
    aperture
        Numerical aperture of the light; default: the largest at which the planes' spectra exceed the noise.

    Raises
    ------
    InputError
        If there are fewer than two planes.
    """
    if len(recorded) < 2:
        raise InputError(
            "free space: must be frames of two planes or more; one plane does not determine the phase"
        )
    unit = math.sqrt(np.mean([np.mean(plane.amplitude.astype(float) ** 2) for plane in recorded]))
    spectra = [scipy.fft.dctn(plane.amplitude.astype(float) / unit, norm="ortho") for plane in recorded]
    cycles, variance = _band_and_noise(spectra)
    if aperture is not None:
        cycles = 1e3 * pitch_mm * aperture / wavelength_um
    cycles = min(cycles, 1e3 * pitch_mm / wavelength_um)
    binning = _coarsest(spectra[0].shape, cycles)
    shape = tuple(n // binning for n in spectra[0].shape)
    padded_shape, window = _padded(shape)
    grid = Grid(padded_shape, binning * pitch_mm, 0.0)
    across = [scipy.fft.fftfreq(n) for n in padded_shape]
    band = np.hypot(across[0][:, None], across[1]) <= binning * cycles
    planes = []
    for plane, spectrum in zip(recorded, spectra, strict=True):
        amplitude, sigma = np.ones(padded_shape, np.float32), np.full(padded_shape, np.inf, np.float32)
        rows, columns = (slice(0, n) for n in shape)
        amplitude[window] = np.maximum(scipy.fft.idctn(spectrum[rows, columns], norm="ortho") / binning, 0.0)
        sigma[window] = 1.0
        planes.append(replace(plane, amplitude=amplitude, sigma=sigma))
    return Stack(
        grid,
        tuple(planes),
        window,
        binning,
        band,
        cycles * wavelength_um / (1e3 * pitch_mm),
        math.sqrt(variance) / binning,
        unit,
        wavelength_um,
    )


def _band_and_noise(spectra: Sequence[Array]) -> tuple[float, float]:
    """Return the band (cycles per pixel) in which signal exceeds noise, and the noise variance of a pixel."""
    down, across = (np.arange(n) / (2.0 * n) for n in spectra[0].shape)
    cycles = np.hypot(down[:, None], across)
    power = np.mean([spectrum**2 for spectrum in spectra], axis=0)
    # Cycles per pixel above which a spectrum contains only noise.
    noise_cycles = 0.4
    variance = float(np.mean(power[cycles > noise_cycles]))
    rings = (2.0 * RINGS * cycles).astype(int).ravel()
    ring_power = np.bincount(rings, power.ravel()) / np.maximum(np.bincount(rings), 1)
    signal = np.flatnonzero(ring_power[:RINGS] > SIGNAL_RATIO * variance)
    return 0.5 * (int(signal[-1]) + 1 if len(signal) else RINGS) / RINGS, variance


def _coarsest(shape: Sequence[int], cycles: float) -> int:
    """Return the largest binning that represents the band."""

    def is_sufficient(binning: int) -> bool:
        # Smallest number of samples along a side after binning.
        least_samples = 32
        divides = all(n % binning == 0 and n // binning >= least_samples for n in shape)
        # Samples of intensities for each cycle of the band.
        oversampling = 2.2
        return divides and oversampling * cycles * binning <= 1.0

    return next((binning for binning in (4, 3, 2) if is_sufficient(binning)), 1)


def _padded(shape: Sequence[int]) -> tuple[tuple[int, int], tuple[slice, slice]]:
    """Return the shape with a margin, and the window of the frames in it."""
    padded_shape, window = [], []
    # Margin on each side over the width of the frames, for light from outside.
    margin = 1.0 / 8.0
    for n in shape:
        least = math.ceil(n * (1.0 + 2.0 * margin))
        count = scipy.fft.next_fast_len(least)
        first = (count - n) // 2
        padded_shape.append(count)
        window.append(slice(first, first + n))
    return (padded_shape[0], padded_shape[1]), (window[0], window[1])


def _upsampled(values: NDArray[Any], binning: int) -> NDArray[Any]:
    """Return values on finer samples, from their cosine series."""
    if binning == 1:
        return values.copy()
    if np.iscomplexobj(values):
        return np.asarray(_upsampled(values.real, binning) + 1j * _upsampled(values.imag, binning))
    spectrum = np.zeros([binning * n for n in values.shape], values.dtype)
    spectrum[: values.shape[0], : values.shape[1]] = scipy.fft.dctn(values, norm="ortho") * binning
    return np.asarray(scipy.fft.idctn(spectrum, norm="ortho"))
