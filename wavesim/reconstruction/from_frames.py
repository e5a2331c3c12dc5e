"""From frames to the object, in one call: the iterations, refocusing, and a comparison with the truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lensdesign.common.clusters import ClusterError
from lensdesign.lens.lens import Lens
from wavesim.camera.frames import Frame
from wavesim.camera.patch_of_frames import refuse_doubtful_frames
from wavesim.camera.recording import Progress
from wavesim.camera.windows import imaging_engine
from wavesim.engines.whole_field.on_cluster import tiles_in
from wavesim.evaluation.judgement import truth_metrics
from wavesim.evaluation.verdicts import MODEL_ERROR
from wavesim.fields.field import Field, Grid
from wavesim.objects.patch import transmission_of
from wavesim.objects.region import cut_field, soft_rim
from wavesim.reconstruction.doubts.held_out import maps_of_all
from wavesim.reconstruction.doubts.starts import agreement_of_starts
from wavesim.reconstruction.field_stop import FieldStop
from wavesim.reconstruction.found import Array, Focus, FoundObject
from wavesim.reconstruction.frames_case import FramesCase, frames_case, keeps_engine
from wavesim.reconstruction.from_object import Progressed, Reconstructed, reconstruct
from wavesim.reconstruction.judging import (
    EngineOn,
    MethodResult,
    engine_errors,
    engine_figures,
    engine_replaced,
    excess_of,
    is_engine_limited,
    judge_result,
    may_be_brighter,
    may_be_stagnated,
    more_accurate_case,
    starts_needed,
    stop_search,
)
from wavesim.reconstruction.refocusing import refocus_field
from wavesim.reconstruction.resumable import keeper, progress_kept, retrieve_resumably
from wavesim.reconstruction.source_width import found_width
from wavesim.reconstruction.stopped_down import (
    ITERATIONS,
    ROUNDS,
    on_all_samples,
    stopped_down_problem,
)
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.runtime.memory import Memory
from wavesim.scene.bench import Bench
from wavesim.scene.engine import SAFETY, Engine, Tiled
from wavesim.scene.light import Light
from wavesim.scene.placement import Placement
from wavesim.scene.settings import ReconstructionSettings, SettingError
from wavesim.scene.source import Source

BETTER = 0.97
"""Ratio of residuals from which on an amplitude object without an upper limit, or from another start, is the
better one."""

BRIGHT = 0.99
"""Quantile of a complex object's amplitudes that becomes 1 in the start of an amplitude object."""

Take = Callable[[Engine], Engine]
"""Hands an engine's tiles to a cluster, if there is one, and returns it."""


def reconstruct_frames(
    lens: Lens,
    frames: Sequence[Frame],
    settings: ReconstructionSettings | None = None,
    *,
    truth: Field | Path | None = None,
    calibration: Placement | Bench | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    before: Callable[[Memory], None] | None = None,
    **changes: Any,
) -> FoundObject:
    """Find the object behind frames: amplitude and phase, residuals, refocusing, and how good it is.

    Parameters
    ----------
    lens
        The nominal lens.
    frames
        One or more of each plane, as :func:`wavesim.image` or :func:`wavesim.read_frames` gives them.
    settings
        All that may be set; defaults if left out.
    truth
        Transmission of the true object on the patch's samples, or its file or folder.
    calibration
        The lens as mounted, as :func:`wavesim.calibrate_frames` finds it.
    folder
        Where a run keeps its last iteration (`CHECKPOINT`), so that one which was cut off goes on with the
        same call, and arrays that memory does not hold. What was kept stays there.
    progress
        Told what is done, how many steps of it are, and of how many; 0 where that is not known.
    before
        Told what the run will take, when nothing can be refused any more.
    **changes
        Settings by name, in place of those of `settings`.

    Raises
    ------
    InputError, SamplingError, MemoryLimitError
        Before anything is computed or written.
    KeyboardInterrupt, ClusterError
        Saying what is kept.

    Warns
    -----
    FootprintWarning, DiversityWarning
        Where frames tell less than they might.
    """
    settings = (settings or ReconstructionSettings()).replaced(**changes)
    refuse_doubtful_frames(lens, frames, settings)
    case = frames_case(lens, frames, settings, truth, calibration, folder)
    told = _Told(progress, settings, case.engine)
    if settings.field_stop == "find":
        stated = settings.with_stop(*_stop_found(case, settings, told))
        case = frames_case(lens, frames, stated, truth, calibration, folder)
    del frames  # nobody else may hold them, and they take much
    if before is not None:
        before(case.memory)
    try:
        with tiles_in(settings.cluster) as take:
            return _run(case, settings, take, told)
    except KeyboardInterrupt:
        where = _goes_on(case) or "nothing was written"
        count = f"{told.iterations} of {settings.most_iterations}"
        raise KeyboardInterrupt(f"interrupted after {count} iterations; {where}") from None
    except ClusterError as error:
        raise ClusterError(f"{error}; {_goes_on(case) or 'no iteration was kept'}") from error


