"""Calibration of a bench from frames and a design, in one call."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from wavesim.calibration.calibration_problem import IGNORED_SETTINGS, CalibrationProblem, search_bench
from wavesim.calibration.calibration_result import Calibrated
from wavesim.calibration.joint.blurred_search import blurred_search
from wavesim.calibration.joint.pixels import SparsePixels
from wavesim.calibration.parameters import (
    LIGHT_ORDER,
    LIGHT_ORDER_ALONE,
    StopShift,
    Unknowns,
    chosen_parameters,
    mounting_parameters,
)
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.linear_model import LinearModel
from wavesim.metrics.goodness_of_fit import Finding, PlaneResidual, verdict, with_finding
from wavesim.metrics.next_steps import STOP_CAUSE
from wavesim.reconstruction.calibrated_bench import JudgedObject
from wavesim.reconstruction.field_stop import FieldStop, StopSearch
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.reconstruction.problem import evidence_key, key_of_frames, patch_of_frames, validate_frames
from wavesim.reconstruction.source_search import (
    FoundSource,
    SourceWarning,
    find_source,
    modes_on,
    sought_widths,
    stated_source,
)
from wavesim.runtime.checkpoint import (
    CHECKPOINT,
    EMPTY_CHECKPOINT,
    SOURCE_CHECKPOINT,
    STOP_CHECKPOINT,
    STOP_TRIALS,
    Checkpoint,
)
from wavesim.scene.engine import Tiled
from wavesim.scene.light_errors import LightErrors
from wavesim.scene.scene import placed_light, placed_scene
from wavesim.scene.settings import (
    CalibrationSettings,
    FramedSettings,
    ReconstructionSettings,
    SettingError,
    StopOrigin,
)
from wavesim.scene.source import POINT, Source
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frame_sets import planes_of_frames
from wavesim.sensor.frames import Frame
from wavesim.sensor.measurement import placed_planes
from wavesim.sensor.recording import Progress
from wavesim.targets.patch import lit, read_object

OBJECT_OVER_NOISE, OBJECT_FRACTION = 4.0, 0.2
"""Misfit of a smooth light above which empty frames contain an object: over the noise, and as a fraction of
the amplitude beyond the noise.
"""


MOST_SOURCE_SEARCHES = 3
"""Largest number of searches for the source of the light, each on a bench calibrated in the light before."""

MOST_STOP_SEARCHES = 2
"""Largest number of refinements of a field stop on a calibrated bench."""


class EmptyWarning(UserWarning):
    """Frames without an object are not explained within their noise."""


def calibrate_frames(
    lens: Lens,
    frames: Sequence[Frame],
    settings: CalibrationSettings | None = None,
    *,
    known: Field | Path | None = None,
    empty: Sequence[Frame] | None = None,
    priors: Mapping[str, float] | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    on_found: Callable[[Calibrated], None] | None = None,
    **changes: Any,
) -> Calibrated:
    """Calibrate a bench from its frames: light, lens, mounting and camera.

    The search finds the bench whose model agrees best with the frames. Without a known object, each trial
    bench includes a short reconstruction of the object. Frames of a known object determine the mounting
    only.

    The verdict is that of a reconstruction on the calibrated bench, by :func:`wavesim.reconstruct_frames`
    with the same settings. With a known object it needs no reconstruction.

    Parameters
    ----------
    lens
        The nominal lens.
    frames
        One or more frames of each plane, from :func:`wavesim.image` or :func:`wavesim.read_frames`.
    settings
        All settings; default: `CalibrationSettings()`.
    known
        Transmission of a known object on the patch's samples, or its file or folder.
    empty
        Frames of the same planes without an object. They determine the light (:func:`calibrate_empty`), and
        the search for other parameters starts from this light.
    priors
        Standard deviations of parameters by name, where more is known than for a usual bench.
        :func:`tolerancing.study.calibration_priors` takes them from a tolerance study.
    folder
        Folder of the checkpoint; the same call continues an interrupted search.
    progress
        Callback `progress(stage, completed, total)`. It counts the benches that were tried.
    on_found
        Callback `on_found(found)` with the bench, called when the search ends and before the reconstruction
        for the verdict.
    **changes
        Settings by name, which replace those of `settings`.

    Returns
    -------
    Calibrated
        The bench, the estimates, and the verdict. Give `bench` to :func:`wavesim.reconstruct_frames` as
        `calibration`.

    Raises
    ------
    InputError, SamplingError
        If a value is invalid, no light passes the lens, or empty frames contain an object.
    KeyboardInterrupt
        If the search is interrupted; the message says what was saved.

    Warns
    -----
    EmptyWarning
        If empty frames are not fully explained.

    Examples
    --------
    A lens that is decentered by 5 um. The object is not known:

    >>> from lensdesign import load_design, scaled
    >>> from wavesim import calibrate_frames, image
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> taken = image(
    ...     lens, "star", patch_mm=0.03, planes_mm=(0.03,), engine="eikonal", error=0.1, decenter_x_mm=0.005
    ... )
    >>> search = {"parameters": "decenter_x_mm,decenter_y_mm", "kind": "amplitude", "iterations": 3}
    >>> found = calibrate_frames(lens, taken.frames, patch_mm=0.03, error=0.1, verdict="none", **search)
    >>> dict(zip(found.parameters, (round(value, 3) + 0.0 for value in found.values)))
    {'decenter_x_mm': 0.005, 'decenter_y_mm': 0.0}
    """
    requested = (settings or CalibrationSettings()).replaced(**changes)
    validate_frames(lens, frames, requested)
    if empty is not None and not requested.deviations:
        raise SettingError(
            "{deviations}: must be computed with {empty}, whose deviations are part of the result"
        )
    progress = progress or (lambda what, done, count: None)
    if known is not None:
        if not requested.deviations:
            raise SettingError("{deviations}: are not computed with {known}, so that they cannot be omitted")
        if empty is not None or priors is not None:
            other = "empty" if priors is None else "priors"
            raise SettingError(f"{{known}}, {{{other}}}: give only one of them")
        found = _calibrated_with_known_object(lens, frames, requested, known, progress)
        return replace(found, verdict=None) if requested.verdict == "none" else found
    if sought_widths(requested):
        found, settings = _calibrated_with_source(lens, frames, requested, empty, priors, folder, progress)
    else:
        found, settings = _calibrated(lens, frames, requested, empty, priors, folder, progress)
    found = replace(found, evidence_key=_evidence_key(lens, frames, settings))
    if requested.verdict == "none":
        return found
    if on_found is not None:
        on_found(found)
    return _with_verdict(lens, frames, settings, found, progress)


def _calibrated(
    lens: Lens,
    frames: Sequence[Frame],
    requested: CalibrationSettings,
    empty: Sequence[Frame] | None,
    priors: Mapping[str, float] | None,
    folder: Path | None,
    progress: Progress,
) -> tuple[Calibrated, CalibrationSettings]:
    """Return the bench in light of a stated source, and the settings with the field stop found."""
    problem = CalibrationProblem(lens, frames, requested, priors)
    stop = _found_stop(problem, folder, progress)
    if stop is None:
        start = Unknowns(problem.start)
        found = _searched(problem, frames, empty, start, folder, CHECKPOINT, progress)
        return _with_field_stop(found, problem, requested.field_stop_from), requested
    settings = requested.with_stop(*stop)
    found = _calibrated_with_stop(lens, frames, requested, settings, empty, priors, folder, progress)
    return found, settings.with_stop(*found.field_stop)


def _calibrated_with_source(
    lens: Lens,
    frames: Sequence[Frame],
    requested: CalibrationSettings,
    empty: Sequence[Frame] | None,
    priors: Mapping[str, float] | None,
    folder: Path | None,
    progress: Progress,
) -> tuple[Calibrated, CalibrationSettings]:
    """Return the bench and the source of its light, found in turn until the source stays.

    The first bench is that of a point source, because a bench that is as designed would make blur of the
    errors of the mounting. If the source does not stay, the bench is that of the last source, and a warning
    says so. After an interrupt, the search continues with the sources that were found.
    """
    sought = sought_widths(requested)
    solver = ReconstructionSettings(
        **requested.model_dump(include=set(FramedSettings.model_fields), exclude_unset=True)
    )
    saved = _source_checkpoint(lens, frames, requested, empty, priors, folder)
    sources = [stated_source(requested), *_saved_sources(saved)]
    try:
        while True:
            source = sources[-1]
            stated = requested.replaced(source_deg=source.width_deg, bandwidth_nm=source.bandwidth_nm)
            found, settings = _calibrated(lens, frames, stated, empty, priors, folder, progress)
            if len(sources) > MOST_SOURCE_SEARCHES:
                _warn_of_changes(*sources[-2:])
                return found, settings
            problem = CalibrationProblem(lens, frames, settings)
            estimate = find_source(
                problem.make(placed_scene(problem.scene, found.state)),
                placed_light(problem.framed.light, found.state),
                placed_planes(problem.recorded, found.state),
                solver,
                lambda text: progress(text, 0, 0),
                known=source,
            )
            if all(_is_settled(name, source, estimate) for name in sought):
                state = replace(found.state, source=estimate.source)
                return replace(found, state=state, source_deviations=estimate.deviations), settings
            sources.append(estimate.source)
            if saved is not None:
                saved.keep(widths=[(one.width_deg, one.bandwidth_nm) for one in sources[1:]])
    except KeyboardInterrupt:
        if saved is None or len(sources) == 1:
            raise
        raise KeyboardInterrupt(
            f"interrupted after search {len(sources) - 1} for the source of the light; run the same command "
            "again to continue"
        ) from None


def _warn_of_changes(before: Source, last: Source) -> None:
    before_text, last_text = (", ".join(one.lines({})) or "point source" for one in (before, last))
    warnings.warn(
        f"the source of the light still changes after {MOST_SOURCE_SEARCHES} searches (last change: from "
        f"{before_text} to {last_text}), so that it is not determined; state it if it is known",
        SourceWarning,
        stacklevel=4,
    )


def _is_settled(name: str, before: Source, estimate: FoundSource) -> bool:
    """Return whether a new estimate of a width differs little from the previous one.

    Blur grows with the squared width. The deviation of a width of 0 is the width that is still possible.
    """
    width, deviation = getattr(estimate.source, name), estimate.deviations.get(name, 0.0)
    # Relative change of a width, or change in its deviations, up to which the bench stays.
    tolerance, tolerated_deviations = 0.03, 2.0
    tolerated = 2.0 * width * max(tolerance * width, tolerated_deviations * deviation)
    if not width:
        tolerated = deviation**2
    return bool(abs(width**2 - getattr(before, name) ** 2) <= tolerated)


def _source_checkpoint(
    lens: Lens,
    frames: Sequence[Frame],
    requested: CalibrationSettings,
    empty: Sequence[Frame] | None,
    priors: Mapping[str, float] | None,
    folder: Path | None,
) -> Checkpoint | None:
    """Return the checkpoint of the sources that were found."""
    if folder is None:
        return None
    light = patch_of_frames(lens, frames, requested).light
    statement = (
        requested.model_dump_json(exclude={"verdict", "deviations"}),
        str(sorted((priors or {}).items())),
    )
    key = key_of_frames(lens, (*frames, *(empty or ())), light, *statement)
    return Checkpoint(folder / SOURCE_CHECKPOINT, key)


def _saved_sources(saved: Checkpoint | None) -> list[Source]:
    stored = None if saved is None else saved.load()
    return [] if stored is None else [Source(*widths) for widths in stored["widths"].tolist()]


def _calibrated_with_known_object(
    lens: Lens,
    frames: Sequence[Frame],
    settings: CalibrationSettings,
    known: Field | Path,
    progress: Progress,
) -> Calibrated:
    """Return the mounting that frames of a known object determine."""
    if settings.source_deg or settings.bandwidth_nm:
        raise SettingError(
            "{known}: cannot be used with {source_deg} or {bandwidth_nm}: the search for the mounting with a "
            "known object assumes coherent light; omit {known}, so that the object is found, too"
        )
    # Without deviations, all parameters have their estimates.
    stop_from, settings = settings.field_stop_from, settings.replaced(deviations=False)
    problem = CalibrationProblem(lens, frames, settings)
    if settings.field_stop == "find":
        stop = _found_stop(problem, None, progress)
        assert stop is not None
        problem = CalibrationProblem(lens, frames, settings.with_stop(*stop))
    known = read_object(known, problem.framed.patch) if isinstance(known, Path) else known
    light = problem.framed.light
    if known.grid != light.grid:
        raise InputError(f"known object: its grid {known.grid} is not the illumination's {light.grid}")
    try:
        sought = chosen_parameters(settings.parameters, mounting_parameters(lens, len(problem.recorded)))
    except InputError as error:
        raise SettingError(f"{{parameters}} = {settings.parameters!r}: {error}") from None
    values = known.values.astype(np.complex64)
    progress("bench: blurred frames", 0, 0)
    nominal = Unknowns(problem.start)
    before = LinearModel(problem.pixels.model(nominal), values, settings.scale is None).misfit
    start = blurred_search(problem.pixels, values, sought, nominal)
    found = search_bench(problem, sought, start, None, progress, values)
    found = _with_field_stop(replace(found, typical=None, misfit_before=before), problem, stop_from)
    return _with_stop_finding(_with_verdict_of_known_object(problem, found, known))


def _calibrated_with_stop(
    lens: Lens,
    frames: Sequence[Frame],
    requested: CalibrationSettings,
    settings: CalibrationSettings,
    empty: Sequence[Frame] | None,
    priors: Mapping[str, float] | None,
    folder: Path | None,
    progress: Progress,
) -> Calibrated:
    """Return the bench together with the field stop, from a stop that was found on the nominal bench.

    The position is a parameter of the search, unless it was requested or the light is found from empty
    frames. The diameter is searched again on the calibrated bench, until it stays.
    """
    seeks_position = requested.field_stop_at_mm is None and empty is None
    problem = CalibrationProblem(lens, frames, settings, priors, seeks_position)
    start = Unknowns(problem.start)
    found = _searched(problem, frames, empty, start, folder, CHECKPOINT, progress)
    found = _with_field_stop(found, problem, "frames")
    if requested.field_stop_mm is not None:
        return found
    for _ in range(MOST_STOP_SEARCHES):
        stop = _stop_search(problem, found.state, progress).refined_width(found.field_stop)
        if abs(stop.width_mm - found.field_stop.width_mm) <= problem.framed.patch.grid.pitch_mm:
            break
        problem = CalibrationProblem(lens, frames, settings.with_stop(*stop), priors, seeks_position)
        applied = found.applied or {}
        kept = [parameter for parameter in found.sought if not isinstance(parameter, StopShift)]
        start = start.changed(kept, [applied[parameter.name] for parameter in kept])
        again = _searched(problem, frames, empty, start, folder, STOP_CHECKPOINT, progress)
        again = replace(again, misfit_before=found.misfit_before, trail=found.trail + again.trail)
        found = _with_field_stop(again, problem, "frames")
    return found


def _found_stop(problem: CalibrationProblem, folder: Path | None, progress: Progress) -> FieldStop | None:
    """Return the field stop as found on the nominal bench; None if it is as the settings have it.

    The stop is searched if this is requested, or if nothing is stated about it, light falls only on a part of
    the patch beside its centre, and first trials explain the frames better than a stop as large as the patch.
    The latter is not tested where all pixels need much more time than those of the calibration.
    """
    settings = problem.settings
    is_requested = settings.field_stop == "find"
    if settings.field_stop_from == "stated" or (
        not is_requested and isinstance(problem.pixels, SparsePixels)
    ):
        return None
    search = _stop_search(problem, problem.start, progress, folder)
    if not is_requested and isinstance(search.engine, Tiled):
        return None
    with search.interruptible():
        if is_requested:
            return search.run(settings.field_stop_mm, settings.field_stop_at_mm)
        patch = problem.framed.patch
        stop = FieldStop(patch.field_stop_mm, patch.field_stop_at_mm)
        # A displaced lens or tilted light move the light by a few hundredths of the patch.
        return search.find_better_stop(stop) if search.is_displaced_from(stop) else None


def _stop_search(
    problem: CalibrationProblem, state: SystemState, progress: Progress, folder: Path | None = None
) -> StopSearch:
    """Return the search for the field stop on a bench; its trials are kept in a folder, if there is one."""
    settings, patch = problem.settings, problem.framed.patch
    checkpoint = None
    if folder is not None:
        settings_json = settings.model_dump_json(exclude=IGNORED_SETTINGS | {"iterations", "parameters"})
        key = key_of_frames(
            problem.lens, problem.framed.frames, problem.framed.light, settings_json, repr(state)
        )
        checkpoint = Checkpoint(folder / STOP_TRIALS, key)
    modes = modes_on(placed_light(problem.framed.light, state), state.source)
    return StopSearch(
        problem.make(placed_scene(problem.scene, state)),
        placed_planes(problem.recorded, state),
        lambda stop: placed_light(lit(patch.with_stop(*stop), settings), state),
        problem.lens.object.field_diameter_mm if settings.patch_mm is None else settings.patch_mm,
        settings.kind,
        settings.scale,
        settings.fill_factor,
        modes,
        progress,
        checkpoint,
    )


def _with_field_stop(found: Calibrated, problem: CalibrationProblem, stop_from: StopOrigin) -> Calibrated:
    """Return the result with the field stop of its problem, at the position that the state gives it.

    The shift of the object goes from the state to the field stop, so that positions of an object are those
    relative to the axis.
    """
    patch = problem.framed.patch
    x_mm, y_mm, z_mm = found.state.object_shift_mm
    at_mm = patch.field_stop_at_mm[0] + x_mm, patch.field_stop_at_mm[1] + y_mm
    return replace(
        found,
        state=replace(found.state, object_shift_mm=(0.0, 0.0, z_mm)),
        field_stop_mm=patch.field_stop_mm,
        field_stop_at_mm=at_mm,
        field_stop_from=stop_from,
    )


def _searched(
    problem: CalibrationProblem,
    frames: Sequence[Frame],
    empty: Sequence[Frame] | None,
    start: Unknowns,
    folder: Path | None,
    checkpoint_name: str,
    progress: Progress,
) -> Calibrated:
    """Return the bench for a stated field stop."""
    checkpoint_path = None if folder is None else folder / checkpoint_name
    if empty is None:
        return search_bench(problem, problem.parameters(), start, checkpoint_path, progress)
    validate_same_frames(empty, frames)
    lens, settings, priors = problem.lens, problem.settings, problem.priors
    measured = calibrate_empty(lens, empty, settings, priors=priors, folder=folder, progress=progress)
    requested = problem.parameters(light_order=LIGHT_ORDER_ALONE)
    remaining = tuple(p for p in requested if p.group != "light" and p in measured.sought)
    if not remaining:
        return measured
    start = start.changed(measured.sought, list((measured.applied or {}).values()))
    deviations = dict(zip(measured.sought, measured.deviations or (), strict=True))
    light = problem.parameters("light", light_order=LIGHT_ORDER)
    absorbed = tuple(replace(p, typical=deviations[p]) for p in light if p in deviations)
    found = search_bench(problem, remaining, start, checkpoint_path, progress, absorbed=absorbed)
    return _with_light(measured, found)


def calibrate_empty(
    lens: Lens,
    empty: Sequence[Frame],
    settings: CalibrationSettings | None = None,
    *,
    start: SystemState | None = None,
    priors: Mapping[str, float] | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> Calibrated:
    """Find the light, and other requested parameters, from frames without an object.

    The light is smooth: modes of its amplitude and phase up to the fourth order are found.

    Parameters
    ----------
    lens, settings, priors, folder, progress, **changes
        See :func:`calibrate_frames`.
    empty
        Frames without an object.
    start
        Lens, mounting and camera as far as they are not sought, and each width of the source that settings
        do not state; its light is ignored.

    Returns
    -------
    Calibrated
        The light and the bench.

    Raises
    ------
    InputError, SamplingError
        If a value is invalid, no light passes the lens, or the frames contain an object.

    Warns
    -----
    EmptyWarning
        If the frames are not fully explained.
    """
    settings = (settings or CalibrationSettings()).replaced(**changes).replaced(deviations=True)
    for name in ("source_deg", "bandwidth_nm"):
        if getattr(settings, name) == "find":
            raise SettingError(
                f"{{{name}}} find: cannot be used with frames without an object, which hardly depend on the "
                "source; state it, or find it by `wavesim calibrate` together with frames of an object"
            )
    validate_frames(lens, empty, settings)
    problem = CalibrationProblem(lens, empty, settings, priors)
    progress = progress or (lambda what, done, count: None)
    everything = problem.parameters("all", light_order=LIGHT_ORDER_ALONE)
    requested = problem.parameters(light_order=LIGHT_ORDER_ALONE)
    parameters_sought = tuple(p for p in everything if p.group == "light" or p in requested)
    source = stated_source(settings, POINT if start is None else start.source)
    unknowns = Unknowns(replace(start or problem.start, light=LightErrors(), source=source))
    checkpoint_path = None if folder is None else folder / EMPTY_CHECKPOINT
    known = np.ones(problem.framed.light.grid.shape, np.float32)
    what = "light, from the frames without an object"
    found = search_bench(problem, parameters_sought, unknowns, checkpoint_path, progress, known, what=what)
    found = _with_verdict_of_known_object(problem, found, problem.framed.light.with_values(known))
    noise, over_noise = found.misfit_of_noise or 0.0, found.over_noise or 0.0
    if over_noise > OBJECT_OVER_NOISE or math.sqrt(max(found.misfit**2 - noise**2, 0.0)) > OBJECT_FRACTION:
        if checkpoint_path is not None:
            checkpoint_path.unlink(missing_ok=True)
        hint = ""
        if len(requested) < len(everything):
            hint = "; if lens or camera differ from the design, `wavesim calibrate` can find these parameters"
        raise SettingError(
            f"{{empty}}: the residuals of a smooth light are {over_noise:.1f} times the noise of these "
            f"frames: must be frames without an object, through this lens{hint}"
        )
    if not found.explained:
        warnings.warn(
            f"frames without an object: the residuals of a smooth light are {over_noise:.1f} times the "
            "noise, which limits the accuracy of the light; for dusty optics, reconstruct these frames as a "
            "complex object, and use the result as the illumination",
            EmptyWarning,
            stacklevel=2,
        )
    return found


def validate_same_frames(empty: Sequence[Frame], frames: Sequence[Frame]) -> None:
    """Check that frames without an object have the wavelength, the pixels and the planes of the object's
    frames.

    Raises
    ------
    InputError
        If they differ; the message names the difference.
    """
    for name in ("wavelength_um", "pixel_pitch_um"):
        empty_value, frames_value = (getattr(frame_set[0].settings, name) for frame_set in (empty, frames))
        if not math.isclose(empty_value, frames_value, rel_tol=1e-6):
            raise SettingError(
                f"{{empty}}: {name} = {empty_value:g}; that of the object's frames is "
                f"{frames_value:g}: must be the same"
            )
    empty_mm, frames_mm = (
        [plane.distance_mm for plane in planes_of_frames(frame_set)] for frame_set in (empty, frames)
    )
    if not (len(empty_mm) == len(frames_mm) and np.allclose(empty_mm, frames_mm, rtol=1e-6, atol=0.0)):
        empty_text, frames_text = (", ".join(f"{z:g}" for z in planes) for planes in (empty_mm, frames_mm))
        raise SettingError(
            f"{{empty}}: planes at {empty_text} mm; the object's frames have {frames_text} mm: "
            "must be the same"
        )


def _with_light(measured: Calibrated, found: Calibrated) -> Calibrated:
    """Return a result, with the light from empty frames in front."""
    assert measured.deviations is not None
    assert measured.typical is not None
    assert found.deviations is not None
    assert found.typical is not None
    count = len(measured.parameters) - len(found.parameters)
    names, light = measured.parameters[:count], measured.values[:count]
    return replace(
        found,
        sought=measured.sought[:count] + found.sought,
        values=light + found.values,
        deviations=measured.deviations[:count] + found.deviations,
        typical=measured.typical[:count] + found.typical,
        covariance=None,
        trail=tuple((light + values, misfit) for values, misfit in found.trail),
        correlated_with={n: measured.correlated_with[n] for n in names if n in measured.correlated_with}
        | dict(found.correlated_with),
        nominal=(*(n for n in names if n in measured.nominal), *found.nominal),
        undetermined=(),
        applied={n: (measured.applied or {})[n] for n in names} | dict(found.applied or {}),
    )


def _evidence_key(lens: Lens, frames: Sequence[Frame], settings: CalibrationSettings) -> str:
    """Return the key of the evidence of a calibration."""
    with warnings.catch_warnings():  # those about the frames have been printed
        warnings.simplefilter("ignore")
        return evidence_key(lens, patch_of_frames(lens, frames, settings), settings)


def _with_verdict(
    lens: Lens,
    frames: Sequence[Frame],
    settings: CalibrationSettings,
    found: Calibrated,
    progress: Progress,
) -> Calibrated:
    """Return the result with the verdict of a reconstruction, and the object that was judged."""
    # The source is part of the calibrated state.
    names = set(FramedSettings.model_fields) - {"source_deg", "bandwidth_nm"}
    settings_given = settings.model_dump(include=names, exclude_unset=True)
    judged = JudgedObject.of(
        reconstruct_frames(
            lens,
            frames,
            ReconstructionSettings(**settings_given),
            calibration=found.bench,
            progress=lambda stage, completed, total: progress(f"verdict: {stage}", completed, total),
        )
    )
    return _with_stop_finding(replace(found, verdict=judged.verdict, judged=judged))


def _with_stop_finding(found: Calibrated) -> Calibrated:
    """Return the result with the warning about its field stop in the verdict."""
    if found.verdict is None or not found.stop_warning:
        return found
    return replace(found, verdict=with_finding(found.verdict, Finding(STOP_CAUSE, found.stop_warning)))


def _with_verdict_of_known_object(problem: CalibrationProblem, found: Calibrated, known: Field) -> Calibrated:
    """Return the result with the verdict for a known object on the bench found."""
    state, settings = found.state, problem.settings
    engine = problem.make(placed_scene(problem.scene, state))
    light, planes = placed_light(problem.framed.light, state), placed_planes(problem.recorded, state)
    modes = modes_on(light, state.source)
    model = ChannelModel.of_source(engine, light, planes, settings.scale, settings.fill_factor, modes=modes)
    if settings.scale is None:
        model = model.with_scale(LinearModel(model, np.asarray(known.values), True).scale)
    nothing = np.zeros(0, np.intp)
    residuals = [
        PlaneResidual(distance_mm, plane.amplitude, sigma, modelled - plane.amplitude, nothing, np.zeros(0))
        for distance_mm, plane, modelled in zip(
            problem.framed.planes_mm, planes, model.amplitudes(np.asarray(known.values)), strict=True
        )
        if (sigma := plane.sigma) is not None
    ]
    return replace(found, verdict=verdict(residuals) if residuals else None)
