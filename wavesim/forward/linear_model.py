"""Linear model of the measured amplitudes about one object on one bench, with its adjoint.

The measurement operators compute the intensity of pixels, and its change to first order: each pixel's mean
of Re(conj(u) v) for the field u on a plane and a change v of it ("product"). Residuals are weighted, and
divided by the length of the measured data. They form an array of shape (planes, ny, nx).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.fields.angular_spectrum import TransferFunction
from wavesim.fields.field import Field
from wavesim.fields.plane_waves import PlaneWaves
from wavesim.fields.propagator import PlanePropagator
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.pixel_kernel import (
    add_halves,
    halves,
    means_along_columns,
    means_along_rows,
    multiply_spread,
)
from wavesim.forward.pixel_means import (
    PixelMeans,
    add_rows_adjoint,
    half_sample,
    tilt_changes,
)
from wavesim.forward.stacked_channels import ChannelsMeasurement, ChannelsOperator
from wavesim.runtime.threads import for_blocks, rows_in
from wavesim.scene.engine import Operator
from wavesim.scene.light_errors import Orders, light_mode
from wavesim.sensor.measurement import amplitude_bias

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]
Rows = tuple[ComplexArray, ComplexArray]


class CachedSamples:
    """The samples of a field on the pixels of a plane, stored for repeated products.

    Parameters
    ----------
    pixels
        Pixels of the plane.
    spectrum
        Spectrum of the field in front of the propagator.
    propagator
        Propagator to the plane.
    """

    def __init__(self, pixels: PixelMeans, spectrum: ComplexArray, propagator: PlanePropagator) -> None:
        self.pixels, self.propagator = pixels, propagator
        self.rows: Rows = pixels.propagate(spectrum, propagator)
        dtype, (height, width) = spectrum.dtype, spectrum.shape
        self._row_shift, self._column_shift = (half_sample(count, dtype) for count in (height, width))
        self._taps = np.array(pixels.taps, dtype.type(0).real.dtype)
        self._samples = tuple(self._sampled(part) for part in self.rows)

    def intensity(self) -> RealArray:
        """Return each pixel's mean intensity, at least 0."""
        return self._means(self._samples, 0.0, self._taps, self._taps)

    def blur_change(self) -> RealArray:
        """Return half the change of the mean intensity per square pixel of the variance of the blur."""
        taps, changes = self._taps, np.array(self.pixels.tap_changes(), self._taps.dtype)
        along_rows, along_columns = (
            self._means(self._samples, -np.inf, row_taps, column_taps)
            for row_taps, column_taps in ((changes, taps), (taps, changes))
        )
        return np.asarray(0.5 * (along_rows + along_columns), taps.dtype)

    def products(self, spectrum: ComplexArray) -> RealArray:
        """Return each pixel's mean of Re(conj(u) v), for the spectrum of a change v in front of the
        propagator.
        """
        return self.products_with(self.pixels.propagate(spectrum, self.propagator))

    def products_with(self, others: Rows) -> RealArray:
        """Return the products with a change on the plane, as :meth:`PixelMeans.propagate` returns it."""
        samples = tuple(self._sampled(part) for part in others)
        return self._means(samples, -np.inf, self._taps, self._taps)

    def add_adjoint(self, change: RealArray, total: ComplexArray) -> None:
        """Add the adjoint of :meth:`products` to a spectrum in front of the propagator."""
        if not isinstance(self.propagator, TransferFunction):
            self.pixels.add_adjoint(
                (self.rows[0].copy(), self.rows[1].copy()), change, self.propagator, total
            )
            return
        taps, half = 2 * self._taps, self._taps.dtype.type(0.5)
        spread: Rows = (np.empty_like(total), np.empty_like(total))
        for between, own, spectrum in zip((False, True), self._samples, spread, strict=True):

            def block(
                start: int,
                stop: int,
                own: Rows = own,
                spectrum: ComplexArray = spectrum,
                between: bool = between,
            ) -> None:
                even, odd = (samples[start:stop].copy() for samples in own)
                multiply_spread(even, odd, change, start, between, taps)
                even, odd = (scipy.fft.fft(one, axis=1, overwrite_x=True) for one in (even, odd))
                add_halves(even, odd, self._column_shift, half, spectrum[start:stop])

            for_blocks(block, len(spectrum), rows_in(spectrum[0].nbytes))
        add_rows_adjoint(spread, self.propagator, self._row_shift, total)

    def _sampled(self, along_rows: ComplexArray) -> Rows:
        """Return samples in the middles of pixels and at their edges, from the spectrum along each row."""
        even, odd = np.empty_like(along_rows), np.empty_like(along_rows)

        def block(start: int, stop: int) -> None:
            own = along_rows[start:stop]
            both = np.empty_like(own), np.empty_like(own)
            halves(own, self._column_shift, *both)
            for spectra, samples in zip(both, (even, odd), strict=True):
                samples[start:stop] = scipy.fft.ifft(spectra, axis=1, overwrite_x=True)

        for_blocks(block, len(along_rows), rows_in(along_rows[0].nbytes))
        return even, odd

    def _means(
        self, others: tuple[Rows, ...], least: float, row_taps: RealArray, column_taps: RealArray
    ) -> RealArray:
        along = tuple(np.empty(part.shape, self._taps.dtype) for part in self.rows)
        for own, theirs, means in zip(self._samples, others, along, strict=True):

            def block(
                start: int, stop: int, own: Rows = own, theirs: Rows = theirs, means: RealArray = means
            ) -> None:
                rows = (one[start:stop] for one in (*own, *theirs))
                means_along_rows(*rows, row_taps, means[start:stop])

            for_blocks(block, len(means), rows_in(self.rows[0][0].nbytes))
        result, bound = np.empty_like(along[0]), self._taps.dtype.type(least)
        for_blocks(
            lambda a, b: means_along_columns(*along, column_taps, bound, result, a, b), len(result), 64
        )
        return result


