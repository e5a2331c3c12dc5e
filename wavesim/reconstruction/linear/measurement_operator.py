"""How the pixels of all planes see the field behind the lens: as far as it is linear, and back.

Products are each pixel's mean of Re(conj(u) v), of the field u there and a change v of it.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavesim.fields.plane_waves import axial_wavenumbers, fft_frequencies
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.linear.cached_samples import CachedSamples
from wavesim.reconstruction.recording.pixel_means import PixelMeans, tilt_changes

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]


class MeasurementOperator(Protocol):
    """What a linearised model asks of it."""

    def intensities(self) -> list[RealArray]:
        """Each pixel's mean intensity, plane by plane."""

    def products(self, change: ComplexArray) -> list[RealArray]:
        """With a change of the field on the exit grid, plane by plane."""

    def back(self, planes: list[RealArray]) -> ComplexArray:
        """On the exit grid, what pixels' shares of the field make together: the adjoint of the products."""


class FreeSpaceMeasurement:
    """All pixels, reached through free space from one field.

    Parameters
    ----------
    model
        Of the bench.
    values
        Of the field on the exit grid.
    """

    def __init__(self, model: ForwardModel, values: ComplexArray) -> None:
        self.model, self._wavelength_um = model, model.illumination.wavelength_um
        self.pixels = model.pixels or PixelMeans(model.engine.scene.exit_grid, 0.0)
        self.spectrum: ComplexArray = scipy.fft.fft2(values, workers=-1)
        self.planes = [CachedSamples(self.pixels, self.spectrum, way) for way in model.ways]

    def intensities(self) -> list[RealArray]:
        return [plane.intensity() for plane in self.planes]

    def products(self, change: ComplexArray) -> list[RealArray]:
        spectrum = scipy.fft.fft2(change, workers=-1)
        return [plane.products(spectrum) for plane in self.planes]

    def by_distance(self, plane: int) -> RealArray:
        """Products with a mm of a plane's distance."""
        grid = self.pixels.grid
        kz, _ = axial_wavenumbers(fft_frequencies(grid.shape, grid.pitch_mm), self._wavelength_um, 1.0)
        return self._moved(plane, 1j * kz)

    def by_shift(self, plane: int, axis: int) -> RealArray:
        """With a um of a plane's shift along x (axis 0) or y (1)."""
        grid = self.pixels.grid
        return self._moved(plane, 2e-3j * np.pi * fft_frequencies(grid.shape, grid.pitch_mm)[1 - axis])

    def by_tilt(self, axis: int) -> list[RealArray]:
        """With a degree of the sensor's tilt about x (axis 0) or y (1), plane by plane."""
        seen = []
        for plane in self.planes:
            turned = tilt_changes(self.pixels, self.spectrum, plane.way, self._wavelength_um)
            seen.append(plane.products_with(turned[axis]))
        return seen

    def back(self, planes: list[RealArray]) -> ComplexArray:
        total = np.zeros_like(self.spectrum)
        for plane, one in zip(self.planes, planes, strict=True):
            plane.add_back(one.astype(self.spectrum.real.dtype), total)
        return np.asarray(scipy.fft.ifft2(total, workers=-1, overwrite_x=True))

    def _moved(self, plane: int, factor: ComplexArray) -> RealArray:
        return self.planes[plane].products(self.spectrum * factor.astype(self.spectrum.dtype))


class PixelMeasurement:
    """Pixels that are points, to which an engine carries light straight, plane after plane.

    Parameters
    ----------
    model
        Of the bench, whose `rows` are those of the planes.
    values
        Of the field on them.
    """

    def __init__(self, model: ForwardModel, values: ComplexArray) -> None:
        self.rows, self.values = model.rows, values

    def intensities(self) -> list[RealArray]:
        return [np.abs(self.values[rows]) ** 2 for rows in self.rows]

    def products(self, change: ComplexArray) -> list[RealArray]:
        both = self.values.real * change.real + self.values.imag * change.imag
        return [both[rows] for rows in self.rows]

    def back(self, planes: list[RealArray]) -> ComplexArray:
        return np.concatenate(planes) * self.values
