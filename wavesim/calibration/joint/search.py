"""Light, lens, mounting and camera from the frames alone, together with the object.

A bench is judged by the misfit of a reconstruction from even light after a few iterations, or of a known
object. Each step of the search takes its direction from the normal equations of object and bench about that
object, and its length from such reconstructions along it. Tiles are computed at the start of the search and
perturbed from there. The derivatives of their rays hardly change during the search and are computed once.

The limit of an amplitude object whose scale is unknown can be far too low
(:mod:`wavesim.reconstruction.amplitude_limit`), as for objects on a dark ground. Such a limit would decide
about the bench, so the search then works without one.

At the end, the object is reconstructed until its misfit reaches that of the noise. An amplitude object that
the search has clipped a little loses its limit then, since uneven light would seem to cause what is clipped.
An object on a dark ground is sought where it lies (:mod:`wavesim.calibration.joint.object_position`). The
normal equations about the object, with the variance of the noise, give the estimates and their covariance
(:mod:`wavesim.calibration.joint.covariance`). Parameters that the frames do not need
(:mod:`wavesim.calibration.joint.selection`) return to their nominal values.

The unevenness of the light is sought last, because it can imitate any other error. The tilt of the sensor is
sought last, too: the frames determine it least, and it makes every reconstruction half as long again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import TransferLensError
from wavesim.calibration.joint.covariance import (
    INDEPENDENT_ERRORS,
    covariance_of_estimates,
    residual_variance,
)
from wavesim.calibration.joint.gauss_newton_step import GaussNewtonStep
from wavesim.calibration.joint.line_search import LineSearch
from wavesim.calibration.joint.object_position import (
    MisfitAt,
    better_position,
    is_dark_at_rim,
    position_deviations,
)
from wavesim.calibration.joint.pixels import CalibrationPixels, RayDerivatives
from wavesim.calibration.joint.selection import count_not_needed, eliminated_in_turn
from wavesim.calibration.object_uncertainty import ObjectUncertainty, object_uncertainty
from wavesim.calibration.parameters import LightAmplitude, Parameter, SensorTilt, Unknowns
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.linear_model import LinearModel, RealArray
from wavesim.forward.step_noise import noise_of_step
from wavesim.metrics.displacement import displacement_changes
from wavesim.metrics.goodness_of_fit import LIMIT
from wavesim.reconstruction.amplitude_limit import with_own_limit
from wavesim.reconstruction.object_solver import Reconstructed, reconstruct
from wavesim.reconstruction.stop_rule import expected_change
from wavesim.scene.engine import Operator
from wavesim.scene.settings import Kind

FIRST_STRETCH, MOST_STRETCH = (1.5, 1.75), 2.0
"""Multiples of a step that are tried first: for the first step of each stage, and the limit for other
steps.
"""

MODEL_FRACTION = 0.02
"""Fraction of the squared misfit that model errors cause, and that therefore carries no information.

