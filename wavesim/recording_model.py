"""From an object's transmission to the amplitudes recorded behind the lens, and the step back.

Amplitudes a with standard deviations s pull with the weight (least s / s)^2: where s is infinite, nothing is
known and nothing is replaced.

A pixel takes the mean of |u|^2 over its square. The intensity has twice the band of the field, so that the
field is taken twice as densely; means over the square follow from seven samples along each axis. The step is
that of the misfit's gradient: each pixel's ratio of recorded and modelled amplitude is spread over it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.engine import Engine
from wavesim.fields import Field, Grid
from wavesim.free_space import transfer_function
from wavesim.retrieval import Recorded, replace_amplitude, weights_of

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]

TAPS = 3
"""Pairs of samples, at 1/2, 1 and 3/2 of a pixel from its middle, that with it make the mean over it."""

DARK = 1e-6
"""Of a plane's mean intensity: added to recorded and modelled means of pixels, to bound their ratio."""


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
    """

    def __init__(
        self,
        engine: Engine,
        illumination: Field,
        recorded: Sequence[Recorded],
        scale: float | None,
        active_width: float = 0.0,
    ) -> None:
        self.engine, self.illumination, self.recorded = engine, illumination, recorded
        power = np.abs(illumination.values) ** 2
        self.brightest = float(power.max())
        self.lit = (power > 1e-6 * self.brightest).astype(power.dtype)
        self.weights = [
            None if w is None else w.astype(power.dtype, copy=False) for w in weights_of(recorded)
        ]
        grid, dtype = engine.scene.exit_grid, illumination.values.dtype
        self.pixels = PixelMeans(grid, active_width) if active_width > 0.0 else None
        self.ways = [_way(grid, illumination.wavelength_um, p.distance_mm).astype(dtype) for p in recorded]
        self.size = math.sqrt(
            sum(
                _sum(p.amplitude**2 if w is None else w * p.amplitude**2)
                for p, w in zip(recorded, self.weights, strict=True)
            )
        )
        self.scale, self.fits_scale = scale or 1.0, False

    def step(self, transmission: ComplexArray) -> tuple[ComplexArray, float]:
        """The change of the transmission, and the misfit before it."""
        fields, moduli = self._seen(transmission)
        spectrum: ComplexArray | None = None
        missed = 0.0
        planes = zip(fields, moduli, self.ways, self.recorded, self.weights, strict=True)
        for field, modulus, way, plane, weight in planes:
            wanted = (plane.amplitude / self.scale).astype(modulus.dtype, copy=False)
            difference = wanted - modulus
            missed += self.scale**2 * _sum(difference**2 if weight is None else weight * difference**2)
            part = self._back(field, modulus, wanted, weight)
            part *= way.conj()
            spectrum = part if spectrum is None else spectrum + part
        assert spectrum is not None
        return self._to_object(spectrum), math.sqrt(missed) / self.size

    def noise_of_step(self, seed: int = 0) -> float:
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
        random = np.random.default_rng(seed)
        spectrum: ComplexArray = np.zeros(self.engine.scene.exit_grid.shape, self.illumination.values.dtype)
        for plane, weight, way in zip(self.recorded, self.weights, self.ways, strict=True):
            assert plane.sigma is not None
            assert weight is not None
            known = np.isfinite(plane.sigma)
            size = weight * np.where(known, plane.sigma, 0.0) * random.standard_normal(weight.shape)
            noise = size * np.exp(2j * np.pi * random.random(weight.shape))
            spectrum += scipy.fft.fftn(noise.astype(spectrum.dtype), workers=-1) * way.conj()
        change = self._to_object(spectrum)
        return math.sqrt(0.5 * float(np.mean(np.abs(change[self.lit > 0.0]) ** 2, dtype=float)))

    def amplitudes(self, transmission: ComplexArray) -> list[RealArray]:
        """Amplitudes on all planes, in units of the recorded ones."""
        return [self.scale * modulus for modulus in self._seen(transmission)[1]]

    def _seen(self, transmission: ComplexArray) -> tuple[list[ComplexArray], list[RealArray]]:
        """Fields on the planes, as densely as the pixels need them, and amplitudes of the pixels."""
        lit = self.illumination.with_values(transmission * self.illumination.values)
        spectrum = scipy.fft.fftn(self.engine.forward(lit).values, workers=-1)
        if self.pixels is None:
            fields = [scipy.fft.ifftn(spectrum * way, workers=-1, overwrite_x=True) for way in self.ways]
            moduli = [np.abs(field) for field in fields]
        else:
            fields = [self.pixels.densely(spectrum * way) for way in self.ways]
            moduli = [np.sqrt(self.pixels.means(field.real**2 + field.imag**2)) for field in fields]
        if self.fits_scale:
            self._fit_scale(moduli)
        return fields, moduli

    def _to_object(self, spectrum: ComplexArray) -> ComplexArray:
        """Change of the transmission, from the sum over planes of spectra at the exit."""
        back = scipy.fft.ifftn(spectrum, workers=-1, overwrite_x=True) / len(self.ways)
        exit_field = Field(self.engine.scene.exit_grid, back, self.illumination.wavelength_um)
        return np.asarray(
            self.engine.adjoint(exit_field).values * self.illumination.values.conj() / self.brightest
        )

    def _fit_scale(self, moduli: list[RealArray]) -> None:
        met = own = 0.0
        for modulus, plane, weight in zip(moduli, self.recorded, self.weights, strict=True):
            pulling = modulus if weight is None else weight * modulus
            met += float(np.vdot(pulling, plane.amplitude))
            own += float(np.vdot(pulling, modulus))
        self.scale = met / own if met > 0.0 < own else 1.0

    def _back(
        self, field: ComplexArray, modulus: RealArray, wanted: RealArray, weight: RealArray | None
    ) -> ComplexArray:
        """Spectrum of what the replacement of the amplitude changes."""
        if self.pixels is None:
            replaced = field.copy()
            replace_amplitude(replaced, wanted)
            replaced -= field
            if weight is not None:
                replaced *= weight
            return np.asarray(scipy.fft.fftn(replaced, workers=-1, overwrite_x=True))
        dark = np.asarray(DARK * np.mean(wanted**2, dtype=float), modulus.dtype)
        change = np.sqrt((wanted**2 + dark) / (modulus**2 + dark))
        change -= 1.0
        if weight is not None:
            change *= weight
        return self.pixels.coarsely(field * self.pixels.spread(change))


class PixelMeans:
    """Means over the squares of pixels, of fields of which each pixel holds one sample.

    Parameters
    ----------
    grid
        One sample in the middle of each pixel.
    active_width
        As of :class:`RecordingModel`.
    """

    def __init__(self, grid: Grid, active_width: float) -> None:
        self.shape = grid.shape
        self.taps = _taps(active_width)

    def densely(self, spectrum: ComplexArray) -> ComplexArray:
        """Two samples a pixel along each axis: in its middle, and at its upper edge."""
        for axis, count in enumerate(self.shape):
            spectrum = _padded(spectrum, axis, 2 * count)
            spectrum = scipy.fft.ifft(spectrum, axis=axis, workers=-1, overwrite_x=True)
            spectrum *= 2.0
        return spectrum

    def coarsely(self, fine: ComplexArray) -> ComplexArray:
        """Spectrum of fine samples within the pixels' band; undoes :meth:`densely`, and is its adjoint."""
        for axis, count in reversed(list(enumerate(self.shape))):
            fine = scipy.fft.fft(fine, axis=axis, workers=-1, overwrite_x=True)
            fine = 0.5 * _cropped(fine, axis, count)
        return fine

    def means(self, fine: RealArray, signed: bool = False) -> RealArray:
        """Means over the squares of fine samples; never negative."""
        for axis in range(fine.ndim):
            halves = _halves(fine, axis)
            total = self.taps[0] * halves[0]
            for away, tap in enumerate(self.taps[1:], start=1):
                half, (behind, before) = halves[away % 2], _shifts(away)
                total += tap * (np.roll(half, -behind, axis) + np.roll(half, before, axis))
            fine = total
        return fine if signed else np.maximum(fine, 0.0)

    def spread(self, values: RealArray) -> RealArray:
        """The adjoint of :meth:`means`, such that means remain."""
        for axis in reversed(range(values.ndim)):
            shape = list(values.shape)
            shape[axis] *= 2
            fine = np.zeros(shape, values.dtype)
            halves = _halves(fine, axis)
            halves[0][...] = self.taps[0] * values
            for away, tap in enumerate(self.taps[1:], start=1):
                half, (behind, before) = halves[away % 2], _shifts(away)
                half += tap * (np.roll(values, behind, axis) + np.roll(values, -before, axis))
            fine *= 2.0
            values = fine
        return values


