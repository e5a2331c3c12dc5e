"""The image sensor: from a field on a recording plane to the light on its pixels, and to frames of counts.

Electrons are the mean intensity over a pixel's photosensitive square times the exposure; what becomes of them
is in :mod:`wavesim.sensor.exposures`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import ValidationError

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_whole_number
from lensdesign.lens.lens import Sensor
from wavesim.fields.field import Field, Grid
from wavesim.fields.propagator import propagate
from wavesim.sensor.exposures import (
    Electronics,
    SaturationWarning,
    Seed,
    expose,
    exposure_for,
    exposure_seeds,
)
from wavesim.sensor.frames import Frame, FrameSettings
from wavesim.sensor.pixel_integration import PixelLight
from wavesim.sensor.pixels.errors import PixelPattern

LOST = 1e-3
"""Share of the light beside the sensor from which on it is told."""
NO_LIGHT = 1e-9
"""Share of the light on the sensor up to which it is taken for rounding."""


class FootprintWarning(UserWarning):
    """A stated share of the light does not fall on the sensor."""


def sensor_grid(sensor: Sensor, z_mm: float, oversampling: int = 1) -> Grid:
    """Samples of a plane such that `oversampling` x `oversampling` of them fill each pixel.

    The sensor's middle is on the axis.
    """
    validate_whole_number("oversampling", oversampling, 1)
    shape = (sensor.pixels[1] * oversampling, sensor.pixels[0] * oversampling)
    return Grid(shape, 1e-3 * sensor.pixel_pitch_um / oversampling, z_mm)


def on_sensor(field: Field, tilt_deg: tuple[float, float] = (0.0, 0.0)) -> Field:
    """A field in the frame of a sensor whose middle is that of the field's grid.

    Parameters
    ----------
    field
        On an upright plane.
    tilt_deg : (x, y)
        Of the sensor, as of :class:`wavesim.scene.Placement`.

    Raises
    ------
    SamplingError
        If the field's samples cannot hold it on a plane so tilted.
    """
    own = replace(field.grid, centre_mm=(0.0, 0.0))
    if not any(tilt_deg):
        return replace(field, grid=own)
    tilted = propagate(field, own.at(0.0), target_tilt_deg=tilt_deg, coarse_output=True)
    return replace(tilted, grid=own)


def light_on_pixels(
    field: Field,
    sensor: Sensor,
    *,
    fill_factor: float = 1.0,
    oversampling: int = 2,
    stage_error_mm: float = 0.0,
    shift_um: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """Mean intensity |u|^2 on each pixel's photosensitive square.

    The field is taken to :func:`sensor_grid` as a band-limited function: by a chirp-z transform, shifts of
    parts of a pixel included, unless it already lies there.

    Parameters
    ----------
    field
        On a plane.
    sensor
        Pitch and number of pixels.
    fill_factor
        Side of the square, as a share of the pitch.
    oversampling
        Samples per pixel along each axis. Intensity has twice the field's band: 2 hold it when the field
        keeps to spread angles that the pixels resolve (asin(wavelength / (2 pitch))).
    stage_error_mm
        How much farther from the lens than the field's plane the sensor stands.
    shift_um : (x, y)
        How far the sensor's middle is off the axis.

    Returns
    -------
    ndarray, shape (ny, nx)
        In single precision if the field is.

    Raises
    ------
    InputError
        If the field is no plane or holds values that are not finite, if none of its light falls on the
        sensor, or a setting is not usable.
    SamplingError
        If the field's samples cannot hold it over the stage error.

    Warns
    -----
    FootprintWarning
        If more than `LOST` of the light falls beside the sensor.
    """
    if field.grid.is_line:
        raise InputError("a sensor records a plane: the field lies on a meridional line")
    if not 0.0 <= fill_factor <= 1.0:
        raise InputError(f"fill_factor = {fill_factor!r}: must be from 0 to 1")
    if fill_factor > 0.0 and oversampling < 2:
        raise InputError(f"oversampling = {oversampling!r}: pixels that are no points take 2 or more")
    if not all(math.isfinite(value) for value in (stage_error_mm, *shift_um)):
        raise InputError(f"stage_error_mm = {stage_error_mm!r}, shift_um = {shift_um!r}: must be finite")
    total = field.energy
    if not math.isfinite(total):
        raise InputError("the field holds values that are not finite")
    grid = replace(
        sensor_grid(sensor, field.grid.z_mm + stage_error_mm, oversampling),
        centre_mm=(1e-3 * shift_um[0], 1e-3 * shift_um[1]),
    )
    if (part := grid.samples_among(field.grid)) is not None:
        field = Field(grid, field.values[part], field.wavelength_um, field.index)
    elif field.grid != grid:
        field = propagate(field, grid, check=stage_error_mm != 0.0, coarse_output=True)
    light = PixelLight(sensor, field.values.dtype, oversampling, fill_factor)
    light.add(slice(0, len(field.values)), np.asarray(field.values))
    warn_of_footprint(light.caught * grid.cell, total, sensor)
    return light.means()


def interference_on_pixels(direct: Field, other: Field, sensor: Sensor, *, fill_factor: float = 1.0) -> Any:
    """Mean of conj(direct) other on each pixel's photosensitive square, shape (ny, nx), complex.

    By the light of their sums, as :func:`light_on_pixels` has it, whose errors are those raised.
    """

    def light(factor: complex) -> Array:
        total = direct.with_values(direct.values + factor * other.values)
        return light_on_pixels(total, sensor, fill_factor=fill_factor)

    return 0.25 * (light(1.0) - light(-1.0) + 1j * (light(-1j) - light(1j)))


def pixel_mtf(frequency_per_mm: Any, sensor: Sensor, fill_factor: float = 1.0) -> Array:
    """Return the modulation transfer of a pixel along one axis: sinc(frequency * pitch * fill factor)."""
    return np.asarray(np.sinc(np.asarray(frequency_per_mm) * 1e-3 * sensor.pixel_pitch_um * fill_factor))


def warn_of_footprint(caught: float, total: float, sensor: Sensor) -> None:
    """Tell how much of the energy falls beside the sensor.

    Raises
    ------
    InputError
        If all of it does.

    Warns
    -----
    FootprintWarning
        If more than `LOST` of it does.
    """
    if caught <= NO_LIGHT * total:
        raise InputError("no light falls on the sensor: the field is dark, or lies beside it")
    lost = 1.0 - caught / total
    if lost > LOST:
        width, height = sensor.size_mm
        warnings.warn(
            f"{100.0 * lost:.2g} % of the light falls beside the sensor of {width:.4g} mm x {height:.4g} mm: "
            "move the plane nearer, centre the sensor, or take a larger one",
            FootprintWarning,
            stacklevel=3,
        )


def record(
    field: Field,
    sensor: Sensor,
    plane_distance_mm: float,
    electronics: Electronics,
    seed: Seed | None,
    *,
    peak_fill: float = 0.8,
    exposure: float | None = None,
    oversampling: int = 2,
    stage_error_mm: float = 0.0,
    shift_um: tuple[float, float] = (0.0, 0.0),
    title: str = "",
) -> Frame:
    """Record a field as a frame.

    Parameters
    ----------
    field, sensor, oversampling, stage_error_mm, shift_um
        As of :func:`light_on_pixels`.
    plane_distance_mm
        Of the field's plane from the exit vertex: what the frame will say, whatever the stage error.
    electronics, seed
        As of :func:`wavesim.sensor.exposures.expose`.
    peak_fill
        Electrons to expect in the brightest pixel, as a share of full well.
    exposure
        Electrons per unit of intensity, in place of that share.
    title
        Free text for the frame.

    Raises
    ------
    InputError, SamplingError
        As of :func:`light_on_pixels`, or if there is no light, or a setting of the frame is not allowed.

    Warns
    -----
    FootprintWarning, SaturationWarning
        If light falls beside the sensor, or pixels are clipped.
    """
    intensity = light_on_pixels(
        field,
        sensor,
        fill_factor=electronics.fill_factor,
        oversampling=oversampling,
        stage_error_mm=stage_error_mm,
        shift_um=shift_um,
    )
    if exposure is None:
        exposure = exposure_for(intensity, peak_fill * electronics.full_well_electrons)
    settings = _settings(sensor, plane_distance_mm, field.wavelength_um, electronics, exposure, title)
    return Frame(expose(intensity, exposure, electronics, seed), settings)


def frames_of_light(
    intensity: Array,
    sensor: Sensor,
    plane_distance_mm: float,
    wavelength_um: float,
    electronics: Electronics,
    seed: Seed | None,
    times: Sequence[float],
    peak_fill: float = 0.8,
    *,
    pattern: PixelPattern | None = None,
    exposure_errors: Sequence[float] = (),
) -> tuple[Frame, ...]:
    """Record light several times, each time with another exposure.

    Parameters
    ----------
    intensity
        Mean on each pixel, as :func:`light_on_pixels` gives it.
    sensor, plane_distance_mm, electronics, seed, peak_fill
        As of :func:`record`. With one exposure the noise is that of :func:`record`.
    wavelength_um
        Of the light, in vacuum.
    times
        Exposures, as multiples of the one that puts `peak_fill` into the brightest pixel.
    pattern
        Of pixels that are not alike.
    exposure_errors
        How much longer each exposure is than its frame says, as a share; left out, they are what frames say.

    Raises
    ------
    InputError
        If there is no light, there are no exposures, or one, or a setting of a frame, is not allowed.

    Warns
    -----
    SaturationWarning
        If pixels are clipped by an exposure of 1 or less; longer ones are meant to clip.
    """
    if not times or not all(math.isfinite(time) and time > 0.0 for time in times):
        raise InputError(f"times = {tuple(times)!r}: must be one exposure at least, finite and above 0")
    least = exposure_for(intensity, peak_fill * electronics.full_well_electrons)
    frames = []
    errors = exposure_errors or [0.0] * len(times)
    for time, error, own in zip(times, errors, exposure_seeds(seed, len(times)), strict=True):
        exposure = time * least
        settings = _settings(sensor, plane_distance_mm, wavelength_um, electronics, exposure)
        with warnings.catch_warnings():
            if time > 1.0:
                warnings.simplefilter("ignore", SaturationWarning)
            counts = expose(intensity, (1.0 + error) * exposure, electronics, own, pattern)
            frames.append(Frame(counts, settings))
    return tuple(frames)


def _settings(
    sensor: Sensor,
    plane_distance_mm: float,
    wavelength_um: float,
    electronics: Electronics,
    exposure: float,
    title: str = "",
) -> FrameSettings:
    try:
        return FrameSettings(
            pixel_pitch_um=sensor.pixel_pitch_um,
            plane_distance_mm=plane_distance_mm,
            wavelength_um=wavelength_um,
            exposure=exposure,
            bits=electronics.bits,
            offset_counts=electronics.offset_counts,
            gain_electrons_per_count=electronics.gain,
            read_noise_electrons=electronics.read_noise_electrons,
            saturation_counts=electronics.saturation_counts,
            title=title,
        )
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, f['loc']))}: {f['msg']}" for f in error.errors())
        raise InputError(f"frame settings: {faults}") from None
