"""Assessment of a result by its frames: residuals, the engine's error, the bench that frames prefer, and
causes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from lensdesign.common.text import finite_or_none
from lensdesign.errors import TransferLensError
from wavesim.fields.field import Field, Grid
from wavesim.forward.step_noise import noise_of_step
from wavesim.metrics.goodness_of_fit import (
    FEW,
    LIMIT,
    MODEL_ERROR,
    Finding,
    GoodnessOfFit,
    Trial,
    Undetected,
    not_judged,
    plane_verdicts,
    verdict,
)
from wavesim.metrics.low_orders import smooth_phase_waves
from wavesim.metrics.object_error import correlation_with_error, held_out_error, object_strength
from wavesim.metrics.plane_residuals import PlaneResidual
from wavesim.reconstruction.diagnostics.bench_control import Bench, measured_part
from wavesim.reconstruction.diagnostics.cause_trials import CauseTrials
from wavesim.reconstruction.diagnostics.held_out import is_given, residual_maps_of
from wavesim.reconstruction.diagnostics.orientation import orientation_findings
from wavesim.reconstruction.diagnostics.score_test import ScoreTest, score_test
from wavesim.reconstruction.field_stop import FieldStop, StopSearch
from wavesim.reconstruction.found_object import Array
from wavesim.reconstruction.growing_aperture import STAGE_ITERATIONS
from wavesim.reconstruction.information import WhitenedJacobian, information_of
from wavesim.reconstruction.object_solver import TV_PER_NOISE, Reconstructed, reconstruct
from wavesim.reconstruction.phase_retrieval import agreement
from wavesim.reconstruction.problem import ReconstructionProblem
from wavesim.reconstruction.search_rules import ends_at_noise, tv_factor
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.scene.engine import Engine, Tiled
from wavesim.scene.settings import ReconstructionSettings
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement, noise_misfit
from wavesim.sensor.windows import LEAST_DIVERSITY

FINER, LEAST_FINER, FINEST = 4.0, 1.25, 2e-3
"""Factor by which a more accurate engine's error is smaller: aim, and least factor. The least factor is small
because predicted errors are upper bounds, which fall by less than errors do. The error is never below
`FINEST`, the error of pixels and free space.
"""

OTHER_BENCHES, TRUE_CORRELATION = "other benches", "correlation with the true object"
"""Tests that a verdict may lack, in words."""

Progress = Callable[[str], None]
"""Callback with a message about the current step."""

EngineOn = Callable[[Grid], AbstractContextManager[Engine]]
"""Returns an engine from a part of the object, ready for use."""


class MethodResult(NamedTuple):
    """Result of one method.

    Attributes
    ----------
    transmission, behind : Field or None
        The transmission, or the field behind the part of the object that is to be refocused.
    residual_maps : tuple of ndarray
        For each plane, modelled less measured amplitude of the object that is judged.
    curve : tuple of float
        Misfit or correlation of every iteration.
    of_method : dict
        Figures that only one method has.
    agreement : float or None
        Smallest correlation between results of several starts.
    whole : Field or None
        The transmission on all samples of the object that is judged.
    engine_errors : tuple of ndarray
        Change of the amplitudes with a more accurate engine.
    model_error : float
        Relative error of amplitudes that is allowed.
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


def unjudged_result(
    case: ReconstructionProblem, found: MethodResult, *, on_request: bool = False
) -> GoodnessOfFit:
    """Return the sizes of the residuals of a result that is not judged, or not yet."""
    residuals = plane_residuals(case, found.residual_maps, ())
    return not_judged(verdict(residuals, rounding=case.rounding), on_request=on_request)


