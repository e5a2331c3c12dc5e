"""What is reconstructed from frames, and from what: read, checked and predicted before it runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from wavesim.camera.exposures import rounding_fraction
from wavesim.camera.frame_sets import PlaneFrames, planes_of_frames, recorded_planes
from wavesim.camera.frames import Frame
from wavesim.camera.light_of_frames import light_of_frames
from wavesim.camera.mounting import light_on, planes_at
from wavesim.camera.patch_of_frames import framed_patch, key_of_frames
from wavesim.camera.recorded import Recorded
from wavesim.camera.windows import exit_scene, imaging_engine
from wavesim.engines.choosing import affordable_engines, engine_for
from wavesim.engines.registry import AUTO
from wavesim.engines.surfaces.grids import LONGEST_SECONDS
from wavesim.engines.whole_field.on_cluster import refuse_no_tiles
from wavesim.fields.field import Field, Grid
from wavesim.objects.patch import Patch, lit, read_object, usaf_charts_of
from wavesim.objects.region import cut_field, region_grid, widened
from wavesim.objects.usaf import UsafElement
from wavesim.reconstruction.doubts.held_out import HeldOut, hold_out, is_given
from wavesim.reconstruction.memory import run_arrays
from wavesim.runtime.checkpoint import CHECKPOINT, Checkpoint
from wavesim.runtime.inventory import Inventory, need_of
from wavesim.runtime.memory import BASE_BYTES, Memory, MemoryLimitError, memory_limit
from wavesim.runtime.scratch import Scratch, scratch_in
from wavesim.scene.bench import Bench, bench_of
from wavesim.scene.engine import Engine
from wavesim.scene.light import Light
from wavesim.scene.placement import Placement
from wavesim.scene.scene import Scene, placed_scene
from wavesim.scene.settings import ReconstructionSettings, SettingError
from wavesim.scene.source import Source, SourceMode

FOLDS = 2.0
"""Of how far light spreads while it is refocused: room about a region, so that its rim does not show."""

MOST_SLOWDOWN = 10.0
"""Largest time of all iterations with an engine that replaces the first one, relative to the first one's."""

TELLING = (
    "hold_out_plane",
    "method",
    "kind",
    "iterations",
    "tv_weight",
    "start",
    "scale",
    "active_width",
    "source_deg",
)
"""Settings on which the iterations depend, beside the engine's."""


class FramesCase(NamedTuple):
    """What is reconstructed from what.

    `shown` is the part of the object that is judged and written, `inside` its samples within the field stop,
    `carried` the part that is refocused, `held` what the iterations are not given of the planes, `engine_on`
    makes an engine from another part of the object to the same plane, `engine_of_error` one of another
    accuracy together with its predicted error, `calibrated` says whether a calibrated bench was given,
    `rounding` is the largest fraction of a dark pixel's variance that comes from rounding, and
    `light_behind` gives the light behind another field stop.
    """

    patch: Patch
    light: Field
    source: Source
    planes: tuple[PlaneFrames, ...]
    recorded: tuple[Recorded, ...]
    held: tuple[HeldOut, ...]
    engine: Engine
    truth: Field | None
    charts: tuple[tuple[UsafElement, ...], ...]
    diversity: float
    checkpoint: Checkpoint | None
    shown: Grid
    inside: NDArray[np.bool_]
    carried: Grid
    depth_mm: float
    engine_on: Callable[[Grid], Engine]
    scratch: Scratch
    memory: Memory
    predicted_error: float
    engine_of_error: Callable[[float], tuple[Engine, float]]
    calibrated: bool
    rounding: float
    light_behind: Callable[[Patch], Field]

    @property
    def modes(self) -> tuple[SourceMode, ...]:
        """Of the light, by which a wide source's is added up."""
        return tuple(self.source.few_modes(self.light.wavelength_um))

    @property
    def given(self) -> list[Recorded]:
        """The planes that the iterations are given: all but one that is held out altogether."""
        return [plane for plane in self.recorded if is_given(plane)]


