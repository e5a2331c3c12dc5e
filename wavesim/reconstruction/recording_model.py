"""From an object's transmission to the amplitudes recorded behind the lens, and the step back.

Amplitudes a with standard deviations s pull with the weight (s of a plane's brightest pixel / s)^2, 1 at most
(:func:`wavesim.camera.recorded.weights_of`): where s is infinite, nothing is known and nothing is
replaced.

A pixel takes the mean of |u|^2 over its square. The step is that of the misfit's gradient: each pixel's ratio
of recorded and modelled amplitude is spread over it. Planes come one after the other, so that the fields of
one alone are held.

Light of a wide source is a few modes, each from its own direction, which do not interfere: a pixel takes the
sum of their intensities, and each mode is changed by the ratio of the recorded amplitude to that of the sum.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.camera.recorded import Recorded, full_weight_sigma, weights_of
from wavesim.fields.field import Field
from wavesim.fields.slight_tilts import Way, way_to
from wavesim.reconstruction.pixel_means import PixelMeans
from wavesim.reconstruction.recording_kernel import change_pixels, change_samples, weighted_products
from wavesim.runtime.scratch import Scratch
from wavesim.runtime.threads import for_blocks
from wavesim.scene.bench import LightErrors
from wavesim.scene.engine import Operator
from wavesim.scene.source import SourceMode

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]

DARK = 1e-6
"""Of a plane's mean intensity: added to recorded and modelled means of pixels, to bound their ratio."""

ROWS = 64
"""Of a plane, for a thread at a time."""


class RecordingModel:
    """The engine, the way to each plane, and what was recorded there.

    Parameters
    ----------
    engine, illumination, recorded
        As of :func:`wavesim.reconstruct`.
    scale
        Recorded amplitude for a unit of the model's; None is 1, to be fitted.
    active_width
        Side of a pixel's photosensitive square as a share of the pitch; 0 is a point.
    scratch
        Where arrays that are kept lie; in memory if left out.
    modes
        Of the light, if its source is wide, all of one wavelength; one mode if left out.
    """

    def __init__(
        self,
        engine: Operator,
        illumination: Field,
        recorded: Sequence[Recorded],
        scale: float | None,
        active_width: float = 0.0,
        scratch: Scratch | None = None,
        modes: Sequence[SourceMode] = (),
    ) -> None:
        self.engine, self.illumination, self.recorded = engine, illumination, recorded
        self.modes = modes if len(modes) > 1 else ()
        power = np.abs(illumination.values)
        power *= power
        self.brightest = float(power.max())
        self.lit: NDArray[np.bool_] = power > 1e-6 * self.brightest
        self.dtype, self.real = illumination.values.dtype, power.dtype
        del power
        grid = engine.scene.exit_grid
        self.pixels = PixelMeans(grid, active_width) if active_width > 0.0 or self.modes else None
        self.ways = [
            way_to(grid, illumination.wavelength_um, p.distance_mm, self.dtype, p.shift_mm, p.tilt_deg)
            for p in recorded
        ]
        least = full_weight_sigma(recorded)
        self._planes = [
            _Plane.of(one, way, least, self.real, scratch or Scratch())
            for one, way in zip(recorded, self.ways, strict=True)
        ]
        self.size = math.sqrt(sum(plane.energy for plane in self._planes))
        self.scale, self.fits_scale = scale or 1.0, False

    @property
    def weights(self) -> list[RealArray | None]:
        """Weights of all planes' pixels; None where all weigh 1."""
        return [None if w is None else w.astype(self.real, copy=False) for w in weights_of(self.recorded)]

    def step(self, transmission: NDArray[Any]) -> tuple[ComplexArray, float]:
        """The change of the transmission, and the misfit before it."""
        if self.modes:
            return self._step_of_modes(transmission)
        behind = _Behind(self._at_exit(transmission, self.illumination), self.pixels)
        if self.fits_scale:
            self._fit_scale(plane.products(behind.intensity(plane)) for plane in self._planes)
        missed = sum(behind.replace(plane, self.scale) for plane in self._planes)
        change = self._to_object(behind.changed(), self.illumination)
        return change, self.scale * math.sqrt(missed) / self.size

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
        change = np.abs(self._to_object(self._noise_at_exit(), self.illumination)[self.lit])
        return math.sqrt(0.5 * float(np.mean(change * change, dtype=float)))

    def _noise_at_exit(self) -> ComplexArray:
        """One draw of all planes' noise, as :meth:`_to_object` takes it."""
        random = np.random.default_rng(0)
        shape = self.engine.scene.exit_grid.shape
        total: ComplexArray | None = None
        for plane in self._planes:
            # Row by row: all draws in double precision would fill more than anything else here.
            noise = np.empty(plane.amplitude.shape, self.dtype)
            for row, sigma in zip(noise, plane.sigma, strict=True):
                known = np.isfinite(sigma)
                stated = np.where(known, sigma, 1.0)
                size = np.minimum(plane.least / stated, 1.0) ** 2 * stated * known
                row[:] = size * random.standard_normal(len(row))
            for row in noise:
                row *= np.exp(2j * np.pi * random.random(len(row)))
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
                self._fit_scale(map(_Plane.products, self._planes, found))
            intensities = iter(found)
        else:
            behind = _Behind(self._at_exit(transmission, self.illumination), self.pixels)
            if self.fits_scale:
                self._fit_scale(plane.products(behind.intensity(plane)) for plane in self._planes)
            intensities = (behind.intensity(plane) for plane in self._planes)
        results = []
        for plane, seen in zip(self._planes, intensities, strict=True):
            seen *= seen.dtype.type(self.scale**2)
            if plane.background.size:
                seen += plane.background
            np.sqrt(seen, out=seen)
            results.append(seen.reshape(self.engine.scene.exit_grid.shape))
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

    def _step_of_modes(self, transmission: NDArray[Any]) -> tuple[ComplexArray, float]:
        assert self.pixels is not None
        spectra = self._spectra(transmission)
        changes = self._intensities(spectra)
        if self.fits_scale:
            self._fit_scale(map(_Plane.products, self._planes, changes))
        missed = sum(
            plane.change_pixels(change, self.scale)
            for plane, change in zip(self._planes, changes, strict=True)
        )
        result, rows = np.zeros(self.lit.shape, self.dtype), None
        for mode in self.modes:
            spectrum = spectra.pop(0)
            change = np.zeros_like(spectrum)
            for plane, ratios in zip(self._planes, changes, strict=True):
                rows = self.pixels.carried(spectrum, plane.way, rows)
                self.pixels.add_back(rows, ratios, plane.way, change)
            del spectrum
            behind = scipy.fft.ifftn(change, workers=-1, overwrite_x=True)
            result += self.real.type(mode.share) * self._to_object(behind, self._light(mode))
        return result, self.scale * math.sqrt(missed) / self.size

    def _fit_scale(self, products: Iterable[tuple[float, float]]) -> None:
        met = own = 0.0
        for here in products:
            met, own = met + here[0], own + here[1]
        self.scale = met / own if met > 0.0 < own else 1.0


