"""From frames without a lens to the field on z = 0: in-line holograms, lensless cameras, focus stacks."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.common.notebook import html_picture, html_table
from lensdesign.errors import InputError
from wavesim.calibration.free_space.descent import (
    Planes,
    at_stated_planes,
    best_scale,
    descend,
    forward_model,
)
from wavesim.calibration.free_space.stack import Array, ComplexArray, Stack, stack_of
from wavesim.fields.angular_spectrum import TransferFunction
from wavesim.fields.field import Field, Grid
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frame_sets import PlaneFrames, planes_of_frames, recorded_planes
from wavesim.sensor.frames import Frame
from wavesim.sensor.recording import Progress

ITERATIONS = 600
"""Default number of iterations.

Planes near each other determine coarse phases slowly. Predictions of a real series improve up to this
number.
"""

DEFAULT_FRAME_SETTINGS: dict[str, Any] = {
    "exposure": 1.0,
    "bits": 16,
    "offset_counts": 0.0,
    "gain_electrons_per_count": 1.0,
}
"""Assumed settings of frames that do not state their counts: counts are proportional to intensity."""


LARGEST_NOISE_RATIO = 1.5
"""Misfit over that of noise above which a warning says that frames are not explained."""


class NotExplainedWarning(UserWarning):
    """Frames differ from the modelled ones by more than their noise."""


@dataclass(frozen=True, eq=False)
class FreeSpaceField:
    """The field on z = 0 behind a stack of frames, and the bench with which it was found.

    Attributes
    ----------
    field : Field
        Field on the frames' pixels, in the unit of the measured amplitude: the object under its light.
    state : SystemState
        Increase of each plane's distance over the stated one, and position of the sensor on it.
    distance_scale : float
        True over stated distance, for all planes.
    drift : (x, y)
        Lateral drift of the sensor per unit of stated distance.
    gains : tuple of float
        Factors that bring the planes' amplitudes to the same light.
    planes : tuple of PlaneFrames
        Distance, exposures and saturation of each plane.
    correlations : tuple of float
        Correlation of modelled and measured amplitudes on each plane, without their means.
    misfit : tuple of float
        Relative misfit before every iteration.
    stack : Stack
        Measured planes on the samples of the search.
    samples : ndarray
        Field on these samples.
    """

    field: Field
    state: SystemState
    distance_scale: float
    drift: tuple[float, float]
    gains: tuple[float, ...]
    planes: tuple[PlaneFrames, ...]
    correlations: tuple[float, ...]
    misfit: tuple[float, ...]
    stack: Stack
    samples: ComplexArray

    def amplitude(self, distance_mm: float) -> Array:
        """Return the amplitude on a plane at a distance in mm as the stage would state it.

        The plane need not be one of the measured planes.

        Raises
        ------
        InputError
            If the distance is not finite.
        """
        if not math.isfinite(distance_mm):
            raise InputError(f"distance_mm = {distance_mm!r}: must be finite")
        x, y = self.drift
        shift_mm = x * distance_mm, y * distance_mm
        propagated = _propagated(self.stack, self.samples, self.distance_scale * distance_mm, shift_mm)
        return np.asarray(self.stack.unit * np.abs(self.stack.on_pixels(propagated)), np.float32)

    def figures(self) -> dict[str, Any]:
        """Return all figures for JSON."""
        return {
            "distance_scale": self.distance_scale,
            "drift": list(self.drift),
            "numerical_aperture": self.stack.aperture,
            "wavelength_um": self.stack.wavelength_um,
            "pixel_pitch_um": 1e3 * self.field.grid.pitch_mm,
            "iterations": len(self.misfit),
            "misfit": self.misfit[-1],
            "misfit_of_noise": self.stack.noise,
            "planes": [
                {
                    "plane_distance_mm": plane.distance_mm,
                    "found_distance_mm": plane.distance_mm + self.state.sensor_pose(n).distance_mm,
                    "shift_um": [1e3 * part for part in self.state.sensor_pose(n).shift_mm],
                    "gain": self.gains[n],
                    "correlation": self.correlations[n],
                }
                for n, plane in enumerate(self.planes)
            ],
        }

    def __repr__(self) -> str:
        return f"FreeSpaceField({', '.join(f'{name} {value}' for name, value in self._rows())})"

    def _repr_html_(self) -> str:
        return html_table("Field behind frames in free space", self._rows(), html_picture(self.field.values))

    def _rows(self) -> list[tuple[str, str]]:
        rows, columns = self.field.grid.shape
        return [
            ("samples", f"{rows} x {columns} of {1e3 * self.field.grid.pitch_mm:.4g} um"),
            ("planes", f"{len(self.planes)}, distances x {self.distance_scale:.4f}"),
            ("iterations", f"{len(self.misfit)}, misfit {self.misfit[-1]:.4f}"),
        ]


def reconstruct_free_space(
    frames: Sequence[Frame],
    *,
    calibrates: bool = False,
    iterations: int = ITERATIONS,
    aperture: float | None = None,
    progress: Progress | None = None,
) -> FreeSpaceField:
    """Find the field on z = 0 behind frames in free space.

    The field outside the frames and the light are unknown. The field includes the light without an object. A
    common shift of all planes along z is equivalent to a shift of the object.

    Parameters
    ----------
    frames
        Frames of two or more planes with distances from the object plane, which may be 0 or negative.
    calibrates
        Whether the scale of distances, and each plane's distance, position and exposure are found, too.
    iterations
        Number of iterations.
    aperture
        Numerical aperture of the light; default: the largest at which the frames' spectra exceed the noise.
    progress
        Callback `progress(stage, completed, total)`; the total is 0 where it is unknown.

    Returns
    -------
    FreeSpaceField
        The field and the bench.

    Raises
    ------
    InputError
        If frames are of fewer than two planes, or a value is invalid.

    Warns
    -----
    NotExplainedWarning
        If the misfit stays above the frames' noise.
    """
    if iterations < 1:
        raise InputError(f"iterations = {iterations}: must be 1 or more")
    if aperture is not None and not 0.0 < aperture <= 1.0:
        raise InputError(f"numerical_aperture = {aperture!r}: must be above 0, and 1 at most")
    plane_frames = planes_of_frames(frames)
    if not plane_frames:
        raise InputError("frames: needs frames of at least two planes")
    progress = progress or (lambda what, done, count: None)
    frame_settings = frames[0].settings
    recorded = [
        replace(plane, distance_mm=frames_of_plane.distance_mm)
        for plane, frames_of_plane in zip(recorded_planes(frames), plane_frames, strict=True)
    ]
    pitch_mm = 1e-3 * frame_settings.pixel_pitch_um
    stack = stack_of(recorded, pitch_mm, frame_settings.wavelength_um, aperture)
    planes = at_stated_planes(stack)
    if calibrates:
        progress("scale of distances", 0, 0)
        planes = replace(planes, distances_mm=best_scale(stack) * stack.distances_mm)
    samples, planes, misfit = descend(
        stack,
        planes,
        iterations,
        calibrates=calibrates,
        progress=lambda index, misfit_now: progress(
            f"free space: misfit {misfit_now:.5f}", index + 1, iterations
        ),
    )
    if misfit[-1] > LARGEST_NOISE_RATIO * stack.noise:
        warnings.warn(
            f"the frames are not explained within their noise: the misfit is {misfit[-1]:.3g}, "
            f"{misfit[-1] / stack.noise:.2g} times that of noise alone; to test the field, omit the frames "
            "of one plane and compare them with its prediction",
            NotExplainedWarning,
            stacklevel=2,
        )
    return _result(stack, samples, planes, plane_frames, misfit, Grid(frames[0].counts.shape, pitch_mm, 0.0))


def _result(
    stack: Stack,
    samples: ComplexArray,
    planes: Planes,
    plane_frames: tuple[PlaneFrames, ...],
    misfit: list[float],
    pixels: Grid,
) -> FreeSpaceField:
    """Return the result, with origins defined by lines through distances and shifts of all planes."""
    amplitudes = forward_model(stack, planes).amplitudes(samples)
    stated = stack.distances_mm
    scale, distance_offset = np.polyfit(stated, planes.distances_mm, 1)
    drift, shift_offset = np.polyfit(stated, planes.shifts_mm, 1)
    samples = _propagated(
        stack, samples, float(distance_offset), (float(shift_offset[0]), float(shift_offset[1]))
    )
    shifts_um = 1e3 * (planes.shifts_mm - shift_offset)
    deltas = planes.distances_mm - distance_offset - stated
    state = SystemState(
        plane_distance_errors_mm=tuple(map(float, deltas)),
        plane_shifts_um=tuple((float(x), float(y)) for x, y in shifts_um),
    )
    values = np.asarray(stack.unit * stack.on_pixels(samples), np.complex64)
    return FreeSpaceField(
        Field(pixels, values, stack.wavelength_um),
        state,
        float(scale),
        (float(drift[0]), float(drift[1])),
        tuple(map(float, planes.gains)),
        plane_frames,
        tuple(
            float(np.corrcoef(plane.amplitude[stack.window].flat, amplitude[stack.window].flat)[0, 1])
            for plane, amplitude in zip(stack.recorded, amplitudes, strict=True)
        ),
        tuple(misfit),
        stack,
        samples,
    )


def _propagated(
    stack: Stack, samples: ComplexArray, distance_mm: float, shift_mm: tuple[float, float]
) -> NDArray[Any]:
    propagator = TransferFunction(stack.grid, stack.wavelength_um, distance_mm, np.complex64, shift_mm)
    return np.asarray(scipy.fft.ifft2(propagator.times(scipy.fft.fft2(samples, workers=-1)), workers=-1))
