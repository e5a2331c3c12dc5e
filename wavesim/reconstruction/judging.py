"""Judging a result by its frames: residuals, the engine's error, the bench that frames prefer, and causes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any, NamedTuple

from lensdesign.common.text import finite_or_none
from lensdesign.errors import TransferLensError
from wavesim.camera.recorded import noise_misfit
from wavesim.camera.windows import LEAST_DIVERSITY
from wavesim.evaluation.plane_residuals import PlaneResidual
from wavesim.evaluation.verdicts import (
    FEW,
    LIMIT,
    MODEL_ERROR,
    Finding,
    Trial,
    Undetected,
    Verdict,
    plane_verdicts,
    verdict,
)
from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.doubts.guesses import smooth_phase_waves
from wavesim.reconstruction.doubts.held_out import is_given, maps_of_all
from wavesim.reconstruction.doubts.orientation import misoriented
from wavesim.reconstruction.doubts.score_test import ScoreTest, score_test
from wavesim.reconstruction.doubts.trials import Doubts
from wavesim.reconstruction.field_stop import FieldStop, StopSearch
from wavesim.reconstruction.found import Array
from wavesim.reconstruction.frames_case import FramesCase
from wavesim.reconstruction.from_object import Reconstructed
from wavesim.scene.engine import Engine, Tiled
from wavesim.scene.settings import ReconstructionSettings

FINER, LEAST_FINER, FINEST = 4.0, 1.5, 2e-3
"""A more accurate engine has an error smaller by `FINER`, by `LEAST_FINER` at least, and never below
`FINEST`, which pixels and free space have too."""

NO_DIVERSITY = 1.0
"""Diversity of the planes below which their pictures do not determine a complex object."""

RAMP_WAVES = 0.35
"""Phase ramp over half of a patch from which on light or camera may have made it, and not the object."""

NEAR = 1.4
"""Times what counts as explained: so near to it a misfit that falls wants nothing but iterations."""

Progress = Callable[[str], None]
"""Called with what is computed."""

EngineOn = Callable[[Grid], AbstractContextManager[Engine]]
"""Makes an engine from a part of the object ready."""


class MethodResult(NamedTuple):
    """What one method gave: the transmission, or the field behind the part that is to be refocused.

    `whole` is the transmission on all samples, `engine_errors` what a more accurate engine would change of
    the amplitudes, `model_error` the relative error of amplitudes that is allowed.
    """

    transmission: Field | None
    behind: Field | None
    residual_maps: tuple[Array, ...]
    curve: tuple[float, ...]
    of_method: dict[str, Any]
    agreement: float | None = None
    whole: Field | None = None
    engine_errors: tuple[Array, ...] = ()
    model_error: float = MODEL_ERROR


def judge_result(
    case: FramesCase,
    settings: ReconstructionSettings,
    engine_on: EngineOn,
    found: MethodResult,
    progress: Progress,
) -> Verdict:
    """Whether the planes are explained; where they are not, what helps is tried, except on a whole field."""
    residuals, curve = _residuals(case, found.residual_maps, found.engine_errors), found.curve
    known = [
        (plane, error)
        for plane, error in zip(case.recorded, found.residual_maps, strict=True)
        if is_given(plane)
    ]
    given, maps = [plane for plane, _ in known], [error for _, error in known]
    findings = misoriented(given, maps)

    def judged(trials: Sequence[Trial] = (), undetected: Sequence[Undetected] = ()) -> Verdict:
        return verdict(
            residuals,
            trials,
            curve,
            found.agreement,
            model_error=found.model_error,
            findings=findings,
            undetected=undetected,
            calibrated=case.calibrated,
            rounding=case.rounding,
        )

    first = judged()
    if settings.method == "paper" or isinstance(case.engine, Tiled):
        return first
    if settings.kind == "complex" and found.whole is not None:
        findings += _ramp(found.whole)
        if len(given) > 1 and case.diversity < NO_DIVERSITY:
            said = (
                "the planes are so near each other that they hold one picture (diversity "
                f"{case.diversity:.2g}, which should be {LEAST_DIVERSITY:g} or more), and it does not "
                "determine a complex object"
            )
            findings.append(Finding("several objects", said))
    # Where little is amiss and the misfit falls, or after no more than a few iterations, that is it.
    early = first.cause == "iterations" and (len(curve) <= FEW or first.over_noise < NEAR * LIMIT)
    if early:
        return judged()
    with engine_on(case.light.grid) as engine:
        trials, undetected = list[Trial](), tuple[Undetected, ...]()
        if found.whole is not None and not case.modes[1:]:
            progress("what the frames say of the bench")
            test = _score_test(case, settings, engine, found, progress)
            if test is not None and first.within:
                undetected = test.undetected
                if test.is_preferred:
                    findings.append(Finding(test.cause, test.explanation, test.chi_square))
        if not first.within:
            progress("what may differ")
            trials = Doubts(
                engine=engine,
                light=case.light,
                recorded=case.given,
                maps=maps,
                kind=settings.kind,
                tv_weight=settings.tv_weight,
                scale=settings.scale,
                active_width=settings.active_width,
                diversity=case.diversity,
                modes=case.modes,
                stops=stop_search(case, settings, engine, progress),
                stop=FieldStop(case.patch.field_stop_mm, case.patch.field_stop_at_mm),
            ).trials()
    return judged(trials, undetected)


def _score_test(
    case: FramesCase,
    settings: ReconstructionSettings,
    engine: Engine,
    found: MethodResult,
    progress: Progress,
) -> ScoreTest | None:
    """What the frames say of small errors of the bench; None where rays or samples do not take them."""
    assert found.whole is not None
    try:
        return score_test(
            engine,
            case.light,
            case.given,
            found.whole.values,
            settings.kind,
            scale=found.of_method["scale"],
            fits_scale=settings.scale is None,
            active_width=settings.active_width,
            model_error=found.model_error,
            progress=progress,
        )
    except TransferLensError:
        return None


def stop_search(
    case: FramesCase, settings: ReconstructionSettings, engine: Engine, progress: Progress
) -> StopSearch:
    """The search for another field stop than the one that was assumed."""
    grid = case.patch.grid
    return StopSearch(
        engine,
        case.given,
        lambda stop: case.light_behind(case.patch.with_stop(*stop)),
        grid.pitch_mm * min(grid.shape) if settings.patch_mm is None else settings.patch_mm,
        settings.kind,
        settings.scale,
        settings.active_width,
        case.modes,
        progress,
    )


def _ramp(transmission: Field) -> list[Finding]:
    """A finding where a complex object carries a phase ramp that light or camera may have made."""
    phase = smooth_phase_waves(transmission)
    x, y = phase[1, 0], phase[0, 1]
    if math.hypot(x, y) < RAMP_WAVES:
        return []
    said = (
        f"the object carries a phase ramp of {x:.2g}, {y:.2g} waves over half of the patch, which tilted "
        "light or a shifted plane would give too"
    )
    return [Finding("phase ramp", said)]


def _residuals(
    case: FramesCase, maps: Sequence[Array], engine_errors: Sequence[Array | None]
) -> list[PlaneResidual]:
    planes = []
    errors = engine_errors or [None] * len(maps)
    for plane, error, held, about, engine in zip(
        case.recorded, maps, case.held, case.planes, errors, strict=True
    ):
        assert plane.sigma is not None
        left = plane.amplitude, plane.sigma, error, held.pixels, held.sigma
        planes.append(PlaneResidual(about.distance_mm, *left, engine))
    return planes


def is_engine_limited(case: FramesCase, maps: Sequence[Array], misfit: float) -> bool:
    """Whether residuals exceed the noise, and by no more than the engine's predicted error."""
    if excess_of(case, maps) <= 1.0:
        return False
    excess = math.sqrt(max(misfit**2 - (noise_misfit(case.given) or 0.0) ** 2, 0.0))
    return case.predicted_error > excess