def _shifts(away: int) -> tuple[int, int]:
    """How many pixels up and down the samples lie that are so many half pixels away on either side."""
    return away // 2, away - away // 2


def _taps(active_width: float) -> list[float]:
    """Weights of the middle and of pairs of samples, fitted to the pixel's transfer up to twice the band.

    An intensity has less and less towards that end, and so do the fit's weights.
    """
    cycles = np.linspace(0.0, 1.0, 201)
    cosines = 2.0 * np.cos(np.pi * np.outer(cycles, np.arange(1, TAPS + 1)))
    weights = 1.0 - cycles
    # All together make 1: the middle has what the pairs leave.
    found, *_ = np.linalg.lstsq(
        weights[:, None] * (cosines - 2.0), weights * (np.sinc(active_width * cycles) - 1.0), rcond=None
    )
    return [float(tap) for tap in (1.0 - 2.0 * found.sum(), *found)]


def _way(grid: Grid, wavelength_um: float, distance_mm: float) -> ComplexArray:
    way = transfer_function(grid.shape, grid.pitch_mm, wavelength_um, 1.0, distance_mm, band_limit=False)
    return np.asarray(way)


def _halves(fine: RealArray, axis: int) -> tuple[RealArray, RealArray]:
    """Views on the samples in the pixels' middles and at their edges."""
    whole = [slice(None)] * fine.ndim
    return tuple(  # type: ignore[return-value]
        fine[tuple(slice(first, None, 2) if i == axis else part for i, part in enumerate(whole))]
        for first in (0, 1)
    )


