"""From an object's transmission to the amplitudes recorded behind the lens, and the step back.

Amplitudes a with standard deviations s pull with the weight (s of a plane's brightest pixel / s)^2, 1 at most
(:func:`wavesim.sensor.measurement.weights_of`): where s is infinite, nothing is known and nothing is
replaced.

A pixel takes the mean of |u|^2 over its square. The step is that of the misfit's gradient: each pixel's ratio
of recorded and modelled amplitude is spread over it. Planes come one after the other, so that the fields of
one alone are held.

Light of a wide source is a few modes, each from its own direction, which do not interfere: a pixel takes the
sum of their intensities, and each mode is changed by the ratio of the recorded amplitude to that of the sum.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.fields.field import Field
from wavesim.fields.tilted_propagator import propagator_to
from wavesim.reconstruction.recording.pixel_means import PixelMeans
from wavesim.reconstruction.recording.planes import (
    EVERY_ROW,
    ROWS,
    ExitField,
    PlaneRecord,
    add_share,
    total_of,
)
from wavesim.runtime.scratch import Scratch
from wavesim.runtime.threads import for_blocks
from wavesim.scene.bench import LightErrors
from wavesim.scene.engine import Operator, Tiled
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement, full_weight_sigma, weights_of

NOISE_PARTS = 8
"""Of an engine that works in parts, at least, by which the noise of a step is told."""

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]


class ForwardModel:
    """The engine, the way to each plane, and what was recorded there.

    Parameters
    ----------
    engine, illumination, recorded
        As of :func:`wavesim.reconstruct`.
    scale
        Recorded amplitude for a unit of the model's; None is 1, to be fitted.
    fill_factor
        Side of a pixel's photosensitive square as a share of the pitch; 0 is a point.
    scratch
        Where arrays that are kept lie; in memory if left out.
    modes
        Of the light, if its source is wide, all of one wavelength; one mode if left out.
    rows
        Of the exit grid, for each plane those in which the engine gives the field on its pixels, which then
        are points, and at no distance; left out, planes are reached through free space from the whole grid.
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
        self.modes = modes if len(modes) > 1 else ()
        power = np.abs(illumination.values)
        power *= power
        self.brightest = float(power.max())
        self.lit: NDArray[np.bool_] = power > 1e-6 * self.brightest
        self.dtype, self.real = illumination.values.dtype, power.dtype
        del power
        grid = engine.scene.exit_grid
        self.pixels = PixelMeans(grid, fill_factor) if fill_factor > 0.0 or self.modes else None
        self.ways = [
            propagator_to(grid, illumination.wavelength_um, p.distance_mm, self.dtype, p.shift_mm, p.tilt_deg)
            for p in recorded
        ]
        least = full_weight_sigma(recorded)
        self._planes = [
            PlaneRecord.of(one, way, part, least, self.real, scratch or Scratch())
            for one, way, part in zip(recorded, self.ways, rows or [EVERY_ROW] * len(recorded), strict=True)
        ]
        self.size = math.sqrt(sum(plane.energy for plane in self._planes))
        self.scale, self.knows_scale, self.fits_scale = scale or 1.0, scale is not None, False

    @property
    def weights(self) -> list[RealArray | None]:
        """Weights of all planes' pixels; None where all weigh 1."""
        return [None if w is None else w.astype(self.real, copy=False) for w in weights_of(self.recorded)]

    def step(
        self, transmission: NDArray[Any], rounds: int = 1, length: float = 1.0
    ) -> tuple[ComplexArray, float]:
        """The change of the transmission, and the misfit before it.

        That of one round is the misfit's slope. In more, the field behind the lens goes down the misfit by
        itself, each round as far as a step of this length, and the sum of its changes comes back to the
        object: planes cost little, and the way through the lens much.
        """
        if self.modes:
            return self._step_of_modes(transmission, rounds, length)
        behind = ExitField(self._at_exit(transmission, self.illumination), self.pixels)
        if self.fits_scale and not self.knows_scale:
            self._fit_scale(plane.products(behind.intensity(plane)) for plane in self._planes)
        scale = self.scale
        told = [behind.replace(plane, scale, weighs=self.fits_scale) for plane in self._planes]
        if self.fits_scale:  # for what follows: planes are not passed once more for the scale alone
            self._fit_scale((one.met, one.own) for one in told)
        for _ in range(rounds - 1):
            behind.go_on(length / len(self.recorded))
            for plane in self._planes:
                behind.replace(plane, self.scale)
        change = self._to_object(behind.changed(), self.illumination)
        return change, scale * math.sqrt(total_of(told).missed) / self.size

    def noise_of_step(self) -> float:
        """Standard deviation that the amplitudes' noise gives a step at scale 1, in either part of it.

        One draw of the noise goes back through the lens, so that aperture, windows and weights count as they
        are. Where light is as bright as brightest, it is about

            s sqrt(exit cell / (2 planes object cell)) / max |u|,

        for the engine is nearly unitary, and half of the noise's energy falls on the real part, half on the
        imaginary one. It goes with the inverse of the scale.

        Raises
        ------
        InputError
            If a plane has no standard deviations.
        """
        if any(p.sigma is None for p in self.recorded):
            raise InputError("the weight of the total variation by the noise: needs sigma on every plane")
        back, light = self._noise_back(), self.illumination.values
        total, count = 0.0, 0
        for start in range(0, len(back), ROWS):
            rows = slice(start, start + ROWS)
            lit = self.lit[rows] & (back[rows] != 0.0)
            change = np.abs(back[rows][lit] * light[rows][lit])
            total, count = total + float(np.vdot(change, change)), count + len(change)
        return math.sqrt(0.5 * total / count) / (self.brightest * len(self.recorded))

    def _noise_back(self) -> ComplexArray:
        """One draw of all planes' noise, back on the object; 0 where it did not go through the lens."""
        scene = self.engine.scene
        field = Field(scene.exit_grid, self._noise_at_exit(), self.illumination.wavelength_um)
        if not isinstance(self.engine, Tiled):
            return np.asarray(self.engine.adjoint(field).values)
        apart = math.ceil(self.engine.parts / NOISE_PARTS)
        return np.asarray(self.engine.adjoint_on(field, range(0, self.engine.parts, apart)).values)

    def _noise_at_exit(self) -> ComplexArray:
        """One draw of all planes' noise, as :meth:`_to_object` takes it."""
        random = np.random.default_rng(0)
        shape = self.engine.scene.exit_grid.shape
        total: ComplexArray | None = None
        for plane in self._planes:
            # Along the real axis: as much goes back through the lens as along any other.
            noise = np.zeros(plane.amplitude.shape, self.dtype)
            for row, sigma in zip(noise.real, plane.sigma, strict=True):
                known = np.isfinite(sigma)
                stated = np.where(known, sigma, self.real.type(1.0))
                size = np.minimum(plane.least / stated, 1.0) ** 2 * stated * known
                np.multiply(size, random.standard_normal(len(row), self.real), out=row, casting="same_kind")
            if plane.rows != EVERY_ROW:
                total = np.zeros(shape, self.dtype) if total is None else total
                total[plane.rows] += noise
                continue
            part = noise.reshape(shape)
            if not plane.way.is_none:
                part = scipy.fft.ifftn(plane.way.back(part), workers=-1, overwrite_x=True)
            total = part if total is None else np.add(total, part, out=total)
        assert total is not None
        return total

    def amplitudes(self, transmission: NDArray[Any]) -> list[RealArray]:
        """Amplitudes on all planes, in units of the recorded ones."""
        if self.modes:
            found = self._intensities(self._spectra(transmission))
            if self.fits_scale:
                self._fit_scale(map(PlaneRecord.products, self._planes, found))
            intensities = iter(found)
        else:
            behind = ExitField(self._at_exit(transmission, self.illumination), self.pixels)
            if self.fits_scale:
                self._fit_scale(plane.products(behind.intensity(plane)) for plane in self._planes)
            intensities = (behind.intensity(plane) for plane in self._planes)
        results = []
        for plane, one, seen in zip(self._planes, self.recorded, intensities, strict=True):
            seen *= seen.dtype.type(self.scale**2)
            if plane.background.size:
                seen += plane.background
            np.sqrt(seen, out=seen)
            results.append(seen.reshape(one.amplitude.shape))
        return results

    def _at_exit(self, transmission: NDArray[Any], light: Field) -> ComplexArray:
        """The field on the exit grid."""
        lit = self.illumination.with_values(np.multiply(transmission, light.values))
        return np.asarray(self.engine.forward(lit).values, self.dtype)

    def _to_object(self, change: ComplexArray, light: Field) -> ComplexArray:
        """Change of the transmission, from the sum over planes of changes at the exit; uses that up."""
        scene, values = self.engine.scene, light.values
        field = Field(scene.exit_grid, change.reshape(scene.exit_grid.shape), light.wavelength_um)
        result = np.require(self.engine.adjoint(field).values, self.dtype, ["W"])
        share = 1.0 / (self.brightest * len(self.recorded))

        def rows(start: int, stop: int) -> None:
            result[start:stop] *= values[start:stop].conj() * share

        for_blocks(rows, len(result), ROWS)
        return result

    def _spectra(self, transmission: NDArray[Any]) -> list[ComplexArray]:
        """Of each mode's field on the exit grid."""
        return [
            scipy.fft.fftn(
                self._at_exit(transmission, self._light(mode)), workers=-1, overwrite_x=True
            ).astype(self.dtype, copy=False)
            for mode in self.modes
        ]

    def _light(self, mode: SourceMode) -> Field:
        return LightErrors(mode.tilt_deg).on(self.illumination)

    def _intensities(self, spectra: Sequence[ComplexArray]) -> list[RealArray]:
        """On each plane, of all modes together."""
        assert self.pixels is not None
        found, rows = [], None
        for plane in self._planes:
            total = np.zeros(plane.amplitude.shape, self.real)
            for mode, spectrum in zip(self.modes, spectra, strict=True):
                rows = self.pixels.carried(spectrum, plane.way, rows)
                total += self.real.type(mode.share) * self.pixels.intensity(rows)
            found.append(total)
        return found

    def _step_of_modes(
        self, transmission: NDArray[Any], rounds: int, length: float
    ) -> tuple[ComplexArray, float]:
        spectra, missed = self._spectra(transmission), 0.0
        totals = [np.zeros_like(spectrum) for spectrum in spectra]
        for number in range(rounds):
            ratios = self._intensities(spectra)
            if self.fits_scale and number == 0:
                self._fit_scale(map(PlaneRecord.products, self._planes, ratios))
            here = sum(
                plane.change_pixels(ratio, self.scale)
                for plane, ratio in zip(self._planes, ratios, strict=True)
            )
            missed = missed if number else here
            for spectrum, total in zip(spectra, totals, strict=True):
                change = self._change_of_mode(spectrum, ratios)
                add_share(spectrum, change, length / len(self.recorded))
                total += change
        del spectra
        result = np.zeros(self.lit.shape, self.dtype)
        for mode in self.modes:
            behind = scipy.fft.ifftn(totals.pop(0), workers=-1, overwrite_x=True)
            result += self.real.type(mode.share) * self._to_object(behind, self._light(mode))
        return result, self.scale * math.sqrt(missed) / self.size

    def _change_of_mode(self, spectrum: ComplexArray, ratios: Sequence[RealArray]) -> ComplexArray:
        assert self.pixels is not None
        change, rows = np.zeros_like(spectrum), None
        for plane, ratio in zip(self._planes, ratios, strict=True):
            rows = self.pixels.carried(spectrum, plane.way, rows)
            self.pixels.add_back(rows, ratio, plane.way, change)
        return change

    def _fit_scale(self, products: Iterable[tuple[float, float]]) -> None:
        met = own = 0.0
        for here in products:
            met, own = met + here[0], own + here[1]
        self.scale, self.knows_scale = (met / own if met > 0.0 < own else 1.0), True
