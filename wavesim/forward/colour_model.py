"""Forward model of several wavelengths: a transmission for each, and pixels that measure their sums.

Wavelengths do not interfere. A pixel measures the sum of their mean intensities, each times the response of
the pixel to the wavelength. The responses state how the wavelengths were recorded:

- one after the other: on each plane, one wavelength has a response;
- at once on a monochrome sensor: all pixels have the same responses;
- through a colour filter array: the responses differ from pixel to pixel, as the filters do. The mosaic is
  used as it is, without an interpolation of missing colours.

The step changes each wavelength's field on a plane by the ratio of the measured amplitude to that of the sum,
in proportion to the pixel's response. With responses of at most 1, the Hessian is at most 1 for the mean of a
wavelength's planes, as it is for one wavelength (:mod:`wavesim.forward.forward_model`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.fields.propagator import propagator_to
from wavesim.forward.exit_field import ALL_ROWS, PlaneRecord, add_fraction
from wavesim.forward.forward_model import Step, fitted_scale
from wavesim.forward.pixel_means import PixelMeans
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Operator
from wavesim.sensor.measurement import Measurement, full_weight_sigma

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]
Response = float | RealArray
"""Response of the pixels of a plane to a wavelength: one value, or one for each pixel."""


class ColourModel:
    """Engines and light of several wavelengths, propagators to each plane, and the measured data.

    Parameters
    ----------
    engines
        Engine of each wavelength; all have the same object grid and the same exit grid.
    lights
        Illumination of each wavelength on the object grid.
    recorded
        Measured amplitudes of the planes.
    responses
        For each plane, the response of its pixels to each wavelength, from 0 to 1.
    scale
        Measured amplitude per unit of the modelled amplitude; None means 1. It is used where a step states
        no scale of its own.
    fill_factor
        Linear fill factor of a pixel.

    Attributes
    ----------
    lit : ndarray of bool, shape (wavelengths, ny, nx)
        Samples of the object with light.
    passes : list of float
        For each wavelength, the sum over the planes of its largest response; 1 if no plane has recorded it.
    """

    rows: Sequence[slice] = ()

    def __init__(
        self,
        engines: Sequence[Operator],
        lights: Sequence[Field],
        recorded: Sequence[Measurement],
        responses: Sequence[Sequence[Response]],
        scale: float | None,
        fill_factor: float = 1.0,
    ) -> None:
        self.engines, self.lights, self.recorded = engines, lights, recorded
        grid = engines[0].scene.exit_grid
        powers = [np.abs(light.values) ** 2 for light in lights]
        self.peak_powers = [float(power.max()) for power in powers]
        self.lit: NDArray[np.bool_] = np.stack(
            [power > 1e-6 * peak for power, peak in zip(powers, self.peak_powers, strict=True)]
        )
        self.dtype, self.real = lights[0].values.dtype, powers[0].dtype
        self.pixels = PixelMeans(grid, fill_factor, recorded[0].blur_mm / grid.pitch_mm)
        self.responses = [
            [np.asarray(response, self.real) for response in of_plane] for of_plane in responses
        ]
        self.passes = [
            sum(float(of_plane[index].max()) for of_plane in self.responses) or 1.0
            for index in range(len(lights))
        ]
        self._propagators = [
            [
                propagator_to(
                    grid, light.wavelength_um, plane.distance_mm, self.dtype, plane.shift_mm, plane.tilt_deg
                )
                if of_plane[index].any()
                else None
                for index, light in enumerate(lights)
            ]
            for plane, of_plane in zip(recorded, self.responses, strict=True)
        ]
        largest_sigma = full_weight_sigma(recorded)
        self._planes = [
            PlaneRecord.of(
                plane,
                next(one for one in of_plane if one is not None),
                ALL_ROWS,
                largest_sigma,
                self.real,
                Scratch(),
            )
            for plane, of_plane in zip(recorded, self._propagators, strict=True)
        ]
        self.size = math.sqrt(sum(plane.energy for plane in self._planes))
        self.scale = scale or 1.0

    def step(
        self,
        transmission: NDArray[Any],
        inner_iterations: int = 1,
        length: float = 1.0,
        *,
        scale: float | None = None,
        fits_scale: bool = False,
    ) -> Step:
        """Return the change of the transmissions that reduces the misfit, and the misfit before it.

        See :meth:`wavesim.forward.forward_model.ForwardModel.step`. The change of each wavelength is the
        negative gradient of half the squared misfit, divided by the peak power of its light and by its
        `passes`.

        Parameters
        ----------
        transmission : ndarray, shape (wavelengths, ny, nx)
            Transmission at each wavelength.
        inner_iterations, length, scale, fits_scale
            As there. A scale that is stated stays.
        """
        spectra = self._spectra(transmission)
        totals = [np.zeros_like(spectrum) for spectrum in spectra]
        if scale is None:
            scale = self._fitted_scale(spectra) if fits_scale else self.scale
        squared_misfit = 0.0
        for iteration in range(inner_iterations):
            changes = [np.zeros_like(spectrum) for spectrum in spectra]
            misfit = sum(
                self._replace_amplitudes(index, spectra, changes, scale) for index in range(len(self._planes))
            )
            squared_misfit = squared_misfit if iteration else misfit
            for spectrum, change, total, passes in zip(spectra, changes, totals, self.passes, strict=True):
                if iteration + 1 < inner_iterations:
                    add_fraction(spectrum, change, length / passes)
                total += change
        del spectra, changes
        result = np.empty(self.lit.shape, self.dtype)
        for index in range(len(result)):
            result[index] = self._adjoint_to_object(index, totals.pop(0))
        return Step(result, scale * math.sqrt(squared_misfit) / self.size, scale)

    def amplitudes(self, transmission: NDArray[Any], scale: float | None = None) -> list[RealArray]:
        """Return the modelled amplitudes on all planes, in the unit of the measured ones.

        Parameters
        ----------
        transmission
            Transmission at each wavelength.
        scale
            Measured amplitude per unit of the modelled amplitude; default: that of the model.
        """
        spectra, scale = self._spectra(transmission), scale or self.scale
        results = []
        for index, plane in enumerate(self._planes):
            _, intensity = self._intensity(index, spectra)
            intensity *= self.real.type(scale**2)
            if plane.background.size:
                intensity += plane.background
            results.append(np.sqrt(intensity, out=intensity))
        return results

    def noise_of_step(self, transmission: NDArray[Any], seed: int = 0) -> RealArray:
        """Return the standard deviation that noise causes in a step at scale 1, for each wavelength.

        It is that of the real or the imaginary part. One draw of the noise is propagated back to the object.
        On a plane, a wavelength gets the part of the noise that belongs to its fraction of the light.

        Parameters
        ----------
        transmission
            Transmissions that give the fractions of the light, such as 1.
        seed
            Seed of the draw.
        """
        random = np.random.default_rng(seed)
        spectra = self._spectra(transmission)
        totals = [np.zeros_like(spectrum) for spectrum in spectra]
        for index, plane in enumerate(self._planes):
            known = np.isfinite(plane.sigma)
            sigma = np.where(known, plane.sigma, 1.0)
            weight = np.minimum(plane.full_weight_sigma / sigma, 1.0) ** 2 * known
            noise = (weight * sigma * random.standard_normal(sigma.shape)).astype(self.real)
            rows_of, intensity = self._intensity(index, spectra)
            # The change of a field by a change of the amplitude is relative to the amplitude.
            noise /= np.sqrt(np.maximum(intensity, 1e-6 * float(intensity.mean())))
            self._add_adjoints(index, rows_of, noise, totals)
        result = np.empty(len(totals), self.real)
        for index in range(len(totals)):
            change = self._adjoint_to_object(index, totals.pop(0))[self.lit[index]]
            result[index] = math.sqrt(0.5 * float(np.mean(np.abs(change) ** 2)))
        return result

    def _spectra(self, transmission: NDArray[Any]) -> list[ComplexArray]:
        """Return the spectrum of each wavelength's field on the exit grid."""
        return [
            scipy.fft.fftn(
                engine.forward(light.with_values(np.multiply(values, light.values, dtype=self.dtype))).values,
                workers=-1,
            ).astype(self.dtype, copy=False)
            for engine, light, values in zip(self.engines, self.lights, transmission, strict=True)
        ]

    def _intensity(self, index: int, spectra: Sequence[ComplexArray]) -> tuple[list[Any], RealArray]:
        """Return the rows of each wavelength's field on a plane, and the light that its pixels measure."""
        total = np.zeros(self._planes[index].amplitude.shape, self.real)
        rows_of: list[Any] = []
        for spectrum, propagator, response in zip(
            spectra, self._propagators[index], self.responses[index], strict=True
        ):
            rows = None if propagator is None else self.pixels.propagate(spectrum, propagator)
            rows_of.append(rows)
            if rows is not None:
                total += response * self.pixels.intensity(rows)
        return rows_of, total

    def _replace_amplitudes(
        self,
        index: int,
        spectra: Sequence[ComplexArray],
        changes: Sequence[ComplexArray],
        scale: float,
    ) -> float:
        """Add the changes that a plane requires; return its squared misfit."""
        rows_of, ratio = self._intensity(index, spectra)
        squared_misfit = self._planes[index].change_pixels(ratio, scale)
        self._add_adjoints(index, rows_of, ratio, changes)
        return squared_misfit

    def _add_adjoints(
        self, index: int, rows_of: Sequence[Any], ratio: RealArray, changes: Sequence[ComplexArray]
    ) -> None:
        """Add relative changes of the fields on a plane to the spectra in front of its propagators."""
        for rows, propagator, response, change in zip(
            rows_of, self._propagators[index], self.responses[index], changes, strict=True
        ):
            if propagator is not None:
                self.pixels.add_adjoint(rows, response * ratio, propagator, change)

    def _adjoint_to_object(self, index: int, spectrum: ComplexArray) -> ComplexArray:
        """Return the change of a transmission due to a change on the exit grid."""
        engine, light = self.engines[index], self.lights[index]
        change = scipy.fft.ifftn(spectrum, workers=-1, overwrite_x=True)
        values = engine.adjoint(Field(engine.scene.exit_grid, change, light.wavelength_um)).values
        factor = self.real.type(1.0 / (self.peak_powers[index] * self.passes[index]))
        return np.asarray(factor * values * light.values.conj(), self.dtype)

    def _fitted_scale(self, spectra: Sequence[ComplexArray]) -> float:
        """Return the scale that fits best."""
        return fitted_scale(
            plane.products(self._intensity(index, spectra)[1]) for index, plane in enumerate(self._planes)
        )
