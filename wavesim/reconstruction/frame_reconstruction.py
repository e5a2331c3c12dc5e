"""Reconstruction of an object from frames, in one call: iterations, refocusing, assessment and
comparison.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from lensdesign.common.clusters import ClusterError
from lensdesign.lens.lens import Lens
from wavesim.engines.eikonal.on_cluster import tiles_in
from wavesim.fields.field import Field, Grid
from wavesim.metrics.goodness_of_fit import MODEL_ERROR, GoodnessOfFit
from wavesim.metrics.result_quality import truth_metrics
from wavesim.reconstruction.assessment import (
    EngineOn,
    MethodResult,
    agreement_of_starts,
    engine_errors,
    engine_replaced,
    engine_summary,
    is_engine_limited,
    judge_result,
    more_accurate_case,
    starts_needed,
    stop_search,
    unjudged_result,
)
from wavesim.reconstruction.calibrated_bench import CalibratedBench, JudgedObject, bench_of
from wavesim.reconstruction.coarse_start import (
    INNER_ITERATIONS,
    ITERATIONS,
    coarse_problem,
    on_all_samples,
)
from wavesim.reconstruction.diagnostics.held_out import residual_maps_of
from wavesim.reconstruction.field_stop import FieldStop
from wavesim.reconstruction.found_object import Array, Focus, FoundObject
from wavesim.reconstruction.object_search import ObjectSearch, Start
from wavesim.reconstruction.object_solver import Reconstructed, SolverState, reconstruct
from wavesim.reconstruction.problem import (
    ReconstructionProblem,
    keeps_engine,
    reconstruction_problem,
    validate_frames,
)
from wavesim.reconstruction.refocusing import refocus_field
from wavesim.reconstruction.resumable import retrieve_resumably, saved_state
from wavesim.reconstruction.search_rules import coarse_step_rule
from wavesim.reconstruction.source_search import WIDTHS, find_source, sought_widths
from wavesim.runtime.checkpoint import STOP_TRIALS, Checkpoint
from wavesim.runtime.memory import Memory
from wavesim.scene.engine import SAFETY, Engine, Tiled
from wavesim.scene.scattered_light import Light
from wavesim.scene.settings import Kind, ReconstructionSettings, SettingError
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frames import Frame
from wavesim.sensor.recording import Progress
from wavesim.sensor.windows import imaging_engine
from wavesim.targets.patch import transmission_of
from wavesim.targets.region import cut_field, soft_rim

ClusterHandover = Callable[[Engine], Engine]
"""Hands the tiles of an engine to a cluster, if there is one, and returns the engine."""

OnSearchEnd = Callable[[ReconstructionProblem, MethodResult], None]
"""Called with the object when the search ends, before the tests of its verdict."""


def reconstruct_frames(
    lens: Lens,
    frames: Sequence[Frame],
    settings: ReconstructionSettings | None = None,
    *,
    truth: Field | Path | None = None,
    calibration: SystemState | CalibratedBench | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    on_estimate: Callable[[Memory], None] | None = None,
    on_found: Callable[[FoundObject], None] | None = None,
    **changes: Any,
) -> FoundObject:
    """Reconstruct the object that was recorded in frames, and assess the result.

    Method "object" seeks the transmission of the object itself (:func:`wavesim.reconstruct`). Method "paper"
    retrieves the field behind the lens and propagates it back (:func:`wavesim.retrieve`).

    Parameters
    ----------
    lens
        The nominal lens.
    frames
        One or more frames of each plane, from :func:`wavesim.image` or :func:`wavesim.read_frames`.
    settings
        All settings; default: `ReconstructionSettings()`.
    truth
        Transmission of the true object on the patch's samples, or its file or folder. The result is compared
        with it.
    calibration
        Calibrated bench (`bench` of the result of :func:`wavesim.calibrate_frames`), or a state of the
        system. Default: as designed. The verdict does not test parameters again that the calibration has
        sought with the same frames, light and kind of object. If it has judged the object with the same
        settings, this object is returned.
    folder
        Folder of the checkpoints (`CHECKPOINT`, and `STOP_TRIALS` of a search for the field stop), and of
        arrays that do not fit in memory. The same call continues an interrupted run. Checkpoints are not
        removed.
    progress
        Callback `progress(stage, completed, total)`; the total is 0 where it is unknown.
    on_estimate
        Callback `on_estimate(memory)` with the estimate of the memory, called after all checks.
    on_found
        Callback `on_found(found)` with the object, called when the search ends. The verdict, which may take
        longer than the search, is not known yet (`found.verdict.judged` is False), unless a calibration has
        judged the object.
    **changes
        Settings by name, which replace those of `settings`.

    Returns
    -------
    FoundObject
        Complex transmission of the object, residuals of each plane, and the verdict.

    Raises
    ------
    InputError, SamplingError, MemoryLimitError
        If an input is invalid or the arrays do not fit, before anything is computed or written.
    KeyboardInterrupt, ClusterError
        If the run is interrupted or the cluster fails; the message says what was saved.

    Warns
    -----
    FootprintWarning, DiversityWarning
        If the frames contain less information than they could.

    Examples
    --------
    An amplitude object from a single frame:

    >>> from lensdesign import load_design, scaled
    >>> from wavesim import image, reconstruct_frames
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> patch = {"patch_mm": 0.03, "engine": "eikonal", "error": 0.1}
    >>> taken = image(lens, "star", planes_mm=(0.03,), **patch)
    >>> truth = taken.target.transmission
    >>> found = reconstruct_frames(lens, taken.frames, kind="amplitude", iterations=10, truth=truth, **patch)
    >>> found.truth["object_correlation"] > 0.9
    True
    """
    settings = (settings or ReconstructionSettings()).replaced(**changes)
    validate_frames(lens, frames, settings)
    bench = bench_of(calibration)
    case = reconstruction_problem(lens, frames, settings, truth, bench, folder)
    reporter = ProgressReporter(progress, settings, case.engine)
    if settings.field_stop == "find":
        stated = settings.with_stop(*_find_stop(case, settings, reporter))
        case = reconstruction_problem(lens, frames, stated, truth, bench, folder)
    del frames  # they are large, and the problem does not need them any more
    if on_estimate is not None:
        on_estimate(case.memory)
    known = None if bench is None else bench.judged_with(case.key)
    earlier = None if known is None else _judged_object(case, settings, known, reporter)
    if earlier is not None:
        if on_found is not None:
            on_found(earlier)
        return earlier
    uncertainty = None if bench is None else bench.uncertainty_for(settings.kind)
    ended = list[FoundObject]()

    def on_search_end(problem: ReconstructionProblem, result: MethodResult) -> None:
        found = _found_object(problem, settings, result, reporter)
        ended.append(replace(found, verdict=replace(found.verdict, bench=uncertainty)))
        if on_found is not None:
            on_found(ended[0])

    try:
        with tiles_in(settings.cluster) as hand_over:
            judged = _run(case, settings, hand_over, reporter, on_search_end)
        return replace(ended.pop(), verdict=replace(judged, bench=uncertainty))
    except KeyboardInterrupt:
        hint = _resume_hint(case)
        if ended:
            raise KeyboardInterrupt(f"interrupted before the verdict{hint and '; '}{hint}") from None
        hint = hint or "nothing was written"
        count = f"{reporter.iterations} of {max(reporter.iterations, settings.most_iterations)}"
        raise KeyboardInterrupt(f"interrupted after {count} iterations; {hint}") from None
    except ClusterError as error:
        raise ClusterError(f"{error}; {_resume_hint(case) or 'no iteration was saved'}") from error


def _find_stop(
    case: ReconstructionProblem, settings: ReconstructionSettings, reporter: ProgressReporter
) -> FieldStop:
    """Return the field stop: position and diameter as far as settings do not state them."""
    if isinstance(case.engine, Tiled):
        raise SettingError(
            "{field_stop} find: needs many short reconstructions, which take too long for a whole field; "
            "find it on a smaller patch ({patch_mm}), and state {field_stop_mm} and {field_stop_at_mm}"
        )
    trials = case.checkpoint and Checkpoint(case.checkpoint.path.with_name(STOP_TRIALS), case.checkpoint.key)
    search = stop_search(case, settings, case.engine, reporter.step, trials)
    with search.interruptible():
        return search.run(settings.field_stop_mm, settings.field_stop_at_mm)


class ProgressReporter:
    """Reports the progress of a run: iterations, and parts of the engine's work within them.

    Parameters
    ----------
    progress
        Callback `progress(stage, completed, total)`, or None.
    settings
        Settings of the reconstruction.
    engine
        Engine, named in the first report.
    """

    def __init__(self, progress: Progress | None, settings: ReconstructionSettings, engine: Engine) -> None:
        self._progress = progress or (lambda what, done, count: None)
        self._method, self._most = settings.method, settings.most_iterations
        self._quantity = "CC" if settings.method == "paper" else "misfit"
        self.iterations = 0
        self._report(f"{self._method}: engine {engine.name}", 0, self._most)

    def _report(self, message: str, done: int, count: int) -> None:
        self._message, self._done, self._count = message, done, count
        self._progress(message, done, count)

    def iteration(self, index: int, value: float) -> None:
        """Report an iteration and its misfit or correlation."""
        self.iterations = index + 1
        most = max(self._most, self.iterations)  # a search without total variation at first has more
        self._report(f"{self._method}: {self._quantity} {value:.5f}", self.iterations, most)

    def coarse_iteration(self, index: int, value: float) -> None:
        """Report an iteration on half of the samples."""
        self._report(f"{self._method}, half of the samples: {self._quantity} {value:.5f}", 0, self._most)

    def step(self, what: str) -> None:
        """Report a step that is not an iteration."""
        self._report(what, 0, 0)

    def count(self, done: int, total: int) -> None:
        """Report the progress within the current step."""
        self._report(self._message, done, total)

    def engine_part(self, done: int, total: int) -> None:
        """Report a part of one use of an engine."""
        self._progress(f"{self._message}, super-tile {done} of {total}", self._done, self._count)


@contextmanager
def _prepared_engine(
    engine: Engine, hand_over: ClusterHandover, reporter: ProgressReporter
) -> Iterator[Engine]:
    """Yield an engine that reports its progress and uses the cluster if there is one.

    The cheapest engine for a region may do neither.
    """
    if not isinstance(engine, Tiled):
        yield engine
        return
    engine.progress = reporter.engine_part
    try:
        yield hand_over(engine)
    finally:
        engine.progress = None


def _resume_hint(case: ReconstructionProblem) -> str:
    saved = case.checkpoint is not None and case.checkpoint.kept
    return "run the same command again to continue from the last saved iteration" if saved else ""


def _run(
    case: ReconstructionProblem,
    settings: ReconstructionSettings,
    hand_over: ClusterHandover,
    reporter: ProgressReporter,
    on_search_end: OnSearchEnd,
) -> GoodnessOfFit:
    """Search for the object, which is passed to `on_search_end`, and return the verdict."""

    def engine_on(grid: Grid) -> AbstractContextManager[Engine]:
        own_grid = case.engine.scene.object_grid
        return _prepared_engine(
            case.engine if grid == own_grid else case.engine_on(grid), hand_over, reporter
        )

    start = None
    if sought_widths(settings):
        with engine_on(case.light.grid) as engine:
            found_source = find_source(
                engine, case.light, case.given, settings, reporter.step, known=case.source
            )
        start = found_source.transmission
        case = case._replace(source=found_source.source, source_deviations=found_source.deviations)
    if settings.method == "paper":
        found = _retrieve(case, settings, engine_on, reporter)
        on_search_end(case, found)
    else:
        # The list gives up the initial state, so that its arrays do not stay in memory to the end.
        initial = [saved_state(case.checkpoint, case.scratch)]
        if initial == [None] and start is None:
            initial = [_coarse_start(case, settings, hand_over, reporter)]
        case, found = _find_object(case, settings, hand_over, reporter, start, initial, on_search_end)
    return judge_result(case, settings, engine_on, found, reporter.step)


def _found_object(
    case: ReconstructionProblem,
    settings: ReconstructionSettings,
    found: MethodResult,
    reporter: ProgressReporter,
) -> FoundObject:
    """Return the object found, refocused and compared with the true object, but not judged."""
    transmission, focus = found.transmission, None
    if found.behind is not None and settings.focus_mm is not None:
        reporter.step("refocusing")
        transmission, focus = _refocus(case, settings.focus_mm, found.behind, reporter)
    assert transmission is not None
    true, truth = None, dict[str, float | None]()
    if case.truth is not None:
        reporter.step("comparison with the true object")
        true, light = (cut_field(field, case.shown_grid) for field in (case.truth, case.light))
        scene = case.engine.scene
        has_phase = settings.method == "object" and settings.kind != "amplitude" and found.whole is not None
        truth = truth_metrics(
            transmission, true, light, case.inside, scene, case.scratch, low_orders=has_phase
        )
    return FoundObject(
        settings=settings,
        patch=case.patch,
        transmission=transmission,
        inside=case.inside,
        planes=case.planes,
        recorded=case.recorded,
        residual_maps=found.residual_maps,
        curve=found.curve,
        verdict=unjudged_result(case, found),
        focus=focus,
        of_method=found.of_method,
        true=true,
        truth=truth,
        charts=case.charts,
        diversity=case.diversity,
        engine=case.engine,
        memory=case.memory,
        predicted_error=case.predicted_error,
        key=case.key,
    )


def _judged_object(
    case: ReconstructionProblem,
    settings: ReconstructionSettings,
    judged: JudgedObject,
    reporter: ProgressReporter,
) -> FoundObject | None:
    """Return an object that a calibration has found and judged with the same inputs.

    It is None if the engine that has found it cannot be made, for want of memory.
    """
    if "engine_replaced" in judged.of_method:
        while engine_summary(case) != judged.of_method["engine_replaced"]["after"]:
            accurate = more_accurate_case(case, reporter.step)
            if accurate is None:
                return None
            case = accurate
    transmission = Field(case.shown_grid, judged.transmission, case.light.wavelength_um)
    result = MethodResult(
        transmission,
        None,
        judged.residual_maps,
        judged.curve,
        dict(judged.of_method) | {"found_by": "calibration"},
        whole=None if isinstance(case.engine, Tiled) else transmission,
    )
    return replace(_found_object(case, settings, result, reporter), verdict=judged.verdict)


def _coarse_start(
    case: ReconstructionProblem,
    settings: ReconstructionSettings,
    hand_over: ClusterHandover,
    reporter: ProgressReporter,
) -> SolverState | None:
    """Return the state after first iterations on half of the samples; None if they save little."""
    if not isinstance(case.engine, Tiled) or len(case.modes) > 1:
        return None
    small = coarse_problem(case.engine.scene, case.light, case.given)
    if small is None:
        return None
    kind: Kind = "amplitude" if settings.first == "amplitude" else settings.kind
    engine = imaging_engine(small.scene, settings, runs=2 * ITERATIONS, light=Light(small.light))
    with _prepared_engine(engine, hand_over, reporter) as ready:
        found = reconstruct(
            ready,
            small.light,
            small.recorded,
            kind=kind,
            tv_weight=settings.tv_weight,
            iterations=min(ITERATIONS, settings.most_iterations),
            until_noise=True,
            scale=settings.scale,
            fill_factor=settings.fill_factor,
            progress=reporter.coarse_iteration,
            residuals=False,
            inner_iterations=INNER_ITERATIONS,
            step_rule=coarse_step_rule(kind),
        )
    values = found.transmission.values
    values = on_all_samples(values.real if kind == "amplitude" else values, case.light.grid.shape)
    values = case.scratch.held(values, "a step")
    return SolverState(values, values, 0.0, (), None, 0, 0)


def _find_object(
    case: ReconstructionProblem,
    settings: ReconstructionSettings,
    hand_over: ClusterHandover,
    reporter: ProgressReporter,
    start: Field | None,
    initial: list[SolverState | None],
    on_search_end: OnSearchEnd,
) -> tuple[ReconstructionProblem, MethodResult]:
    """Return the object with all that its verdict needs, and the problem with the engine that found it.

    If residuals exceed the noise by at most the engine's predicted error, a more accurate engine continues,
    unless engine or error was stated. If that engine leaves more than the noise, the engine was not the
    cause, and the predicted error is not allowed as noise any more.
    """
    checkpoint: Checkpoint | None = case.checkpoint
    curve: tuple[float, ...] = ()
    first: Start = "amplitude" if settings.first == "amplitude" else start
    replaced: dict[str, Any] = {}
    while True:
        with _prepared_engine(case.engine, hand_over, reporter) as engine:
            search = ObjectSearch(case, settings, engine, reporter.step, reporter.iteration)
            found = search.solve(first, checkpoint=checkpoint, resume=initial.pop() if initial else None)
            found, judged = search.improved(found, first, is_first=not curve)
            maps = _maps_of_all_planes(case, settings, engine, judged)
            curve += found.misfit
            is_limited = is_engine_limited(case, maps, judged.misfit[-1])
            accurate = more_accurate_case(case, reporter.step) if is_limited else None
            if accurate is None or keeps_engine(settings):
                shown = maps if judged is found else _maps_of_all_planes(case, settings, engine, found)
                result = _method_result(case, settings, found, shown, curve, replaced)
                on_search_end(case, result)
                if judged is not found:
                    result = result._replace(residual_maps=maps, whole=judged.transmission)
                if accurate is not None:
                    errors = engine_errors(accurate, case, settings, judged, maps)
                    result = result._replace(engine_errors=errors)
                elif is_limited and not replaced:  # a wrong bench must not pass because the engine changed
                    model_error = math.hypot(MODEL_ERROR, case.predicted_error / SAFETY)
                    result = result._replace(model_error=model_error)
                agreement = agreement_of_starts(
                    engine,
                    case.light,
                    case.given,
                    starts_needed(case, settings, found),
                    found,
                    reporter.step,
                    case.modes,
                )
                return case, result._replace(agreement=agreement)
        replaced = engine_replaced(replaced.get("before") or engine_summary(case), accurate)
        reporter.step(replaced["words"])
        case, first, checkpoint = accurate, found.transmission, None


def _maps_of_all_planes(
    case: ReconstructionProblem, settings: ReconstructionSettings, engine: Engine, found: Reconstructed
) -> tuple[Array, ...]:
    """Return the residual maps of an object, also on a plane that is held out."""
    if len(found.residual_maps) == len(case.recorded):
        return found.residual_maps
    return residual_maps_of(engine, case.light, case.recorded, settings.fill_factor, found, case.modes)


def _method_result(
    case: ReconstructionProblem,
    settings: ReconstructionSettings,
    found: Reconstructed,
    maps: tuple[Array, ...],
    curve: tuple[float, ...],
    replaced: dict[str, Any],
) -> MethodResult:
    """Return the object of a search, or the field behind it that is to be refocused."""
    of_method: dict[str, Any] = {
        "scale": found.scale,
        "misfit": found.misfit[-1],
        "stopped_because": found.stopped_because,
    }
    if replaced:
        of_method["engine_replaced"] = replaced
    of_method |= _source_summary(case, settings)
    shown_part, field_behind = cut_field(found.transmission, case.refocus_grid), None
    if settings.focus_mm is not None:
        field_behind = shown_part.with_values(
            cut_field(case.light, case.refocus_grid).values * shown_part.values
        )
    whole = None if isinstance(case.engine, Tiled) else found.transmission
    transmission = shown_part if field_behind is None else None
    return MethodResult(transmission, field_behind, maps, curve, of_method, whole=whole)


def _source_summary(case: ReconstructionProblem, settings: ReconstructionSettings) -> dict[str, Any]:
    """Return the widths of the source that are not 0 or were sought, with their standard deviations."""
    summary = {}
    for attribute, name in zip(WIDTHS, ("source_deg", "bandwidth_nm"), strict=True):
        width = getattr(case.source, attribute)
        if width or getattr(settings, name):
            summary[name] = width
        if attribute in case.source_deviations:
            summary[f"{name}_deviation"] = case.source_deviations[attribute]
    return summary


def _retrieve(
    case: ReconstructionProblem,
    settings: ReconstructionSettings,
    engine_on: EngineOn,
    reporter: ProgressReporter,
) -> MethodResult:
    with engine_on(case.light.grid) as engine:
        retrieved, maps = retrieve_resumably(
            engine,
            case.light,
            case.recorded,
            case.checkpoint,
            iterations=settings.most_iterations,
            start=settings.first,
            progress=reporter.iteration,
            scratch=case.scratch,
        )
    of_method = {"correlation_a6": retrieved.correlation[-1], "stagnated_at": retrieved.stagnated_at}
    reporter.step("back to the object")
    with engine_on(case.refocus_grid) as engine:
        return MethodResult(None, engine.adjoint(retrieved.field), maps, retrieved.correlation, of_method)


def _refocus(
    case: ReconstructionProblem,
    focus_mm: tuple[float, float],
    field_behind: Field,
    reporter: ProgressReporter,
) -> tuple[Field, Focus]:
    """Return the object at its sharpest distance; the field is propagated, and not the transmission."""
    if field_behind.grid != case.shown_grid:  # a sharp edge of a part of the field would diffract
        field_behind = field_behind.with_values(
            field_behind.values * soft_rim(case.shown_grid, field_behind.grid)
        )
    found = refocus_field(field_behind, focus_mm, case.depth_mm, reporter.count)
    # The illumination hardly changes over a few depths of focus.
    light = cut_field(case.light, field_behind.grid)
    transmission = transmission_of(replace(found.field, grid=light.grid), light)
    return cut_field(transmission, case.shown_grid), Focus(found.distance_mm, found.distances_mm, found.svfg)