def judge_result(
    case: ReconstructionProblem,
    settings: ReconstructionSettings,
    engine_on: EngineOn,
    found: MethodResult,
    progress: Progress,
) -> GoodnessOfFit:
    """Return whether the planes are explained.

    Where they are not, possible causes are tried, except on a whole field or for a quick verdict, which
    rests on the residuals alone.
    """
    if settings.verdict == "none":
        return unjudged_result(case, found, on_request=True)
    residuals, curve = plane_residuals(case, found.residual_maps, found.engine_errors), found.curve
    known = [
        (plane, error)
        for plane, error in zip(case.recorded, found.residual_maps, strict=True)
        if is_given(plane)
    ]
    given, maps = [plane for plane, _ in known], [error for _, error in known]
    findings = orientation_findings(given, maps)

    def judged(
        trials: Sequence[Trial] = (),
        undetected: Sequence[Undetected] = (),
        noise_correlation: float | None = None,
        untested: Sequence[str] = (),
    ) -> GoodnessOfFit:
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
            noise_correlation=noise_correlation,
            untested=untested,
        )

    first = judged()
    without_tests = (OTHER_BENCHES, TRUE_CORRELATION) if first.within else ("causes",)
    if settings.method == "paper" or isinstance(case.engine, Tiled):
        return judged(untested=without_tests)
    if settings.kind == "complex" and found.whole is not None:
        findings += _ramp(found.whole)
        # Diversity of the planes below which their pictures do not determine a complex object.
        no_diversity = 1.0
        if len(given) > 1 and case.diversity < no_diversity:
            explanation = (
                "the planes are so near each other that their pictures are nearly equal (diversity "
                f"{case.diversity:.2g}, which should be {LEAST_DIVERSITY:g} or more); they do not determine "
                "a complex object"
            )
            findings.append(Finding("several objects", explanation))
    # Factor to the limit of an explained misfit below which a falling misfit only needs more iterations.
    near_limit = 1.4
    # If the misfit is only slightly too large and still falls, more iterations are sufficient.
    early = first.cause == "iterations" and (len(curve) <= FEW or first.over_noise < near_limit * LIMIT)
    if early:
        return judged(untested=without_tests)
    if settings.verdict == "quick":
        starts = ("other starts",) if settings.starts == 1 and _may_depend_on_start(case) else ()
        return judged(untested=(*without_tests, *starts))
    with engine_on(case.light.grid) as engine:
        trials, undetected = list[Trial](), tuple[Undetected, ...]()
        noise_correlation, untested = None, list[str]()
        if first.within and (first.held_out_over_noise or 0.0) <= LIMITED_BY_NOISE:
            noise_correlation = _noise_correlation(case, settings, engine, found, residuals)
        if first.within and case.modes[1:]:
            untested.append(f"{OTHER_BENCHES}, since the light has several modes")
        elif first.within and case.bench_test_gb:
            untested.append(f"{OTHER_BENCHES}, which needs --memory-gb {case.bench_test_gb:g}")
        elif first.within and found.whole is not None:
            progress("score test of the bench")
            test = _score_test(case, settings, engine, found, progress)
            if test is None:
                untested.append(OTHER_BENCHES)
            else:
                undetected = test.undetected
                if test.is_preferred:
                    findings.append(Finding(test.cause, test.explanation, test.chi_square))
        if not first.within:
            progress("possible causes")
            trials = CauseTrials(
                engine=engine,
                light=case.light,
                recorded=case.given,
                maps=maps,
                kind=settings.kind,
                tv_weight=settings.tv_weight,
                scale=settings.scale,
                fill_factor=settings.fill_factor,
                diversity=case.diversity,
                source=case.source,
                stops=stop_search(case, settings, engine, progress),
                stop=FieldStop(case.patch.field_stop_mm, case.patch.field_stop_at_mm),
                misfit_of_result=curve[-1],
            ).trials()
    if first.within and noise_correlation is None:
        untested.append(TRUE_CORRELATION)
    return judged(trials, undetected, noise_correlation, untested)


def _noise_correlation(
    case: ReconstructionProblem,
    settings: ReconstructionSettings,
    engine: Engine,
    found: MethodResult,
    residuals: Sequence[PlaneResidual],
) -> float | None:
    """Return the least correlation with the true object that noise leaves.

    It is the smaller of two: that of the error on held-out pixels, and that of an estimate which knows only
    band and contrast of the object and removes detail as the total variation does. The second contains errors
    that no pixel shows. None without held-out pixels, for several modes of light, and where planes have too
    little diversity: many objects then explain the frames.
    """
    has_little_diversity = len(case.given) > 1 and case.diversity < LEAST_DIVERSITY
    if found.whole is None or case.modes[1:] or has_little_diversity:
        return None
    error = held_out_error(residuals)
    if error is None:
        return None
    shown = correlation_with_error(error, object_strength(found.whole, case.light))
    jacobian = WhitenedJacobian(
        engine,
        case.light,
        case.given,
        found.whole,
        settings.kind,
        case.patch.inside,
        settings.fill_factor,
    )
    shrinkage = TV_PER_NOISE * tv_factor(settings.kind, engine, case.given)
    if settings.tv_weight != "auto":
        shrinkage = settings.tv_weight * found.of_method["scale"] / noise_of_step(jacobian.linear.model)
    return min(shown, information_of(jacobian, shrinkage=shrinkage).least_correlation)