def frames_case(
    lens: Lens,
    frames: Sequence[Frame],
    settings: ReconstructionSettings,
    truth: Field | Path | None,
    calibration: Placement | Bench | None,
    folder: Path | None,
) -> FramesCase:
    """Read all that a run needs, and refuse what cannot be done."""
    limit = memory_limit(settings.memory_gb)
    bench = None if calibration is None else bench_of(calibration)
    if bench is not None and settings.pose != Pose():
        raise SettingError("{calibration} says how the lens is mounted: give no decenter, tilt or despace")
    pose = settings.pose if bench is None else bench.placement.pose
    framed = framed_patch(lens, frames, settings, pose)
    patch, light = framed.patch, framed.light
    if settings.method == "paper" and len(framed.planes_mm) < 2:
        raise SettingError(
            "{method} paper: needs frames of two planes or more; {method} object can do with one"
        )
    shown, inside = _shown(patch, settings.region_mm)
    true = None if truth is None else _true(truth, patch)
    charts = usaf_charts_of(patch, settings.chart_at_mm) if settings.usaf else ()
    scene = exit_scene(lens, patch, framed.sensor, framed.planes_mm[0], pose)
    recorded = recorded_planes(frames)
    if bench is not None:
        scene, light = placed_scene(scene, bench.placement), light_on(light, bench)
        recorded = planes_at(recorded, bench)
    recorded, held = hold_out(recorded, settings.hold_out_plane)
    behind = light_of_frames(scene, framed.frames, light)
    # One that is to be found is wide until it is known.
    source = Source(1.0 if settings.source_deg == "find" else settings.source_deg)
    modes = source.few_modes(light.wavelength_um)
    runs = 2 * settings.most_iterations * len(modes) if settings.method == "object" else 2
    engine = _engine(scene, settings, runs, limit, behind)
    if settings.cluster is not None:
        refuse_no_tiles(engine)
    shown = shown.at(light.grid.z_mm)
    carried = _carried(scene, settings, shown)
    arrays = _arrays(engine, frames, recorded, shown, carried, settings, true is not None, len(modes))
    memory = Memory(need_of(arrays), limit)
    scratch = scratch_in(folder, _room(memory, settings))
    key = _key(lens, framed.frames, settings, light, recorded, engine)
    predicted_error, even = engine.predicted_error(behind), behind.even
    lit = light.with_values(scratch.held(light.values, "the illumination"))

    def engine_of_error(error: float) -> tuple[Engine, float]:
        light = Light(lit, even)
        if keeps_engine(settings):
            own = _engine(scene, settings.replaced(error=error), runs, limit, light)
            return own, own.predicted_error(light)
        return _raised_engine(engine, error, predicted_error, runs, limit, light)

    return FramesCase(
        patch,
        lit,
        source,
        planes_of_frames(frames),
        tuple(_held_plane(scratch, plane) for plane in recorded),
        held,
        engine,
        true and true.with_values(scratch.held(true.values, "the true object")),
        charts,
        framed.diversity,
        None if folder is None else Checkpoint(folder / CHECKPOINT, key),
        shown,
        inside,
        carried,
        1e-3 * patch.wavelength_um / lens.object.numerical_aperture**2,
        lambda grid: _engine(
            replace(scene, object_grid=grid), settings, 6, limit, Light(cut_field(lit, grid), even)
        ),
        scratch,
        memory,
        predicted_error,
        engine_of_error,
        bench is not None,
        max(rounding_fraction(frame) for frame in framed.frames),
        lambda other: _light_behind(other, settings, bench),
    )


def _light_behind(patch: Patch, settings: ReconstructionSettings, bench: Bench | None) -> Field:
    """The light on the object behind a patch's field stop, on the bench as it is."""
    light = lit(patch, settings)
    return light if bench is None else light_on(light, bench)


def _shown(patch: Patch, region_mm: Sequence[float] | None) -> tuple[Grid, Any]:
    """The part of the object that is judged and written, and its samples within the field stop."""
    if region_mm is None:
        return patch.grid, patch.inside
    try:
        shown = region_grid(patch.grid, region_mm, "{region_mm}")
    except InputError as error:
        raise SettingError(str(error)) from None
    inside = replace(patch, grid=shown).inside
    if not inside.any():
        said = ",".join(f"{n:g}" for n in region_mm)
        raise SettingError(
            f"{{region_mm}} = {said}: lies beside the field stop of {patch.field_stop_mm:g} mm, where there "
            "is no light"
        )
    return shown, inside


def _true(truth: Field | Path, patch: Patch) -> Field:
    if not isinstance(truth, Field):
        truth = read_object(truth, patch)
    elif truth.grid != patch.grid:
        raise InputError(f"truth: its grid {truth.grid} is not the patch's {patch.grid}")
    return truth.with_values(truth.values.astype(np.complex64, copy=False))