def may_be_brighter(case: FramesCase, settings: ReconstructionSettings, found: Reconstructed) -> bool:
    """Whether an amplitude object, whose upper limit of 1 may be too low, rests above the noise."""
    if settings.kind != "amplitude" or settings.scale is not None or isinstance(case.engine, Tiled):
        return False
    if found.stopped_because != "rest" or len(found.residual_maps) < len(case.recorded):
        return False
    return excess_of(case, found.residual_maps) > 1.0


def may_be_stagnated(case: FramesCase, settings: ReconstructionSettings, found: Reconstructed) -> bool:
    """Whether the search for an amplitude object rests above the noise, perhaps in a local minimum."""
    if settings.kind != "amplitude" or isinstance(case.engine, Tiled) or found.stopped_because != "rest":
        return False
    return len(found.residual_maps) == len(case.recorded) and excess_of(case, found.residual_maps) > 1.0


def excess_of(case: FramesCase, maps: Sequence[Array]) -> float:
    """Largest residuals of all planes, over those that count as explained."""
    return max(plane.excess for plane in plane_verdicts(_residuals(case, maps, ())))


def more_accurate_case(case: FramesCase, progress: Progress) -> FramesCase | None:
    """The case with a more accurate engine; None where there is none that is worth it."""
    if isinstance(case.engine, Tiled) or case.predicted_error <= FINEST:
        return None
    target = max(case.predicted_error / FINER, FINEST)
    progress(f"more accurate engine: predicted errors (now {case.predicted_error:.2g}, aim {target:.2g})")
    try:
        engine, predicted = case.engine_of_error(target)
    except TransferLensError:
        return None
    if predicted > case.predicted_error / LEAST_FINER:
        return None
    return case._replace(engine=engine, predicted_error=predicted)


def engine_figures(case: FramesCase) -> dict[str, Any]:
    """Return name and predicted error of the case's engine, ready for JSON."""
    return {"name": case.engine.name, "predicted_error": finite_or_none(case.predicted_error)}


def engine_replaced(before: dict[str, Any], case: FramesCase) -> dict[str, Any]:
    """Return what is reported of an engine that the case's more accurate one has replaced.

    `before` is what :func:`engine_figures` gives of the first engine.
    """
    after = engine_figures(case)
    words = (
        "the engine was replaced, because the misfit was as small as its own error: predicted error "
        f"{before['predicted_error']:.2g} ({before['name']}) before, {after['predicted_error']:.2g} "
        f"({after['name']}) now"
    )
    return {"words": words, "before": before, "after": after}


def engine_errors(
    finer: FramesCase,
    case: FramesCase,
    settings: ReconstructionSettings,
    found: Reconstructed,
    maps: Sequence[Array],
) -> tuple[Array, ...]:
    """Amplitudes of the object found by a more accurate engine less those by the engine asked for."""
    more = maps_of_all(finer.engine, case.light, case.recorded, settings.active_width, found, case.modes)
    return tuple(one - other for one, other in zip(more, maps, strict=True))


def starts_needed(
    case: FramesCase, settings: ReconstructionSettings, found: Reconstructed
) -> ReconstructionSettings:
    """Settings with a second start where iterations rest and planes may not determine a complex object."""
    if settings.starts > 1 or settings.kind != "complex" or isinstance(case.engine, Tiled):
        return settings
    if case.diversity >= LEAST_DIVERSITY or found.stopped_because == "iterations":
        return settings
    return settings.replaced(starts=2)