@dataclass(frozen=True, eq=False)
class _Plane:
    """What was recorded on a plane, in the model's precision; a line is one row.

    `sigma` has no samples where all pixels are alike, `background` where there is none; up to `least` sigma
    weighs 1.
    """

    way: Way
    amplitude: RealArray
    sigma: RealArray
    background: RealArray
    least: float

    @classmethod
    def of(cls, one: Recorded, way: Way, least: float, dtype: np.dtype[Any], scratch: Scratch) -> _Plane:
        def kept(values: RealArray, what: str) -> RealArray:
            values = np.atleast_2d(values)
            if values.dtype == dtype:
                return values
            result = scratch.array(values.shape, dtype, what)
            result[:] = values
            return result

        none = np.empty((0, 0), dtype)
        sigma = none if one.sigma is None else kept(one.sigma, "the standard deviations")
        background = none if one.background is None else kept(one.background, "the backgrounds")
        return cls(way, kept(one.amplitude, "the recorded amplitudes"), sigma, background, least)

    @property
    def energy(self) -> float:
        """Weighted sum of squared amplitudes."""
        return sum(self._by_rows(lambda part: self._products(self.amplitude[part] ** 2, part)[0]))

    def products(self, intensity: RealArray) -> tuple[float, float]:
        """Weighted sums of modelled times recorded amplitudes without background, and of modelled powers."""
        found = self._by_rows(lambda part: self._products(intensity[part], part))
        return sum(met for met, _ in found), sum(own for _, own in found)

    def change_pixels(self, intensity: RealArray, scale: float) -> float:
        """Replace pixels' mean intensities by the relative changes wanted; gives the misfit."""
        real = intensity.dtype.type
        mean = float(np.vdot(self.amplitude, self.amplitude)) / self.amplitude.size / scale**2
        dark = real(DARK * mean)

        def rows(part: slice) -> float:
            told = (*self._recorded(part), real(scale), dark, self._background(part))
            return float(change_pixels(intensity[part], *told))

        return sum(self._by_rows(rows))

    def change_samples(self, field: ComplexArray, scale: float) -> float:
        """Replace a field by the change wanted; gives the misfit."""
        factor = self.amplitude.dtype.type(scale)

        def rows(part: slice) -> float:
            told = (*self._recorded(part), factor, self._background(part))
            return float(change_samples(field[part], *told))

        return sum(self._by_rows(rows))

    def _products(self, intensity: RealArray, part: slice) -> tuple[float, float]:
        amplitude, *others = self._recorded(part)
        if self.background.size:
            amplitude = np.sqrt(np.maximum(amplitude * amplitude - self.background[part], 0.0))
        return weighted_products(intensity, amplitude, *others)

    def _background(self, part: slice) -> RealArray:
        return self.background[part] if self.background.size else self.background

    def _recorded(self, part: slice) -> tuple[RealArray, RealArray, Any]:
        return self.amplitude[part], self.sigma[part], self.amplitude.dtype.type(self.least)

    def _by_rows(self, work: Callable[[slice], Any]) -> list[Any]:
        return for_blocks(lambda start, stop: work(slice(start, stop)), len(self.amplitude), ROWS)


