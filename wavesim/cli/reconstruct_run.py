"""What `wavesim reconstruct` does between its options and its results."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from lensdesign.common.console import progress_bar
from lensdesign.errors import InputError
from wavesim.calibration.mounting import read_mounting
from wavesim.camera.frame_sets import planes_of_frames, recorded_planes
from wavesim.camera.recorded import Recorded
from wavesim.camera.windows import exit_scene, imaging_error
from wavesim.cli.imaging_options import engine_options, framed_patch, key_of_frames, pose_of, tiles_in
from wavesim.cli.reconstruct_results import read_truth, truth_figures
from wavesim.engines.choosing import engine_for
from wavesim.engines.whole_field.on_cluster import ClusterError, refuse_no_tiles
from wavesim.fields.field import Field, Grid
from wavesim.objects.patch import Patch, transmission_of, usaf_charts_of
from wavesim.objects.region import cut_field, region_grid, soft_rim, widened
from wavesim.reconstruction.memory import run_need
from wavesim.reconstruction.refocusing import refocus_field
from wavesim.reconstruction.resumable import reconstruct_resumably, retrieve_resumably
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.runtime.memory import (
    BASE_BYTES,
    Memory,
    MemoryLimitError,
    Need,
    memory_limit,
    room_for_arrays,
)
from wavesim.runtime.scratch import Scratch, scratch_in
from wavesim.scene.engine import Engine, Tiled
from wavesim.scene.scene import Scene

ONE_PLANE = "--method paper: needs frames of two planes or more; --method object can do with one"

Take = Callable[[Any], Any]
"""Hands an engine's tiles to a cluster, if there is one, and returns it."""

FOLDS = 2.0
"""Of how far light spreads while it is refocused: room about a region, so that its rim does not show."""


class Case(NamedTuple):
    """What is reconstructed from what.

    `shown` is the part of the object that is judged and written, `inside` its samples within the field stop,
    `engine_on` makes an engine from another part of the object to the same plane.
    """

    lens: Any
    patch: Patch
    light: Field
    sensor: Any
    planes: Any
    recorded: list[Recorded]
    engine: Engine
    truth: Field | None
    charts: Any
    diversity: float
    checkpoint: Checkpoint
    shown: Grid
    inside: Any
    engine_on: Callable[[Grid], Engine]
    scratch: Scratch
    memory: Memory


class Outcome(NamedTuple):
    """What came out.

    `transmission` is that of the part shown, `curve` the misfit (object) or the correlation A6 (paper) for
    every iteration; `said` holds figures of one method alone, `truth` those against the true object.
    """

    transmission: Field
    residual_maps: Any
    curve: Any
    refocusing: Refocused | None
    said: dict[str, Any]
    truth: dict[str, float | None]


class Refocused(NamedTuple):
    """The sharpest distance, and the curve that told."""

    distance_mm: float
    distances_mm: Any
    svfg: Any


def case_of(lens: Any, options: Any) -> Case:
    """Read all that a run needs, and refuse what cannot be done.

    Raises
    ------
    InputError, SamplingError, MemoryLimitError
        Before anything is computed or written.
    """
    limit = memory_limit(options.memory_gb)
    mounting = None if options.calibration is None else read_mounting(options.calibration)
    pose = pose_of(options) if mounting is None else mounting.pose
    frames, planes, sensor, patch, light, diversity = framed_patch(lens, options, pose)
    if options.method == "paper" and len(planes) < 2:
        raise InputError(ONE_PLANE)
    shown, inside = _shown(patch, options.region_mm)
    truth = None if options.truth is None else _true(options.truth, patch)
    charts = usaf_charts_of(patch, options.chart_at_mm) if options.usaf else ()
    scene = exit_scene(lens, patch, sensor, planes[0], pose)
    recorded = recorded_planes(frames)
    if mounting is not None:
        scene, light = mounting.scene(scene), mounting.illumination(light)
        recorded = mounting.recorded(recorded)
    engine = _engine(scene, options, 2 * options.iterations if options.method == "object" else 2, limit)
    if options.cluster is not None:
        refuse_no_tiles(engine)
    shown = shown.at(light.grid.z_mm)
    memory = Memory(_need(engine, frames, recorded, shown, lens, options), limit)
    scratch = scratch_in(options.output, _room(memory, options))
    key = _key(lens, frames, options, light, recorded, engine)
    return Case(
        lens,
        patch,
        light.with_values(scratch.held(light.values, "the illumination")),
        sensor,
        planes_of_frames(frames),
        [_held_plane(scratch, plane) for plane in recorded],
        engine,
        truth and truth.with_values(scratch.held(truth.values, "the true object")),
        charts,
        diversity,
        Checkpoint(options.output / "checkpoint.npz", key),
        shown,
        inside,
        lambda grid: _engine(replace(scene, object_grid=grid), options, 6, limit),
        scratch,
        memory,
    )


