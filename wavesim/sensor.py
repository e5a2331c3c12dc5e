"""The image sensor: from a field on a recording plane to a frame of counts, and back to intensity.

Electrons are the mean intensity over a pixel's photosensitive square times the exposure. They scatter as a
Poisson law says, are clipped at full well, gain the amplifier's noise, and are rounded to counts: the linear
camera model of EMVA standard 1288.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import scipy.fft
from pydantic import Field as Setting
from pydantic import ValidationError

from lensdesign.errors import InputError
from lensdesign.system import Positive, Section, Sensor
from wavesim.chirp_z import propagate_to
from wavesim.fields import Field, Grid
from wavesim.frames import Array, Bits, Frame, FrameSettings, NotNegative, Offset

Seed = int | np.random.SeedSequence

LOST = 1e-3
"""Share of the light beside the sensor from which on it is told."""
NO_LIGHT = 1e-9
"""Share of the light on the sensor up to which it is taken for rounding."""
CLEAR = 3.0
"""Standard deviations of read noise by which a pixel must stay below full well to count as not clipped."""


BLOCK = 1024
"""Rows or columns of which pixels' means are taken at one time."""


class FootprintWarning(UserWarning):
    """A stated share of the light does not fall on the sensor."""


class SaturationWarning(UserWarning):
    """A stated number of pixels is clipped, so that their intensity is only known to be larger."""


class Electronics(Section):
    """How a sensor turns light into counts.

    Attributes
    ----------
    full_well_electrons
        Most electrons that a pixel holds.
    read_noise_electrons
        Standard deviation of the amplifier's noise.
    bits
        Of a count.
    offset_counts
        Added to all counts, so that read noise of dark pixels is not clipped at 0.
    gain_electrons_per_count
        Electrons that raise a pixel by one count; if left out, full well reaches the top count.
    active_width
        Side of a pixel's photosensitive square, as a share of the pitch; 0 is a point.
    """

    full_well_electrons: Positive = 10_000.0
    read_noise_electrons: NotNegative = 2.0
    bits: Bits = 12
    offset_counts: Offset = 64.0
    gain_electrons_per_count: Positive | None = None
    active_width: Annotated[float, Setting(ge=0.0, le=1.0)] = 1.0

    @property
    def gain(self) -> float:
        """Electrons that raise a pixel by one count.

        Raises
        ------
        InputError
            If the offset leaves no counts for light.
        """
        if self.gain_electrons_per_count is not None:
            return self.gain_electrons_per_count
        room = 2**self.bits - 1 - self.offset_counts
        if room <= 0.0:
            raise InputError(f"offset_counts = {self.offset_counts:g}: {self.bits} bits leave none for light")
        return self.full_well_electrons / room

    @property
    def saturation_counts(self) -> int:
        """From which count on a pixel may have been clipped, at full well or at the top count."""
        clear = self.full_well_electrons - CLEAR * self.read_noise_electrons
        return int(min(max(math.floor(self.offset_counts + clear / self.gain), 1), 2**self.bits - 1))


def sensor_grid(sensor: Sensor, z_mm: float, oversampling: int = 1) -> Grid:
    """Samples of a plane such that `oversampling` x `oversampling` of them fill each pixel.

    The sensor's middle is on the axis.
    """
    if not (isinstance(oversampling, int | np.integer) and oversampling >= 1):
        raise InputError(f"oversampling = {oversampling!r}: must be a whole number from 1")
    shape = (sensor.pixels[1] * oversampling, sensor.pixels[0] * oversampling)
    return Grid(shape, 1e-3 * sensor.pixel_pitch_um / oversampling, z_mm)