class MeasurementOperator(Protocol):
    """Intensities of the pixels of all planes, their first-order changes, and the adjoint."""

    def intensities(self) -> list[RealArray]:
        """Return each pixel's mean intensity, plane by plane."""

    def products(self, change: ComplexArray) -> list[RealArray]:
        """Return the products with a change of the field on the exit grid, plane by plane."""

    def adjoint(self, planes: list[RealArray]) -> ComplexArray:
        """Return the adjoint of :meth:`products`: the change on the exit grid for a factor of each pixel."""


class FreeSpaceMeasurement:
    """Pixels of planes that are reached through free space from one exit field.

    Parameters
    ----------
    model
        Forward model of the bench.
    values
        Field on the exit grid.
    channel
        Index of the channel to which the field belongs.
    """

    def __init__(self, model: ChannelModel, values: ComplexArray, channel: int = 0) -> None:
        self._wavelength_um = model.channels[channel].wavelength_um
        self.pixels = model.pixels or PixelMeans(model.engine.scene.exit_grid, 0.0)
        self.spectrum: ComplexArray = scipy.fft.fft2(values, workers=-1)
        self.planes = [
            CachedSamples(self.pixels, self.spectrum, propagator)
            for propagator in model.propagators[channel]
            if propagator is not None
        ]

    def intensities(self) -> list[RealArray]:
        return [plane.intensity() for plane in self.planes]

    def products(self, change: ComplexArray) -> list[RealArray]:
        spectrum = scipy.fft.fft2(change, workers=-1)
        return [plane.products(spectrum) for plane in self.planes]

    def by_distance(self, plane: int) -> RealArray:
        """Return the products per mm of a plane's distance."""
        return self._moved(plane, 1j * PlaneWaves.of(self.pixels.grid, self._wavelength_um).kz)

    def by_shift(self, plane: int, axis: int) -> RealArray:
        """Return the products per um of a plane's shift along x (axis 0) or y (axis 1)."""
        waves = PlaneWaves.of(self.pixels.grid, self._wavelength_um)
        return self._moved(plane, 2e-3j * np.pi * waves.cycles_per_mm[1 - axis])

    def by_tilt(self, axis: int) -> list[RealArray]:
        """Return the products per degree of the sensor's tilt about x (axis 0) or y (axis 1), plane by
        plane.
        """
        changes = []
        for plane in self.planes:
            tilted = tilt_changes(self.pixels, self.spectrum, plane.propagator, self._wavelength_um)
            changes.append(plane.products_with(tilted[axis]))
        return changes

    def by_blur(self) -> list[RealArray]:
        """Return the products per square um of the variance of the blur, plane by plane."""
        per_um2 = 1e-6 / self.pixels.grid.pitch_mm**2
        return [plane.blur_change() * np.float32(per_um2) for plane in self.planes]

    def adjoint(self, planes: list[RealArray]) -> ComplexArray:
        total = np.zeros_like(self.spectrum)
        for plane, part in zip(self.planes, planes, strict=True):
            plane.add_adjoint(part.astype(self.spectrum.real.dtype), total)
        return np.asarray(scipy.fft.ifft2(total, workers=-1, overwrite_x=True))

    def _moved(self, plane: int, factor: ComplexArray) -> RealArray:
        return self.planes[plane].products(self.spectrum * factor.astype(self.spectrum.dtype))


