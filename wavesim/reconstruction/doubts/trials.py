"""What may differ where frames are not explained: each is changed, and a few iterations tell what helps.

Shifts are those of the recorded intensities against the modelled ones, by their cross-correlation; a tilt of
the light is the one that would shift the planes so.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavesim.camera.recorded import Recorded
from wavesim.evaluation.verdicts import Trial
from wavesim.fields.field import Field
from wavesim.reconstruction.from_object import Kind, Reconstructed, reconstruct
from wavesim.reconstruction.recording_model import RecordingModel
from wavesim.scene.bench import LightErrors
from wavesim.scene.engine import Engine
from wavesim.scene.source import SourceMode

Array = NDArray[np.floating[Any]]
Shifts = Sequence[tuple[float, float]]

ITERATIONS = 6
"""Of each trial."""

LEAST_SHIFT_PIXELS, LEAST_BACKGROUND = 0.15, 2e-3
"""From which a shift of a plane, and a background over the mean intensity, are tried."""

STRETCHES = (-0.15, -0.05, -0.015, 0.015, 0.05, 0.15)
"""Of the distance between the first plane and the others, that are tried."""

DARK = 1e-3
"""Of the brightest modelled intensity, below which what is recorded tells the background."""


class Change(NamedTuple):
    """What is changed: a cause and what to say of it, light and planes."""

    cause: str
    told: str
    light: Field
    recorded: Sequence[Recorded]


@dataclass(frozen=True, eq=False)
class Doubts:
    """What is doubted, and how a trial is made.

    Parameters
    ----------
    engine, light, recorded, kind, tv_weight, scale, active_width, modes
        As of :func:`wavesim.reconstruct`.
    maps
        What the result leaves of the planes.
    """

    engine: Engine
    light: Field
    recorded: Sequence[Recorded]
    maps: Sequence[Array]
    kind: Kind
    tv_weight: float | Literal["auto"]
    scale: float | None
    active_width: float
    modes: Sequence[SourceMode] = ()

    def trials(self) -> list[Trial]:
        """All that are worth it, the best first."""
        before = self._found(self.light, self.recorded).misfit[-1]
        found = [
            Trial(cause, told, self._found(light, recorded).misfit[-1] / before)
            for cause, told, light, recorded in self._changes()
        ]
        return sorted(found, key=lambda trial: trial.misfit_ratio)

    def _found(self, light: Field, recorded: Sequence[Recorded]) -> Reconstructed:
        return reconstruct(
            self.engine,
            light,
            recorded,
            kind=self.kind,
            tv_weight=self.tv_weight,
            iterations=ITERATIONS,
            scale=self.scale,
            active_width=self.active_width,
            modes=self.modes,
        )

    def _changes(self) -> Iterator[Change]:
        """Cause, words, light and planes of each trial."""
        yield from self._swaps()
        shifts = [_shift_pixels(*pair) for pair in self._intensities()]
        apart = max(math.hypot(x - shifts[0][0], y - shifts[0][1]) for x, y in shifts)
        if apart > LEAST_SHIFT_PIXELS:
            yield self._shifted(shifts)
        if max(math.hypot(*shift) for shift in shifts) > LEAST_SHIFT_PIXELS:
            yield from self._tilted(shifts)
        backgrounds = [_background(*pair) for pair in self._intensities()]
        if max(share for share, _ in backgrounds) > LEAST_BACKGROUND:
            said = ", ".join(f"{100.0 * max(share, 0.0):.2g} %" for share, _ in backgrounds)
            planes = [
                replace(plane, background=np.full_like(plane.amplitude, max(level, 0.0)))
                for plane, (_, level) in zip(self.recorded, backgrounds, strict=True)
            ]
            yield Change("background", f"backgrounds of {said} taken out", self.light, planes)
        for stretch in STRETCHES if len(self.recorded) > 1 else ():
            planes = [replace(p, distance_mm=(1.0 + stretch) * p.distance_mm) for p in self.recorded]
            said = f"planes {100.0 * stretch:+.2g} % farther from each other"
            yield Change("distance", said, self.light, planes)

    def _swaps(self) -> Iterator[Change]:
        """Every two planes, in each other's place."""
        for i, j in combinations(range(len(self.recorded)), 2):
            planes = list(self.recorded)
            planes[i] = replace(planes[j], distance_mm=self.recorded[i].distance_mm)
            planes[j] = replace(self.recorded[i], distance_mm=self.recorded[j].distance_mm)
            yield Change("planes swapped", f"planes {i + 1} and {j + 1} exchanged", self.light, planes)

    def _shifted(self, shifts: Shifts) -> Change:
        """Planes whose sensor is where the picture's shift says: the other way."""
        pitch_mm = self.engine.scene.exit_grid.pitch_mm

        def moved(shifts: Shifts) -> list[Recorded]:
            return [
                replace(plane, shift_mm=(plane.shift_mm[0] - pitch_mm * x, plane.shift_mm[1] - pitch_mm * y))
                for plane, (x, y) in zip(self.recorded, shifts, strict=True)
            ]

        left = self._left(self.light, moved(shifts))
        total = [(x + a, y + b) for (x, y), (a, b) in zip(shifts, left, strict=True)]
        said = ", ".join(f"{1e3 * pitch_mm * x:.2g}, {1e3 * pitch_mm * y:.2g} um" for x, y in total)
        return Change("shift", f"frames shifted by {said}", self.light, moved(total))

    def _tilted(self, shifts: Shifts) -> Iterator[Change]:
        """The tilt of the light that shifts the planes most like what is seen."""
        height, width = self.light.grid.half_widths_mm
        step_deg = math.degrees(0.25e-3 * self.light.wavelength_um / max(height, width))
        straight, aside = (
            [_centre(made)[0] for made in self._of_light(light)]
            for light in (self.light, LightErrors((step_deg, 0.0)).on(self.light))
        )
        moves = [(there - here) / step_deg for here, there in zip(straight, aside, strict=True)]
        size = sum(move * move for move in moves)
        if size == 0.0:
            return

        def tilt_of(shifts: Shifts) -> tuple[float, float]:
            x, y = (
                sum(move * shift[axis] for move, shift in zip(moves, shifts, strict=True)) / size
                for axis in (0, 1)
            )
            return x, y

        x, y = tilt_of(shifts)
        more_x, more_y = tilt_of(self._left(LightErrors((x, y)).on(self.light), self.recorded))
        x, y = x + more_x, y + more_y
        light = LightErrors((x, y)).on(self.light)
        yield Change("light", f"light tilted by {x:.2g}, {y:.2g} deg", light, self.recorded)

    def _left(self, light: Field, recorded: Sequence[Recorded]) -> Shifts:
        """Shifts that a few iterations leave."""
        maps = self._found(light, recorded).residual_maps
        return [_shift_pixels(*pair) for pair in _intensities(recorded, maps)]

    def _of_light(self, light: Field) -> list[Array]:
        """Intensities of the light without an object."""
        model = RecordingModel(self.engine, light, self.recorded, None, self.active_width, modes=self.modes)
        return [made.astype(float) ** 2 for made in model.amplitudes(model.lit.astype(light.values.dtype))]

    def _intensities(self) -> Iterator[tuple[Array, Array]]:
        return _intensities(self.recorded, self.maps)