def light_on_pixels(
    field: Field,
    sensor: Sensor,
    *,
    active_width: float = 1.0,
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
    active_width
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
    if not 0.0 <= active_width <= 1.0:
        raise InputError(f"active_width = {active_width!r}: must be from 0 to 1")
    if active_width > 0.0 and oversampling < 2:
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
        field = propagate_to(field, grid, check=stage_error_mm != 0.0, coarse_output=True)
    values = np.asarray(field.values)
    caught, across = 0.0, np.empty((len(values), sensor.pixels[0]))
    for rows in _blocks(len(values)):
        intensity = np.abs(values[rows]).astype(float) ** 2
        caught += float(intensity.sum())
        across[rows] = _pixel_means(intensity, oversampling, active_width)
    _tell_footprint(caught * grid.cell, total, sensor)
    means = np.empty((sensor.pixels[1], sensor.pixels[0]))
    for columns in _blocks(sensor.pixels[0]):
        means[:, columns] = _pixel_means(across[:, columns].T, oversampling, active_width).T
    # Means of a band-limited function that is never negative may pass 0 by rounding and at clipped edges.
    return np.maximum(means, 0.0, out=means)


def _blocks(count: int) -> Iterator[slice]:
    """Parts of a range, so that a large sensor is not transformed at one time."""
    return (slice(start, start + BLOCK) for start in range(0, count, BLOCK))


def pixel_mtf(frequency_per_mm: Any, sensor: Sensor, active_width: float = 1.0) -> Array:
    """Modulation transfer of a pixel along one axis: sinc(frequency * active width)."""
    return np.asarray(np.sinc(np.asarray(frequency_per_mm) * 1e-3 * sensor.pixel_pitch_um * active_width))


def _pixel_means(fine: Array, oversampling: int, active_width: float) -> Array:
    """Means over pixels along the last axis, by the pixel's transfer on a cosine series.

    The series continues the light mirrored at the window's borders, so that nothing wraps around. At the
    pixels' middles cosines of higher order than there are pixels look like lower ones: these are summed.
    """
    if oversampling == 1:
        return fine
    pixels = fine.shape[-1] // oversampling
    order = np.arange(fine.shape[-1])
    series = scipy.fft.dct(fine, axis=-1) * np.sinc(0.5 * active_width * order / pixels)
    folded = np.zeros((*fine.shape[:-1], pixels))
    for part in range(oversampling):
        block = series[..., part * pixels : (part + 1) * pixels]
        sign = (1.0, -1.0, -1.0, 1.0)[part % 4]
        if part % 2:
            folded[..., 1:] += sign * block[..., :0:-1]
        else:
            folded += sign * block
            if part:  # the series counts its constant once, all others twice
                folded[..., 0] += sign * block[..., 0]
    return np.asarray(scipy.fft.idct(folded, axis=-1) / oversampling)


def _tell_footprint(caught: float, total: float, sensor: Sensor) -> None:
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


def exposure_for(intensity: Array, brightest_electrons: float) -> float:
    """Electrons per unit of intensity at which the brightest pixel is to hold a given number.

    Raises
    ------
    InputError
        If there is no light, or the number is not usable.
    """
    if not (math.isfinite(brightest_electrons) and brightest_electrons > 0.0):
        raise InputError(f"brightest_electrons = {brightest_electrons!r}: must be finite and greater than 0")
    brightest = float(np.max(intensity, initial=0.0))
    exposure = brightest_electrons / brightest if brightest > 0.0 else math.inf
    if not (math.isfinite(exposure) and exposure > 0.0):
        raise InputError(f"the brightest pixel's intensity is {brightest:g}: no light to expose for")
    return exposure


def expose(intensity: Array, exposure: float, electronics: Electronics, seed: Seed | None) -> np.ndarray:
    """Counts of pixels on which a mean intensity falls.

    Parameters
    ----------
    intensity
        Not negative.
    exposure
        Electrons per unit of intensity.
    electronics
        Full well, noise and quantisation.
    seed
        Of the noise; None gives the counts of the mean, rounded, without noise.

    Returns
    -------
    ndarray of uint16, of the shape of `intensity`

    Warns
    -----
    SaturationWarning
        If pixels are clipped, at full well or at the top count.
    """
    electrons = np.asarray(intensity, float) * exposure
    if not (np.all(np.isfinite(electrons)) and np.all(electrons >= 0.0)):
        raise InputError("the electrons to expect must be finite and not negative in all pixels")
    full = electronics.full_well_electrons
    if seed is not None:
        random = _generator(seed)
        # Beyond twice full well all is clipped, and Poisson numbers have no upper end.
        electrons = random.poisson(np.minimum(electrons, 2.0 * full + 100.0)).astype(float)
    clipped = electrons > full
    electrons = np.minimum(electrons, full)
    if seed is not None:
        electrons += electronics.read_noise_electrons * random.standard_normal(electrons.shape)
    counts = np.rint(electrons / electronics.gain + electronics.offset_counts)
    top = 2**electronics.bits - 1
    number = int(np.count_nonzero(clipped | (counts > top)))
    if number:
        warnings.warn(
            f"{number} of {counts.size} pixels are saturated: expose less", SaturationWarning, stacklevel=2
        )
    return np.clip(counts, 0, top).astype(np.uint16)


def _generator(seed: Seed) -> np.random.Generator:
    try:
        return np.random.Generator(np.random.PCG64(seed))
    except (TypeError, ValueError):
        raise InputError(f"seed = {seed!r}: must be a whole number from 0, or a SeedSequence") from None


def record(
    field: Field,
    sensor: Sensor,
    plane_distance_mm: float,
    electronics: Electronics,
    seed: Seed | None,
    *,
    brightest_share: float = 0.8,
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
        As of :func:`expose`.
    brightest_share
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
        active_width=electronics.active_width,
        oversampling=oversampling,
        stage_error_mm=stage_error_mm,
        shift_um=shift_um,
    )
    if exposure is None:
        exposure = exposure_for(intensity, brightest_share * electronics.full_well_electrons)
    settings = _settings(
        pixel_pitch_um=sensor.pixel_pitch_um,
        plane_distance_mm=plane_distance_mm,
        wavelength_um=field.wavelength_um,
        exposure=exposure,
        bits=electronics.bits,
        offset_counts=electronics.offset_counts,
        gain_electrons_per_count=electronics.gain,
        read_noise_electrons=electronics.read_noise_electrons,
        saturation_counts=electronics.saturation_counts,
        title=title,
    )
    return Frame(expose(intensity, exposure, electronics, seed), settings)


def _settings(**values: Any) -> FrameSettings:
    try:
        return FrameSettings(**values)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, f['loc']))}: {f['msg']}" for f in error.errors())
        raise InputError(f"frame settings: {faults}") from None


def plane_seeds(seed: int | None, planes: int) -> Sequence[Seed | None]:
    """Independent seeds for frames of several planes: one seed for all would repeat the noise."""
    return [None] * planes if seed is None else np.random.SeedSequence(seed).spawn(planes)


def estimate_intensity(frame: Frame) -> tuple[Array, Array]:
    """Intensity on each pixel and the variance of its error, from a frame.

    The variance is that of shot noise, read noise and rounding (one twelfth of a count squared). The
    estimate may be negative where it is dark, so that means are not biased.

    Returns
    -------
    intensity, variance : ndarray, shape (ny, nx)
        The variance is infinite in pixels that may have been clipped.
    """
    settings = frame.settings
    gain = settings.gain_electrons_per_count
    electrons = (frame.counts.astype(float) - settings.offset_counts) * gain
    fixed = settings.read_noise_electrons**2 + gain**2 / 12.0
    variance = np.where(frame.saturated, np.inf, (np.maximum(electrons, 0.0) + fixed) / settings.exposure**2)
    return electrons / settings.exposure, variance
