"""From frames without any lens to the field on z = 0: in-line holograms, lensless cameras, focus stacks."""

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
from wavesim.fields.field import Field, Grid
from wavesim.fields.plane_waves import TransferFunction
from wavesim.scene.bench import Bench
from wavesim.scene.placement import Placement
from wavesim.sensor.frame_sets import PlaneFrames, planes_of_frames, recorded_planes
from wavesim.sensor.frames import Frame
from wavesim.sensor.recording import Progress

ITERATIONS = 600
"""Planes near to each other tell coarse phases slowly: a real series is better predicted up to there."""

PLAIN: dict[str, Any] = {"exposure": 1.0, "bits": 16, "offset_counts": 0.0, "gain_electrons_per_count": 1.0}
"""What frames are taken to be that say nothing of their counts: proportional to intensity."""


NOT_EXPLAINED = 1.5
"""Misfit over that of noise from which on frames are told not to be explained."""


class NotExplainedWarning(UserWarning):
    """Frames differ from what is found behind them by more than their noise."""


@dataclass(frozen=True, eq=False)
class FreeSpaceField:
    """The field on z = 0 behind a stack of frames, and the bench with which it was found.

    Attributes
    ----------
    field : Field
        On the frames' pixels, in units of the recorded amplitude: the object under its light.
    bench : Bench
        How much farther each plane is than its frame says, and where the sensor's middle is on it.
    distance_scale : float
        True over stated distance, over all planes.
    drift : (x, y)
        How far the sensor's middle moves for a stated distance of 1.
    gains : tuple of float
        By which the planes' amplitudes were multiplied to be of one light.
    planes : tuple of PlaneFrames
        What the frames of each plane say.
    correlations : tuple of float
        Of modelled and recorded amplitudes on each plane, without their means.
    misfit : tuple of float
        Relative, before every iteration.
    stack : Stack
        What was recorded, on the samples on which the field was sought.
    samples : ndarray
        The field there.
    """

    field: Field
    bench: Bench
    distance_scale: float
    drift: tuple[float, float]
    gains: tuple[float, ...]
    planes: tuple[PlaneFrames, ...]
    correlations: tuple[float, ...]
    misfit: tuple[float, ...]
    stack: Stack
    samples: ComplexArray

    def amplitude(self, distance_mm: float) -> Array:
        """That the sensor would record on a plane, given or not, at a distance as the stage would state it.

        Raises
        ------
        InputError
            If the distance is not finite.
        """
        if not math.isfinite(distance_mm):
            raise InputError(f"distance_mm = {distance_mm!r}: must be finite")
        x, y = self.drift
        place = x * distance_mm, y * distance_mm
        there = _carried(self.stack, self.samples, self.distance_scale * distance_mm, place)
        return np.asarray(self.stack.unit * np.abs(self.stack.on_pixels(there)), np.float32)

    def figures(self) -> dict[str, Any]:
        """All figures, ready for JSON."""
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
                    "found_distance_mm": plane.distance_mm + self.bench.placement.plane_distance_mm(n),
                    "shift_um": [1e3 * part for part in self.bench.shift_mm(n)],
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
    """Find the field on z = 0 behind frames that free space alone lies before.

    The field is not known beside the frames, nor is the light: what it is without an object is part of the
    field. A shift of all planes along z cannot be told from one of the object.

    Parameters
    ----------
    frames
        Of two planes or more, which state their distances from the object's plane, 0 or negative ones too.
    calibrates
        Whether the scale of distances, each plane's distance and place and its exposure are found too.
    iterations
        How many.
    aperture
        Numerical aperture of the light; left out, that up to which the frames' spectra stand out of noise.
    progress
        Told what is done, how many steps of it are, and of how many; 0 where that is not known.

    Raises
    ------
    InputError
        If frames are of fewer than two planes, or a value is not usable.

    Warns
    -----
    NotExplainedWarning
        If the misfit stays above the frames' noise.
    """
    if iterations < 1:
        raise InputError(f"iterations = {iterations}: must be 1 or more")
    if aperture is not None and not 0.0 < aperture <= 1.0:
        raise InputError(f"numerical_aperture = {aperture!r}: must be above 0, and 1 at most")
    told = planes_of_frames(frames)
    if not told:
        raise InputError("frames: must be two at least")
    tell = progress or (lambda what, done, count: None)
    of_frames = frames[0].settings
    recorded = [
        replace(plane, distance_mm=one.distance_mm)
        for plane, one in zip(recorded_planes(frames), told, strict=True)
    ]
    pitch_mm = 1e-3 * of_frames.pixel_pitch_um
    stack = stack_of(recorded, pitch_mm, of_frames.wavelength_um, aperture)
    planes = at_stated_planes(stack)
    if calibrates:
        tell("scale of distances", 0, 0)
        planes = replace(planes, distances_mm=best_scale(stack) * stack.distances_mm)
    samples, planes, misfit = descend(
        stack,
        planes,
        iterations,
        calibrates=calibrates,
        tell=lambda number, left: tell(f"free space: misfit {left:.5f}", number + 1, iterations),
    )
    if misfit[-1] > NOT_EXPLAINED * stack.noise:
        warnings.warn(
            f"the frames are not explained within their noise: the misfit of {misfit[-1]:.3g} is "
            f"{misfit[-1] / stack.noise:.2g} times what it would leave; leave out one plane and predict it "
            "to see how far the field holds",
            NotExplainedWarning,
            stacklevel=2,
        )
    return _found(stack, samples, planes, told, misfit, Grid(frames[0].counts.shape, pitch_mm, 0.0))


def _found(
    stack: Stack,
    samples: ComplexArray,
    planes: Planes,
    told: tuple[PlaneFrames, ...],
    misfit: list[float],
    pixels: Grid,
) -> FreeSpaceField:
    """With z = 0 and x = y = 0 where the lines through distances and shifts of all planes have them."""
    amplitudes = forward_model(stack, planes).amplitudes(samples)
    stated = stack.distances_mm
    scale, farther = np.polyfit(stated, planes.distances_mm, 1)
    drift, beside = np.polyfit(stated, planes.shifts_mm, 1)
    samples = _carried(stack, samples, float(farther), (float(beside[0]), float(beside[1])))
    shifts_um = 1e3 * (planes.shifts_mm - beside)
    deltas = planes.distances_mm - farther - stated
    bench = Bench(
        Placement(plane_distances_mm=tuple(map(float, deltas))),
        plane_shifts_um=tuple((float(x), float(y)) for x, y in shifts_um),
    )
    values = np.asarray(stack.unit * stack.on_pixels(samples), np.complex64)
    return FreeSpaceField(
        Field(pixels, values, stack.wavelength_um),
        bench,
        float(scale),
        (float(drift[0]), float(drift[1])),
        tuple(map(float, planes.gains)),
        told,
        tuple(
            float(np.corrcoef(plane.amplitude[stack.window].flat, amplitude[stack.window].flat)[0, 1])
            for plane, amplitude in zip(stack.recorded, amplitudes, strict=True)
        ),
        tuple(misfit),
        stack,
        samples,
    )


def _carried(
    stack: Stack, samples: ComplexArray, distance_mm: float, place_mm: tuple[float, float]
) -> NDArray[Any]:
    way = TransferFunction(stack.grid, stack.wavelength_um, distance_mm, np.complex64, place_mm)
    return np.asarray(scipy.fft.ifft2(way.times(scipy.fft.fft2(samples, workers=-1)), workers=-1))
