"""What a bench is like, from frames and a design, in one call."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from wavesim.calibration.bench_search import Seen, searched
from wavesim.calibration.calibrated import Calibrated
from wavesim.calibration.estimation import calibrate
from wavesim.calibration.parameters import LIGHT_ORDER_ALONE, Unknowns
from wavesim.fields.field import Field
from wavesim.metrics.goodness_of_fit import STOP_CAUSE, Finding, PlaneResidual, verdict, with_finding
from wavesim.reconstruction.field_stop import StopSearch
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.from_frames import reconstruct_frames
from wavesim.reconstruction.linear.linearised import Linearised
from wavesim.runtime.checkpoint import CHECKPOINT, EMPTY_CHECKPOINT
from wavesim.scene.bench import Bench, LightErrors
from wavesim.scene.scene import placed_scene
from wavesim.scene.settings import (
    CalibrationSettings,
    FramedSettings,
    ReconstructionSettings,
    SettingError,
)
from wavesim.sensor.frame_sets import planes_of_frames
from wavesim.sensor.frames import Frame
from wavesim.sensor.mounting import RIGID, light_on, parameter_names, planes_at, validate_parameters
from wavesim.sensor.patch_of_frames import validate_frames
from wavesim.sensor.recording import Progress
from wavesim.targets.patch import lit, lit_patch, read_object

SEEN_OVER_NOISE, SEEN = 4.0, 0.2
"""What a smooth light leaves of frames that saw an object: times the noise, or, where there is much of that,
a share of the amplitude beside it."""


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
    judges: bool = True,
    **changes: Any,
) -> Calibrated:
    """Find what the bench is like: light, lens, mounting and camera.

    It is the one with which frames and reconstruction agree best; :func:`wavesim.reconstruct_frames` takes
    it. Frames of a known object tell the mounting alone.

    Parameters
    ----------
    lens
        The nominal lens.
    frames
        One or more of each plane, as :func:`wavesim.image` or :func:`wavesim.read_frames` gives them.
    settings
        All that may be set; defaults if left out.
    known
        Transmission of the object on the patch's samples, where it is known, or its file or folder.
    empty
        Frames of the same planes without an object. The light is what they tell
        (:func:`calibrate_empty`), and the search for the rest goes on from there.
    priors
        Standard deviations of parameters, by their names, where more is known of lens or bench than is usual:
        from a tolerance study by :func:`tolerancing.study.calibration_priors`.
    folder
        Where what was tried is kept, so that a search which was cut off goes on with the same call.
    progress
        Told what is done, how many mountings are tried, and the most that will be.
    judges
        Whether the object is reconstructed on the bench found, as :func:`wavesim.reconstruct_frames` does it
        with the same settings, and its verdict stated. A known object is judged by itself, without that.
    **changes
        Settings by name, in place of those of `settings`.

    Raises
    ------
    InputError, SamplingError
        If a value is not usable, no light gets through the lens, or empty frames saw an object.
    KeyboardInterrupt
        Saying what is kept.

    Warns
    -----
    EmptyWarning
        If empty frames are not quite explained.
    """
    chosen = (settings or CalibrationSettings()).replaced(**changes)
    validate_frames(lens, frames, chosen)
    tell = progress or (lambda what, done, count: None)
    settings = _with_stop(lens, frames, chosen, tell)
    found = _calibrated(lens, frames, settings, known, empty, priors, folder, tell, judges)
    patch = lit_patch(lens, settings, frames[0].settings.wavelength_um)[0]
    found = replace(
        found,
        field_stop_mm=patch.field_stop_mm,
        field_stop_at_mm=patch.field_stop_at_mm,
        field_stop_from=chosen.field_stop_from,
    )
    if found.verdict is None or not found.stop_doubt:
        return found
    return replace(found, verdict=with_finding(found.verdict, Finding(STOP_CAUSE, found.stop_doubt)))


def _with_stop(
    lens: Lens, frames: Sequence[Frame], settings: CalibrationSettings, tell: Progress
) -> CalibrationSettings:
    """Settings that state the field stop, which is found first where they ask for that."""
    if settings.field_stop != "find":
        return settings
    seen = Seen(lens, frames, settings)
    patch = seen.framed.patch
    search = StopSearch(
        seen.make(seen.scene),
        seen.recorded,
        lambda stop: lit(patch.with_stop(*stop), settings),
        lens.object.field_diameter_mm if settings.patch_mm is None else settings.patch_mm,
        settings.kind,
        settings.scale,
        settings.fill_factor,
        progress=lambda text: tell(text, 0, 0),
    )
    return settings.with_stop(*search.run(settings.field_stop_mm, settings.field_stop_at_mm))


def _calibrated(
    lens: Lens,
    frames: Sequence[Frame],
    settings: CalibrationSettings,
    known: Field | Path | None,
    empty: Sequence[Frame] | None,
    priors: Mapping[str, float] | None,
    folder: Path | None,
    tell: Progress,
    judges: bool,
) -> Calibrated:
    """The bench behind a field stop that is stated."""
    seen = Seen(lens, frames, settings, priors)
    if known is not None:
        if empty is not None or priors is not None:
            other = "empty" if priors is None else "priors"
            raise SettingError(f"{{known}}, {{{other}}}: give one of them")
        known = read_object(known, seen.framed.patch) if isinstance(known, Path) else known
        return _of_known_object(seen, _mounting_alone(seen, known, tell), known)
    begin, kept_in = Unknowns(lens, Bench(seen.start)), None if folder is None else folder / CHECKPOINT
    if empty is None:
        found = searched(seen, seen.parameters(), begin, kept_in, tell)
        return _judged(lens, frames, settings, found, tell) if judges else found
    validate_same_frames(empty, frames)
    measured = calibrate_empty(lens, empty, settings, priors=priors, folder=folder, progress=tell)
    rest = tuple(p for p in seen.parameters(light_order=0) if p.name in measured.parameters)
    if not rest:
        return _judged(lens, frames, settings, measured, tell) if judges else measured
    begin = begin.changed(measured.parameters, list((measured.applied or {}).values()))
    found = _with_light_of(measured, searched(seen, rest, begin, kept_in, tell))
    return _judged(lens, frames, settings, found, tell) if judges else found


def calibrate_empty(
    lens: Lens,
    empty: Sequence[Frame],
    settings: CalibrationSettings | None = None,
    *,
    start: Bench | None = None,
    priors: Mapping[str, float] | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> Calibrated:
    """Find the light, and what else is asked for, from frames without an object.

    The light is smooth: of its amplitude and phase, modes up to the fourth order are found.

    Parameters
    ----------
    lens, settings, priors, folder, progress, **changes
        As of :func:`calibrate_frames`.
    empty
        The frames.
    start
        Lens, mounting and camera, as far as they are not sought; its light is left out.

    Raises
    ------
    InputError, SamplingError
        As of :func:`calibrate_frames`.

    Warns
    -----
    EmptyWarning
        If the frames are not quite explained.
    """
    settings = (settings or CalibrationSettings()).replaced(**changes)
    validate_frames(lens, empty, settings)
    seen = Seen(lens, empty, settings, priors)
    tell = progress or (lambda what, done, count: None)
    everything = seen.parameters("all", light_order=LIGHT_ORDER_ALONE)
    asked = seen.parameters(light_order=LIGHT_ORDER_ALONE)
    sought = tuple(p for p in everything if p.part == "light" or p in asked)
    begin = Unknowns(lens, replace(start or Bench(seen.start), light=LightErrors()))
    kept_in = None if folder is None else folder / EMPTY_CHECKPOINT
    known = np.ones(seen.framed.light.grid.shape, np.float32)
    found = searched(seen, sought, begin, kept_in, tell, known)
    found = _of_known_object(seen, found, seen.framed.light.with_values(known))
    noise, over = found.misfit_of_noise or 0.0, found.over_noise or 0.0
    if over > SEEN_OVER_NOISE or math.sqrt(max(found.misfit**2 - noise**2, 0.0)) > SEEN:
        if kept_in is not None:
            kept_in.unlink(missing_ok=True)
        raise SettingError(
            f"{{empty}}: a smooth light leaves {over:.1f} times the noise of these frames: must be frames "
            "without an object, through this lens" + _HINT * (len(asked) < len(everything))
        )
    if not found.explained:
        warnings.warn(
            f"frames without an object: a smooth light leaves {over:.1f} times the noise, so that it is "
            "known no better",
            EmptyWarning,
            stacklevel=2,
        )
    return found


_HINT = "; where lens or camera are not as designed, all that differs is sought by `wavesim calibrate`"


def validate_same_frames(empty: Sequence[Frame], frames: Sequence[Frame]) -> None:
    """Refuse frames without an object that are not of the light, the pixels and the planes of the object's.

    Raises
    ------
    InputError
        Naming what differs.
    """
    for name in ("wavelength_um", "pixel_pitch_um"):
        one, other = (getattr(some[0].settings, name) for some in (empty, frames))
        if not math.isclose(one, other, rel_tol=1e-6):
            raise SettingError(
                f"{{empty}}: {name} = {one:g}; that of the object's frames is {other:g}: must be the same"
            )
    here, there = ([plane.distance_mm for plane in planes_of_frames(some)] for some in (empty, frames))
    if not (len(here) == len(there) and np.allclose(here, there, rtol=1e-6, atol=0.0)):
        said, wanted = (", ".join(f"{z:g}" for z in planes) for planes in (here, there))
        raise SettingError(
            f"{{empty}}: planes at {said} mm; the object's frames have {wanted} mm: must be the same"
        )


def _with_light_of(measured: Calibrated, found: Calibrated) -> Calibrated:
    """What was found, with the light that empty frames tell in front."""
    assert measured.deviations is not None
    assert measured.typical is not None
    assert found.deviations is not None
    assert found.typical is not None
    count = len(measured.parameters) - len(found.parameters)
    names, light = measured.parameters[:count], measured.values[:count]
    return replace(
        found,
        parameters=names + found.parameters,
        values=light + found.values,
        deviations=measured.deviations[:count] + found.deviations,
        typical=measured.typical[:count] + found.typical,
        covariance=None,
        trail=tuple((light + values, misfit) for values, misfit in found.trail),
        traded={n: measured.traded[n] for n in names if n in measured.traded} | dict(found.traded),
        nominal=(*(n for n in names if n in measured.nominal), *found.nominal),
        undetermined=(),
        applied={n: (measured.applied or {})[n] for n in names} | dict(found.applied or {}),
    )


def _judged(
    lens: Lens,
    frames: Sequence[Frame],
    settings: CalibrationSettings,
    found: Calibrated,
    progress: Progress | None,
) -> Calibrated:
    """The same with the verdict of a reconstruction, which alone says whether frames are explained."""
    given = settings.model_dump(include=set(FramedSettings.model_fields), exclude_unset=True)
    judged = reconstruct_frames(
        lens, frames, ReconstructionSettings(**given), calibration=found.bench, progress=progress
    )
    return replace(found, verdict=judged.verdict)


def _of_known_object(seen: Seen, found: Calibrated, known: Field) -> Calibrated:
    """The same with the verdict of what a known object leaves of the frames on the bench found."""
    bench, settings = found.bench, seen.settings
    engine = seen.make(placed_scene(seen.scene, bench.placement))
    light, planes = light_on(seen.framed.light, bench), planes_at(seen.recorded, bench)
    model = ForwardModel(engine, light, planes, settings.scale, settings.fill_factor)
    if settings.scale is None:
        model.scale = Linearised(model, np.asarray(known.values), True).scale
    nothing = np.zeros(0, np.intp)
    residuals = [
        PlaneResidual(plane.distance_mm, plane.amplitude, sigma, own - plane.amplitude, nothing, np.zeros(0))
        for plane, own in zip(planes, model.amplitudes(np.asarray(known.values)), strict=True)
        if (sigma := plane.sigma) is not None
    ]
    return replace(found, verdict=verdict(residuals) if residuals else None)


def _mounting_alone(seen: Seen, known: Field, tell: Progress) -> Calibrated:
    settings = seen.settings
    return calibrate(
        seen.scene,
        seen.framed.light,
        seen.recorded,
        known=known,
        parameters=_named(settings.parameters, parameter_names(len(seen.framed.planes_mm))),
        scale=settings.scale,
        fill_factor=settings.fill_factor,
        start=seen.start,
        make=seen.make,
        most_mountings=settings.most_mountings,
        progress=lambda name, number, _, misfit: tell(
            f"{name} search: misfit {misfit:.4f}", number, settings.most_mountings
        ),
    )


def _named(text: str, allowed: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters asked for."""
    groups = {"rigid": RIGID, "all": allowed}
    names = groups.get(text) or tuple(part.strip() for part in text.split(",") if part.strip())
    try:
        validate_parameters(names, len(allowed) - len(RIGID) - 1)
    except InputError as error:
        raise SettingError(f"{{parameters}} = {text!r}: {error}; or: rigid, all") from None
    return names