It is the cost of a parameter that deviates by its expected standard deviation.
"""

CONVERGED_ITERATIONS, ESTIMATE_ITERATIONS, ELIMINATION_ITERATIONS = 80, 30, 20
"""Iterations of the object at the end, and iterations of conjugate gradients: for the estimates, and at most
to eliminate the object from the effects of the parameters.
"""

CONVERGED = "converged"
"""Reason for the end of a search that has found its parameters."""

Progress = Callable[[int, Unknowns, float], None]

MOST_ITERATIONS, UNSETTLED_GAIN = 40, 0.1
"""Iterations of a reconstruction up to which they are doubled where the misfit of the object has not settled,
and the fraction of the squared misfit by which as many iterations again then reduce it.
"""

CLIPPED_GAIN = 0.5
"""Fraction of the squared misfit that must disappear without a limit of the object, for the search to work
without it. On careful benches, a letter and a chart on a dark ground lose 0.72 to 0.82, others up to 0.24.
"""

EQUAL_RATIO = 1.02
"""Ratio of misfits up to which a bench with fewer parameters, a refined one, or one with a displaced object
counts as equal.
"""

TRIAL_ITERATIONS, LEAST_TRIAL_GAIN = 20, 0.2
"""Iterations with and without a limit, and the fraction of the squared misfit that must disappear in them for
the whole test. They find 0.5 and more where that finds `CLIPPED_GAIN`.
"""

DISPLACEMENT_ORDERS = 3
"""Orders of the displacement of an object on a dark ground that are eliminated exactly. Decenter and light
tilt have converged after 30 iterations with three, and after 100 with one.
"""

NEAR_NOISE = 1.5
"""Misfit over that of noise below which it is near the noise."""


class StoredFit(NamedTuple):
    """A bench with its object, as a checkpoint holds it.

    Attributes
    ----------
    unknowns : Unknowns
        The bench.
    transmission : ndarray
        Transmission of the object.
    curve : tuple of float
        Misfit of each iteration.
    upper_bound, scale : float
        Limit of the object's amplitude, and measured amplitude per unit of the modelled amplitude.
    """

    unknowns: Unknowns
    transmission: NDArray[Any]
    curve: tuple[float, ...]
    upper_bound: float
    scale: float


class StagePoint(NamedTuple):
    """Point of a stage, between two steps.

    Attributes
    ----------
    reference : Unknowns
        Bench of the tiles that the stage perturbs.
    current, slopes : StoredFit
        Current bench, and the one where the derivatives were computed.
    sought : tuple of str
        Names of the parameters that the stage seeks.
    is_repeated : bool
        Whether the last stage is repeated about tiles of its own, because perturbed tiles have misled it.
    ended_because : str
        Reason for the end of the stage; empty while it continues, or if only the number of benches ends it.
    """

    reference: Unknowns
    current: StoredFit
    slopes: StoredFit
    sought: tuple[str, ...]
    is_repeated: bool
    ended_because: str = ""


@dataclass(frozen=True, eq=False)
class SearchState:
    """State of a search: all that is needed to resume it, and to find the same bits.

    Attributes
    ----------
    unknowns : Unknowns
        Current bench.
    stage : int
        Index of the stage; each stage seeks more parameters.
    stretch : float
        Multiple of the last step that was best.
    trail : tuple of (Unknowns, float)
        Benches that were tried, and their misfits.
    iterations : int
        Iterations of each reconstruction; 0: as many as the search began with.
    scale_without_limit : float
        Scale of an amplitude object that has no limit, because that of 1 would clip it; 0: it has the limit.
    point : StagePoint or None
        Where the stage continues; None: it begins at the current bench.
    """

    unknowns: Unknowns
    stage: int = 0
    stretch: float = FIRST_STRETCH[0]
    trail: tuple[tuple[Unknowns, float], ...] = ()
    iterations: int = 0
    scale_without_limit: float = 0.0
    point: StagePoint | None = None


@dataclass(frozen=True, eq=False)
class FitResult:
    """Result of a search.

    Attributes
    ----------
    unknowns : Unknowns
        The bench; parameters that are not needed have their nominal values.
    estimates : ndarray, shape (parameters,)
        Estimate of each parameter, needed or not.
    needed : ndarray of bool, shape (parameters,)
        Whether the frames need the parameter.
    covariance : ndarray, shape (parameters, parameters), or None
        Covariance of the estimates, with the prior included; None if it was not requested. All parameters
        are then needed.
    misfit : float
        Misfit of the bench.
    trail : tuple of (Unknowns, float)
        Benches that were tried, and their misfits.
    stopped_because : str
        Reason for the end of the search.
    object_uncertainty : ObjectUncertainty or None
        Errors of the object that the covariance allows; None for a known object, or without a covariance.
    """

    unknowns: Unknowns
    estimates: Array
    needed: NDArray[np.bool_]
    covariance: Array | None
    misfit: float
    trail: tuple[tuple[Unknowns, float], ...]
    stopped_because: str
    object_uncertainty: ObjectUncertainty | None = None

    @property
    def deviations(self) -> Array | None:
        """Standard deviation of each parameter; None without a covariance."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance))


class _BenchFit(NamedTuple):
    """A bench with the object found on it (or the known object), and the misfit of each iteration.

    An amplitude object that the limit of 1 would clip has none, and keeps its scale.
    """

    unknowns: Unknowns
    linear: LinearModel
    transmission: NDArray[Any]
    curve: tuple[float, ...]
    upper_bound: float = 1.0

    @property
    def misfit(self) -> float:
        return self.linear.misfit

    @property
    def engine(self) -> Operator:
        return self.linear.model.engine

    @property
    def stored(self) -> StoredFit:
        """The bench as a checkpoint holds it."""
        scale = self.linear.model.scale
        return StoredFit(self.unknowns, self.transmission, self.curve, self.upper_bound, scale)


class _ReferenceTiles(NamedTuple):
    """A bench with tiles of its own, which similar benches perturb, and the derivatives of their rays."""

    unknowns: Unknowns
    model: ChannelModel
    ray_derivatives: RayDerivatives | None

    @property
    def engine(self) -> Operator:
        return self.model.engine


