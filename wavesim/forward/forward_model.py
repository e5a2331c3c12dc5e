"""Forward model: from an object's transmission to the amplitudes on the sensor planes, and the adjoint step.

Amplitudes with standard deviations s have the weight (s of a plane's brightest pixel / s)^2, at most 1
(:func:`wavesim.sensor.measurement.weights_of`). A pixel with infinite s has no influence.

A pixel measures the mean of `|u|^2` over its square. The step follows the gradient of the misfit: each
pixel's ratio of measured to modelled amplitude is spread over its square. Planes are processed one after the
other, so that only one plane's fields are in memory.

Light of an extended or polychromatic source consists of a few modes. Each has its own direction and
wavelength, and they do not interfere. A pixel measures the sum of their intensities, and each mode is changed
by the ratio of the measured amplitude to that of the sum.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.fields.field import Field
from wavesim.fields.propagator import PlanePropagator, propagator_to
from wavesim.forward.exit_field import (
    ALL_ROWS,
    ROWS,
    ExitField,
    PlaneRecord,
    add_fraction,
    sum_of_parts,
)
from wavesim.forward.pixel_means import LinePixelMeans, PixelMeans
from wavesim.runtime.scratch import Scratch
from wavesim.runtime.threads import for_blocks
from wavesim.scene.engine import Engine, Operator, Tiled
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement, full_weight_sigma, weights_of

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]


class Step(NamedTuple):
    """A step of the descent.

    Attributes
    ----------
    change : ndarray
        Change of the transmission that reduces the misfit.
    misfit : float
        Relative misfit before the step.
    scale : float
        Scale for the next step: the given one, or the one that was fitted.
    """

    change: NDArray[Any]
    misfit: float
    scale: float


class ForwardModel:
    """Engine, propagators to each plane, and the measured data.

    Parameters
    ----------
    engine, illumination, recorded
        See :func:`wavesim.reconstruct`.
    scale
        Measured amplitude per unit of the modelled amplitude; None means 1. It is used where a step states
        no scale of its own.
    fill_factor
        Linear fill factor of a pixel (side of its photosensitive square over the pitch); 0 means a point.
    scratch
        Storage of arrays that persist; default: memory.
    modes
        Modes of the light of an extended or polychromatic source; default: a single mode. Other wavelengths
        than the illumination's have their own engines (:meth:`wavesim.scene.engine.Engine.at_wavelength`).
    rows
        For each plane, the rows of the exit grid in which the engine gives the field on its pixels. The
        pixels are then points, and planes lie at distance 0. Default: planes are reached through free space
        from the whole grid.
    """

    def __init__(
        self,
        engine: Operator,
        illumination: Field,
        recorded: Sequence[Measurement],
        scale: float | None,
        fill_factor: float = 0.0,
        scratch: Scratch | None = None,
        modes: Sequence[SourceMode] = (),
        rows: Sequence[slice] = (),
    ) -> None:
        self.engine, self.illumination, self.recorded, self.rows = engine, illumination, recorded, rows
        self.fill_factor, self.modes = fill_factor, modes if len(modes) > 1 else ()
        self.blur_mm = recorded[0].blur_mm
        if any(plane.blur_mm != self.blur_mm for plane in recorded):
            raise InputError("recorded: blur_mm differs between planes: must be equal on all planes")
        power = np.abs(illumination.values)
        power *= power
        self.peak_power = float(power.max())
        self.lit: NDArray[np.bool_] = power > 1e-6 * self.peak_power
        self.dtype, self.real = illumination.values.dtype, power.dtype
        del power
        grid = engine.scene.exit_grid
        blur_pixels = self.blur_mm / grid.pitch_mm
        needs_means = fill_factor > 0.0 or blur_pixels > 0.0 or self.modes
        means = PixelMeans if len(grid.shape) == 2 else LinePixelMeans
        self.pixels = means(grid, fill_factor, blur_pixels) if needs_means else None
        self.propagators = self._propagators(illumination.wavelength_um)
        self._propagators_of = {illumination.wavelength_um: self.propagators}
        self._engines: dict[tuple[float, int | None], Operator] = {(illumination.wavelength_um, None): engine}
        for mode in self.modes:
            whole = mode.wavelength_um, None
            if mode.wavelength_um not in self._propagators_of:
                self._propagators_of[mode.wavelength_um] = self._propagators(mode.wavelength_um)
            if whole not in self._engines:
                assert isinstance(engine, Engine)
                self._engines[whole] = engine.at_wavelength(mode.wavelength_um)
            if mode.component is not None:
                of_wavelength = self._engines[whole]
                assert isinstance(of_wavelength, Engine)
                self._engines[mode.wavelength_um, mode.component] = of_wavelength.component(mode.component)
        largest_sigma = full_weight_sigma(recorded)
        self._planes = [
            PlaneRecord.of(
                measurement, propagator, plane_rows, largest_sigma, self.real, scratch or Scratch()
            )
            for measurement, propagator, plane_rows in zip(
                recorded, self.propagators, rows or [ALL_ROWS] * len(recorded), strict=True
            )
        ]
        self.size = math.sqrt(sum(plane.energy for plane in self._planes))
        self.scale = scale or 1.0

    def _propagators(self, wavelength_um: float) -> list[PlanePropagator]:
        """Return the propagators from the exit grid to all planes for one wavelength."""
        grid = self.engine.scene.exit_grid
        return [
            propagator_to(grid, wavelength_um, p.distance_mm, self.dtype, p.shift_mm, p.tilt_deg)
            for p in self.recorded
        ]

    def engine_of(self, mode: SourceMode) -> Operator:
        """Return the operator to the exit grid for the wavelength and component of a mode."""
        return self._engines[mode.wavelength_um, mode.component]

    def propagators_of(self, mode: SourceMode) -> list[PlanePropagator]:
        """Return the propagators from the exit grid to all planes for the wavelength of a mode."""
        return self._propagators_of[mode.wavelength_um]

    @property
    def weights(self) -> list[RealArray | None]:
        """Weights of the pixels of all planes; None where all weights are 1."""
        return [None if w is None else w.astype(self.real, copy=False) for w in weights_of(self.recorded)]

    def step(
        self,
        transmission: NDArray[Any],
        inner_iterations: int = 1,
        length: float = 1.0,
        *,
        scale: float | None = None,
        fits_scale: bool = False,
        planes_in_turn: bool = False,
    ) -> Step:
        """Return the change of the transmission that reduces the misfit, and the misfit before it.

        A single iteration gives the negative gradient. With more inner iterations the field behind the lens
        descends the misfit by itself, each time by a step of this length, and the sum of its changes is
        propagated back to the object. Planes cost little, and the propagation through the lens costs much.

        Parameters
        ----------
        transmission
            Transmission before the step.
        inner_iterations, length
            Number of iterations behind the lens, and length of each.
        scale
            Measured amplitude per unit of the modelled amplitude; default: that of the model.
        fits_scale
            Whether the scale of the next step is fitted. Without a scale, that of this step is fitted, too.
        planes_in_turn
            Whether, after the first inner iteration, each plane imposes its amplitudes on the field that the
            plane before has left. Light of several modes uses all planes at once.
        """
        if self.modes:
            return self._step_with_modes(transmission, inner_iterations, length, scale, fits_scale)
        exit_field = ExitField(self._at_exit(transmission, self.illumination), self.pixels)
        if scale is None and fits_scale:
            scale = fitted_scale(plane.products(exit_field.intensity(plane)) for plane in self._planes)
        scale = scale or self.scale
        sums = [
            exit_field.replace_amplitudes(plane, scale, with_products=fits_scale) for plane in self._planes
        ]
        next_scale = scale
        if fits_scale:  # for the next steps, so that planes are not propagated for the scale alone
            next_scale = fitted_scale((plane_sums.cross, plane_sums.power) for plane_sums in sums)
        fraction = length / len(self.recorded)
        for index in range(inner_iterations - 1):
            if index == 0 or not planes_in_turn:
                exit_field.advance(fraction)
            for plane in self._planes:
                exit_field.replace_amplitudes(plane, next_scale)
                if planes_in_turn:
                    exit_field.advance(1.0, 1.0 / fraction)
        change = self._adjoint_to_object(exit_field.take_change(), self.illumination)
        misfit = scale * math.sqrt(sum_of_parts(sums).squared_misfit) / self.size
        return Step(change, misfit, next_scale)

    def noise_of_step(self) -> float:
        """Return the standard deviation that noise causes in a step, for the real or imaginary part at scale
        1.

        One draw of the noise is propagated back through the lens, which accounts for aperture, windows and
        weights. Where the light has its peak brightness the result is about::

            s sqrt(exit cell / (2 planes object cell)) / max |u|,

        because the engine is nearly unitary and half of the noise energy is in the real part. The noise is
        inversely proportional to the scale.

        Raises
        ------
        InputError
            If a plane has no standard deviations.
        """
        if any(p.sigma is None for p in self.recorded):
            raise InputError("tv_weight = 'auto': needs sigma on every plane; state sigma, or give a number")
        on_object, light = self._noise_on_object(), self.illumination.values
        total, count = 0.0, 0
        for start in range(0, len(on_object), ROWS):
            rows = slice(start, start + ROWS)
            lit = self.lit[rows] & (on_object[rows] != 0.0)
            change = np.abs(on_object[rows][lit] * light[rows][lit])
            total, count = total + float(np.vdot(change, change)), count + len(change)
        return math.sqrt(0.5 * total / count) / (self.peak_power * len(self.recorded))

    def _noise_on_object(self) -> ComplexArray:
        """Return one draw of the noise of all planes on the object; 0 where it did not pass the lens."""
        scene = self.engine.scene
        field = Field(scene.exit_grid, self._noise_at_exit(), self.illumination.wavelength_um)
        if not isinstance(self.engine, Tiled):
            return np.asarray(self.engine.adjoint(field).values)
        # Smallest number of parts of a tiled engine from which the noise of a step is estimated.
        noise_parts = 8
        step = math.ceil(self.engine.parts / noise_parts)
        return np.asarray(self.engine.adjoint_on(field, range(0, self.engine.parts, step)).values)

    def _noise_at_exit(self) -> ComplexArray:
        """Return one draw of the noise of all planes on the exit grid."""
        random = np.random.default_rng(0)
        shape = self.engine.scene.exit_grid.shape
        total: ComplexArray | None = None
        for plane in self._planes:
            # Real noise passes the lens as well as noise of any other phase.
            noise = np.zeros(plane.amplitude.shape, self.dtype)
            for row, sigma in zip(noise.real, plane.sigma, strict=True):
                is_known = np.isfinite(sigma)
                stated = np.where(is_known, sigma, self.real.type(1.0))
                size = np.minimum(plane.full_weight_sigma / stated, 1.0) ** 2 * stated * is_known
                np.multiply(size, random.standard_normal(len(row), self.real), out=row, casting="same_kind")
            if plane.rows != ALL_ROWS:
                total = np.zeros(shape, self.dtype) if total is None else total
                total[plane.rows] += noise
                continue
            plane_noise = noise.reshape(shape)
            if not plane.propagator.is_identity:
                plane_noise = scipy.fft.ifftn(
                    plane.propagator.adjoint(plane_noise), workers=-1, overwrite_x=True
                )
            total = plane_noise if total is None else np.add(total, plane_noise, out=total)
        assert total is not None
        return total

    def amplitudes(self, transmission: NDArray[Any], scale: float | None = None) -> list[RealArray]:
        """Return the modelled amplitudes on all planes, in the unit of the measured ones.

        Parameters
        ----------
        transmission
            Transmission of the object.
        scale
            Measured amplitude per unit of the modelled amplitude; default: that of the model.
        """
        return list(self._scaled_amplitudes(self._plane_intensities(transmission)(), scale or self.scale))

    def fitted_amplitudes(self, transmission: NDArray[Any]) -> tuple[list[RealArray], float]:
        """Return the modelled amplitudes on all planes with the scale that fits best, and this scale."""
        intensities = self._plane_intensities(transmission)
        scale = fitted_scale(map(PlaneRecord.products, self._planes, intensities()))
        return list(self._scaled_amplitudes(intensities(), scale)), scale

    def _plane_intensities(self, transmission: NDArray[Any]) -> Callable[[], Iterator[RealArray]]:
        """Return a function that yields the intensity on each plane, one after the other."""
        if self.modes:
            spectra = self._spectra(transmission)
            return lambda: iter(self._intensities(spectra))
        exit_field = ExitField(self._at_exit(transmission, self.illumination), self.pixels)
        return lambda: (exit_field.intensity(plane) for plane in self._planes)

    def _scaled_amplitudes(self, intensities: Iterable[RealArray], scale: float) -> Iterator[RealArray]:
        for plane, measurement, intensity in zip(self._planes, self.recorded, intensities, strict=True):
            intensity *= intensity.dtype.type(scale**2)
            if plane.background.size:
                intensity += plane.background
            np.sqrt(intensity, out=intensity)
            yield intensity.reshape(measurement.amplitude.shape)

    def _at_exit(
        self, transmission: NDArray[Any], light: Field, component: int | None = None
    ) -> ComplexArray:
        """Return the field on the exit grid, or one of its components."""
        lit = light.with_values(np.multiply(transmission, light.values))
        engine = self._engines[light.wavelength_um, component]
        return np.asarray(engine.forward(lit).values, self.dtype)

    def _adjoint_to_object(
        self, change: ComplexArray, light: Field, component: int | None = None
    ) -> ComplexArray:
        """Return the change of the transmission due to a change on the exit grid, which is overwritten."""
        scene, values = self.engine.scene, light.values
        field = Field(scene.exit_grid, change.reshape(scene.exit_grid.shape), light.wavelength_um)
        engine = self._engines[light.wavelength_um, component]
        result = np.require(engine.adjoint(field).values, self.dtype, ["W"])
        fraction = 1.0 / (self.peak_power * len(self.recorded))

        def rows(start: int, stop: int) -> None:
            result[start:stop] *= values[start:stop].conj() * fraction

        for_blocks(rows, len(result), ROWS)
        return result

    def _spectra(self, transmission: NDArray[Any]) -> list[ComplexArray]:
        """Return the spectrum of each mode's field on the exit grid."""
        return [
            scipy.fft.fftn(
                self._at_exit(transmission, mode.on(self.illumination), mode.component),
                workers=-1,
                overwrite_x=True,
            ).astype(self.dtype, copy=False)
            for mode in self.modes
        ]

    def _intensities(self, spectra: Sequence[ComplexArray]) -> list[RealArray]:
        """Return the total intensity of all modes on each plane."""
        assert self.pixels is not None
        found, rows = [], None
        for index, plane in enumerate(self._planes):
            total = np.zeros(plane.amplitude.shape, self.real)
            for mode, spectrum in zip(self.modes, spectra, strict=True):
                propagator = self._propagators_of[mode.wavelength_um][index]
                rows = self.pixels.propagate(spectrum, propagator, rows)
                total += self.real.type(mode.weight) * self.pixels.intensity(rows)
            found.append(total)
        return found

    def _step_with_modes(
        self,
        transmission: NDArray[Any],
        inner_iterations: int,
        length: float,
        scale: float | None,
        fits_scale: bool,
    ) -> Step:
        spectra, squared_misfit = self._spectra(transmission), 0.0
        totals = [np.zeros_like(spectrum) for spectrum in spectra]
        for iteration in range(inner_iterations):
            ratios = self._intensities(spectra)
            if iteration == 0:
                if fits_scale:
                    scale = fitted_scale(map(PlaneRecord.products, self._planes, ratios))
                scale = scale or self.scale
            assert scale is not None
            misfit_of_planes = sum(
                plane.change_pixels(ratio, scale) for plane, ratio in zip(self._planes, ratios, strict=True)
            )
            squared_misfit = squared_misfit if iteration else misfit_of_planes
            for mode, spectrum, total in zip(self.modes, spectra, totals, strict=True):
                change = self._change_of_mode(mode, spectrum, ratios)
                add_fraction(spectrum, change, length / len(self.recorded))
                total += change
        del spectra
        result = np.zeros(self.lit.shape, self.dtype)
        for mode in self.modes:
            exit_field = scipy.fft.ifftn(totals.pop(0), workers=-1, overwrite_x=True)
            result += self.real.type(mode.weight) * self._adjoint_to_object(
                exit_field, mode.on(self.illumination), mode.component
            )
        assert scale is not None
        return Step(result, scale * math.sqrt(squared_misfit) / self.size, scale)

    def _change_of_mode(
        self, mode: SourceMode, spectrum: ComplexArray, ratios: Sequence[RealArray]
    ) -> ComplexArray:
        assert self.pixels is not None
        change, rows = np.zeros_like(spectrum), None
        for propagator, ratio in zip(self._propagators_of[mode.wavelength_um], ratios, strict=True):
            rows = self.pixels.propagate(spectrum, propagator, rows)
            self.pixels.add_adjoint(rows, ratio, propagator, change)
        return change


def fitted_scale(products: Iterable[tuple[float, float]]) -> float:
    """Return the scale that fits best, from each plane's sums of measured times modelled amplitude, and of
    modelled intensity.
    """
    cross = power = 0.0
    for plane_cross, plane_power in products:
        cross, power = cross + plane_cross, power + plane_power
    return cross / power if cross > 0.0 < power else 1.0
