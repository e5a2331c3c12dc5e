"""What may differ where frames are not explained: each is changed, and a few iterations tell what helps.

Shifts are those of the recorded intensities against the modelled ones, by their cross-correlation, and a
decenter is the one that would shift the planes so. The light's tilt and bend are what a complex object would
have of them. Of distances, pitch and radii, longer and longer steps are tried: the object adapts to what is
wrong with them, and pictures no longer show it.

What is simple or cheap to try comes first; where that explains enough, the rest is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np

from lensdesign.errors import TransferLensError
from wavesim.engines.registry import engine_on
from wavesim.fields.field import Field
from wavesim.metrics.goodness_of_fit import LEAST_GAIN, Trial
from wavesim.reconstruction.diagnostics.guesses import (
    BENDS,
    SHAPES,
    background,
    centre,
    shift_pixels,
    smooth_phase_waves,
)
from wavesim.reconstruction.diagnostics.orientation import ORIENTATIONS
from wavesim.reconstruction.field_stop import FieldStop, StopSearch
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.from_object import Kind, Reconstructed, reconstruct
from wavesim.reconstruction.source_width import coherent_deg
from wavesim.scene.bench import LightErrors
from wavesim.scene.engine import Engine, Tiled
from wavesim.scene.source import Source, SourceMode
from wavesim.sensor.measurement import Array, Measurement, noise_misfit

Shifts = Sequence[tuple[float, float]]

ITERATIONS, FREE_ITERATIONS = 6, 8
"""Of each trial, and of a complex object whose phase tells the light's."""

AT_NOISE, ENOUGH = 1.5, 0.7
"""Misfit over that of the noise, to which so few iterations come where nothing differs any more; and share of
the squared misfit, with which nothing else is tried."""

LEAST_SHIFT_PIXELS, LEAST_BACKGROUND, LEAST_BEND_WAVES = 0.15, 2e-3, 0.04
"""From which a shift of a plane, a background over the mean intensity, and a bend of the light are tried: so
few iterations give any object some of the latter."""

RIM_PIXELS, WAVES = 1.5, 0.1
"""First steps: of pitch and radii, how far they move the rim of the pictures; of the distance between planes,
over their diversity."""

LONGEST, REFINED = 0.4, 2
"""Longest step, and how often steps beside the best one are tried."""

SOURCES, BLURS_PIXELS = (0.5, 1.0, 2.0), (0.15, 0.3)
"""Widths of the source that are tried, over that at which light is coherent over half of the object; and root
mean square blurs."""

FALLS = 0.995
"""Ratio of misfits, below which a first step helps, and longer ones are tried."""


class Change(NamedTuple):
    """What is changed: a cause and what to say of it, engine, light, planes, pixels and modes."""

    cause: str
    told: str
    engine: Engine
    light: Field
    recorded: Sequence[Measurement]
    fill_factor: float
    modes: Sequence[SourceMode]