@dataclass(frozen=True, eq=False)
class JointSearch:
    """Search for parameters of a bench together with the object.

    Attributes
    ----------
    pixels : CalibrationPixels
        Pixels of the frames, and their engines.
    kind : {"amplitude", "complex", "phase"}
        Kind of the object.
    parameters : tuple of Parameter
        Parameters that are sought.
    iterations : int
        Iterations of each reconstruction at first. They are doubled, up to `MOST_ITERATIONS`, where the
        misfit of the object has not settled on the bench found.
    most_benches : int
        Largest number of benches that are tried.
    noise_misfit : float or None
        Misfit that the stated noise alone would leave.
    known : ndarray or None
        Transmission of the object where it is known, real for an amplitude object.
    progress
        Callback `progress(count, unknowns, misfit)`, called for each bench.
    keep
        Callback `keep(state)`, called after each step.
    on_stage
        Callback `on_stage(stage, completed, total)` for the stages that follow the search; the total is 0
        where it is unknown.
    absorbed : tuple of Parameter
        Parameters of the light that are not sought, because the object takes them over.
    scale_without_limit : float
        Scale of an amplitude object without a limit, that of the state (`SearchState`).
    has_deviations : bool
        Whether standard deviations are computed, and parameters that are not needed return to nominal.
    """

    pixels: CalibrationPixels
    kind: Kind
    parameters: tuple[Parameter, ...]
    iterations: int
    most_benches: int
    noise_misfit: float | None
    known: NDArray[Any] | None = None
    progress: Progress | None = None
    keep: Callable[[SearchState], None] | None = None
    on_stage: Callable[[str, int, int], None] = lambda stage, completed, total: None
    absorbed: tuple[Parameter, ...] = ()
    scale_without_limit: float = 0.0
    has_deviations: bool = True

    def run(self, state: SearchState) -> FitResult:
        """Search from a state and return the result.

        Raises
        ------
        TransferLensError
            If the model raises it at the start. Later benches at which it raises are avoided.
        """
        if state.iterations > self.iterations:  # of a search that was interrupted
            return replace(self, iterations=state.iterations).run(state)
        if state.scale_without_limit != self.scale_without_limit:
            return replace(self, scale_without_limit=state.scale_without_limit).run(state)
        if state.point is None:
            current = self._fit_bench(state.unknowns)
            if not state.trail and (scale := self._scale_without_limit(current)) > 0.0:
                del current  # the search makes its own engine
                iterations = max(self.iterations, MOST_ITERATIONS)
                return self.run(replace(state, iterations=iterations, scale_without_limit=scale))
            state = self._with_trial(state, current.unknowns, current.misfit)
            reference = self._reference_tiles(current)
        else:
            reference = self._restored_tiles(state.point)
            current = self._restored_fit(state.point.current, reference)
        is_repeated = state.point is not None and state.point.is_repeated
        if state.stage == 0:
            first_parameters = tuple(p for p in self.parameters if not p.is_sought_last)
            if state.point is not None or not self._is_near_noise(current):
                state, current = self._descend(
                    state, current, reference, first_parameters or self.parameters
                )[:2]
            state = replace(state, stage=1, stretch=FIRST_STRETCH[1])
        state, current, reason = self._descend(
            state, current, reference, self.parameters, is_repeated=is_repeated
        )
        verified = self._verified(current)
        if not is_repeated and self._is_misled(current, verified) and len(state.trail) < self.most_benches:
            current = self._fit_bench(current.unknowns, verified.engine)
            state = self._with_trial(state, current.unknowns, current.misfit)
            reference = self._reference_tiles(current)
            state, current, reason = self._descend(
                state, current, reference, self.parameters, is_repeated=True
            )
            verified = self._verified(current)
        if self._is_unsettled(current, verified) and len(state.trail) < self.most_benches:
            iterations = min(2 * self.iterations, MOST_ITERATIONS)
            del current, verified, reference  # the next search makes its own engines and derivatives
            return self.run(replace(state, iterations=iterations, stretch=FIRST_STRETCH[1]))
        return self._estimated(state, current, verified, reference.ray_derivatives, reason)

    def _estimated(
        self,
        state: SearchState,
        current: _BenchFit,
        verified: _BenchFit,
        ray_derivatives: RayDerivatives | None,
        reason: str,
    ) -> FitResult:
        """Return the estimates about the final object, and the bench with the parameters that are needed."""
        self.on_stage("object on the bench found", 0, 0)
        best, equations = self._refined(
            self._without_wrong_limit(self._converged_fit(current.unknowns, verified)), ray_derivatives
        )
        if not self.has_deviations:
            return self._without_deviations(best, equations, state, reason)
        eliminated = equations.eliminated(
            ELIMINATION_ITERATIONS if self.known is None else 0,
            lambda done, total: self.on_stage("standard deviations", done, total),
        )
        estimates = self._within_range(best, partial(equations.step_of_effects, eliminated.columns))
        covariance = covariance_of_estimates(
            equations, self.parameters, self.pixels.recorded, eliminated.columns
        )
        position = self._position_deviations(best, equations)
        uncertainty = None
        if self.known is None:
            self.on_stage("uncertainty of the object", 0, 0)
            uncertainty = object_uncertainty(
                equations, covariance, eliminated.changes, position, self._absorbed_changes(best.unknowns)
            )
        if position is not None:
            steps = position[:, None] * self._steps_with_samples(equations)
            covariance = covariance + steps.T @ steps
        del equations, eliminated  # their columns are large
        best, needed = self._with_fewer(best, estimates, covariance)
        end = best.misfit, state.trail, reason, uncertainty
        return FitResult(best.unknowns, estimates, needed, covariance, *end)

    def _without_deviations(
        self, best: _BenchFit, equations: GaussNewtonStep, state: SearchState, reason: str
    ) -> FitResult:
        """Return the bench of the last estimates, or the one before if that is better; all are needed."""
        last = best.unknowns.changed(self.parameters, self._estimates(best, equations).tolist())
        best = self._fit_within((EQUAL_RATIO * best.misfit) ** 2, last, best) or best
        needed = np.ones(len(self.parameters), bool)
        end = best.misfit, state.trail, reason
        return FitResult(best.unknowns, best.unknowns.of(self.parameters), needed, None, *end)

    def _refined(
        self, best: _BenchFit, ray_derivatives: RayDerivatives | None
    ) -> tuple[_BenchFit, GaussNewtonStep]:
        """Return the object and its normal equations, each about the bench that the ones before estimate."""
        # Number of times that estimates are made. On a dark ground, each may follow a displaced object.
        is_on_dark_ground = self._is_on_dark_ground(best)
        rounds = 4 if is_on_dark_ground else 2
        for count in range(rounds):
            self.on_stage("estimates", count, rounds)
            equations = self._equations(best, ray_derivatives)
            if count == rounds - 1:
                break
            estimates = self._estimates(best, equations)
            unknowns = best.unknowns.changed(self.parameters, estimates.tolist())
            refined = self._converged_fit_or_none(unknowns, best)
            if refined is None or refined.misfit > EQUAL_RATIO * best.misfit:
                break
            best = self._at_better_position(refined, equations) if is_on_dark_ground else refined
        return best, equations

    def _position_deviations(self, fit: _BenchFit, equations: GaussNewtonStep) -> Array | None:
        """Return how far trials leave the position of the object open, along x and y in samples.

        It is None for an object on a clear ground.
        """
        if not self._is_on_dark_ground(fit):
            return None
        self.on_stage("position of the object", 0, 0)
        return np.array(position_deviations(self._misfits_of_displaced(fit, equations), EQUAL_RATIO))

    def _absorbed_changes(self, unknowns: Unknowns) -> list[NDArray[np.complexfloating]]:
        """Return changes of the light that was not sought, of one expected standard deviation each."""
        return [np.asarray(p.typical * self.pixels.light_change(unknowns, p), complex) for p in self.absorbed]

    def _with_fewer(
        self, best: _BenchFit, estimates: Array, covariance: Array
    ) -> tuple[_BenchFit, NDArray[np.bool_]]:
        """Return a fit that is as good with fewer parameters, and which ones it needs.

        A misfit that is larger by 2 % counts as equal. If the frames are not explained within their noise,
        each parameter explains one of the independent errors of the model by chance, and the squared misfit
        may rise by as much without it. In frames that are explained, or whose noise is not known, errors of
        the model do not decide.
        """
        selections = eliminated_in_turn(estimates, covariance)
        noise = self.noise_misfit or 0.0
        is_explained = self.noise_misfit is None or best.misfit <= LIMIT * noise
        square = (EQUAL_RATIO * max(best.misfit, noise)) ** 2
        by_chance = 0.0 if is_explained else (best.misfit**2 - noise**2) / INDEPENDENT_ERRORS

        def fit(count: int) -> _BenchFit | None:
            """Return the fit without a number of parameters; None if its misfit is larger."""
            unknowns = best.unknowns.changed(self.parameters, selections[count].values.tolist())
            return self._fit_within(square + count * by_chance, unknowns, best)

        # The nominal bench comes first: small errors in stiff directions make a linear model ask for more.
        not_needed = count_not_needed(selections, covariance, self._pixel_count)
        most_fits, fits = 2 + (0 if is_explained else not_needed.bit_length()), 0
        for count in (len(self.parameters), not_needed):
            self.on_stage("parameters that the frames need", fits, most_fits)
            fits += 1
            if (fewer := fit(count)) is not None:
                return fewer, selections[count].needed
        kept, without = best, 0
        while not is_explained and not_needed - without > 1:
            self.on_stage("parameters that the frames need", fits, most_fits)
            fits += 1
            count = (without + not_needed) // 2
            if (fewer := fit(count)) is None:
                not_needed = count
            else:
                kept, without = fewer, count
        return kept, selections[without].needed

    @property
    def _pixel_count(self) -> int:
        """Number of valid pixels."""
        planes = self.pixels.recorded
        return sum(p.amplitude.size if p.known is None else int(p.known.sum()) for p in planes)

    def _at_better_position(self, fit: _BenchFit, equations: GaussNewtonStep) -> _BenchFit:
        """Return the bench with the object displaced to where the misfit is smaller, if it is."""
        place = better_position(self._misfits_of_displaced(fit, equations))
        moved = None if place == (0, 0) else self._displaced_fit(fit, equations, *place)
        found = None if moved is None else self._converged_fit_or_none(moved.unknowns, moved)
        return fit if found is None or found.misfit > fit.misfit else found

    def _misfits_of_displaced(self, fit: _BenchFit, equations: GaussNewtonStep) -> MisfitAt:
        """Return the function of a displacement in samples along x and y that returns the misfit."""

        def misfit_at(x: int, y: int) -> float:
            found = self._displaced_fit(fit, equations, x, y)
            return math.inf if found is None else found.misfit

        return misfit_at

    def _displaced_fit(self, fit: _BenchFit, equations: GaussNewtonStep, x: int, y: int) -> _BenchFit | None:
        """Return the fit of an object displaced by samples along x and y, on a bench that follows.

        It is None where the model fails, and where a parameter would be too far from its expected deviation.
        """
        # Most iterations of the object, and largest deviation of a parameter over the expected one.
        iterations, most_deviations = 4, 3.0
        typical, values = _typical(self.parameters), fit.unknowns.of(self.parameters)
        bench = values + np.array([x, y]) @ self._steps_with_samples(equations)
        bench = np.maximum(bench, _lower_bounds(self.parameters))
        if np.any(np.abs(bench) > np.maximum(most_deviations * typical, np.abs(values))):
            return None
        start = fit._replace(transmission=np.roll(fit.transmission, (y, x), (0, 1)))
        try:
            unknowns = fit.unknowns.changed(self.parameters, bench.tolist())
            return self._fit_bench(unknowns, fit.engine, start, iterations)
        except TransferLensError:
            return None

    def _steps_with_samples(self, equations: GaussNewtonStep) -> Array:
        """Return the steps of the bench that follow a sample of displacement along x and y."""
        follows = np.array([p.follows_object for p in self.parameters])
        return equations.steps_with_displacements(follows)[:2]

    def _converged_fit_or_none(self, unknowns: Unknowns, start: _BenchFit) -> _BenchFit | None:
        try:
            return self._converged_fit(unknowns, start)
        except TransferLensError:
            return None

    def _converged_fit(self, unknowns: Unknowns, start: _BenchFit) -> _BenchFit:
        """Return the bench with an object whose misfit has reached the noise or has converged."""
        return self._fit_bench(unknowns, start=start, iterations=CONVERGED_ITERATIONS)

    def _fit_within(self, square: float, unknowns: Unknowns, start: _BenchFit) -> _BenchFit | None:
        """Return the converged fit if its squared misfit is within a limit, else None.

        Where the noise is known, a bench is given up that is far from the limit after some iterations, and
        whose further ones are not expected to come near it.
        """
        # Those iterations, and the squared misfit over the limit from which a bench is given up.
        first_iterations, hopeless = 10, 4.0
        try:
            fit = self._fit_bench(unknowns, start=start, iterations=first_iterations)
            if self.known is None:
                expected = fit.misfit * (1.0 - min(expected_change(fit.curve), 1.0))
                if self.noise_misfit is not None and expected**2 > hopeless * square:
                    return None
                fit = self._continued_fit(fit)
        except TransferLensError:
            return None
        return fit if fit.misfit**2 <= square else None

    def _continued_fit(self, fit: _BenchFit) -> _BenchFit:
        """Return the same bench with an object whose misfit has reached the noise or has converged."""
        model, is_bounded = fit.linear.model, math.isfinite(fit.upper_bound)
        found = self._object(
            model,
            model.illumination.with_values(fit.transmission),
            CONVERGED_ITERATIONS,
            scale=self.pixels.scale if is_bounded else model.scale,
            until_noise=True,
            bounded=is_bounded,
        )
        return self._on_bench(fit.unknowns, model, found, fit.upper_bound)

    def _is_on_dark_ground(self, fit: _BenchFit) -> bool:
        """Return whether only the aberrations of the lens tell where an amplitude object is."""
        if self.kind != "amplitude" or self.known is not None:
            return False
        return is_dark_at_rim(fit.transmission, fit.linear.model.illumination)

    @property
    def _keeps_limit(self) -> bool:
        """Whether the limit of the object stays; without noise, how far it brightens is not known."""
        is_sought = self.kind == "amplitude" and self.known is None and self.pixels.scale is None
        return not is_sought or self.noise_misfit is None

    def _without_wrong_limit(self, fit: _BenchFit) -> _BenchFit:
        """Return the bench with an amplitude object that is not limited where the search has clipped it."""
        if self._keeps_limit or math.isinf(fit.upper_bound):
            return fit
        model = fit.linear.model

        def solve(
            start: Field | None, scale: float, *, bounded: bool, iterations: int | None = None
        ) -> Reconstructed:
            most = iterations or CONVERGED_ITERATIONS
            return self._object(model, start, most, scale=scale, until_noise=False, bounded=bounded)

        transmission = model.illumination.with_values(fit.transmission)
        found = Reconstructed(transmission, fit.curve, (), model.scale, "converged")
        limited = with_own_limit(solve, found, model.illumination, noise_of_step(model))
        if limited.scale <= found.scale:  # the limit was right, or too high
            return fit
        free = solve(limited.transmission, limited.scale, bounded=False)
        return self._on_bench(fit.unknowns, model, free, math.inf)

    def _scale_without_limit(self, first: _BenchFit) -> float:
        """Return the scale of an object whose limit explains most of its misfit; 0 if it does not."""
        if self._keeps_limit or math.isinf(first.upper_bound) or self._is_near_noise(first):
            return 0.0
        self.on_stage("scale of the object", 0, 0)
        free = first._replace(upper_bound=math.inf)
        short, short_free = (
            self._fit_bench(first.unknowns, start=start, iterations=TRIAL_ITERATIONS)
            for start in (first, free)
        )
        if short_free.misfit**2 > (1.0 - LEAST_TRIAL_GAIN) * short.misfit**2:
            return 0.0
        limited = self._converged_fit(first.unknowns, first)
        lifted = self._without_wrong_limit(limited)
        if lifted.misfit**2 > (1.0 - CLIPPED_GAIN) * limited.misfit**2:
            return 0.0
        return lifted.linear.model.scale

    def _equations(self, fit: _BenchFit, ray_derivatives: RayDerivatives | None) -> GaussNewtonStep:
        """Return the normal equations about an object, without damping."""
        linear = fit.linear
        columns = self.pixels.columns(fit.unknowns, linear, self.parameters, ray_derivatives)
        # A misfit beyond the noise is a model error, which limits the information like noise.
        misfit = max(linear.misfit, self.noise_misfit or 0.0)
        variance = residual_variance(misfit, self._pixel_count)
        equations = self._normal_equations(
            fit, self.parameters, columns, variance, linear.unbiased_residual()
        )
        equations.damping = np.zeros_like(equations.damping)
        return equations

    def _estimates(self, fit: _BenchFit, equations: GaussNewtonStep) -> Array:
        """Return the estimates that conjugate gradients find."""

        def step_of(is_free: NDArray[np.bool_], others: Array) -> Array:
            left = equations if is_free.all() else equations.after(others).restricted(is_free)
            return left.solve(ESTIMATE_ITERATIONS)

        return self._within_range(fit, step_of)

    def _within_range(self, fit: _BenchFit, step_of: Callable[[NDArray[np.bool_], Array], Array]) -> Array:
        """Return the estimates, from a function that solves for free parameters beside steps of the others.

        A parameter that would leave its range ends there, and moves the others.
        """
        values = fit.unknowns.of(self.parameters)
        estimates = values + step_of(np.ones(len(values), bool), np.zeros(len(values)))
        lower_bounds = _lower_bounds(self.parameters)
        is_free = estimates >= lower_bounds
        if not is_free.all():
            estimates = np.where(is_free, values, lower_bounds)
            estimates[is_free] += step_of(is_free, estimates - values)
        return estimates

    def _verified(self, current: _BenchFit) -> _BenchFit:
        """Return the bench with tiles of its own, after as many iterations again."""
        return self._fit_bench(current.unknowns, start=current)

    def _is_misled(self, current: _BenchFit, verified: _BenchFit) -> bool:
        """Return whether a bench's own tiles leave a larger misfit than the perturbed tiles of the search."""
        # Iterations after which an object found with other tiles has adapted to a bench's own tiles.
        adapted_after = 1
        own_misfit = verified.curve[min(adapted_after, len(verified.curve) - 1)]
        return own_misfit**2 > (1.0 + MODEL_FRACTION) * current.misfit**2

    def _is_unsettled(self, current: _BenchFit, verified: _BenchFit) -> bool:
        """Return whether the object on the bench found needs more iterations, as grey objects do.

        Its misfit then is that of the object, not of the bench, and hides what the frames tell of the bench.
        """
        if self.known is not None or self.iterations >= MOST_ITERATIONS or self._is_near_noise(current):
            return False
        return verified.misfit**2 < (1.0 - UNSETTLED_GAIN) * current.misfit**2

    def _reference_tiles(self, current: _BenchFit) -> _ReferenceTiles:
        return self._tiles_of(current.unknowns, current.linear.model)

    def _tiles_of(self, unknowns: Unknowns, model: ChannelModel) -> _ReferenceTiles:
        derivatives = self.pixels.ray_derivatives(unknowns, model.engine, self.parameters)
        return _ReferenceTiles(unknowns, model, derivatives)

    def _restored_tiles(self, point: StagePoint) -> _ReferenceTiles:
        """Return the tiles of a stage that continues."""
        model = self.pixels.model(point.reference)
        if point.is_repeated:
            model = self.pixels.model(point.reference, model.engine)
        return self._tiles_of(point.reference, model)

    def _restored_fit(self, stored: StoredFit, reference: _ReferenceTiles) -> _BenchFit:
        """Return a bench with its object from a checkpoint."""
        is_reference = stored.unknowns.state == reference.unknowns.state
        model = reference.model if is_reference else self.pixels.model(stored.unknowns, reference.engine)
        model = model.with_scale(stored.scale)
        linear = LinearModel(model, stored.transmission, self.pixels.scale is None)
        return _BenchFit(stored.unknowns, linear, stored.transmission, stored.curve, stored.upper_bound)

    def _descend(
        self,
        state: SearchState,
        current: _BenchFit,
        reference: _ReferenceTiles,
        parameters: tuple[Parameter, ...],
        *,
        is_repeated: bool = False,
    ) -> tuple[SearchState, _BenchFit, str]:
        """Return state and bench at the end of a stage, and the reason for its end.

        The stage continues at the state's point, if there is one.
        """
        point, parameters_sought, reason = state.point, parameters, ""
        about = current if point is None else self._restored_fit(point.slopes, reference)
        slopes = about.stored
        columns = self.pixels.columns(about.unknowns, about.linear, parameters, reference.ray_derivatives)
        del about
        if point is not None:
            parameters_sought = tuple(p for p in parameters if p.name in point.sought)
            state, reason = replace(state, point=None), point.ended_because
        elif parameters == self.parameters:
            parameters_sought = self._determined_parameters(current, columns)
        # For each stage, the fraction of the squared misfit below which the gain of a step ends it.
        least_gains = 0.05, 0.02
        # Fraction of the squared misfit below which a step hardly changes the derivatives.
        linear_gain = 0.1

        def keep() -> None:
            if self.keep is not None:
                names = tuple(p.name for p in parameters_sought)
                now = StagePoint(reference.unknowns, current.stored, slopes, names, is_repeated, reason)
                self.keep(replace(state, unknowns=current.unknowns, point=now))

        while not reason and len(state.trail) < self.most_benches:
            keep()
            sought_columns = (
                columns
                if parameters_sought == parameters
                else columns[[parameters.index(p) for p in parameters_sought]]
            )
            equations = self._normal_equations(
                current, parameters_sought, sought_columns, _variance(current.misfit)
            )
            is_free = self._is_free(current, equations, parameters_sought)
            free = tuple(p for p, one in zip(parameters_sought, is_free, strict=True) if one)
            if not free:
                reason = CONVERGED
                break
            equations = equations.restricted(is_free)
            state, best = self._search_along_step(state, current, reference.engine, equations, free)
            gain = 1.0 - self._price(best) / self._price(current)
            current, state = best, replace(state, unknowns=best.unknowns)
            if gain < least_gains[state.stage] or (state.stage == 0 and self._is_near_noise(current)):
                reason = CONVERGED
                break
            del equations, sought_columns
            if gain > linear_gain:
                del columns  # only one set of columns fits in memory
                slopes = current.stored
                columns = self.pixels.columns(
                    current.unknowns, current.linear, parameters, reference.ray_derivatives
                )
        keep()
        return state, current, reason or "limit of benches reached"

    def _is_free(
        self, current: _BenchFit, equations: GaussNewtonStep, parameters: Sequence[Parameter]
    ) -> NDArray[np.bool_]:
        """Return which parameters do not leave their range in the direction of descent."""
        values = current.unknowns.of(parameters)
        return np.asarray((values > _lower_bounds(parameters)) | (equations.descent >= 0.0))

    def _is_near_noise(self, current: _BenchFit) -> bool:
        """Return whether the misfit is near enough to the noise to seek all parameters."""
        return self.noise_misfit is not None and current.misfit < NEAR_NOISE * self.noise_misfit

    def _search_along_step(
        self,
        state: SearchState,
        current: _BenchFit,
        reference: Operator,
        equations: GaussNewtonStep,
        parameters_sought: Sequence[Parameter],
    ) -> tuple[SearchState, _BenchFit]:
        """Return the best bench along a step, or the current one."""
        # Iterations of conjugate gradients for the direction of a step.
        step_iterations = 3
        step, best = equations.solve(step_iterations), current
        lower_bounds = _lower_bounds(parameters_sought)
        line_search = LineSearch(self._price(current), -2.0 * float(equations.descent @ step), state.stretch)
        # Misfit that is assumed where the model fails.
        failed_misfit = 4.0
        while (length := line_search.next()) is not None and len(state.trail) < self.most_benches:
            values = np.maximum(current.unknowns.of(parameters_sought) + length * step, lower_bounds)
            unknowns = current.unknowns.changed(parameters_sought, values.tolist())
            try:
                fit = self._fit_bench(unknowns, reference)
            except TransferLensError:
                line_search.add(length, failed_misfit**2)
                state = self._with_trial(state, unknowns, failed_misfit)
                continue
            line_search.add(length, self._price(fit))
            state = self._with_trial(state, unknowns, fit.misfit)
            best = fit if line_search.best == length else best
        return replace(state, stretch=min(max(line_search.best, 1.0), MOST_STRETCH)), best

    def _determined_parameters(self, current: _BenchFit, columns: RealArray) -> tuple[Parameter, ...]:
        """Return all parameters except sensor tilts that frames of a known object would not determine."""
        flat = columns.reshape(len(columns), -1)
        typical = _typical(self.parameters)
        information = (
            np.asarray(flat @ flat.T, float) * np.outer(typical, typical) / _variance(current.misfit)
        )
        deviations = np.sqrt(np.diag(np.linalg.inv(information + np.eye(len(typical)))))
        pairs = zip(self.parameters, deviations, strict=True)
        # Standard deviation of a sensor tilt over the expected one above which the tilt is not sought.
        undetermined_tilt = 0.8
        return tuple(
            p for p, deviation in pairs if not isinstance(p, SensorTilt) or deviation < undetermined_tilt
        )

    def _price(self, fit: _BenchFit) -> float:
        """Return the cost function: the squared misfit, increased by the deviation from the prior.

        It corresponds to the logarithm of a probability with an unknown variance of the residuals.
        """
        values = fit.unknowns.of(self.parameters)
        squared_deviation = float(np.sum((values / _typical(self.parameters)) ** 2))
        return fit.misfit**2 * math.exp(MODEL_FRACTION * squared_deviation)

    def _with_trial(self, state: SearchState, unknowns: Unknowns, misfit: float) -> SearchState:
        state = replace(state, trail=(*state.trail, (unknowns, misfit)))
        if self.progress is not None:
            self.progress(len(state.trail), unknowns, misfit)
        return state

    def _fit_bench(
        self,
        unknowns: Unknowns,
        reference: Operator | None = None,
        start: _BenchFit | None = None,
        iterations: int | None = None,
    ) -> _BenchFit:
        """Reconstruct the object from even light or that of a fit, by tiles of this or a similar bench."""
        model = self.pixels.model(unknowns, reference)
        if self.known is not None:
            linear = LinearModel(model, self.known, self.pixels.scale is None)
            return _BenchFit(unknowns, linear, self.known, (linear.misfit,))
        first, scale, upper_bound = None, self.pixels.scale, 1.0
        if self.scale_without_limit > 0.0:
            scale, upper_bound = self.scale_without_limit, math.inf
        if start is not None:
            first, upper_bound = model.illumination.with_values(start.transmission), start.upper_bound
            scale = scale if math.isfinite(upper_bound) else start.linear.model.scale
        found = self._object(
            model,
            first,
            iterations or self.iterations,
            scale=scale,
            until_noise=iterations is not None,
            bounded=math.isfinite(upper_bound),
        )
        return self._on_bench(unknowns, model, found, upper_bound)

    def _object(
        self,
        model: ChannelModel,
        start: Field | None,
        iterations: int,
        *,
        scale: float | None,
        until_noise: bool,
        bounded: bool,
    ) -> Reconstructed:
        # More inner iterations take longer than the propagation through the lens.
        return reconstruct(
            model.engine,
            model.illumination,
            model.recorded,
            kind=self.kind,
            tv_weight="auto" if self.noise_misfit is not None else 0.0,
            iterations=iterations,
            until_noise=until_noise,
            scale=scale,
            start=start,
            fill_factor=self.pixels.fill_factor,
            modes=model.modes,
            rows=self.pixels.rows,
            residuals=False,
            inner_iterations=2,
            bounded=bounded,
        )

    def _on_bench(
        self, unknowns: Unknowns, model: ChannelModel, found: Reconstructed, upper_bound: float
    ) -> _BenchFit:
        """Return the bench of a model with an object that was found on it."""
        model = model.with_scale(found.scale)
        values = found.transmission.values
        transmission = values.real if self.kind == "amplitude" else values
        linear = LinearModel(model, transmission, self.pixels.scale is None)
        return _BenchFit(unknowns, linear, transmission, found.misfit, upper_bound)

    def _normal_equations(
        self,
        fit: _BenchFit,
        parameters: tuple[Parameter, ...],
        columns: RealArray,
        variance: float,
        residual: RealArray | None = None,
    ) -> GaussNewtonStep:
        object_is_free = self.known is None
        is_on_dark_ground = self._is_on_dark_ground(fit)
        return GaussNewtonStep(
            fit.linear,
            columns,
            fit.unknowns.of(parameters),
            _typical(parameters),
            variance,
            fit.transmission,
            self.kind,
            object_is_free,
            self._compensations(fit, parameters) if object_is_free else {},
            residual,
            fit.upper_bound,
            displacement_changes(fit.transmission, DISPLACEMENT_ORDERS) if is_on_dark_ground else (),
        )

    def _compensations(self, fit: _BenchFit, parameters: Sequence[Parameter]) -> dict[int, NDArray[Any]]:
        """Return the changes of an amplitude object that compensate a unit of the light's amplitude."""
        light = {n: p for n, p in enumerate(parameters) if isinstance(p, LightAmplitude)}
        if np.iscomplexobj(fit.transmission):
            return {}
        changes = {n: self.pixels.light_change(fit.unknowns, p).real for n, p in light.items()}
        return {n: -change.astype(np.float32) * fit.transmission for n, change in changes.items()}


def _typical(parameters: Sequence[Parameter]) -> Array:
    return np.array([p.typical for p in parameters])


def _lower_bounds(parameters: Sequence[Parameter]) -> Array:
    return np.array([p.lower_bound for p in parameters])


def _variance(misfit: float) -> float:
    """Return the variance of the residuals for the derivatives of parameters."""
    return MODEL_FRACTION * misfit**2
