"""Trials of causes where frames are not explained: a few iterations with each change show what helps.

Shifts follow from the cross-correlation of measured and modelled intensities. A decenter is the one that
would cause these shifts. Tilt and bend of the light follow from the phase of a complex object. For
distances, pitch and radii, longer and longer steps are tried, because the object adapts to such errors and
pictures do not show them.

Trials that are simple or fast come first. Where one of them explains enough, the others are skipped.
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
from wavesim.forward.channel_model import ChannelModel
from wavesim.metrics.goodness_of_fit import LEAST_GAIN, Trial
from wavesim.metrics.low_orders import CURVATURE_ORDERS, PHASE_ORDERS, smooth_phase_waves
from wavesim.reconstruction.diagnostics.bench_estimates import background, centroid, shift_pixels
from wavesim.reconstruction.field_stop import FieldStop, StopSearch
from wavesim.reconstruction.object_solver import Kind, Reconstructed, reconstruct
from wavesim.reconstruction.source_search import coherent_deg, coherent_nm, modes_on
from wavesim.scene.engine import Engine, Tiled
from wavesim.scene.light_errors import LightErrors
from wavesim.scene.source import POINT, Source
from wavesim.sensor.measurement import Array, Measurement, noise_misfit
from wavesim.sensor.orientations import ORIENTATIONS

Shifts = Sequence[tuple[float, float]]

ITERATIONS, FREE_ITERATIONS, MOST_ITERATIONS = 6, 8, 20
"""Iterations of each trial, of a complex object whose phase gives that of the light, and at most for trials
of pictures that were mistaken.
"""

NOISE_RATIO, ENOUGH_GAIN = 1.5, 0.7
"""Misfit over that of noise that so few iterations reach with the right model, and fraction of the squared
misfit that a trial must explain so that no other is made.
"""

LEAST_SHIFT_PIXELS, LEAST_BACKGROUND, LEAST_BEND_WAVES = 0.15, 2e-3, 0.04
"""Smallest shift of a plane, background over mean intensity, and bend of the light for which a trial is
made. A few iterations give any object a small bend.
"""

RIM_PIXELS, WAVES = 1.5, 0.1
"""First steps: for pitch and radii, the shift at the rim of the pictures in pixels; for the distance between
planes, over their diversity.
"""

LONGEST, REFINED = 0.4, 2
"""Longest relative step, and number of refinements about the best step."""

SOURCES, BLURS_PIXELS = (0.5, 1.0, 2.0), (0.15, 0.3)
"""Widths of the source, over the width at which light is coherent over half of the object, and bandwidths,
over the one that shifts the steepest light by a speckle, as long as they help; and blurs (rms).
"""


class Change(NamedTuple):
    """A change of the model.

    Attributes
    ----------
    cause, description : str
        Cause, and its description for the user.
    engine, light, recorded
        Arguments of :func:`wavesim.reconstruct` with the change.
    source : Source
        Source of the light with the change.
    """

    cause: str
    description: str
    engine: Engine
    light: Field
    recorded: Sequence[Measurement]
    source: Source


@dataclass(frozen=True, eq=False, kw_only=True)
class CauseTrials:
    """Trials of possible causes.

    Parameters
    ----------
    engine, light, recorded, kind, tv_weight, scale, fill_factor
        See :func:`wavesim.reconstruct`.
    source
        Source of the light.
    maps
        For each plane, modelled less measured amplitude of the result.
    diversity
        Diversity of the planes (:func:`wavesim.sensor.windows.diversity`).
    stops, stop
        Search for another field stop, and the field stop of the light; default: no such trial.
    misfit_of_result
        Misfit of the result. Trials of pictures take so many iterations that a search without a change comes
        near it; default: `ITERATIONS`.
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
    source: Source = POINT
    stops: StopSearch | None = None
    stop: FieldStop | None = None
    misfit_of_result: float = math.inf

    def trials(self) -> list[Trial]:
        """Return all trials that were made, the best first."""
        found = list[Trial]()
        for group in (
            self._swaps,
            self._orientations,
            self._backgrounds,
            self._blurs,
            self._displacements,
            self._field_stops,
            self._scalings,
        ):
            found += group()
            if any(self._explains(trial) for trial in found):
                break
        return sorted(found, key=lambda trial: trial.misfit_ratio)

    @cached_property
    def _reference_misfit(self) -> float:
        return self._reconstructed(self._change("", "")).misfit[-1]

    @cached_property
    def _misfits_of_pictures(self) -> tuple[float, ...]:
        """Misfits of a search without a change, until they are near that of the result."""
        misfits = self._reconstructed(
            self._change("", ""), iterations=MOST_ITERATIONS, bounded=self._is_bounded
        ).misfit
        # Ratio of misfits up to which a short search is near the result.
        near = 1.03
        reached = near * self.misfit_of_result
        count = next((n for n, misfit in enumerate(misfits, start=1) if misfit <= reached), len(misfits))
        return misfits[: max(count, ITERATIONS)]

    @property
    def _is_bounded(self) -> bool:
        """Whether searches for mistaken pictures limit the amplitude to 1, as the scale allows."""
        return self.scale is not None or self.kind != "amplitude"

    def _explains(self, trial: Trial) -> bool:
        noise = noise_misfit(self.recorded) or 0.0
        at_noise = trial.misfit <= NOISE_RATIO * noise
        return trial.gain > (LEAST_GAIN if at_noise else ENOUGH_GAIN)

    def _change(
        self,
        cause: str,
        description: str,
        *,
        engine: Engine | None = None,
        light: Field | None = None,
        recorded: Sequence[Measurement] | None = None,
        source: Source | None = None,
    ) -> Change:
        return Change(
            cause,
            description,
            engine or self.engine,
            light or self.light,
            recorded or self.recorded,
            source or self.source,
        )

    def _reconstructed(
        self,
        change: Change,
        kind: Kind | None = None,
        iterations: int = ITERATIONS,
        bounded: bool = True,
    ) -> Reconstructed:
        return reconstruct(
            change.engine,
            change.light,
            change.recorded,
            kind=kind or self.kind,
            tv_weight=self.tv_weight,
            iterations=iterations,
            scale=self.scale,
            fill_factor=self.fill_factor,
            modes=modes_on(self.light, change.source),
            bounded=bounded,
        )

    def _trial(self, change: Change) -> Trial:
        misfit = self._reconstructed(change).misfit[-1]
        return Trial(change.cause, change.description, misfit / self._reference_misfit, misfit)

    def _trial_of_pictures(self, change: Change) -> Trial:
        """Return a trial of pictures that were mistaken, with which a search must come near the noise.

        Pictures that do not belong to each other hardly change the first iterations.
        """
        misfits = self._misfits_of_pictures
        misfit = self._reconstructed(change, iterations=len(misfits), bounded=self._is_bounded).misfit[-1]
        return Trial(change.cause, change.description, misfit / misfits[-1], misfit)

    def _swaps(self) -> Iterator[Trial]:
        """Yield trials in which two planes are exchanged."""
        for i, j in combinations(range(len(self.recorded)), 2):
            planes = list(self.recorded)
            planes[i] = replace(planes[j], distance_mm=self.recorded[i].distance_mm)
            planes[j] = replace(self.recorded[i], distance_mm=self.recorded[j].distance_mm)
            description = f"planes {i + 1} and {j + 1} exchanged"
            yield self._trial_of_pictures(self._change("planes swapped", description, recorded=planes))

    def _orientations(self) -> Iterator[Trial]:
        """Yield trials in which a picture other than the first is mirrored or rotated."""
        for n in range(1, len(self.recorded)):
            plane = self.recorded[n]
            for name, orientation in ORIENTATIONS.items():
                amplitude = orientation(plane.amplitude)
                if amplitude.shape != plane.amplitude.shape:
                    continue
                sigma = None if plane.sigma is None else np.ascontiguousarray(orientation(plane.sigma))
                planes = list(self.recorded)
                planes[n] = replace(plane, amplitude=np.ascontiguousarray(amplitude), sigma=sigma)
                description = f"picture of plane {n + 1} {name}"
                yield self._trial_of_pictures(self._change("orientation", description, recorded=planes))

    def _backgrounds(self) -> Iterator[Trial]:
        """Yield a trial in which light in dark parts of the result is subtracted from each plane."""
        found = [background(*pair) for pair in _intensities(self.recorded, self.maps)]
        if max(fraction for fraction, _ in found) <= LEAST_BACKGROUND:
            return
        description = ", ".join(f"{100.0 * max(fraction, 0.0):.2g} %" for fraction, _ in found)
        planes = [
            replace(plane, background=np.full_like(plane.amplitude, max(level, 0.0)))
            for plane, (_, level) in zip(self.recorded, found, strict=True)
        ]
        yield self._trial(
            self._change("background", f"backgrounds of {description} subtracted", recorded=planes)
        )

    def _blurs(self) -> Iterator[Trial]:
        """Yield trials of blur: an extended or polychromatic source, or a camera that vibrates."""
        if not isinstance(self.engine, Tiled):
            if not self.source.width_deg:
                yield from self._sources("source", "source {:.2g}° wide", "width_deg", coherent_deg)
            if not self.source.bandwidth_nm:
                words = "light with a bandwidth of {:.2g} nm"
                yield from self._sources("bandwidth", words, "bandwidth_nm", coherent_nm)
        pitch_um = 1e3 * self.engine.scene.exit_grid.pitch_mm
        for blur in BLURS_PIXELS:
            description = f"pictures blurred by {blur * pitch_um:.2g} µm rms, as by vibration"
            blur_mm = math.hypot(self.recorded[0].blur_mm, 1e-3 * blur * pitch_um)
            planes = [replace(plane, blur_mm=blur_mm) for plane in self.recorded]
            yield self._trial(self._change("vibration", description, recorded=planes))

    def _sources(
        self, cause: str, words: str, name: str, unit_of: Callable[[Field], float]
    ) -> Iterator[Trial]:
        """Yield trials of wider and wider sources, or broader and broader bands, as long as they help.

        A width that is far too small may hardly change the misfit, or raise it a little.
        """
        best, clearly_worse = 1.0, 1.02
        for factor in SOURCES:
            width = factor * unit_of(self.light)
            source = replace(self.source, **{name: width})
            trial = self._trial(self._change(cause, words.format(width), source=source))
            yield trial
            if trial.misfit_ratio > clearly_worse * best:
                return
            best = min(best, trial.misfit_ratio)

    def _displacements(self) -> Iterator[Trial]:
        """Yield trials of a displaced sensor, tilted light, or a decentered lens."""
        shifts = [shift_pixels(*pair) for pair in _intensities(self.recorded, self.maps)]
        if max(math.dist(shift, shifts[0]) for shift in shifts) > LEAST_SHIFT_PIXELS:
            yield self._trial(self._shifted_planes(shifts))
        if self.kind == "amplitude":  # a complex object absorbs the phase of the light
            yield self._light_trial()
        if max(math.hypot(*shift) for shift in shifts) > LEAST_SHIFT_PIXELS:
            yield from _if_possible(lambda: self._trial(self._decentered_lens(shifts)))

    def _shifted_planes(self, shifts: Shifts) -> Change:
        """Return planes that are shifted against the shift of their pictures."""
        pitch_mm = self.engine.scene.exit_grid.pitch_mm

        def shifted(shifts: Shifts) -> Change:
            planes = [
                replace(plane, shift_mm=(plane.shift_mm[0] - pitch_mm * x, plane.shift_mm[1] - pitch_mm * y))
                for plane, (x, y) in zip(self.recorded, shifts, strict=True)
            ]
            description = ", ".join(
                f"{1e3 * pitch_mm * x:.2g}, {1e3 * pitch_mm * y:.2g} µm" for x, y in shifts
            )
            return self._change("shift", f"frames shifted by {description}", recorded=planes)

        remaining = self._remaining_shifts(shifted(shifts))
        return shifted([(x + a, y + b) for (x, y), (a, b) in zip(shifts, remaining, strict=True)])

    def _light_trial(self) -> Trial:
        """Return a trial of light with the tilt and bend of a complex object, repeated if it helps."""
        best = Trial("light", "", math.inf)
        phase = dict.fromkeys(PHASE_ORDERS, 0.0)
        for _ in range(2):
            light = LightErrors(phase_waves=phase).on(self.light)
            free = self._reconstructed(
                self._change("", "", light=light), "complex", FREE_ITERATIONS
            ).transmission
            correction = smooth_phase_waves(free.with_values(free.values * (light.values != 0.0)))
            phase = {orders: phase[orders] + correction[orders] for orders in PHASE_ORDERS}
            best = min(best, self._trial(self._with_light(phase)), key=lambda one: one.misfit_ratio)
            if best.gain <= LEAST_GAIN:
                break
        return best

    def _with_light(self, phase: dict[tuple[int, int], float]) -> Change:
        height, width = self.light.grid.half_widths_mm
        per_mm = 1e-3 * self.light.wavelength_um / self.light.index
        x, y = (math.degrees(per_mm * phase[one] / half) for one, half in (((1, 0), width), ((0, 1), height)))
        bent = max(abs(phase[orders]) for orders in CURVATURE_ORDERS)
        description = f"light tilted by {x:.2g}, {y:.2g}°"
        if bent < LEAST_BEND_WAVES:
            phase = phase | dict.fromkeys(CURVATURE_ORDERS, 0.0)
        else:
            description = f"{description}, bent by {bent:.1g} waves"
        return self._change("light", description, light=LightErrors(phase_waves=phase).on(self.light))

    def _decentered_lens(self, shifts: Shifts) -> Change:
        """Return a change with the decenter of the lens that best explains the shifts."""
        pose, step_mm = self.engine.scene.pose, self.engine.scene.exit_grid.pitch_mm

        def at(x: float, y: float) -> Engine:
            decentered_pose = replace(
                pose, decenter_x_mm=pose.decenter_x_mm + x, decenter_y_mm=pose.decenter_y_mm + y
            )
            return engine_on(self.engine, replace(self.engine.scene, pose=decentered_pose))

        nominal, displaced = (
            [centroid(one)[0] for one in self._light_intensities(e)] for e in (self.engine, at(step_mm, 0.0))
        )
        moves = np.subtract(displaced, nominal) / step_mm

        def change(x: float, y: float) -> Change:
            description = f"lens decentered by {1e3 * x:.2g}, {1e3 * y:.2g} µm"
            return self._change("mounting", description, engine=at(x, y))

        size = float(moves @ moves) or 1.0  # without a lens nothing moves
        x, y = moves @ np.array(shifts) / size
        more_x, more_y = moves @ np.array(self._remaining_shifts(change(x, y))) / size
        return change(float(x + more_x), float(y + more_y))

    def _field_stops(self) -> Iterator[Trial]:
        """Yield a trial of the field stop that explains the frames best."""
        if self.stops is None or self.stop is None:
            return
        found = self.stops.find_better_stop(self.stop)
        if found is None:
            return
        (x, y), width = found.at_mm, found.width_mm
        description = f"field stop of {width:.4g} mm at {x:.4g},{y:.4g} mm"
        yield self._trial(self._change("field stop", description, light=self.stops.light_of(found)))

    def _scalings(self) -> Iterator[Trial]:
        """Yield trials of other plane distances, working distance, pixel pitch, and radii of the lens."""
        scene = self.engine.scene
        rim = 2.0 * RIM_PIXELS / max(scene.exit_grid.shape)

        def planes(step: float) -> Change:
            shifted = [replace(p, distance_mm=(1.0 + step) * p.distance_mm) for p in self.recorded]
            description = f"planes {100.0 * step:+.2g} % farther from each other"
            return self._change("distance", description, recorded=shifted)

        def working_distance(step: float) -> Change:
            grid, distance_mm = scene.object_grid, scene.lens.object.working_distance_mm
            grid = replace(grid, z_mm=grid.z_mm - step * distance_mm)
            description = f"object {1e3 * step * distance_mm:+.2g} µm farther from the lens"
            light, engine = (
                replace(self.light, grid=grid),
                engine_on(self.engine, replace(scene, object_grid=grid)),
            )
            return self._change("working distance", description, engine=engine, light=light)

        def pixels(step: float) -> Change:
            grid = replace(scene.exit_grid, pitch_mm=(1.0 + step) * scene.exit_grid.pitch_mm)
            description = (
                f"pixels of {1e3 * grid.pitch_mm:.4g} µm in place of {1e3 * scene.exit_grid.pitch_mm:.4g}"
            )
            return self._change(
                "pixel pitch", description, engine=engine_on(self.engine, replace(scene, exit_grid=grid))
            )

        def lens(step: float) -> Change:
            surfaces = tuple(
                s if s.radius_mm is None else s.replaced(radius_mm=(1.0 + step) * s.radius_mm)
                for s in scene.lens.surfaces
            )
            other = replace(scene, lens=scene.lens.replaced(surfaces=surfaces))
            description = f"radii of all surfaces {100.0 * step:+.2g} %"
            return self._change("lens", description, engine=engine_on(self.engine, other))

        if len(self.recorded) > 1:
            yield from self._best(planes, min(WAVES / self.diversity, 0.1))
        for change in (working_distance, pixels, lens):
            yield from self._best(change, rim)

    def _best(self, change: Callable[[float], Change], first: float) -> Iterator[Trial]:
        """Yield the best trial of steps in both directions: doubled while they help, then refined."""
        tried = {0.0: Trial("", "", 1.0)}

        def ratio(step: float) -> float:
            if step not in tried:
                found = list(_if_possible(lambda: self._trial(change(step))))
                tried[step] = found[0] if found else Trial("", "", math.inf)
            return tried[step].misfit_ratio

        best = step = min((first, -first), key=ratio)
        # Ratio of misfits below which a first step helps, so that longer ones are tried.
        improving_ratio = 0.995
        if ratio(best) < improving_ratio:
            while abs(step) <= 0.5 * LONGEST:
                step *= 2.0
                best = min(best, step, key=ratio)
            for _ in range(REFINED):
                steps = sorted(tried)
                position = steps.index(best)
                middles = [
                    0.5 * (best + neighbour) for neighbour in steps[max(position - 1, 0) : position + 2]
                ]
                best = min((best, *middles), key=ratio)
        if math.isfinite(ratio(best)):
            yield tried[best]

    def _remaining_shifts(self, change: Change) -> Shifts:
        """Return the shifts that remain after a few iterations."""
        maps = self._reconstructed(change).residual_maps
        return [shift_pixels(*pair) for pair in _intensities(change.recorded, maps)]

    def _light_intensities(self, engine: Engine) -> list[Array]:
        """Return the intensities of the light without an object."""
        modes = modes_on(self.light, self.source)
        model = ChannelModel.of_source(engine, self.light, self.recorded, None, self.fill_factor, modes=modes)
        return [
            modelled.astype(float) ** 2
            for modelled in model.amplitudes(model.lit.astype(self.light.values.dtype))
        ]


def _if_possible(trial: Callable[[], Trial]) -> Iterator[Trial]:
    """Yield a trial, or nothing where rays or samples do not allow it."""
    try:
        yield trial()
    except TransferLensError:
        return


def _intensities(recorded: Sequence[Measurement], maps: Sequence[Array]) -> Iterator[tuple[Array, Array]]:
    """Yield measured and modelled intensity of each plane; they are equal in invalid pixels."""
    for plane, error in zip(recorded, maps, strict=True):
        modelled = np.maximum(plane.amplitude.astype(float) + error, 0.0) ** 2
        known = plane.known
        measured = plane.amplitude.astype(float) ** 2
        yield (measured if known is None else np.where(known, measured, modelled)), modelled