def _stop_found(case: FramesCase, settings: ReconstructionSettings, told: _Told) -> FieldStop:
    """Position and diameter of the field stop, as far as settings do not state them."""
    if isinstance(case.engine, Tiled):
        raise SettingError(
            "{field_stop} find: takes many short reconstructions, too long for the engine of a whole field; "
            "find it on a smaller patch ({patch_mm}), and state {field_stop_mm} and {field_stop_at_mm}"
        )
    search = stop_search(case, settings, case.engine, told.step)
    return search.run(settings.field_stop_mm, settings.field_stop_at_mm)


class _Told:
    """How far a run is: iterations, and within them what an engine reports."""

    def __init__(self, progress: Progress | None, settings: ReconstructionSettings, engine: Engine) -> None:
        self._progress = progress or (lambda what, done, count: None)
        self._method, self._most = settings.method, settings.most_iterations
        self._figure = "CC" if settings.method == "paper" else "misfit"
        self.iterations = 0
        self._show(f"{self._method}: engine {engine.name}", 0, self._most)

    def _show(self, said: str, done: int, count: int) -> None:
        self._said, self._done, self._count = said, done, count
        self._progress(said, done, count)

    def iteration(self, number: int, figure: float) -> None:
        self.iterations = number + 1
        self._show(f"{self._method}: {self._figure} {figure:.5f}", self.iterations, self._most)

    def on_half(self, number: int, figure: float) -> None:
        """An iteration on half of the samples."""
        self._show(f"{self._method}, half of the samples: {self._figure} {figure:.5f}", 0, self._most)

    def step(self, what: str) -> None:
        """Something after the iterations."""
        self._show(what, 0, 0)

    def count(self, done: int, total: int) -> None:
        self._show(self._said, done, total)

    def part(self, done: int, total: int) -> None:
        """Of one use of an engine."""
        self._progress(f"{self._said}, super-tile {done} of {total}", self._done, self._count)


@contextmanager
def _ready(engine: Engine, take: Take, told: _Told) -> Iterator[Engine]:
    """An engine that tells how far it is, and hands its work to the cluster if there is one.

    Of a region, the cheapest engine may be one that does neither.
    """
    if not isinstance(engine, Tiled):
        yield engine
        return
    engine.report = told.part
    try:
        yield take(engine)
    finally:
        engine.report = None


def _goes_on(case: FramesCase) -> str:
    kept = case.checkpoint is not None and case.checkpoint.kept
    return "the same command goes on from where it was last kept" if kept else ""


