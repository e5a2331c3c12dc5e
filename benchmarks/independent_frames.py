"""Frames made with other models than those that reconstruct them.

The light passes the lens by an engine that the reconstruction does not use. Free space, pixels, noise and
counts are computed here: exact angular spectrum in double precision on a padded window, means of 16
sub-samples on every pixel, Poisson and normal noise, rounding.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field
from wavesim.sensor.frames import Frame, FrameSettings
from wavesim.sensor.windows import exit_scene, sensor_window
from wavesim.targets.patch import Patch

PADDING, SUBSAMPLES = 2, 2
"""Width of the padded window over that of the light, and samples per pixel along a side of the engine's grid.
Each of these samples is split into another two along each side.
"""

BITS, OFFSET_COUNTS = 12, 64
FULL_WELL_ELECTRONS, READ_NOISE_ELECTRONS, PEAK_FILL = 10_000.0, 2.0, 0.8


def independent_intensities(
    lens: Lens,
    patch: Patch,
    behind: Field,
    planes_mm: Sequence[float],
    *,
    pose: Pose = Pose(),
    shifts_um: Sequence[tuple[float, float]] = (),
    engine: str = "eikonal",
    error: float | None = 0.003,
) -> list[NDArray[np.floating]]:
    """Return the mean intensity on the pixels of each plane.

    Parameters
    ----------
    lens, patch
        The lens and the patch of its object.
    behind
        Field behind the object, on the patch.
    planes_mm
        Distances of the planes from the exit vertex, increasing.
    pose
        Mounting of the lens.
    shifts_um
        Lateral displacement (x, y) of the sensor on each plane; default: none.
    engine
        Engine from the object to the first plane.
    """
    sensor = sensor_window(lens, patch, planes_mm)
    # As many pixels are added on both sides, so that the pixels of both windows coincide.
    wide = sensor.replaced(pixels=tuple(n + 2 * math.ceil(0.5 * (PADDING - 1) * n) for n in sensor.pixels))
    scene = exit_scene(lens, patch, wide, planes_mm[0], pose, SUBSAMPLES)
    first = engine_for(scene, engine, error=error).forward(behind)
    pitch_mm = first.grid.pitch_mm
    spectrum = scipy.fft.fft2(first.values.astype(complex))
    fy, fx = (scipy.fft.fftfreq(count, pitch_mm) for count in spectrum.shape)
    axial_squared = (1e3 / patch.wavelength_um) ** 2 - fy[:, None] ** 2 - fx[None, :] ** 2
    axial = np.sqrt(np.maximum(axial_squared, 0.0))
    intensities = []
    for index, plane_mm in enumerate(planes_mm):
        x_um, y_um = shifts_um[index] if shifts_um else (0.0, 0.0)
        phase = axial * (plane_mm - planes_mm[0]) + fy[:, None] * 1e-3 * y_um + fx[None, :] * 1e-3 * x_um
        on_plane = np.where(axial_squared > 0.0, spectrum * np.exp(2j * np.pi * phase), 0.0)
        light = np.zeros(spectrum.shape)
        for along_y in (-0.25, 0.25):
            for along_x in (-0.25, 0.25):
                moved = np.exp(2j * np.pi * pitch_mm * (fy[:, None] * along_y + fx[None, :] * along_x))
                light += 0.25 * np.abs(scipy.fft.ifft2(on_plane * moved)) ** 2
        rows, columns = (count // SUBSAMPLES for count in light.shape)
        means = light.reshape(rows, SUBSAMPLES, columns, SUBSAMPLES).mean(axis=(1, 3))
        across, down = sensor.pixels
        top, left = (rows - down) // 2, (columns - across) // 2
        intensities.append(means[top : top + down, left : left + across])
    return intensities


def independent_frames(
    lens: Lens,
    wavelength_um: float,
    planes_mm: Sequence[float],
    intensities: Sequence[NDArray[np.floating]],
    *,
    exposures: Sequence[float] = (1.0,),
    seed: int = 0,
) -> list[Frame]:
    """Return frames with noise, each plane exposed for its brightest pixel, times each exposure."""
    random = np.random.default_rng(seed)
    largest = 2**BITS - 1
    gain = FULL_WELL_ELECTRONS / (largest - OFFSET_COUNTS)
    frames = []
    for plane_mm, intensity in zip(planes_mm, intensities, strict=True):
        for time in exposures:
            exposure = time * PEAK_FILL * FULL_WELL_ELECTRONS / float(intensity.max())
            electrons = random.poisson(intensity * exposure).astype(float)
            electrons += READ_NOISE_ELECTRONS * random.standard_normal(intensity.shape)
            counts = np.clip(np.rint(electrons / gain + OFFSET_COUNTS), 0, largest).astype(np.uint16)
            settings = FrameSettings(
                pixel_pitch_um=lens.sensor.pixel_pitch_um,
                plane_distance_mm=plane_mm,
                wavelength_um=wavelength_um,
                exposure=exposure,
                bits=BITS,
                offset_counts=OFFSET_COUNTS,
                gain_electrons_per_count=gain,
                read_noise_electrons=READ_NOISE_ELECTRONS,
            )
            frames.append(Frame(counts, settings))
    return frames