@dataclass(frozen=True, eq=False, kw_only=True)
class CauseTrials:
    """What is doubted, and how a trial is made.

    Parameters
    ----------
    engine, light, recorded, kind, tv_weight, scale, fill_factor, modes
        As of :func:`wavesim.reconstruct`.
    maps
        What the result leaves of the planes.
    diversity
        What the planes tell of the phase (:func:`wavesim.sensor.windows.diversity`).
    stops, stop
        The search for another field stop, and the one of the light; without them none is tried.
    """

    engine: Engine
    light: Field
    recorded: Sequence[Measurement]
    maps: Sequence[Array]
    kind: Kind
    tv_weight: float | Literal["auto"]
    scale: float | None
    fill_factor: float
    diversity: float
    modes: Sequence[SourceMode] = ()
    stops: StopSearch | None = None
    stop: FieldStop | None = None

    def trials(self) -> list[Trial]:
        """All that are worth it, the best first."""
        found = list[Trial]()
        for group in (
            self._swaps,
            self._turned,
            self._backgrounds,
            self._blurred,
            self._moved,
            self._stopped,
            self._stretched,
        ):
            found += group()
            if any(self._explains(trial) for trial in found):
                break
        return sorted(found, key=lambda trial: trial.misfit_ratio)

    @cached_property
    def _before(self) -> float:
        return self._found(self._change("", "")).misfit[-1]

    def _explains(self, trial: Trial) -> bool:
        noise = noise_misfit(self.recorded) or 0.0
        at_noise = trial.misfit_ratio * self._before <= AT_NOISE * noise
        return trial.gain > (LEAST_GAIN if at_noise else ENOUGH)

    def _change(
        self,
        cause: str,
        told: str,
        *,
        engine: Engine | None = None,
        light: Field | None = None,
        recorded: Sequence[Measurement] | None = None,
        fill_factor: float | None = None,
        modes: Sequence[SourceMode] | None = None,
    ) -> Change:
        return Change(
            cause,
            told,
            engine or self.engine,
            light or self.light,
            recorded or self.recorded,
            self.fill_factor if fill_factor is None else fill_factor,
            self.modes if modes is None else modes,
        )

    def _found(self, change: Change, kind: Kind | None = None, iterations: int = ITERATIONS) -> Reconstructed:
        return reconstruct(
            change.engine,
            change.light,
            change.recorded,
            kind=kind or self.kind,
            tv_weight=self.tv_weight,
            iterations=iterations,
            scale=self.scale,
            fill_factor=change.fill_factor,
            modes=change.modes,
        )

    def _trial(self, change: Change) -> Trial:
        return Trial(change.cause, change.told, self._found(change).misfit[-1] / self._before)

    def _swaps(self) -> Iterator[Trial]:
        """Every two planes, in each other's place."""
        for i, j in combinations(range(len(self.recorded)), 2):
            planes = list(self.recorded)
            planes[i] = replace(planes[j], distance_mm=self.recorded[i].distance_mm)
            planes[j] = replace(self.recorded[i], distance_mm=self.recorded[j].distance_mm)
            said = f"planes {i + 1} and {j + 1} exchanged"
            yield self._trial(self._change("planes swapped", said, recorded=planes))

    def _turned(self) -> Iterator[Trial]:
        """Each picture but the first, mirrored and turned against it."""
        for n in range(1, len(self.recorded)):
            plane = self.recorded[n]
            for name, turn in ORIENTATIONS.items():
                amplitude = turn(plane.amplitude)
                if amplitude.shape != plane.amplitude.shape:
                    continue
                sigma = None if plane.sigma is None else np.ascontiguousarray(turn(plane.sigma))
                planes = list(self.recorded)
                planes[n] = replace(plane, amplitude=np.ascontiguousarray(amplitude), sigma=sigma)
                said = f"picture of plane {n + 1} {name}"
                yield self._trial(self._change("orientation", said, recorded=planes))

    def _backgrounds(self) -> Iterator[Trial]:
        """Light where the result is dark, taken out of each plane."""
        found = [background(*pair) for pair in _intensities(self.recorded, self.maps)]
        if max(share for share, _ in found) <= LEAST_BACKGROUND:
            return
        said = ", ".join(f"{100.0 * max(share, 0.0):.2g} %" for share, _ in found)
        planes = [
            replace(plane, background=np.full_like(plane.amplitude, max(level, 0.0)))
            for plane, (_, level) in zip(self.recorded, found, strict=True)
        ]
        yield self._trial(self._change("background", f"backgrounds of {said} taken out", recorded=planes))

    def _blurred(self) -> Iterator[Trial]:
        """What washes pictures out: a wide source, or a camera that vibrates."""
        if len(self.modes) < 2 and not isinstance(self.engine, Tiled):
            for factor in SOURCES:
                width = factor * coherent_deg(self.light)
                modes = Source(width).few_modes(self.light.wavelength_um)
                yield self._trial(self._change("source", f"source {width:.2g} deg wide", modes=modes))
        if not self.fill_factor:
            return
        pitch_um = 1e3 * self.engine.scene.exit_grid.pitch_mm
        for blur in BLURS_PIXELS:
            width = math.sqrt(self.fill_factor**2 + 12.0 * blur**2)
            said = f"pictures blurred by {blur * pitch_um:.2g} um rms, as by vibration"
            yield self._trial(self._change("vibration", said, fill_factor=width))

    def _moved(self) -> Iterator[Trial]:
        """What moves the light on the planes: sensor, light, lens."""
        shifts = [shift_pixels(*pair) for pair in _intensities(self.recorded, self.maps)]
        if max(math.dist(shift, shifts[0]) for shift in shifts) > LEAST_SHIFT_PIXELS:
            yield self._trial(self._shifted(shifts))
        if self.kind == "amplitude":  # a complex object takes up all of the light's phase
            yield self._lit()
        if max(math.hypot(*shift) for shift in shifts) > LEAST_SHIFT_PIXELS:
            yield from _tolerant(lambda: self._trial(self._decentered(shifts)))

    def _shifted(self, shifts: Shifts) -> Change:
        """Planes whose sensor is where the picture's shift says: the other way."""
        pitch_mm = self.engine.scene.exit_grid.pitch_mm

        def moved(shifts: Shifts) -> Change:
            planes = [
                replace(plane, shift_mm=(plane.shift_mm[0] - pitch_mm * x, plane.shift_mm[1] - pitch_mm * y))
                for plane, (x, y) in zip(self.recorded, shifts, strict=True)
            ]
            said = ", ".join(f"{1e3 * pitch_mm * x:.2g}, {1e3 * pitch_mm * y:.2g} um" for x, y in shifts)
            return self._change("shift", f"frames shifted by {said}", recorded=planes)

        left = self._left(moved(shifts))
        return moved([(x + a, y + b) for (x, y), (a, b) in zip(shifts, left, strict=True)])

    def _lit(self) -> Trial:
        """Light tilted and bent as a complex object says, once more if that helps."""
        best = Trial("light", "", math.inf)
        phase = dict.fromkeys(SHAPES, 0.0)
        for _ in range(2):
            light = LightErrors(phase_waves=phase).on(self.light)
            free = self._found(self._change("", "", light=light), "complex", FREE_ITERATIONS).transmission
            more = smooth_phase_waves(free.with_values(free.values * (light.values != 0.0)))
            phase = {orders: phase[orders] + more[orders] for orders in SHAPES}
            best = min(best, self._trial(self._with_light(phase)), key=lambda one: one.misfit_ratio)
            if best.gain <= LEAST_GAIN:
                break
        return best

    def _with_light(self, phase: dict[tuple[int, int], float]) -> Change:
        height, width = self.light.grid.half_widths_mm
        per_mm = 1e-3 * self.light.wavelength_um / self.light.index
        x, y = (math.degrees(per_mm * phase[one] / half) for one, half in (((1, 0), width), ((0, 1), height)))
        bent = max(abs(phase[orders]) for orders in BENDS)
        said = f"light tilted by {x:.2g}, {y:.2g} deg"
        if bent < LEAST_BEND_WAVES:
            phase = phase | dict.fromkeys(BENDS, 0.0)
        else:
            said = f"{said}, bent by {bent:.1g} waves"
        return self._change("light", said, light=LightErrors(phase_waves=phase).on(self.light))

    def _decentered(self, shifts: Shifts) -> Change:
        """The lens where it shifts the planes most like what is seen."""
        pose, step_mm = self.engine.scene.pose, self.engine.scene.exit_grid.pitch_mm

        def at(x: float, y: float) -> Engine:
            there = replace(pose, decenter_x_mm=pose.decenter_x_mm + x, decenter_y_mm=pose.decenter_y_mm + y)
            return engine_on(self.engine, replace(self.engine.scene, pose=there))

        here, aside = ([centre(one)[0] for one in self._of_light(e)] for e in (self.engine, at(step_mm, 0.0)))
        moves = np.subtract(aside, here) / step_mm

        def change(x: float, y: float) -> Change:
            said = f"lens decentered by {1e3 * x:.2g}, {1e3 * y:.2g} um"
            return self._change("mounting", said, engine=at(x, y))

        size = float(moves @ moves) or 1.0  # no lens moves nothing
        x, y = moves @ np.array(shifts) / size
        more_x, more_y = moves @ np.array(self._left(change(x, y))) / size
        return change(float(x + more_x), float(y + more_y))

    def _stopped(self) -> Iterator[Trial]:
        """Light behind the field stop that explains the frames best."""
        if self.stops is None or self.stop is None:
            return
        found = self.stops.run_beside(self.stop)
        if found is None:
            return
        (x, y), width = found.at_mm, found.width_mm
        said = f"field stop of {width:.4g} mm at {x:.4g},{y:.4g} mm"
        yield self._trial(self._change("field stop", said, light=self.stops.light_of(found)))

    def _stretched(self) -> Iterator[Trial]:
        """Other distances of planes and object, pitch of the pixels, and radii of the lens."""
        scene = self.engine.scene
        rim = 2.0 * RIM_PIXELS / max(scene.exit_grid.shape)

        def planes(step: float) -> Change:
            moved = [replace(p, distance_mm=(1.0 + step) * p.distance_mm) for p in self.recorded]
            said = f"planes {100.0 * step:+.2g} % farther from each other"
            return self._change("distance", said, recorded=moved)

        def farther(step: float) -> Change:
            grid, distance_mm = scene.object_grid, scene.lens.object.working_distance_mm
            grid = replace(grid, z_mm=grid.z_mm - step * distance_mm)
            said = f"object {1e3 * step * distance_mm:+.2g} um farther from the lens"
            light, engine = (
                replace(self.light, grid=grid),
                engine_on(self.engine, replace(scene, object_grid=grid)),
            )
            return self._change("working distance", said, engine=engine, light=light)

        def pixels(step: float) -> Change:
            grid = replace(scene.exit_grid, pitch_mm=(1.0 + step) * scene.exit_grid.pitch_mm)
            said = f"pixels of {1e3 * grid.pitch_mm:.4g} um in place of {1e3 * scene.exit_grid.pitch_mm:.4g}"
            return self._change(
                "pixel pitch", said, engine=engine_on(self.engine, replace(scene, exit_grid=grid))
            )

        def lens(step: float) -> Change:
            surfaces = tuple(
                s if s.radius_mm is None else s.replaced(radius_mm=(1.0 + step) * s.radius_mm)
                for s in scene.lens.surfaces
            )
            other = replace(scene, lens=scene.lens.replaced(surfaces=surfaces))
            said = f"radii of all surfaces {100.0 * step:+.2g} %"
            return self._change("lens", said, engine=engine_on(self.engine, other))

        if len(self.recorded) > 1:
            yield from self._best(planes, min(WAVES / self.diversity, 0.1))
        for change in (farther, pixels, lens):
            yield from self._best(change, rim)

    def _best(self, change: Callable[[float], Change], first: float) -> Iterator[Trial]:
        """The best of steps either way: doubled where that helps, then between."""
        tried = {0.0: Trial("", "", 1.0)}

        def ratio(step: float) -> float:
            if step not in tried:
                found = list(_tolerant(lambda: self._trial(change(step))))
                tried[step] = found[0] if found else Trial("", "", math.inf)
            return tried[step].misfit_ratio

        best = step = min((first, -first), key=ratio)
        if ratio(best) < FALLS:
            while abs(step) <= 0.5 * LONGEST:
                step *= 2.0
                best = min(best, step, key=ratio)
            for _ in range(REFINED):
                steps = sorted(tried)
                place = steps.index(best)
                middles = [0.5 * (best + beside) for beside in steps[max(place - 1, 0) : place + 2]]
                best = min((best, *middles), key=ratio)
        if math.isfinite(ratio(best)):
            yield tried[best]

    def _left(self, change: Change) -> Shifts:
        """Shifts that a few iterations leave."""
        maps = self._found(change).residual_maps
        return [shift_pixels(*pair) for pair in _intensities(change.recorded, maps)]

    def _of_light(self, engine: Engine) -> list[Array]:
        """Intensities of the light without an object."""
        model = ForwardModel(engine, self.light, self.recorded, None, self.fill_factor, modes=self.modes)
        return [
            made.astype(float) ** 2 for made in model.amplitudes(model.lit.astype(self.light.values.dtype))
        ]


def _tolerant(trial: Callable[[], Trial]) -> Iterator[Trial]:
    """None where rays or samples do not take what is tried."""
    try:
        yield trial()
    except TransferLensError:
        return


def _intensities(recorded: Sequence[Measurement], maps: Sequence[Array]) -> Iterator[tuple[Array, Array]]:
    """Of each plane: as recorded, and as the result has it; alike where nothing is known."""
    for plane, error in zip(recorded, maps, strict=True):
        made = np.maximum(plane.amplitude.astype(float) + error, 0.0) ** 2
        known = plane.known
        seen = plane.amplitude.astype(float) ** 2
        yield (seen if known is None else np.where(known, seen, made)), made