def _score_test(
    case: ReconstructionProblem,
    settings: ReconstructionSettings,
    engine: Engine,
    found: MethodResult,
    progress: Progress,
) -> ScoreTest | None:
    """Return the score test of the bench, or None where rays or samples do not allow it.

    Where it prefers another bench, a control tells how much of its significance is due to the bench.
    """
    assert found.whole is not None
    scale = found.of_method["scale"]
    try:
        test = score_test(
            engine,
            case.light,
            case.given,
            found.whole.values,
            settings.kind,
            scale=scale,
            fits_scale=settings.scale is None,
            fill_factor=settings.fill_factor,
            model_error=found.model_error,
            calibrated=case.sought,
            progress=progress,
        )
    except TransferLensError:
        return None
    if not test.is_preferred:
        return test
    progress("control: the object on the preferred bench")
    try:
        part = measured_part(
            Bench(engine, case.light, case.given),
            found.whole,
            test.estimate,
            test.fall,
            kind=settings.kind,
            scale=scale,
            fill_factor=settings.fill_factor,
        )
    except TransferLensError:  # without a control, the score test alone decides
        return test
    return replace(test, chi_square=min(max(part, 0.0), 1.0) * test.chi_square)


def stop_search(
    case: ReconstructionProblem,
    settings: ReconstructionSettings,
    engine: Engine,
    progress: Progress,
    checkpoint: Checkpoint | None = None,
) -> StopSearch:
    """Return the search for another field stop than the assumed one."""
    grid = case.patch.grid
    return StopSearch(
        engine,
        case.given,
        lambda stop: case.light_behind(case.patch.with_stop(*stop)),
        grid.pitch_mm * min(grid.shape) if settings.patch_mm is None else settings.patch_mm,
        settings.kind,
        settings.scale,
        settings.fill_factor,
        case.modes,
        lambda stage, completed, total: progress(stage),
        checkpoint,
    )


def _ramp(transmission: Field) -> list[Finding]:
    """Return a finding if a complex object has a phase ramp that light or camera may have caused."""
    phase = smooth_phase_waves(transmission)
    x, y = phase[1, 0], phase[0, 1]
    # Phase ramp in waves over half of the patch above which light or camera may be its cause.
    ramp_waves = 0.35
    if math.hypot(x, y) < ramp_waves:
        return []
    explanation = (
        f"the object carries a phase ramp of {x:.2g}, {y:.2g} waves over half of the patch, which tilted "
        "light or a shifted plane would give too"
    )
    return [Finding("phase ramp", explanation)]


def plane_residuals(
    case: ReconstructionProblem, maps: Sequence[Array], engine_errors: Sequence[Array | None]
) -> list[PlaneResidual]:
    """Return the residuals of all planes, with the pixels that were held out."""
    planes = []
    errors = engine_errors or [None] * len(maps)
    for plane, error, held_out, plane_frames, engine in zip(
        case.recorded, maps, case.held_out, case.planes, errors, strict=True
    ):
        assert plane.sigma is not None
        left = plane.amplitude, plane.sigma, error, held_out.pixels, held_out.sigma
        planes.append(PlaneResidual(plane_frames.distance_mm, *left, engine))
    return planes


def is_engine_limited(case: ReconstructionProblem, maps: Sequence[Array], misfit: float) -> bool:
    """Return whether residuals exceed the noise, by no more than the engine's predicted error."""
    if excess_of(case, maps) <= 1.0:
        return False
    excess = math.sqrt(max(misfit**2 - (noise_misfit(case.given) or 0.0) ** 2, 0.0))
    return case.predicted_error > excess


def may_be_stagnated(
    case: ReconstructionProblem, settings: ReconstructionSettings, found: Reconstructed
) -> bool:
    """Return whether the search for an amplitude or phase object may have ended in a local minimum.

    Whether it left more than the noise is for :func:`excess_of` to say, which needs all planes.
    """
    has_all_planes = len(found.residual_maps) == len(case.recorded)
    return has_all_planes and not needs_more_iterations(settings, found)


def needs_more_iterations(settings: ReconstructionSettings, found: Reconstructed) -> bool:
    """Return whether a search of few iterations has not converged, so that more are the remedy."""
    return found.stopped_because == "iterations" and settings.most_iterations < STAGE_ITERATIONS


def excess_of(case: ReconstructionProblem, maps: Sequence[Array]) -> float:
    """Return the largest residuals of all planes over those that count as explained."""
    return max(plane.excess for plane in plane_verdicts(plane_residuals(case, maps, ())))


def more_accurate_case(case: ReconstructionProblem, progress: Progress) -> ReconstructionProblem | None:
    """Return the problem with a more accurate engine; None if no engine is accurate enough to be worth it."""
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


