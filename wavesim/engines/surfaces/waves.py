"""Plane waves of a medium on a curved surface, and the waves that a surface emits into a medium.

A field with spectrum S at the plane z = r has on a surface z = h(x, y) the values

    sum over plane waves of S exp(i kx x + i ky y + i kz (h - r)),

and a surface that carries the values v emits, by Kirchhoff's integral for waves that leave it,

    S = sum of v (1 - (kx dh/dx + ky dh/dy) / kz) exp(-i kx x - i ky y - i kz (h - r)).

Both follow from ordinary Fourier transforms on equidistant planes. Between planes each sample interpolates
the four nearest ones by the cubic B-spline, whose frequency response is divided out for every plane wave. The
remaining error falls with the fourth power of the step.

Reference: M. Unser, "Splines: a perfect fit for signal and image processing", IEEE Signal Process. Mag. 16
(6), 22 (1999).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.engines.surfaces.samples import SurfaceSamples
from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import PlaneWaves

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Medium:
    """Plane waves of a homogeneous medium on a grid, up to a largest transverse wavenumber.

    Attributes
    ----------
    grid : Grid
        Transverse samples; its z has no effect.
    wavelength_um, index : float
        Vacuum wavelength, and refractive index.
    band_per_mm : float
        Largest transverse component of the wave vector.
    """

    grid: Grid
    wavelength_um: float
    index: float
    band_per_mm: float

    @property
    def largest_kz_per_mm(self) -> float:
        """kz of the wave along the axis."""
        return 2e3 * math.pi * self.index / self.wavelength_um

    @property
    def smallest_kz_per_mm(self) -> float:
        """kz of the steepest wave in the band."""
        return math.sqrt(self.largest_kz_per_mm**2 - self.band_per_mm**2)

    def phase_across(self, step_mm: float) -> float:
        """Return the phase in radians by which the steepest and the axial wave differ after a step."""
        return (self.largest_kz_per_mm - self.smallest_kz_per_mm) * step_mm

    @cached_property
    def waves(self) -> PlaneWaves:
        """Plane waves of the grid; those outside the band are omitted."""
        return PlaneWaves.of(self.grid, self.wavelength_um, self.index, self.smallest_kz_per_mm)


def interpolation_error(phase_across: float) -> float:
    """Return the largest relative error of a plane wave between planes, for a phase across the step."""
    fraction = phase_across / (4.0 * math.pi)
    return (fraction / (1.0 - fraction)) ** 4 if fraction < 0.5 else 1.0


def planes_across(height_mm: float, step_mm: float) -> int:
    """Return the number of planes that interpolate a surface of some extent along z."""
    return 1 if height_mm == 0.0 else math.floor(height_mm / step_mm) + 4


class SurfaceWaves:
    """The plane waves of one medium at one surface.

    Parameters
    ----------
    medium
        Medium on one side of the surface.
    samples
        Samples of the surface.
    step_mm
        Distance between planes.
    """

    def __init__(self, medium: Medium, samples: SurfaceSamples, step_mm: float) -> None:
        self.medium, self.samples, self.step_mm = medium, samples, step_mm
        low, high = float(samples.z_mm[0]), float(samples.z_mm[-1])
        self.flat = high == low
        self.planes = planes_across(high - low, step_mm)
        self.first_z_mm = low if self.flat else low - step_mm
        """Position of the first plane, to which spectra refer."""
        self._carrier = 0.5 * (medium.largest_kz_per_mm + medium.smallest_kz_per_mm)

    def evaluate(self, spectrum: ComplexArray) -> ComplexArray:
        """Return the values on the surface of the waves with a spectrum at the first plane."""
        size = self.medium.grid.size
        wave = spectrum * self._unfiltered
        step = self.medium.waves.transfer_function(self.step_mm)
        values = np.zeros(len(self.samples.pixels), complex)
        for plane in range(self.planes):
            part, weight = self._samples_near(plane)
            if part.start < part.stop:
                field = scipy.fft.ifftn(wave, norm="ortho", workers=-1).reshape(size)
                values[part] += weight * field[self.samples.pixels[part]]
                del field  # frees its memory before the next transform
            wave *= step
        return values

    def collect(self, values: ComplexArray) -> ComplexArray:
        """Apply the exact adjoint of :meth:`evaluate` to values on the surface."""
        shape = self.medium.grid.shape
        step_back = self.medium.waves.transfer_function(-self.step_mm)
        spectrum = np.zeros(shape, complex)
        for plane in reversed(range(self.planes)):
            spectrum *= step_back
            part, weight = self._samples_near(plane)
            if part.start < part.stop:
                field = np.zeros(self.medium.grid.size, complex)
                field[self.samples.pixels[part]] = weight.conj() * values[part]
                spectrum += scipy.fft.fftn(field.reshape(shape), norm="ortho", workers=-1, overwrite_x=True)
                del field
        spectrum *= self._unfiltered
        return spectrum

    def radiate(self, values: ComplexArray) -> ComplexArray:
        """Return the spectrum, at the first plane, of the waves that the surface emits into the medium."""
        spectrum = self.collect(values)
        if not self.flat:
            for axis, slope in enumerate(self.samples.slopes):
                tilted = self.collect(slope * values)
                tilted *= self.medium.waves.transverse[axis]
                tilted /= self.medium.waves.kz
                spectrum -= tilted
                del tilted
        return spectrum

    def radiate_adjoint(self, spectrum: ComplexArray) -> ComplexArray:
        """Apply the exact adjoint of :meth:`radiate` to a spectrum."""
        values = self.evaluate(spectrum)
        if not self.flat:
            for axis, slope in enumerate(self.samples.slopes):
                tilted = spectrum * self.medium.waves.transverse[axis]
                tilted /= self.medium.waves.kz
                values -= slope * self.evaluate(tilted)
                del tilted
        return values

    @property
    def _unfiltered(self) -> Array:
        """Inverse of the spline's frequency response within the band, 0 outside it."""
        if self.flat:
            return self.medium.waves.propagating.astype(float)
        phase = (self.medium.waves.kz - self._carrier) * self.step_mm
        return np.asarray(self.medium.waves.propagating / np.sinc(phase / (2.0 * np.pi)) ** 4)

    def _samples_near(self, plane: int) -> tuple[slice, ComplexArray]:
        """Return the samples that a plane interpolates, and their weights."""
        z = self.samples.z_mm
        if self.flat:
            return slice(0, len(z)), np.ones(len(z), complex)
        plane_z = self.first_z_mm + plane * self.step_mm
        low, high = np.searchsorted(z, [plane_z - 2.0 * self.step_mm, plane_z + 2.0 * self.step_mm])
        part = slice(int(low), int(high))
        offset = z[part] - plane_z
        return part, _cubic_spline(offset / self.step_mm) * np.exp(1j * self._carrier * offset)


def _cubic_spline(t: Array) -> Array:
    """Return the cubic B-spline of unit spacing, which vanishes from |t| = 2 on."""
    t = np.abs(t)
    outer = np.maximum(2.0 - t, 0.0) ** 3
    return np.asarray((outer - 4.0 * np.maximum(1.0 - t, 0.0) ** 3) / 6.0)