def _run(case: FramesCase, settings: ReconstructionSettings, take: Take, told: _Told) -> FoundObject:
    def engine_on(grid: Grid) -> AbstractContextManager[Engine]:
        own = case.engine.scene.object_grid
        return _ready(case.engine if grid == own else case.engine_on(grid), take, told)

    start = None
    if settings.source_deg == "find":
        with engine_on(case.light.grid) as engine:
            width_deg, start = found_width(engine, case.light, case.given, settings, told.step)
        case = case._replace(source=Source(width_deg))
    if settings.method == "paper":
        found = _paper(case, settings, engine_on, told)
    else:
        # Given away without a name for it: its arrays would else be held to the end.
        begun = [progress_kept(case.checkpoint, case.scratch)]
        if begun == [None] and start is None:
            begun = [_begun_on_half(case, settings, take, told)]
        case, found = _object(case, settings, take, told, start, begun)
    judged = judge_result(case, settings, engine_on, found, told.step)
    transmission, behind, maps, curve, of_method = found[:5]
    del found
    focus = None
    if behind is not None and settings.focus_mm is not None:
        told.step("refocusing")
        transmission, focus = _refocused(case, settings.focus_mm, behind, told)
        behind = None
    assert transmission is not None
    true, truth = None, dict[str, float | None]()
    if case.truth is not None:
        told.step("comparison with the true object")
        true, light = (cut_field(field, case.shown) for field in (case.truth, case.light))
        scene = case.engine.scene
        truth = truth_metrics(transmission, true, light, case.inside, scene, case.scratch)
    return FoundObject(
        settings,
        case.patch,
        transmission,
        case.inside,
        case.planes,
        case.recorded,
        maps,
        curve,
        judged,
        focus,
        of_method,
        true,
        truth,
        case.charts,
        case.diversity,
        case.engine,
        case.memory,
        case.predicted_error,
    )


def _begun_on_half(
    case: FramesCase, settings: ReconstructionSettings, take: Take, told: _Told
) -> Progressed | None:
    """What the first iterations of a whole field find on half of its samples; None where they win little."""
    if not isinstance(case.engine, Tiled) or len(case.modes) > 1:
        return None
    small = stopped_down_problem(case.engine.scene, case.light, case.given)
    if small is None:
        return None
    kind = "amplitude" if settings.first == "amplitude" else settings.kind
    engine = imaging_engine(small.scene, settings, runs=2 * ITERATIONS, light=Light(small.light))
    with _ready(engine, take, told) as ready:
        found = reconstruct(
            ready,
            small.light,
            small.recorded,
            kind=kind,
            tv_weight=settings.tv_weight,
            iterations=min(ITERATIONS, settings.most_iterations),
            until_noise=True,
            scale=settings.scale,
            active_width=settings.active_width,
            progress=told.on_half,
            residuals=False,
            rounds=ROUNDS,
        )
    values = found.transmission.values
    values = on_all_samples(values.real if kind == "amplitude" else values, case.light.grid.shape)
    values = case.scratch.held(values, "a step")
    return Progressed(values, values, 0.0, (), None, 0, 0)


def _object(
    case: FramesCase,
    settings: ReconstructionSettings,
    take: Take,
    told: _Told,
    start: Field | None,
    begun: list[Progressed | None],
) -> tuple[FramesCase, MethodResult]:
    """The object, and the case with the engine that found it.

    Where residuals exceed the noise by no more than the engine's predicted error, a more accurate engine goes
    on from there, unless engine or error was stated. The predicted error is not allowed as noise any more
    where such an engine leaves more than the noise: then it was not the engine.
    """
    kept: Checkpoint | None = case.checkpoint
    curve: tuple[float, ...] = ()
    model_error = MODEL_ERROR
    first: Field | Literal["amplitude"] | None = "amplitude" if settings.first == "amplitude" else start
    errors: tuple[Array, ...] = ()
    replaced: dict[str, Any] = {}
    while True:
        with _ready(case.engine, take, told) as engine:
            found = _solved(case, settings, engine, told, first, kept, begun.pop() if begun else None)
            if not curve and may_be_brighter(case, settings, found):
                brighter = _solved(case, settings, engine, told, first, bounded=False)
                excess = [excess_of(case, one.residual_maps) for one in (found, brighter)]
                if excess[1] < BETTER * excess[0]:
                    found = brighter
                del brighter
            if not curve and may_be_stagnated(case, settings, found):
                found = _by_complex_object(case, settings, engine, told, found)
            maps = found.residual_maps
            if len(maps) < len(case.recorded):
                maps = maps_of_all(
                    engine, case.light, case.recorded, settings.active_width, found, case.modes
                )
            curve += found.misfit
            limited = is_engine_limited(case, maps, found.misfit[-1])
            finer = more_accurate_case(case, told.step) if limited else None
            if finer is None or keeps_engine(settings):
                if finer is not None:
                    errors = engine_errors(finer, case, settings, found, maps)
                elif limited and not replaced:  # a wrong bench must not pass because the engine changed
                    model_error = math.hypot(MODEL_ERROR, case.predicted_error / SAFETY)
                agreement = agreement_of_starts(
                    engine,
                    case.light,
                    case.given,
                    starts_needed(case, settings, found),
                    found,
                    told.step,
                    case.modes,
                )
                break
        replaced = engine_replaced(replaced.get("before") or engine_figures(case), finer)
        told.step(replaced["words"])
        case, first, kept = finer, found.transmission, None
    said: dict[str, Any] = {
        "scale": found.scale,
        "misfit": found.misfit[-1],
        "stopped_because": found.stopped_because,
    }
    if replaced:
        said["engine_replaced"] = replaced
    if settings.source_deg:
        said["source_deg"] = case.source.width_deg
    part, behind = cut_field(found.transmission, case.carried), None
    if settings.focus_mm is not None:
        behind = part.with_values(cut_field(case.light, case.carried).values * part.values)
    whole = None if isinstance(case.engine, Tiled) else found.transmission
    transmission = part if behind is None else None
    return case, MethodResult(transmission, behind, maps, curve, said, agreement, whole, errors, model_error)