def _engine(scene: Scene, settings: ReconstructionSettings, runs: int, limit: float, light: Light) -> Engine:
    return imaging_engine(scene, settings, runs=runs, memory_gb=_free_gb(scene, limit), light=light)


def _free_gb(scene: Scene, limit: float) -> float:
    """Return the memory (GB) that is left for an engine."""
    fields = 8 * (scene.object_grid.size + scene.exit_grid.size)
    return 1e-9 * (limit - BASE_BYTES - fields)


def keeps_engine(settings: ReconstructionSettings) -> bool:
    """Return whether the engine or its error is stated, so that no other engine may replace it."""
    return settings.error is not None or settings.engine != AUTO


def _raised_engine(
    present: Engine, error: float, predicted_error: float, runs: int, limit: float, light: Light
) -> tuple[Engine, float]:
    """Return an engine in place of the present one, with its predicted error.

    It is the cheapest affordable engine that meets the error limit, or else the most accurate one.
    """
    scene, cost = present.scene, present.cost()
    affordable = affordable_engines(
        scene,
        (error, min(2.0 * error, predicted_error)),
        memory_gb=_free_gb(scene, limit),
        seconds=min(LONGEST_SECONDS, MOST_SLOWDOWN * (cost.setup_seconds + runs * cost.seconds)),
        runs=runs,
        light=light,
    )
    if not affordable:
        raise SamplingError("no other engine is affordable")
    meeting = [one for one in affordable if one.relative_error <= error]
    best = min(meeting, key=lambda one: one.total_seconds(runs)) if meeting else affordable[0]
    return engine_for(scene, best.engine, **best.settings), best.relative_error


def _arrays(
    engine: Engine,
    frames: Sequence[Frame],
    recorded: Sequence[Recorded],
    shown: Grid,
    carried: Grid,
    settings: ReconstructionSettings,
    truth: bool,
    modes: int,
) -> Inventory:
    return run_arrays(
        engine,
        # A plane that is shifted has a way to it, at whatever distance.
        [math.hypot(plane.distance_mm, *plane.shift_mm) for plane in recorded],
        method=settings.method,
        kind=settings.kind,
        active_width=settings.active_width,
        frames_bytes=sum(frame.counts.nbytes for frame in frames),
        shown=shown.shape,
        carried=0 if settings.focus_mm is None else carried.size,
        truth=truth,
        backgrounds=sum(plane.background is not None for plane in recorded),
        modes=modes,
        tilted=any(any(plane.tilt_deg) for plane in recorded),
    )


def _carried(scene: Scene, settings: ReconstructionSettings, shown: Grid) -> Grid:
    """The part of the object that is refocused: with room for what light spreads."""
    if settings.focus_mm is None:
        return shown
    aperture = min(scene.lens.object.numerical_aperture, 0.99)
    reach_mm = max(map(abs, settings.focus_mm)) * math.tan(math.asin(aperture))
    return widened(shown, scene.object_grid, FOLDS * reach_mm)


def _room(memory: Memory, settings: ReconstructionSettings) -> float:
    try:
        return memory.room_for_arrays("the reconstruction")
    except MemoryLimitError as error:
        if settings.focus_mm is None or settings.region_mm is not None:
            raise
        raise MemoryLimitError(f"{error}; or refocus a part of the object alone (--region-mm)") from None


def _held_plane(scratch: Scratch, plane: Recorded) -> Recorded:
    amplitude = scratch.held(plane.amplitude, "the recorded amplitudes")
    sigma = plane.sigma if plane.sigma is None else scratch.held(plane.sigma, "the standard deviations")
    background = plane.background
    if background is not None:
        background = scratch.held(background, "the backgrounds")
    return replace(plane, amplitude=amplitude, sigma=sigma, background=background)


def _key(
    lens: Lens,
    frames: Sequence[Frame],
    settings: ReconstructionSettings,
    light: Field,
    recorded: Sequence[Recorded],
    engine: Engine,
) -> str:
    told = settings.model_dump_json(include=set(TELLING))
    planes = [
        (p.distance_mm, p.shift_mm, p.tilt_deg, None if p.background is None else float(p.background.mean()))
        for p in recorded
    ]
    return key_of_frames(lens, frames, light, told, engine.key(), str((light.grid.z_mm, planes)))