class _Behind:
    """The field on the exit grid, seen on one plane after the other, and what planes change of it.

    Parameters
    ----------
    values
        Of the field; used up.
    pixels
        None for samples at points.
    """

    def __init__(self, values: ComplexArray, pixels: PixelMeans | None) -> None:
        self.pixels = pixels
        self.values: ComplexArray | None = np.atleast_2d(values)
        self._spectrum: ComplexArray | None = None
        self._change: ComplexArray | None = None
        self._spectrum_change: ComplexArray | None = None
        self._rows: tuple[ComplexArray, ComplexArray] | None = None
        if pixels is not None:
            self._spectrum, self.values = self.spectrum, None

    @property
    def spectrum(self) -> ComplexArray:
        """Of the field; computed where it is first needed."""
        if self._spectrum is None:
            assert self.values is not None
            # The values themselves go where pixels integrate, for then no plane needs them.
            self._spectrum = scipy.fft.fftn(self.values, workers=-1, overwrite_x=self.pixels is not None)
        return self._spectrum

    def intensity(self, plane: _Plane) -> RealArray:
        """On a plane: pixels' means, or at points."""
        if self.pixels is not None:
            self._rows = self.pixels.carried(self.spectrum, plane.way, self._rows)
            return self.pixels.intensity(self._rows)
        field = self._samples(plane)
        return np.asarray(field.real**2 + field.imag**2)

    def replace(self, plane: _Plane, scale: float) -> float:
        """Take the amplitudes recorded on a plane, and give the misfit before."""
        if self.pixels is not None:
            change = self.intensity(plane)
            assert self._rows is not None
            missed = plane.change_pixels(change, scale)
            if self._spectrum_change is None:
                self._spectrum_change = np.zeros_like(self.spectrum)
            self.pixels.add_back(self._rows, change, plane.way, self._spectrum_change)
            return missed
        field = self._samples(plane)
        missed = plane.change_samples(field, scale)
        if plane.way.is_none:
            self._change = _added(self._change, field)
        else:
            self._spectrum_change = _added(self._spectrum_change, plane.way.back(field))
        return missed

    def changed(self) -> ComplexArray:
        """The sum of all changes, at the exit; uses up all else, and keeps nothing."""
        self.values = self._spectrum = self._rows = None
        change, spectrum = self._change, self._spectrum_change
        self._change = self._spectrum_change = None
        if spectrum is None:
            assert change is not None
            return change
        return _added(change, scipy.fft.ifftn(spectrum, workers=-1, overwrite_x=True))

    def _samples(self, plane: _Plane) -> ComplexArray:
        if plane.way.is_none:
            assert self.values is not None
            return self.values.copy()
        return plane.way.there(self.spectrum)


def _added(total: ComplexArray | None, part: ComplexArray) -> ComplexArray:
    return part if total is None else np.add(total, part, out=total)