def _intensities(recorded: Sequence[Recorded], maps: Sequence[Array]) -> Iterator[tuple[Array, Array]]:
    """Of each plane: as recorded, and as the result has it; alike where nothing is known."""
    for plane, error in zip(recorded, maps, strict=True):
        made = np.maximum(plane.amplitude.astype(float) + error, 0.0) ** 2
        known = plane.known
        seen = plane.amplitude.astype(float) ** 2
        yield (seen if known is None else np.where(known, seen, made)), made


def _shift_pixels(seen: Array, made: Array) -> tuple[float, float]:
    """How far a picture is shifted against another (x, y), by the peak of their cross-correlation."""
    one, other = (scipy.fft.rfft2(values - values.mean()) for values in (seen, made))
    product = scipy.fft.irfft2(one * other.conj(), seen.shape)
    peak = np.unravel_index(int(np.argmax(product)), product.shape)
    found = []
    for axis in (1, 0):
        line = np.moveaxis(product, axis, 0)[:, peak[1 - axis]]
        near = [float(line[(peak[axis] + step) % len(line)]) for step in (-1, 0, 1)]
        curvature = near[0] - 2.0 * near[1] + near[2]
        part = 0.5 * (near[0] - near[2]) / curvature if curvature < 0.0 else 0.0
        count = product.shape[axis]
        found.append((int(peak[axis]) + count // 2) % count - count // 2 + float(part))
    return found[0], found[1]


def _centre(intensity: Array) -> tuple[float, float]:
    """Centre of gravity (x, y) in pixels."""
    rows, columns = (np.arange(count) for count in intensity.shape)
    total = float(intensity.sum())
    return float(intensity.sum(axis=0) @ columns) / total, float(intensity.sum(axis=1) @ rows) / total


def _background(seen: Array, made: Array) -> tuple[float, float]:
    """Even light where the result is dark: as a share of the mean, and itself."""
    dark = made < DARK * made.max()
    level = float(np.mean(seen[dark] - made[dark])) if np.any(dark) else 0.0
    return level / float(seen.mean()), level
