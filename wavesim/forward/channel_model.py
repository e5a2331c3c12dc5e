"""Forward model of channels: light that does not interfere, summed by the pixels of each plane.

A channel is the light of one wavelength, direction and polarization. It passes one of the unknown
transmissions. A pixel measures the sum over the channels of response times mean intensity. The responses
state how the light was recorded:

- one coherent light: a single channel;
- an extended or polychromatic source: its modes, with their fractions of the energy;
- several wavelengths in turn: on each plane, one wavelength has a response;
- several wavelengths at once on a monochrome sensor: all pixels have the same responses;
- several wavelengths through a colour filter array: the responses differ from pixel to pixel, as the filters
  do. The mosaic is used as it is, without an interpolation of missing colours.

Amplitudes with standard deviations s have the weight (s of a plane's brightest pixel / s)^2, at most 1
(:func:`wavesim.sensor.measurement.weights_of`). A pixel with infinite s has no influence.

A pixel measures the mean of `|u|^2` over its square. The step follows the gradient of the misfit: each
pixel's ratio of measured to modelled amplitude is spread over its square, and changes each channel's field in
proportion to the pixel's response. With responses of at most 1, the Hessian is at most 1 for the mean over
the planes that a transmission has reached. Planes of a single channel are processed one after the other, so
that only one plane's fields are in memory.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
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
from wavesim.forward.pixel_means import LinePixelMeans, PixelMeans, Rows
from wavesim.runtime.scratch import Scratch
from wavesim.runtime.threads import for_blocks
from wavesim.scene.engine import Engine, Operator
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement, full_weight_sigma, weights_of

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]
Response = float | RealArray
"""Response of the pixels of a plane to a channel, from 0 to 1: one value, or one for each pixel."""

KEPT_BYTES = 2**28
"""Size of fields on the planes up to which they are kept from the modelled amplitudes to the changes."""


class Channel(NamedTuple):
    """Light that does not interfere with that of other channels.

    Attributes
    ----------
    engine : Operator
        Operator from the object grid to the exit grid for the wavelength (and component) of the channel.
    illumination : Field
        Light on the object, or that of the middle of the source to which a mode belongs.
    responses : sequence
        For each plane, the response of its pixels.
    transmission : int
        Index of the transmission that the light passes.
    mode : SourceMode or None
        Mode of a source.
    """

    engine: Operator
    illumination: Field
    responses: Sequence[Response]
    transmission: int = 0
    mode: SourceMode | None = None

    def on(self, light: Field) -> Field:
        """Return light of the middle of the source, changed to that of the channel."""
        return light if self.mode is None else self.mode.on(light)

    @property
    def wavelength_um(self) -> float:
        """Wavelength of the channel."""
        return self.illumination.wavelength_um if self.mode is None else self.mode.wavelength_um


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


@dataclass(frozen=True, eq=False)
class ChannelModel:
    """Channels, propagators to each plane, and the measured data; made by :meth:`of` and :meth:`of_source`.

    A transmission is an array on the object grid. Where channels pass different ones, their arrays are
    stacked: (transmissions, ny, nx).

    Attributes
    ----------
    channels : tuple of Channel
        Channels; all have the same object grid and the same exit grid.
    engine, illumination
        Operator and light of the middle of the source, or of the first channel.
    recorded : sequence of Measurement
        Measured amplitudes of the planes.
    rows : sequence of slice
        For each plane, the rows of the exit grid in which the engine gives the field on its pixels. The
        pixels are then points, and planes lie at distance 0. Without rows, planes are reached through free
        space from the whole grid.
    fill_factor : float
        Linear fill factor of a pixel (side of its photosensitive square over the pitch); 0 means a point.
    scale : float
        Measured amplitude per unit of the modelled amplitude, where a step states no scale of its own.
    pixels : PixelMeans or None
        Pixels that integrate; None for samples of one channel at points.
    propagators : tuple of tuple
        For each channel, the propagators from the exit grid to all planes; None to those that do not record
        it.
    planes : tuple of PlaneRecord
        Measured data in the model's precision.
    lit : ndarray of bool
        Samples of the transmission with light.
    peak_powers, passes : tuple of float
        For each transmission, the largest power of its light, and the sum over planes and channels of the
        largest response (1 if no plane has recorded it).
    channel_passes : tuple of float
        The same sum for each channel.
    size : float
        Weighted length of the measured amplitudes.
    """

    channels: tuple[Channel, ...]
    engine: Operator
    illumination: Field
    recorded: Sequence[Measurement]
    rows: Sequence[slice]
    fill_factor: float
    scale: float
    pixels: PixelMeans | None
    propagators: tuple[tuple[PlanePropagator | None, ...], ...]
    planes: tuple[PlaneRecord, ...]
    lit: NDArray[np.bool_]
    peak_powers: tuple[float, ...]
    passes: tuple[float, ...]
    channel_passes: tuple[float, ...]
    size: float

    @classmethod
    def of(
        cls,
        channels: Sequence[Channel],
        recorded: Sequence[Measurement],
        scale: float | None,
        fill_factor: float = 0.0,
        *,
        scratch: Scratch | None = None,
        rows: Sequence[slice] = (),
        engine: Operator | None = None,
    ) -> ChannelModel:
        """Return the model of some channels.

        Parameters
        ----------
        channels, recorded, fill_factor, rows
            See the attributes.
        scale
            Measured amplitude per unit of the modelled amplitude; None means 1.
        scratch
            Storage of arrays that persist; default: memory.
        engine
            Operator of the middle of the source; default: that of the first channel.
        """
        engine, illumination = engine or channels[0].engine, channels[0].illumination
        blur_mm = recorded[0].blur_mm
        if any(plane.blur_mm != blur_mm for plane in recorded):
            raise InputError("recorded: blur_mm differs between planes: must be equal on all planes")
        lights = {one.transmission: one.illumination for one in reversed(channels)}
        lit, peaks = zip(*(_lit(lights[index]) for index in range(len(lights))), strict=True)
        grid, dtype = engine.scene.exit_grid, illumination.values.dtype
        real = np.dtype(dtype.type(0).real.dtype)
        blur_pixels = blur_mm / grid.pitch_mm
        channel_passes = tuple(sum(float(np.max(r)) for r in one.responses) or 1.0 for one in channels)
        channels = [
            one._replace(responses=[np.asarray(response, real) for response in one.responses])
            for one in channels
        ]
        means = PixelMeans if len(grid.shape) == 2 else LinePixelMeans
        needs_means = fill_factor > 0.0 or blur_pixels > 0.0 or len(channels) > 1
        of_wavelengths: dict[float, tuple[PlanePropagator, ...]] = {}
        for wavelength_um in {one.wavelength_um: None for one in channels}:
            of_wavelengths[wavelength_um] = tuple(
                propagator_to(grid, wavelength_um, p.distance_mm, dtype, p.shift_mm, p.tilt_deg)
                for p in recorded
            )
        propagators = tuple(
            tuple(
                one if np.any(response) else None
                for one, response in zip(
                    of_wavelengths[channel.wavelength_um], channel.responses, strict=True
                )
            )
            for channel in channels
        )
        passes = [0.0] * len(lights)
        for channel, own in zip(channels, channel_passes, strict=True):
            passes[channel.transmission] += own
        largest_sigma = full_weight_sigma(recorded)
        planes = tuple(
            PlaneRecord.of(
                measurement,
                next(iter(of_wavelengths.values()))[index],
                rows[index] if rows else ALL_ROWS,
                largest_sigma,
                real,
                scratch or Scratch(),
            )
            for index, measurement in enumerate(recorded)
        )
        return cls(
            channels=tuple(channels),
            engine=engine,
            illumination=illumination,
            recorded=recorded,
            rows=rows,
            fill_factor=fill_factor,
            scale=scale or 1.0,
            pixels=means(grid, fill_factor, blur_pixels) if needs_means else None,
            propagators=propagators,
            planes=planes,
            lit=lit[0] if len(lights) == 1 else np.stack(lit),
            peak_powers=peaks,
            passes=tuple(passes),
            channel_passes=channel_passes,
            size=math.sqrt(sum(plane.energy for plane in planes)),
        )

    @classmethod
    def of_source(
        cls,
        engine: Operator,
        illumination: Field,
        recorded: Sequence[Measurement],
        scale: float | None,
        fill_factor: float = 0.0,
        scratch: Scratch | None = None,
        modes: Sequence[SourceMode] = (),
        rows: Sequence[slice] = (),
    ) -> ChannelModel:
        """Return the model of one coherent light, or of the modes of an extended or polychromatic source.

        Other wavelengths than the illumination's have their own engines
        (:meth:`wavesim.scene.engine.Engine.at_wavelength`).
        """
        channels = [Channel(engine, illumination, (1.0,) * len(recorded))]
        if len(modes) > 1:
            engine_of = _engines(engine, illumination.wavelength_um, modes)
            channels = [
                Channel(engine_of(mode), illumination, (mode.weight,) * len(recorded), mode=mode)
                for mode in modes
            ]
        return cls.of(channels, recorded, scale, fill_factor, scratch=scratch, rows=rows, engine=engine)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Data type of fields."""
        return self.illumination.values.dtype

    @property
    def real(self) -> np.dtype[Any]:
        """Data type of amplitudes."""
        return self.planes[0].amplitude.dtype

    @property
    def modes(self) -> list[SourceMode]:
        """Modes of the source; empty for one coherent light."""
        return [one.mode for one in self.channels if one.mode is not None]

    @property
    def weights(self) -> list[RealArray | None]:
        """Weights of the pixels of all planes; None where all weights are 1."""
        return [None if w is None else w.astype(self.real, copy=False) for w in weights_of(self.recorded)]

    def with_scale(self, scale: float) -> ChannelModel:
        """Return the model with another scale; all arrays are shared."""
        return replace(self, scale=scale)

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

        A single iteration gives the negative gradient of half the squared misfit, divided by the peak power
        of the light and by `passes`. With more inner iterations the field behind the lens descends the misfit
        by itself, each time by a step of this length, and the sum of its changes is propagated back to the
        object. Planes cost little, and the propagation through the lens costs much.

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
            plane before has left. Several channels use all planes at once.
        """
        if len(self.channels) > 1:
            return self._step_of_channels(transmission, inner_iterations, length, scale, fits_scale)
        (channel,) = self.channels
        exit_field = ExitField(self._at_exit(transmission, channel), self.pixels)
        if scale is None and fits_scale:
            scale = fitted_scale(plane.products(exit_field.intensity(plane)) for plane in self.planes)
        scale = scale or self.scale
        sums = [
            exit_field.replace_amplitudes(plane, scale, with_products=fits_scale) for plane in self.planes
        ]
        next_scale = scale
        if fits_scale:  # for the next steps, so that planes are not propagated for the scale alone
            next_scale = fitted_scale((plane_sums.cross, plane_sums.power) for plane_sums in sums)
        fraction = length / len(self.recorded)
        for index in range(inner_iterations - 1):
            if index == 0 or not planes_in_turn:
                exit_field.advance(fraction)
            for plane in self.planes:
                exit_field.replace_amplitudes(plane, next_scale)
                if planes_in_turn:
                    exit_field.advance(1.0, 1.0 / fraction)
        change = self._adjoint_to_object(exit_field.take_change(), channel)
        misfit = scale * math.sqrt(sum_of_parts(sums).squared_misfit) / self.size
        return Step(change, misfit, next_scale)

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
        scale = fitted_scale(map(PlaneRecord.products, self.planes, intensities()))
        return list(self._scaled_amplitudes(intensities(), scale)), scale

    def _plane_intensities(self, transmission: NDArray[Any]) -> Callable[[], Iterator[RealArray]]:
        """Return a function that yields the intensity on each plane, one after the other."""
        if len(self.channels) > 1:
            spectra = self.spectra(transmission)
            return lambda: (self.intensity(index, spectra) for index in range(len(self.planes)))
        exit_field = ExitField(self._at_exit(transmission, self.channels[0]), self.pixels)
        return lambda: (exit_field.intensity(plane) for plane in self.planes)

    def _scaled_amplitudes(self, intensities: Iterable[RealArray], scale: float) -> Iterator[RealArray]:
        for plane, measurement, intensity in zip(self.planes, self.recorded, intensities, strict=True):
            intensity *= intensity.dtype.type(scale**2)
            if plane.background.size:
                intensity += plane.background
            np.sqrt(intensity, out=intensity)
            yield intensity.reshape(measurement.amplitude.shape)

    def _step_of_channels(
        self,
        transmission: NDArray[Any],
        inner_iterations: int,
        length: float,
        scale: float | None,
        fits_scale: bool,
    ) -> Step:
        spectra, squared_misfit = self.spectra(transmission), 0.0
        totals = [np.zeros_like(spectrum) for spectrum in spectra]
        for iteration in range(inner_iterations):
            kept: list[dict[int, Rows]] = [{} for _ in self.planes]
            ratios = [self.intensity(index, spectra, rows) for index, rows in enumerate(kept)]
            if iteration == 0 and fits_scale:
                scale = fitted_scale(map(PlaneRecord.products, self.planes, ratios))
            scale = scale or self.scale
            misfits = [plane.change_pixels(r, scale) for plane, r in zip(self.planes, ratios, strict=True)]
            squared_misfit = squared_misfit if iteration else sum(misfits)
            for index, (spectrum, total) in enumerate(zip(spectra, totals, strict=True)):
                change = np.zeros_like(spectrum)
                self.add_adjoint(index, spectrum, ratios, change, kept)
                add_fraction(spectrum, change, length / self.channel_passes[index])
                total += change
        del spectra
        change = self.to_transmission(totals)
        assert scale is not None
        return Step(change, scale * math.sqrt(squared_misfit) / self.size, scale)

    def spectra(self, transmission: NDArray[Any]) -> list[ComplexArray]:
        """Return the spectrum of each channel's field on the exit grid."""
        return [
            scipy.fft.fftn(
                self._at_exit(self._part(transmission, one), one),
                workers=-1,
                overwrite_x=True,
            ).astype(self.dtype, copy=False)
            for one in self.channels
        ]

    def intensity(
        self, plane: int, spectra: Sequence[ComplexArray], kept: dict[int, Rows] | None = None
    ) -> RealArray:
        """Return the light that the pixels of a plane measure.

        Where `kept` is given, it takes the rows of the channels' fields, if those of all are not too large.
        """
        assert self.pixels is not None
        total, rows = np.zeros(self.planes[plane].amplitude.shape, self.real), None
        if 2 * sum(spectrum.nbytes for spectrum in spectra) * len(self.planes) > KEPT_BYTES:
            kept = None
        for index, (channel, spectrum) in enumerate(zip(self.channels, spectra, strict=True)):
            propagator = self.propagators[index][plane]
            if propagator is not None:
                rows = self.pixels.propagate(spectrum, propagator, rows)
                total += channel.responses[plane] * self.pixels.intensity(rows)
                if kept is not None:
                    kept[index], rows = rows, None
        return total

    def add_adjoint(
        self,
        index: int,
        spectrum: ComplexArray,
        ratios: Sequence[RealArray],
        change: ComplexArray,
        kept: Sequence[dict[int, Rows]] = (),
    ) -> None:
        """Add relative changes of a channel's field on all planes to a spectrum in front of them."""
        assert self.pixels is not None
        rows = None
        for plane, (propagator, ratio) in enumerate(zip(self.propagators[index], ratios, strict=True)):
            if propagator is None:
                continue
            own = kept[plane].pop(index, None) if kept else None
            if own is None:
                own = rows = self.pixels.propagate(spectrum, propagator, rows)
            self.pixels.add_adjoint(own, self.channels[index].responses[plane] * ratio, propagator, change)

    def to_transmission(self, spectra: list[ComplexArray]) -> ComplexArray:
        """Return the change of the transmission due to changes of the spectra, which are given up."""
        result = np.zeros(self.lit.shape, self.dtype)
        for channel in self.channels:
            exit_field = scipy.fft.ifftn(spectra.pop(0), workers=-1, overwrite_x=True)
            part = self._part(result, channel)
            part += self._adjoint_to_object(exit_field, channel)
        return result

    def _part(self, values: NDArray[Any], channel: Channel) -> NDArray[Any]:
        """Return the transmission that a channel passes, as a view of all transmissions."""
        return values[channel.transmission] if len(self.passes) > 1 else values

    def _at_exit(self, transmission: NDArray[Any], channel: Channel) -> ComplexArray:
        """Return the field of a channel on the exit grid."""
        light = channel.on(channel.illumination)
        lit = light.with_values(np.multiply(transmission, light.values))
        return np.asarray(channel.engine.forward(lit).values, self.dtype)

    def _adjoint_to_object(self, change: ComplexArray, channel: Channel) -> ComplexArray:
        """Return the change of the transmission due to a change on the exit grid, which is overwritten."""
        light, grid = channel.on(channel.illumination), self.engine.scene.exit_grid
        field, values = Field(grid, change.reshape(grid.shape), light.wavelength_um), light.values
        result = np.require(channel.engine.adjoint(field).values, self.dtype, ["W"])
        fraction = 1.0 / (self.peak_powers[channel.transmission] * self.passes[channel.transmission])

        def rows(start: int, stop: int) -> None:
            result[start:stop] *= values[start:stop].conj() * fraction

        for_blocks(rows, len(result), ROWS)
        return result