class PixelMeasurement:
    """Pixels that are points, to which an engine propagates light directly, plane by plane.

    Parameters
    ----------
    model
        Forward model of the bench, with the `rows` of the planes.
    values
        Field on the pixels.
    """

    def __init__(self, model: ChannelModel, values: ComplexArray) -> None:
        self.rows, self.values = model.rows, values

    def intensities(self) -> list[RealArray]:
        return [np.abs(self.values[rows]) ** 2 for rows in self.rows]

    def products(self, change: ComplexArray) -> list[RealArray]:
        both = self.values.real * change.real + self.values.imag * change.imag
        return [both[rows] for rows in self.rows]

    def adjoint(self, planes: list[RealArray]) -> ComplexArray:
        return np.concatenate(planes) * self.values


class LinearModel:
    """Residuals of the amplitudes, and their Jacobian with respect to fields, object and light, with the
    adjoint.

    Parameters
    ----------
    model
        Forward model of the bench.
    transmission
        Transmission of the object.
    fits_scale
        Whether measured amplitudes are known only up to a factor. The factor is fitted, and its effect is
        removed from all changes.

    Attributes
    ----------
    engine : Operator
        Operator from the light behind the object to the exit grid, or to one for each channel.
    measurement : MeasurementOperator
        Pixels of all planes.
    residual : ndarray, shape (planes, ny, nx)
        Measured less modelled amplitudes.
    misfit : float
        Length of the residual.
    scale : float
        Measured amplitude per unit of the modelled amplitude.
    size : float
        Weighted length of the measured amplitudes, by which residuals are divided.
    """

    def __init__(self, model: ChannelModel, transmission: ComplexArray, fits_scale: bool) -> None:
        self.model, self.lit = model, self._object_field(model, transmission)
        self.engine: Operator = model.engine if len(model.channels) == 1 else ChannelsOperator(model)
        exit_field = self.engine.forward(self.lit)
        self._index = exit_field.index
        self.measurement = _measurement(model, exit_field.values)
        self._root_weights = [
            np.float32(1.0) if weight is None else np.sqrt(weight) for weight in model.weights
        ]
        intensity = self.measurement.intensities()
        size = math.sqrt(
            sum(_sum((w * p.amplitude) ** 2) for w, p in zip(self._root_weights, model.recorded, strict=True))
        )
        self.size = size
        self.scale = self._fitted_scale(intensity) if fits_scale else model.scale
        real = exit_field.values.real.dtype.type
        power = real(self.scale**2)
        residual, modelled, self._slopes = [], [], []
        # Fraction of the mean intensity added under the root: dark pixels then have finite derivatives.
        dark = 1e-5
        for plane, weight, modelled_power in zip(model.recorded, self._root_weights, intensity, strict=True):
            total = (
                power * modelled_power
                if plane.background is None
                else power * modelled_power + plane.background
            )
            root = np.sqrt(total + real(dark * float(total.mean())))
            residual.append(weight * (plane.amplitude - np.sqrt(total)) / real(size))
            modelled.append(weight * power * modelled_power / root)
            self._slopes.append(weight * power / root / real(size))
        self.residual = np.stack(residual)
        self.misfit = math.sqrt(_sum(self.residual**2))
        self._scale_direction = (
            np.stack(modelled) / math.sqrt(_sum(np.stack(modelled) ** 2)) if fits_scale else None
        )
        self._by_intensity = [slope / (2 * power) for slope in self._slopes]

    def unbiased_residual(self) -> RealArray:
        """Return the residuals less the bias that noise causes in measured amplitudes.

        Planes without standard deviations keep their residuals.
        """
        planes = []
        values = zip(self.model.recorded, self._root_weights, self.residual, strict=True)
        for index, (plane, root, residual) in enumerate(values):
            if plane.sigma is None:
                planes.append(residual)
                continue
            bias = amplitude_bias(plane, self.modelled_amplitude(index))
            planes.append((residual - root * bias / self.size).astype(residual.dtype))
        return np.stack(planes)

    def shown_fraction(self) -> RealArray:
        """Return the change of the mean measured amplitude per change of the modelled one, for each pixel.

        It is 1 in bright pixels, and nearly 0 in those whose noise hides their light
        (:func:`wavesim.sensor.measurement.amplitude_bias`) and on planes without standard deviations 1.
        """
        planes = []
        # Step in standard deviations, small beside the scale on which the bias changes.
        step_deviations = 0.05
        for index, plane in enumerate(self.model.recorded):
            modelled = self.modelled_amplitude(index)
            if plane.sigma is None:
                planes.append(np.ones_like(modelled))
                continue
            step = step_deviations * np.where(np.isfinite(plane.sigma), plane.sigma, 1.0)
            rise = amplitude_bias(plane, modelled + step) - amplitude_bias(plane, modelled)
            planes.append((1.0 + rise / step).astype(modelled.dtype))
        return np.stack(planes)

    def residual_variances(self, model_error: float) -> RealArray | None:
        """Return the variance of each residual: that of the noise, and a relative error of the amplitudes.

        It is None if a plane has no standard deviations.
        """
        variances = []
        for plane, root in zip(self.model.recorded, self._root_weights, strict=True):
            if plane.sigma is None:
                return None
            sigma = np.where(np.isfinite(plane.sigma), plane.sigma, 0.0)
            variances.append(root**2 * (sigma**2 + np.float32(model_error**2) * plane.amplitude**2))
        return np.stack(variances) / np.float32(self.size**2)

    def without_scale(self, changes: RealArray) -> RealArray:
        """Return changes of the residuals without the part that a change of the scale would cause."""
        if self._scale_direction is None:
            return changes
        return changes - self._scale_direction * np.float32(np.vdot(self._scale_direction, changes))

    def jacobian_times_exit_field(self, change: ComplexArray) -> RealArray:
        """Return the change of the modelled amplitudes for a change of the field on the exit grid."""
        return self.amplitude_changes(self.measurement.products(change))

    def amplitude_changes(self, products: Sequence[RealArray]) -> RealArray:
        """Return the change of the modelled amplitudes for pixel means of Re(conj(u) v), plane by plane."""
        pairs = zip(self._slopes, products, strict=True)
        return self.without_scale(np.stack([slope * product for slope, product in pairs]))

    def amplitude_change_on_plane(self, plane: int, products: RealArray) -> RealArray:
        """Return the change of the modelled amplitudes for pixel means of a change that affects one
        plane.
        """
        return self._change_on_plane(plane, self._slopes[plane] * products)

    def jacobian_times_object(self, change: NDArray[Any]) -> RealArray:
        """Return the change of the modelled amplitudes for a change of the transmission."""
        return self.jacobian_times_exit_field(
            self.engine.forward(self._object_field(self.model, change)).values
        )

    def exit_field_change_of_light(self, change: NDArray[Any]) -> ComplexArray:
        """Return the change of the field on the exit grid for a relative change of the illumination."""
        lit = self.lit.with_values((self.lit.values * change).astype(self.lit.values.dtype))
        return self.engine.forward(lit).values

    def jacobian_times_background(self, plane: int, orders: Orders = (0, 0)) -> RealArray:
        """Return the change of the modelled amplitudes for a background equal to the mean intensity.

        Parameters
        ----------
        plane
            Index of the plane.
        orders
            Orders of the polynomial by which the background is uneven; default: it is even.
        """
        mean = np.float32(np.mean(self.model.recorded[plane].amplitude ** 2))
        shape = light_mode(orders, self.residual.shape[1:]).astype(np.float32)
        return self._change_on_plane(plane, self._by_intensity[plane] * mean * shape)

    def jacobian_times_exposure(self, plane: int) -> RealArray:
        """Return the change of the modelled amplitudes, with the background, for a relative change of a
        plane's exposure of 1.
        """
        light = np.square(self.modelled_amplitude(plane))
        return self._change_on_plane(plane, self._by_intensity[plane] * light)

    def jacobian_times_nonlinearity(self) -> RealArray:
        """Return the change of the modelled amplitudes that has the effect of a camera's nonlinearity.

        The nonlinearity acts on the measured amplitudes. Their change by it is computed from the modelled
        ones: those measured have noise, which the residuals have, too.

        Raises
        ------
        InputError
            If the planes do not say which signals the camera recorded.
        """
        changes = []
        for index, (plane, root) in enumerate(zip(self.model.recorded, self._root_weights, strict=True)):
            if plane.fraction_per_intensity is None:
                raise InputError("nonlinearity: needs planes that state the signals that the camera recorded")
            modelled = self.modelled_amplitude(index)
            changes.append(-0.5 / self.size * root * plane.fraction_per_intensity * modelled**3)
        return self.without_scale(np.stack(changes).astype(self.residual.dtype))

    def adjoint_to_object(self, residuals: RealArray) -> ComplexArray:
        """Return the adjoint of :meth:`jacobian_times_object`."""
        residuals = self.without_scale(residuals)
        change = self.measurement.adjoint(
            [slope * part for slope, part in zip(self._slopes, residuals, strict=True)]
        )
        scene = self.engine.scene
        on_object = self.engine.adjoint(Field(scene.exit_grid, change, self.lit.wavelength_um, self._index))
        # The adjoint of an engine refers to integrals, not to sums of samples.
        cells = np.float32(scene.object_grid.cell / scene.exit_grid.cell)
        return np.asarray(cells * on_object.values * self.model.illumination.values.conj())

    @staticmethod
    def _object_field(model: ChannelModel, transmission: NDArray[Any]) -> Field:
        values = transmission * model.illumination.values
        return model.illumination.with_values(values.astype(model.illumination.values.dtype))

    def modelled_amplitude(self, plane: int) -> RealArray:
        """Return the modelled amplitudes on a plane, with its background; the measured ones where the weight
        is 0.
        """
        return np.asarray(self.model.recorded[plane].amplitude - self.unweighted(plane, self.residual[plane]))

    def unweighted(self, plane: int, changes: RealArray) -> RealArray:
        """Return residuals or changes on a plane in the unit of the amplitudes; 0 where the weight is 0."""
        root = self._root_weights[plane]
        return np.divide(changes * self.size, root, out=np.zeros(changes.shape), where=root > 0.0)

    def _change_on_plane(self, plane: int, change: RealArray) -> RealArray:
        changes = np.zeros_like(self.residual)
        changes[plane] = change
        return self.without_scale(changes)

    def _fitted_scale(self, intensity: list[RealArray]) -> float:
        cross = power = 0.0
        for plane, weight, modelled in zip(self.model.recorded, self._root_weights, intensity, strict=True):
            background = 0.0 if plane.background is None else plane.background
            clean = np.sqrt(np.maximum(plane.amplitude**2 - background, 0.0))
            cross += _sum(weight**2 * clean * np.sqrt(modelled))
            power += _sum(weight**2 * modelled)
        return cross / power if cross > 0.0 < power else 1.0


def _measurement(model: ChannelModel, values: ComplexArray) -> MeasurementOperator:
    """Return the pixels of all planes for a field on the exit grid, or for the stacked fields of channels."""
    if model.rows:
        return PixelMeasurement(model, values)
    parts = np.split(values, len(model.channels))
    measurements = [FreeSpaceMeasurement(model, part, index) for index, part in enumerate(parts)]
    return measurements[0] if len(measurements) == 1 else ChannelsMeasurement(model, measurements)


def _sum(values: RealArray) -> float:
    return float(np.sum(values, dtype=float))