def _padded(spectrum: ComplexArray, axis: int, count: int) -> ComplexArray:
    shape = list(spectrum.shape)
    shape[axis] = count
    result = np.zeros(shape, spectrum.dtype)
    for mine, other in _bands(spectrum.shape[axis], count):
        result[_on(axis, other, spectrum.ndim)] = spectrum[_on(axis, mine, spectrum.ndim)]
    return result


def _cropped(spectrum: ComplexArray, axis: int, count: int) -> ComplexArray:
    shape = list(spectrum.shape)
    shape[axis] = count
    result = np.empty(shape, spectrum.dtype)
    for mine, other in _bands(count, spectrum.shape[axis]):
        result[_on(axis, mine, spectrum.ndim)] = spectrum[_on(axis, other, spectrum.ndim)]
    return result


def _bands(few: int, many: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Where the frequencies from 0 on, and those below it, lie in a short and in a long spectrum."""
    positive = (few + 1) // 2
    return (slice(0, positive),) * 2, (slice(positive, few), slice(many - few + positive, many))


def _on(axis: int, part: slice, dimensions: int) -> tuple[slice, ...]:
    return tuple(part if i == axis else slice(None) for i in range(dimensions))


def _sum(values: RealArray) -> float:
    return float(np.sum(values, dtype=float))
