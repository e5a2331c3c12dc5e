"""What pixels see of many changes of one field: its own samples are made once.

Products with a change take the samples of both (:mod:`wavesim.reconstruction.recording.pixel_means`), and the
way back those of the field: half of all transforms along rows are of the field that stays as it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.fields.plane_waves import TransferFunction, axial_wavenumbers, fft_frequencies
from wavesim.fields.tilted_propagator import Way
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.recording.kernel import (
    add_halves,
    halves,
    means_along_columns,
    means_along_rows,
    multiply_spread,
)
from wavesim.reconstruction.recording.pixel_means import (
    PixelMeans,
    add_rows_adjoint,
    half_sample,
    tilt_changes,
)
from wavesim.runtime.threads import for_blocks, rows_in

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]
Rows = tuple[ComplexArray, ComplexArray]


class CachedSamples:
    """A field on the pixels of a plane.

    Parameters
    ----------
    pixels
        Of the plane.
    spectrum
        Of the field in front of the way.
    way
        To the plane.
    """

    def __init__(self, pixels: PixelMeans, spectrum: ComplexArray, propagator: Way) -> None:
        self.pixels, self.propagator = pixels, propagator
        self.rows: Rows = pixels.propagate(spectrum, propagator)
        dtype, (height, width) = spectrum.dtype, spectrum.shape
        self._row_shift, self._column_shift = (half_sample(count, dtype) for count in (height, width))
        self._taps = np.array(pixels.taps, dtype.type(0).real.dtype)
        self._samples = tuple(self._sampled(part) for part in self.rows)

    def intensity(self) -> RealArray:
        """Each pixel's mean intensity, never negative."""
        return self._means(self._samples, 0.0)

    def products(self, spectrum: ComplexArray) -> RealArray:
        """Each pixel's mean of Re(conj(u) v), with the spectrum of a change v in front of the way."""
        return self.products_with(self.pixels.propagate(spectrum, self.propagator))

    def products_with(self, others: Rows) -> RealArray:
        """The same, with a change on the plane itself, as :meth:`PixelMeans.carried` gives it."""
        return self._means(tuple(self._sampled(part) for part in others), -np.inf)

    def add_adjoint(self, change: RealArray, total: ComplexArray) -> None:
        """Add the adjoint of :meth:`products` to a spectrum in front of the way."""
        if not isinstance(self.propagator, TransferFunction):
            self.pixels.add_adjoint(
                (self.rows[0].copy(), self.rows[1].copy()), change, self.propagator, total
            )
            return
        taps, half = 2 * self._taps, self._taps.dtype.type(0.5)
        spread: Rows = (np.empty_like(total), np.empty_like(total))
        for between, own, part in zip((False, True), self._samples, spread, strict=True):

            def block(
                start: int, stop: int, own: Rows = own, part: ComplexArray = part, between: bool = between
            ) -> None:
                even, odd = (samples[start:stop].copy() for samples in own)
                multiply_spread(even, odd, change, start, between, taps)
                even, odd = (scipy.fft.fft(one, axis=1, overwrite_x=True) for one in (even, odd))
                add_halves(even, odd, self._column_shift, half, part[start:stop])

            for_blocks(block, len(part), rows_in(part[0].nbytes))
        add_rows_adjoint(spread, self.propagator, self._row_shift, total)

    def _sampled(self, part: ComplexArray) -> Rows:
        """In the middles of pixels and at their upper edges, from the spectrum along each row."""
        even, odd = np.empty_like(part), np.empty_like(part)

        def block(start: int, stop: int) -> None:
            own = part[start:stop]
            both = np.empty_like(own), np.empty_like(own)
            halves(own, self._column_shift, *both)
            for one, samples in zip(both, (even, odd), strict=True):
                samples[start:stop] = scipy.fft.ifft(one, axis=1, overwrite_x=True)

        for_blocks(block, len(part), rows_in(part[0].nbytes))
        return even, odd

    def _means(self, others: tuple[Rows, ...], least: float) -> RealArray:
        along = tuple(np.empty(part.shape, self._taps.dtype) for part in self.rows)
        for own, theirs, means in zip(self._samples, others, along, strict=True):

            def block(
                start: int, stop: int, own: Rows = own, theirs: Rows = theirs, means: RealArray = means
            ) -> None:
                here = (one[start:stop] for one in (*own, *theirs))
                means_along_rows(*here, self._taps, means[start:stop])

            for_blocks(block, len(means), rows_in(self.rows[0][0].nbytes))
        result, bound = np.empty_like(along[0]), self._taps.dtype.type(least)
        for_blocks(lambda a, b: means_along_columns(*along, self._taps, bound, result, a, b), len(result), 64)
        return result


class MeasurementOperator(Protocol):
    """What a linearised model asks of it."""

    def intensities(self) -> list[RealArray]:
        """Each pixel's mean intensity, plane by plane."""

    def products(self, change: ComplexArray) -> list[RealArray]:
        """With a change of the field on the exit grid, plane by plane."""

    def adjoint(self, planes: list[RealArray]) -> ComplexArray:
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
        self.planes = [
            CachedSamples(self.pixels, self.spectrum, propagator) for propagator in model.propagators
        ]

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
            turned = tilt_changes(self.pixels, self.spectrum, plane.propagator, self._wavelength_um)
            seen.append(plane.products_with(turned[axis]))
        return seen

    def adjoint(self, planes: list[RealArray]) -> ComplexArray:
        total = np.zeros_like(self.spectrum)
        for plane, one in zip(self.planes, planes, strict=True):
            plane.add_adjoint(one.astype(self.spectrum.real.dtype), total)
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

    def adjoint(self, planes: list[RealArray]) -> ComplexArray:
        return np.concatenate(planes) * self.values