def _lit(illumination: Field) -> tuple[NDArray[np.bool_], float]:
    """Return where there is light on the object, and its largest power."""
    power = np.abs(illumination.values)
    power *= power
    peak = float(power.max())
    return power > 1e-6 * peak, peak


def _engines(
    engine: Operator, wavelength_um: float, modes: Sequence[SourceMode]
) -> Callable[[SourceMode], Operator]:
    """Return a function that returns the operator of a mode; those of a wavelength share one engine."""
    whole = {wavelength_um: engine}

    def engine_of(mode: SourceMode) -> Operator:
        if mode.wavelength_um not in whole:
            assert isinstance(engine, Engine)
            whole[mode.wavelength_um] = engine.at_wavelength(mode.wavelength_um)
        of_wavelength = whole[mode.wavelength_um]
        if mode.component is None:
            return of_wavelength
        assert isinstance(of_wavelength, Engine)
        return of_wavelength.component(mode.component)

    return engine_of


def fitted_scale(products: Iterable[tuple[float, float]]) -> float:
    """Return the scale that fits best, from each plane's sums of measured times modelled amplitude, and of
    modelled intensity.
    """
    cross = power = 0.0
    for plane_cross, plane_power in products:
        cross, power = cross + plane_cross, power + plane_power
    return cross / power if cross > 0.0 < power else 1.0
