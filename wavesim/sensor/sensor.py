"""The image sensor: from a field on a recording plane to the light on its pixels, and to frames of counts.

The expected electrons of a pixel are the mean intensity over its photosensitive square times the exposure.
:mod:`wavesim.sensor.camera_noise` describes noise, clipping and quantisation.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from functools import cached_property
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
from wavesim.sensor.pixels.non_uniformity import ALIKE, PixelErrors, PixelPattern

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


@dataclass(frozen=True)
class Camera:
    """A sensor with its electronics and pixels, and the exposures of each plane.

    Attributes
    ----------
    sensor : Sensor
        Pitch and number of pixels.
    electronics : Electronics
        Full well, noise and quantisation.
    exposures : tuple of float
        Exposures of the frames of each plane, relative to the exposure that reaches `peak_fill`.
    peak_fill : float
        Expected electrons in the brightest pixel at an exposure of 1, as a fraction of full well.
    exposure_errors : tuple of float
        Relative errors (true over stated exposure, minus 1) of each exposure; default: no errors.
    pixel_errors : PixelErrors
        Non-uniformity of the pixels.
    colours : ColourFilters or None
        Wavelengths that are recorded at once, and the responses of the pixels; None for one wavelength.

    Raises
    ------
    InputError
        If there is no exposure, or one is not finite and above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from lensdesign import Sensor
    >>> from wavesim.sensor import Camera, Electronics
    >>> sensor = Sensor(pixel_pitch_um=3.0, pixels=(4, 4), plane_distances_mm=(1.0,))
    >>> camera = Camera(sensor, Electronics(), exposures=(0.5, 1.0))
    >>> [int(frame.counts[0, 0]) for frame in camera.frames(np.ones((4, 4)), 1.0, 0.532, seed=None)]
    [1676, 3289]
    """

    sensor: Sensor
    electronics: Electronics
    exposures: tuple[float, ...] = (1.0,)
    peak_fill: float = 0.8
    exposure_errors: tuple[float, ...] = ()
    pixel_errors: PixelErrors = ALIKE
    colours: ColourFilters | None = None

    def __post_init__(self) -> None:
        if not self.exposures or not all(math.isfinite(one) and one > 0.0 for one in self.exposures):
            raise InputError(
                f"exposures = {self.exposures!r}: must be one exposure at least, finite and above 0"
            )

    @cached_property
    def pattern(self) -> PixelPattern | None:
        """Gain and dark signal of each pixel; None if all pixels are ideal."""
        return self.pixel_errors.pattern(self.sensor.pixels[::-1], self.electronics.full_well_electrons)

    def frames(
        self,
        intensity: Array,
        plane_distance_mm: float,
        wavelength_um: float,
        seed: Seed | None,
        exposure_error: float = 0.0,
    ) -> tuple[Frame, ...]:
        """Return the frames of the light on one plane, one for each exposure.

        Parameters
        ----------
        intensity
            Mean intensity on each pixel, from :func:`light_on_pixels`.
        plane_distance_mm
            Distance of the plane from the exit vertex, which the frames state.
        wavelength_um
            Vacuum wavelength.
        seed
            Seed of the noise; None for frames without noise. A single exposure uses it as it is.
        exposure_error
            Further relative error of all exposures.

        Raises
        ------
        InputError
            If there is no light, or an exposure or a setting of a frame is invalid.

        Warns
        -----
        SaturationWarning
            If pixels are clipped at an exposure of 1 or less; longer exposures are expected to clip.
        """
        count, of_plane = len(self.exposures), 1.0 + exposure_error
        unit = exposure_for(intensity, self.peak_fill * self.electronics.full_well_electrons)
        errors, seeds = self.exposure_errors or (0.0,) * count, exposure_seeds(seed, count)
        frames = []
        for relative, error, frame_seed in zip(self.exposures, errors, seeds, strict=True):
            settings = self._settings(plane_distance_mm, wavelength_um, relative * unit)
            true = (1.0 + ((1.0 + error) * of_plane - 1.0)) * (relative * unit)
            with warnings.catch_warnings():
                if relative > 1.0:
                    warnings.simplefilter("ignore", SaturationWarning)
                counts = expose(intensity, true, self.electronics, frame_seed, self.pattern)
            frames.append(Frame(counts, settings))
        return tuple(frames)

    def _settings(self, plane_distance_mm: float, wavelength_um: float, exposure: float) -> FrameSettings:
        electronics = self.electronics
        try:
            return FrameSettings(
                pixel_pitch_um=self.sensor.pixel_pitch_um,
                plane_distance_mm=plane_distance_mm,
                wavelength_um=wavelength_um,
                exposure=exposure,
                bits=electronics.bits,
                offset_counts=electronics.offset_counts,
                gain_electrons_per_count=electronics.gain,
                read_noise_electrons=electronics.read_noise_electrons,
                saturation_counts=electronics.saturation_counts,
                colours=self.colours,
            )
        except ValidationError as error:
            faults = "; ".join(f"{'.'.join(map(str, f['loc']))}: {f['msg']}" for f in error.errors())
            raise InputError(f"frame settings: {faults}") from None