def engine_summary(case: ReconstructionProblem) -> dict[str, Any]:
    """Return name and predicted error of the problem's engine, ready for JSON."""
    return {"name": case.engine.name, "predicted_error": finite_or_none(case.predicted_error)}


def engine_replaced(first_engine: dict[str, Any], case: ReconstructionProblem) -> dict[str, Any]:
    """Return the report on an engine that the problem's more accurate one has replaced.

    `first_engine` is the result of :func:`engine_summary` for the first engine.
    """
    last_engine = engine_summary(case)
    words = (
        "the engine was replaced, because the misfit was as small as its own error: predicted error "
        f"{first_engine['predicted_error']:.2g} ({first_engine['name']}) before, "
        f"{last_engine['predicted_error']:.2g} ({last_engine['name']}) now"
    )
    return {"words": words, "before": first_engine, "after": last_engine}


def engine_errors(
    finer: ReconstructionProblem,
    case: ReconstructionProblem,
    settings: ReconstructionSettings,
    found: Reconstructed,
    maps: Sequence[Array],
) -> tuple[Array, ...]:
    """Return amplitudes of the object with a more accurate engine less those with the given engine."""
    more = residual_maps_of(finer.engine, case.light, case.recorded, settings.fill_factor, found, case.modes)
    return tuple(one - other for one, other in zip(more, maps, strict=True))


LIMITED_BY_NOISE = 1.1
"""Residuals of held-out pixels over the noise up to which the noise alone limits the object. Textures, of
which the total variation removes more than noise demands, leave 1.17.
"""

LARGEST_MISFIT_RATIO = 1.03
"""Misfit of another start over that of the object found, up to which it explains the frames as well."""


def starts_needed(
    case: ReconstructionProblem, settings: ReconstructionSettings, found: Reconstructed
) -> ReconstructionSettings:
    """Return settings with a second start if iterations converged but the planes may not determine the
    object.
    """
    if settings.starts > 1 or isinstance(case.engine, Tiled) or settings.verdict != "full":
        return settings
    if not _may_depend_on_start(case) or found.stopped_because == "iterations":
        return settings
    return settings.replaced(starts=2)


def _may_depend_on_start(case: ReconstructionProblem) -> bool:
    """Return whether planes have so little diversity that another start may end at another object."""
    return case.diversity < LEAST_DIVERSITY


def agreement_of_starts(
    engine: Engine,
    light: Field,
    recorded: Sequence[Measurement],
    settings: ReconstructionSettings,
    found: Reconstructed,
    progress: Callable[[str], None],
    modes: Sequence[SourceMode] = (),
) -> float | None:
    """Return the smallest correlation between the lit objects of several starts.

    A start that leaves a clearly larger misfit has ended in a local minimum and does not count; the result is
    None if no other start counts. Amplitude objects have the scale of the object found, and thus its limit.

    Parameters
    ----------
    engine, light, recorded, modes
        See :func:`wavesim.reconstruct`.
    settings
        Number of starts, and all other settings.
    found
        Result of the usual start.
    progress
        Called with a message for each start.
    """
    if settings.starts == 1:
        return None
    ends = [light.with_values(light.values * found.transmission.values)]
    # The total variation would hold the edges of a random start.
    has_free_edges = settings.tv_weight != 0.0 and not ends_at_noise(settings.kind, engine)
    without_tv = settings.most_iterations if has_free_edges else 0
    # Root mean square of the random phases of complex objects at the start; amplitudes are from 0 to 1.
    phase_rad = 1.0
    for seed in range(1, settings.starts):
        progress(f"start {seed + 1} of {settings.starts}")
        random = np.random.default_rng(seed)
        if settings.kind == "amplitude":
            first = random.random(light.grid.shape)
        else:
            first = np.exp(1j * phase_rad * random.standard_normal(light.grid.shape))
        other = reconstruct(
            engine,
            light,
            recorded,
            kind=settings.kind,
            tv_weight=settings.tv_weight,
            iterations=settings.most_iterations,
            until_noise=ends_at_noise(settings.kind, engine),
            scale=found.scale if settings.kind == "amplitude" else settings.scale,
            start=light.with_values(first.astype(light.values.dtype)),
            fill_factor=settings.fill_factor,
            modes=modes,
            tv_factor=found.tv_factor,
            iterations_without_tv=without_tv,
        )
        if other.misfit[-1] <= LARGEST_MISFIT_RATIO * found.misfit[-1]:
            ends.append(light.with_values(light.values * other.transmission.values))
    return agreement(ends) if len(ends) > 1 else None