def _solved(
    case: FramesCase,
    settings: ReconstructionSettings,
    engine: Engine,
    told: _Told,
    start: Field | Literal["amplitude"] | None,
    kept: Checkpoint | None = None,
    resume: Progressed | None = None,
    bounded: bool = True,
) -> Reconstructed:
    """The object that iterations with one engine come to."""
    return reconstruct(
        engine,
        case.light,
        case.given,
        kind=settings.kind,
        tv_weight=settings.tv_weight,
        iterations=settings.most_iterations,
        until_noise=True,
        scale=settings.scale,
        start=start,
        active_width=settings.active_width,
        progress=told.iteration,
        resume=resume,
        keep=keeper(kept),
        scratch=case.scratch,
        modes=case.modes,
        bounded=bounded,
    )


def _by_complex_object(
    case: FramesCase, settings: ReconstructionSettings, engine: Engine, told: _Told, found: Reconstructed
) -> Reconstructed:
    """The amplitude object that starts from a complex one, if it fits better than the one found.

    A real transmission between 0 and 1 has local minima that a complex one passes by.
    """
    told.step("complex object as another start")
    free = _solved(case, settings.replaced(kind="complex"), engine, told, None).transmission
    amplitude = np.abs(free.values)
    if settings.scale is None:
        amplitude /= max(float(np.quantile(amplitude[case.light.values != 0.0], BRIGHT)), 1e-6)
    start = free.with_values(np.clip(amplitude, 0.0, 1.0).astype(free.values.dtype))
    other = _solved(case, settings, engine, told, start)
    is_better = excess_of(case, other.residual_maps) < BETTER * excess_of(case, found.residual_maps)
    return other if is_better else found


def _paper(
    case: FramesCase, settings: ReconstructionSettings, engine_on: EngineOn, told: _Told
) -> MethodResult:
    with engine_on(case.light.grid) as engine:
        retrieved, maps = retrieve_resumably(
            engine,
            case.light,
            case.recorded,
            case.checkpoint,
            iterations=settings.most_iterations,
            start=settings.first,
            progress=told.iteration,
            scratch=case.scratch,
        )
    said = {"correlation_a6": retrieved.correlation[-1], "stagnated_at": retrieved.stagnated_at}
    told.step("back to the object")
    with engine_on(case.carried) as engine:
        return MethodResult(None, engine.adjoint(retrieved.field), maps, retrieved.correlation, said)


def _refocused(
    case: FramesCase, focus_mm: tuple[float, float], behind: Field, told: _Told
) -> tuple[Field, Focus]:
    """The sharpest of all distances; a field is carried, not a transmission."""
    if behind.grid != case.shown:  # a part of the field must not end as if it were cut off
        behind = behind.with_values(behind.values * soft_rim(case.shown, behind.grid))
    found = refocus_field(behind, focus_mm, case.depth_mm, told.count)
    # The light is taken where the object was thought to be: over a few depths of focus it hardly changes.
    light = cut_field(case.light, behind.grid)
    there = transmission_of(replace(found.field, grid=light.grid), light)
    return cut_field(there, case.shown), Focus(found.distance_mm, found.distances_mm, found.svfg)