DARK = 1e-5
"""Of a plane's mean intensity: keeps roots of dark pixels smooth."""


class Linearised:
    """Residuals, their slopes by whatever changes the field behind the lens, and the way back to the object.

    Parameters
    ----------
    model
        Of the bench.
    transmission
        Of the object.
    fits_scale
        Whether recorded amplitudes are known but for a factor, which is fitted, and taken out of all slopes.

    Attributes
    ----------
    residual : ndarray, shape (planes, ny, nx)
        Recorded less modelled amplitudes.
    misfit : float
        Its length.
    scale : float
        Recorded amplitude for a unit of the model's.
    size : float
        Weighted length of the recorded amplitudes, of which residuals are fractions.
    """

    def __init__(self, model: ForwardModel, transmission: ComplexArray, fits_scale: bool) -> None:
        self.model, self.lit = model, self._behind_object(model, transmission)
        behind = model.engine.forward(self.lit)
        self._index = behind.index
        self.measurement: MeasurementOperator = (PixelMeasurement if model.rows else FreeSpaceMeasurement)(
            model, behind.values
        )
        self._root_weights = [
            np.float32(1.0) if weight is None else np.sqrt(weight) for weight in model.weights
        ]
        intensity = self.measurement.intensities()
        size = math.sqrt(
            sum(_sum((w * p.amplitude) ** 2) for w, p in zip(self._root_weights, model.recorded, strict=True))
        )
        self.size = size
        self.scale = self._fitted_scale(intensity) if fits_scale else model.scale
        real = behind.values.real.dtype.type
        power = real(self.scale**2)
        residual, seen, self._slopes = [], [], []
        for plane, weight, own in zip(model.recorded, self._root_weights, intensity, strict=True):
            whole = power * own if plane.background is None else power * own + plane.background
            root = np.sqrt(whole + real(DARK * float(whole.mean())))
            residual.append(weight * (plane.amplitude - np.sqrt(whole)) / real(size))
            seen.append(weight * power * own / root)
            self._slopes.append(weight * power / root / real(size))
        self.residual = np.stack(residual)
        self.misfit = math.sqrt(_sum(self.residual**2))
        self._along_scale = np.stack(seen) / math.sqrt(_sum(np.stack(seen) ** 2)) if fits_scale else None
        self._by_intensity = [slope / (2 * power) for slope in self._slopes]

    def without_scale(self, changes: RealArray) -> RealArray:
        """Changes of the residuals, less what another scale does too."""
        if self._along_scale is None:
            return changes
        return changes - self._along_scale * np.float32(np.vdot(self._along_scale, changes))

    def of_exit(self, change: ComplexArray) -> RealArray:
        """Change of the modelled amplitudes with one of the field on the exit grid."""
        return self.of_planes(self.measurement.products(change))

    def of_planes(self, products: Sequence[RealArray]) -> RealArray:
        """With pixels' means of Re(conj(u) v), plane by plane."""
        seen = zip(self._slopes, products, strict=True)
        return self.without_scale(np.stack([slope * own for slope, own in seen]))

    def of_plane(self, plane: int, products: RealArray) -> RealArray:
        """With those of one plane, of a change that the others do not see."""
        return self._alone(plane, self._slopes[plane] * products)

    def of_object(self, change: NDArray[Any]) -> RealArray:
        """With one of the transmission."""
        return self.of_exit(self.model.engine.forward(self._behind_object(self.model, change)).values)

    def exit_of_light(self, change: NDArray[Any]) -> ComplexArray:
        """Change of the field on the exit grid with one of the illumination, relative to it."""
        lit = self.lit.with_values((self.lit.values * change).astype(self.lit.values.dtype))
        return self.model.engine.forward(lit).values

    def of_background(self, plane: int) -> RealArray:
        """With an even background as large as the plane's mean recorded intensity."""
        mean = np.float32(np.mean(self.model.recorded[plane].amplitude ** 2))
        return self._alone(plane, self._by_intensity[plane] * mean)

    def to_object(self, left: RealArray) -> ComplexArray:
        """The adjoint of :meth:`of_object`."""
        left = self.without_scale(left)
        change = self.measurement.adjoint(
            [slope * one for slope, one in zip(self._slopes, left, strict=True)]
        )
        scene = self.model.engine.scene
        back = self.model.engine.adjoint(Field(scene.exit_grid, change, self.lit.wavelength_um, self._index))
        # Engines' adjoints are those of integrals, and not of sums.
        cells = np.float32(scene.object_grid.cell / scene.exit_grid.cell)
        return np.asarray(cells * back.values * self.model.illumination.values.conj())

    @staticmethod
    def _behind_object(model: ForwardModel, transmission: NDArray[Any]) -> Field:
        values = transmission * model.illumination.values
        return model.illumination.with_values(values.astype(model.illumination.values.dtype))

    def _alone(self, plane: int, change: RealArray) -> RealArray:
        changes = np.zeros_like(self.residual)
        changes[plane] = change
        return self.without_scale(changes)

    def _fitted_scale(self, intensity: list[RealArray]) -> float:
        met = own = 0.0
        for plane, weight, seen in zip(self.model.recorded, self._root_weights, intensity, strict=True):
            behind = 0.0 if plane.background is None else plane.background
            clean = np.sqrt(np.maximum(plane.amplitude**2 - behind, 0.0))
            met += _sum(weight**2 * clean * np.sqrt(seen))
            own += _sum(weight**2 * seen)
        return met / own if met > 0.0 < own else 1.0


def _sum(values: RealArray) -> float:
    return float(np.sum(values, dtype=float))