def _shown(patch: Patch, region_mm: Any) -> tuple[Grid, Any]:
    """The part of the object that is judged and written, and its samples within the field stop."""
    if region_mm is None:
        return patch.grid, patch.inside
    shown = region_grid(patch.grid, region_mm, "--region-mm")
    inside = replace(patch, grid=shown).inside
    if not inside.any():
        said = ",".join(f"{n:g}" for n in region_mm)
        raise InputError(
            f"--region-mm = {said}: lies beside the field stop of {patch.field_stop_mm:g} mm, where there is "
            "no light"
        )
    return shown, inside


def _true(path: Path, patch: Patch) -> Field:
    import numpy as np

    truth = read_truth(path, patch)
    return truth.with_values(truth.values.astype(np.complex64))


def _engine(scene: Scene, options: Any, runs: int, limit: float) -> Engine:
    fields = 8 * (scene.object_grid.size + scene.exit_grid.size)
    return engine_for(
        scene,
        options.engine,
        error=imaging_error(options.engine, options.error),
        memory_gb=1e-9 * (limit - BASE_BYTES - fields),
        runs=runs,
        **engine_options(options),
    )


def _need(engine: Engine, frames: Any, recorded: Any, shown: Grid, lens: Any, options: Any) -> Need:
    return run_need(
        engine,
        [plane.distance_mm for plane in recorded],
        method=options.method,
        kind=options.kind,
        active_width=options.active_width,
        frames_bytes=sum(frame.counts.nbytes for frame in frames),
        shown=shown.size,
        carried=0 if options.refocus_mm is None else _carried(engine, shown, lens, options).size,
        truth=options.truth is not None,
    )


def _carried(engine: Engine, shown: Grid, lens: Any, options: Any) -> Grid:
    """The part of the object that is refocused: with room for what light spreads."""
    if options.refocus_mm is None:
        return shown
    reach_mm = max(map(abs, options.refocus_mm)) * math.tan(math.asin(min(_aperture(lens), 0.99)))
    return widened(shown, engine.scene.object_grid, FOLDS * reach_mm)


def _aperture(lens: Any) -> float:
    return float(lens.object.numerical_aperture)


def _room(memory: Memory, options: Any) -> float:
    try:
        return room_for_arrays(memory.need, memory.limit_bytes, "the reconstruction")
    except MemoryLimitError as error:
        if options.refocus_mm is None or options.region_mm is not None:
            raise
        raise MemoryLimitError(f"{error}; or refocus a part of the object alone (--region-mm)") from None


def _held_plane(scratch: Scratch, plane: Recorded) -> Recorded:
    amplitude = scratch.held(plane.amplitude, "the recorded amplitudes")
    sigma = plane.sigma if plane.sigma is None else scratch.held(plane.sigma, "the standard deviations")
    return Recorded(plane.distance_mm, amplitude, sigma)


def _key(lens: Any, frames: Any, options: Any, light: Any, recorded: Any, engine: Any) -> str:
    told = {
        name: str(getattr(options, name))
        for name in ("method", "kind", "iterations", "tv_weight", "start", "scale")
    }
    told |= {"active_width": str(options.active_width), "pose": str(engine.scene.pose)}
    told |= {"engine": engine.name, "settings": str(engine.settings())}
    told |= {"object_z": str(light.grid.z_mm), "planes": str([p.distance_mm for p in recorded])}
    return key_of_frames(lens, frames, light, str(sorted(told.items())))


class _Told:
    """The bar of a run: iterations, and within them what an engine reports."""

    def __init__(self, bar: Any, case: Case, options: Any) -> None:
        self._bar, self._name = bar, "CC" if options.method == "paper" else "misfit"
        self._method, self.done = options.method, 0
        self._said = f"{options.method}: engine {case.engine.name}"
        self._task = bar.add_task(self._said, total=options.iterations)

    def iteration(self, number: int, figure: float) -> None:
        self.done = number + 1
        self._said = f"{self._method}: {self._name} {figure:.5f}"
        self._bar.update(self._task, completed=self.done, description=self._said)

    def step(self, what: str) -> None:
        """Something after the iterations."""
        self._said = what
        self._bar.update(self._task, description=what, completed=0, total=None)

    def count(self, done: int, total: int) -> None:
        self._bar.update(self._task, completed=done, total=total)

    def part(self, done: int, total: int) -> None:
        """Of one use of an engine."""
        self._bar.update(self._task, description=f"{self._said}, super-tile {done} of {total}")


