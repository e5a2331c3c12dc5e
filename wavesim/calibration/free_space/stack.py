"""Amplitudes of a stack of planes, on samples as coarse as their band allows, with room about them."""

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

RINGS, ABOVE = 50, 2.0
"""Rings of a spectrum up to half a cycle a pixel; power over that of noise from which a ring holds signal."""

NOISE_FROM = 0.4
"""Cycles a pixel beyond which a spectrum is taken to hold noise alone."""

SPARE = 2.2
"""Samples that intensities get for each cycle of the band."""

ROOM = 1.0 / 8.0
"""Of the frames' width, on each side, for light that comes from beside them."""

LEAST_SAMPLES = 32
"""That coarser samples leave along a side."""


@dataclass(frozen=True, eq=False)
class Stack:
    """What planes recorded, ready for a descent.

    Attributes
    ----------
    grid : Grid
        Of the field on z = 0: the frames' window and room about it.
    recorded : tuple of Recorded
        On that grid, in units of the planes' rms amplitude, with their distances from the object; beside the
        frames nothing is known.
    window : (slice, slice)
        Of the frames in the grid.
    every : int
        Pixels along a side of a sample.
    band : ndarray of bool
        Frequencies, in FFT order, that the field may hold.
    aperture : float
        Numerical aperture of that band.
    noise : float
        Relative misfit that the frames' noise leaves.
    unit : float
        Recorded amplitude for 1.
    wavelength_um : float
        Of the light.
    """

    grid: Grid
    recorded: tuple[Measurement, ...]
    window: tuple[slice, slice]
    every: int
    band: NDArray[np.bool_]
    aperture: float
    noise: float
    unit: float
    wavelength_um: float

    @property
    def distances_mm(self) -> Array:
        """Of the planes, as stated."""
        return np.array([plane.distance_mm for plane in self.recorded])

    def limited(self, field: ComplexArray) -> ComplexArray:
        """A field without what the band does not hold."""
        spectrum = scipy.fft.fft2(field, workers=-1)
        spectrum *= self.band
        return np.asarray(scipy.fft.ifft2(spectrum, workers=-1, overwrite_x=True))

    def on_pixels(self, values: NDArray[Any]) -> NDArray[Any]:
        """Of values on the grid, those on the frames' pixels."""
        return _finer(values[self.window], self.every)


def stack_of(
    recorded: Sequence[Measurement],
    pitch_mm: float,
    wavelength_um: float,
    aperture: float | None = None,
) -> Stack:
    """The stack of recorded amplitudes.

    Parameters
    ----------
    recorded
        Two planes or more, at distances from the object.
    pitch_mm, wavelength_um
        Of the pixels and of the light.
    aperture
        Numerical aperture of the light; left out, that up to which the planes' spectra stand out of noise.

    Raises
    ------
    InputError
        If there are not two planes.
    """
    if len(recorded) < 2:
        raise InputError("free space: must be frames of two planes or more; one tells nothing of the phase")
    unit = math.sqrt(np.mean([np.mean(plane.amplitude.astype(float) ** 2) for plane in recorded]))
    spectra = [scipy.fft.dctn(plane.amplitude.astype(float) / unit, norm="ortho") for plane in recorded]
    cycles, variance = _band_and_noise(spectra)
    if aperture is not None:
        cycles = 1e3 * pitch_mm * aperture / wavelength_um
    cycles = min(cycles, 1e3 * pitch_mm / wavelength_um)
    every = _coarsest(spectra[0].shape, cycles)
    shape = tuple(n // every for n in spectra[0].shape)
    wide, window = _with_room(shape)
    grid = Grid(wide, every * pitch_mm, 0.0)
    across = [scipy.fft.fftfreq(n) for n in wide]
    band = np.hypot(across[0][:, None], across[1]) <= every * cycles
    planes = []
    for plane, spectrum in zip(recorded, spectra, strict=True):
        amplitude, sigma = np.ones(wide, np.float32), np.full(wide, np.inf, np.float32)
        rows, columns = (slice(0, n) for n in shape)
        amplitude[window] = np.maximum(scipy.fft.idctn(spectrum[rows, columns], norm="ortho") / every, 0.0)
        sigma[window] = 1.0
        planes.append(replace(plane, amplitude=amplitude, sigma=sigma))
    return Stack(
        grid,
        tuple(planes),
        window,
        every,
        band,
        cycles * wavelength_um / (1e3 * pitch_mm),
        math.sqrt(variance) / every,
        unit,
        wavelength_um,
    )


def _band_and_noise(spectra: Sequence[Array]) -> tuple[float, float]:
    """Cycles a pixel up to which signal stands out of noise, and the noise's variance in a pixel."""
    down, across = (np.arange(n) / (2.0 * n) for n in spectra[0].shape)
    cycles = np.hypot(down[:, None], across)
    power = np.mean([spectrum**2 for spectrum in spectra], axis=0)
    variance = float(np.mean(power[cycles > NOISE_FROM]))
    rings = (2.0 * RINGS * cycles).astype(int).ravel()
    ring_power = np.bincount(rings, power.ravel()) / np.maximum(np.bincount(rings), 1)
    signal = np.flatnonzero(ring_power[:RINGS] > ABOVE * variance)
    return 0.5 * (int(signal[-1]) + 1 if len(signal) else RINGS) / RINGS, variance


def _coarsest(shape: Sequence[int], cycles: float) -> int:
    """Pixels along a side of a sample that holds the band."""

    def holds(every: int) -> bool:
        whole = all(n % every == 0 and n // every >= LEAST_SAMPLES for n in shape)
        return whole and SPARE * cycles * every <= 1.0

    return next((every for every in (4, 3, 2) if holds(every)), 1)


def _with_room(shape: Sequence[int]) -> tuple[tuple[int, int], tuple[slice, slice]]:
    wide, window = [], []
    for n in shape:
        least = math.ceil(n * (1.0 + 2.0 * ROOM))
        count = scipy.fft.next_fast_len(least)
        first = (count - n) // 2
        wide.append(count)
        window.append(slice(first, first + n))
    return (wide[0], wide[1]), (window[0], window[1])


def _finer(values: NDArray[Any], every: int) -> NDArray[Any]:
    """Samples within samples, by the cosine series of the values."""
    if every == 1:
        return values.copy()
    if np.iscomplexobj(values):
        return np.asarray(_finer(values.real, every) + 1j * _finer(values.imag, every))
    spectrum = np.zeros([every * n for n in values.shape], values.dtype)
    spectrum[: values.shape[0], : values.shape[1]] = scipy.fft.dctn(values, norm="ortho") * every
    return np.asarray(scipy.fft.idctn(spectrum, norm="ortho"))
