"""The image sensor: from a field on a recording plane to the light on its pixels, and to frames of counts.

The expected electrons of a pixel are the mean intensity over its photosensitive square times the exposure.
:mod:`wavesim.sensor.camera_noise` describes noise, clipping and quantisation.
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
from wavesim.sensor.camera_noise import (
    Electronics,
    SaturationWarning,
    Seed,
    expose,
    exposure_for,
    exposure_seeds,
)
from wavesim.sensor.colour_filters import ColourFilters
from wavesim.sensor.frames import Frame, FrameSettings
from wavesim.sensor.pixel_integration import PixelLight
from wavesim.sensor.pixels.non_uniformity import PixelPattern

LOST = 1e-3
"""Fraction of the light outside the sensor above which a warning is issued."""


class FootprintWarning(UserWarning):
    """Warning that a fraction of the light falls outside the sensor."""


def sensor_grid(sensor: Sensor, z_mm: float, oversampling: int = 1) -> Grid:
    """Return a grid with `oversampling` x `oversampling` samples in each pixel, centred on the axis."""
    validate_whole_number("oversampling", oversampling, 1)
    shape = (sensor.pixels[1] * oversampling, sensor.pixels[0] * oversampling)
    return Grid(shape, 1e-3 * sensor.pixel_pitch_um / oversampling, z_mm)


def on_sensor(field: Field, tilt_deg: tuple[float, float] = (0.0, 0.0)) -> Field:
    """Return a field in the coordinates of a sensor that is centred on the field's grid.

    Parameters
    ----------
    field
        Field on a plane perpendicular to the axis.
    tilt_deg : (x, y)
        Tilt of the sensor, see :class:`wavesim.SystemState`.

    Raises
    ------
    SamplingError
        If the sampling is too coarse for a plane with this tilt.
    """
    centred = replace(field.grid, centre_mm=(0.0, 0.0))
    if not any(tilt_deg):
        return replace(field, grid=centred)
    tilted = propagate(field, centred.at(0.0), target_tilt_deg=tilt_deg, coarse_output=True)
    return replace(tilted, grid=centred)


def light_on_pixels(
    field: Field,
    sensor: Sensor,
    *,
    fill_factor: float = 1.0,
    oversampling: int = 2,
    stage_error_mm: float = 0.0,
    shift_um: tuple[float, float] = (0.0, 0.0),
    blur_um: float = 0.0,
) -> Array:
    """Return the mean intensity `|u|^2` on each pixel's photosensitive square.

    A chirp-z transform resamples the field to :func:`sensor_grid` as a band-limited function, including
    shifts by fractions of a pixel, unless the field already has these samples.

    Parameters
    ----------
    field
        Field on a plane.
    sensor
        Pitch and number of pixels.
    fill_factor
        Linear fill factor of a pixel (0 to 1): side of the photosensitive square over the pitch.
    oversampling
        Samples per pixel along each axis. The intensity has twice the bandwidth of the field: 2 samples
        suffice if the angles of the field do not exceed asin(wavelength / (2 index pitch)).
    stage_error_mm
        Distance of the sensor from the field's plane, positive away from the lens.
    shift_um : (x, y)
        Position of the sensor's centre relative to the axis.
    blur_um
        Standard deviation of a blur along x and y, such as by vibration.

    Returns
    -------
    ndarray, shape (ny, nx)
        Mean intensity, in single precision if the field is.

    Raises
    ------
    InputError
        If the field lies on a line or has values that are not finite, if no light falls on the sensor, or
        if a setting is invalid.
    SamplingError
        If the sampling is too coarse for propagation over the stage error.

    Warns
    -----
    FootprintWarning
        If more than the fraction `LOST` of the light falls outside the sensor.
    """
    if field.grid.is_line:
        raise InputError("a sensor records a plane: the field lies on a meridional line")
    if not 0.0 <= fill_factor <= 1.0:
        raise InputError(f"fill_factor = {fill_factor!r}: must be from 0 to 1")
    if (fill_factor > 0.0 or blur_um > 0.0) and oversampling < 2:
        raise InputError(f"oversampling = {oversampling!r}: must be 2 or more for pixels that are not points")
    if not 0.0 <= blur_um < math.inf:
        raise InputError(f"blur_um = {blur_um!r}: must be finite, and 0 or above")
    if not all(math.isfinite(value) for value in (stage_error_mm, *shift_um)):
        raise InputError(f"stage_error_mm = {stage_error_mm!r}, shift_um = {shift_um!r}: must be finite")
    total = field.energy
    if not math.isfinite(total):
        raise InputError("the field has values that are not finite")
    grid = replace(
        sensor_grid(sensor, field.grid.z_mm + stage_error_mm, oversampling),
        centre_mm=(1e-3 * shift_um[0], 1e-3 * shift_um[1]),
    )
    if (part := grid.samples_among(field.grid)) is not None:
        field = Field(grid, field.values[part], field.wavelength_um, field.index)
    elif field.grid != grid:
        field = propagate(field, grid, check=stage_error_mm != 0.0, coarse_output=True)
    blur_pixels = blur_um / sensor.pixel_pitch_um
    light = PixelLight(sensor, field.values.dtype, oversampling, fill_factor, blur_pixels=blur_pixels)
    light.add(slice(0, len(field.values)), np.asarray(field.values))
    warn_of_footprint(light.caught * grid.cell, total, sensor)
    return light.means()


def interference_on_pixels(direct: Field, other: Field, sensor: Sensor, *, fill_factor: float = 1.0) -> Any:
    """Return the complex mean of conj(direct) other on each pixel's photosensitive square, shape (ny, nx).

    Four intensities of sums of the fields give it; for errors see :func:`light_on_pixels`.
    """

    def light(factor: complex) -> Array:
        total = direct.with_values(direct.values + factor * other.values)
        return light_on_pixels(total, sensor, fill_factor=fill_factor)

    return 0.25 * (light(1.0) - light(-1.0) + 1j * (light(-1j) - light(1j)))


def warn_of_footprint(caught: float, total: float, sensor: Sensor) -> None:
    """Warn if a fraction of the energy falls outside the sensor.

    Raises
    ------
    InputError
        If no light falls on the sensor.

    Warns
    -----
    FootprintWarning
        If more than the fraction `LOST` falls outside.
    """
    # Fraction of the light on the sensor up to which it counts as rounding error.
    no_light = 1e-9
    if caught <= no_light * total:
        raise InputError("no light falls on the sensor: the field is dark or outside the sensor")
    lost = 1.0 - caught / total
    if lost > LOST:
        width, height = sensor.size_mm
        warnings.warn(
            f"{100.0 * lost:.2g} % of the light falls outside the sensor of {width:.4g} mm x {height:.4g} mm"
            ": move the plane nearer, centre the sensor, or use a larger one",
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
    """Return the frame that a sensor records of a field.

    Parameters
    ----------
    field, sensor, oversampling, stage_error_mm, shift_um
        See :func:`light_on_pixels`.
    plane_distance_mm
        Distance of the field's plane from the exit vertex. The frame states it, without the stage error.
    electronics, seed
        See :func:`wavesim.sensor.camera_noise.expose`.
    peak_fill
        Expected electrons in the brightest pixel, as a fraction of full well.
    exposure
        Electrons per unit of intensity; replaces `peak_fill`.
    title
        Free text for the frame.

    Raises
    ------
    InputError, SamplingError
        If :func:`light_on_pixels` fails, there is no light, or a setting of the frame is invalid.

    Warns
    -----
    FootprintWarning, SaturationWarning
        If light falls outside the sensor, or pixels are clipped.
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
    colours: ColourFilters | None = None,
) -> tuple[Frame, ...]:
    """Return the frames that a sensor records of one intensity with several exposures.

    Parameters
    ----------
    intensity
        Mean intensity on each pixel, from :func:`light_on_pixels`.
    sensor, plane_distance_mm, electronics, seed, peak_fill
        See :func:`record`. With one exposure the noise is that of :func:`record`.
    wavelength_um
        Vacuum wavelength.
    times
        Exposures relative to the exposure that reaches `peak_fill` in the brightest pixel.
    pattern
        Gain and dark signal of each pixel; default: identical pixels.
    exposure_errors
        Relative errors (true over stated exposure, minus 1); default: no errors.
    colours
        Wavelengths of the light and the responses of the pixels, which the frames state.

    Raises
    ------
    InputError
        If there is no light, `times` is empty, or an exposure or a setting of a frame is invalid.

    Warns
    -----
    SaturationWarning
        If pixels are clipped at an exposure of 1 or less; longer exposures are expected to clip.
    """
    if not times or not all(math.isfinite(time) and time > 0.0 for time in times):
        raise InputError(f"times = {tuple(times)!r}: must be one exposure at least, finite and above 0")
    unit_exposure = exposure_for(intensity, peak_fill * electronics.full_well_electrons)
    frames = []
    errors = exposure_errors or [0.0] * len(times)
    for time, error, frame_seed in zip(times, errors, exposure_seeds(seed, len(times)), strict=True):
        exposure = time * unit_exposure
        settings = _settings(sensor, plane_distance_mm, wavelength_um, electronics, exposure, colours=colours)
        with warnings.catch_warnings():
            if time > 1.0:
                warnings.simplefilter("ignore", SaturationWarning)
            counts = expose(intensity, (1.0 + error) * exposure, electronics, frame_seed, pattern)
            frames.append(Frame(counts, settings))
    return tuple(frames)


def _settings(
    sensor: Sensor,
    plane_distance_mm: float,
    wavelength_um: float,
    electronics: Electronics,
    exposure: float,
    title: str = "",
    colours: ColourFilters | None = None,
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
            colours=colours,
        )
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, f['loc']))}: {f['msg']}" for f in error.errors())
        raise InputError(f"frame settings: {faults}") from None