@contextmanager
def _ready(engine: Any, take: Take, told: _Told) -> Iterator[Engine]:
    """An engine that tells how far it is, and hands its work to the cluster if there is one.

    Of a region, the cheapest engine may be one that does neither.
    """
    reports = isinstance(engine, Tiled)
    if reports:
        engine.report = told.part
    try:
        yield take(engine) if reports else engine
    finally:
        if reports:
            engine.report = engine.perform = None


def run(case: Case, options: Any) -> Outcome:
    """Reconstruct, refocus and compare, with a bar.

    Raises
    ------
    KeyboardInterrupt, ClusterError
        Saying what is kept.
    """
    told: _Told | None = None
    try:
        with tiles_in(options.cluster) as take, progress_bar() as bar:
            told = _Told(bar, case, options)
            return _run(case, options, take, told)
    except KeyboardInterrupt:
        done = told.done if told else 0
        where = _goes_on(case) or "nothing was written"
        raise KeyboardInterrupt(
            f"interrupted after {done} of {options.iterations} iterations; {where}"
        ) from None
    except ClusterError as error:
        raise ClusterError(f"{error}; {_goes_on(case) or 'no iteration was kept'}") from error


def _goes_on(case: Case) -> str:
    return "the same command goes on from where it was last kept" if case.checkpoint.kept else ""


class _Found(NamedTuple):
    """What one method gave: the transmission, or the field behind the part that is to be refocused."""

    transmission: Field | None
    behind: Field | None
    residual_maps: Any
    curve: Any
    said: dict[str, Any]


def _run(case: Case, options: Any, take: Take, told: _Told) -> Outcome:
    def engine_on(grid: Grid) -> AbstractContextManager[Engine]:
        own = case.engine.scene.object_grid
        return _ready(case.engine if grid == own else case.engine_on(grid), take, told)

    carried = _carried(case.engine, case.shown, case.lens, options)
    found = (_paper if options.method == "paper" else _object)(case, options, carried, engine_on, told)
    transmission, behind, *others = found
    del found
    refocused = None
    if behind is not None:
        told.step("refocusing")
        transmission, refocused = _refocused(case, options, behind, told)
        behind = None
    assert transmission is not None
    truth: dict[str, float | None] = {}
    if case.truth is not None:
        told.step("comparison with the true object")
        with engine_on(case.shown) as engine:
            truth = truth_figures(case, transmission, engine)
    maps, curve, said = others
    return Outcome(transmission, maps, curve, refocused, said, truth)


def _object(case: Case, options: Any, carried: Grid, engine_on: Callable[[Grid], Any], told: _Told) -> _Found:
    with engine_on(case.light.grid) as engine:
        found = reconstruct_resumably(
            engine,
            case.light,
            case.recorded,
            case.checkpoint,
            kind=options.kind,
            tv_weight=options.tv_weight,
            iterations=options.iterations,
            scale=options.scale,
            start="amplitude" if options.start == "amplitude" else None,
            active_width=options.active_width,
            progress=told.iteration,
            scratch=case.scratch,
        )
    said = {"scale": found.scale, "misfit": found.misfit[-1], "stopped_early": found.stopped_early}
    part = cut_field(found.transmission, carried)
    if options.refocus_mm is None:
        return _Found(part, None, found.residual_maps, found.misfit, said)
    behind = part.with_values(cut_field(case.light, carried).values * part.values)
    return _Found(None, behind, found.residual_maps, found.misfit, said)


def _paper(case: Case, options: Any, carried: Grid, engine_on: Callable[[Grid], Any], told: _Told) -> _Found:
    with engine_on(case.light.grid) as engine:
        retrieved, maps = retrieve_resumably(
            engine,
            case.light,
            case.recorded,
            case.checkpoint,
            iterations=options.iterations,
            start=options.start,
            progress=told.iteration,
            scratch=case.scratch,
        )
    said = {"correlation_a6": retrieved.correlation[-1], "stagnated_at": retrieved.stagnated_at}
    told.step("back to the object")
    with engine_on(carried) as engine:
        return _Found(None, engine.adjoint(retrieved.field), maps, retrieved.correlation, said)


def _refocused(case: Case, options: Any, behind: Field, told: _Told) -> tuple[Field, Refocused]:
    """The sharpest of all distances; a field is carried, not a transmission."""
    depth_mm = 1e-3 * case.patch.wavelength_um / _aperture(case.lens) ** 2
    if behind.grid != case.shown:  # a part of the field must not end as if it were cut off
        behind = behind.with_values(behind.values * soft_rim(case.shown, behind.grid))
    found = refocus_field(behind, options.refocus_mm, depth_mm, told.count)
    # The light is taken where the object was thought to be: over a few depths of focus it hardly changes.
    light = cut_field(case.light, behind.grid)
    there = transmission_of(replace(found.field, grid=light.grid), light)
    return cut_field(there, case.shown), Refocused(found.distance_mm, found.distances_mm, found.svfg)
