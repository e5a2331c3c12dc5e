"""Object-domain reconstruction: find the object itself from intensities behind the lens.

The object t (its complex transmission) under a known illumination u gives the fields A_n(u t) on the planes
n. The solver minimizes the weighted misfit of amplitudes plus a total variation by the steps::

    t <- prox( t + mean over n of conj(u) A_n*( P_n(A_n(u t)) - A_n(u t) ) / max |u|^2 ),

where P_n replaces the amplitude of a field by the measured one. Engine and free space are nearly unitary.
The Hessian is therefore 1 at most, and accelerated steps are stable up to a step length of 4/3.

Each step consists of a few inner iterations of the same kind on the field behind the lens, where planes cost
little, before the change is taken back to the object. The proximal map of the total variation preserves
edges and suppresses noise. Steps are accelerated (FISTA), and the momentum restarts where it increases the
misfit. The object is zero where the illumination is zero: a field stop acts as a support constraint. After
the proximal map, an amplitude object is clipped to 0 and 1, and a phase object is divided by its modulus.

References
----------
A. Beck and M. Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse problems",
SIAM J. Imaging Sci. 2, 183 (2009).
B. O'Donoghue and E. Candes, "Adaptive restart for accelerated gradient schemes", Found. Comput. Math. 15,
715 (2015).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError, validate_choice, validate_positive, validate_whole_number
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel, Step
from wavesim.forward.exit_field import ROWS
from wavesim.forward.step_noise import noise_of_step
from wavesim.reconstruction.phase_retrieval import validate_planes
from wavesim.reconstruction.stop_rule import FAR, STOPPED, Stop, stop_reason
from wavesim.reconstruction.total_variation import prox_tv
from wavesim.runtime.result import Result
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Engine, Grids, Operator
from wavesim.scene.settings import Kind
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement, amplitude_unit, in_unit, noise_misfit, power_of_two

Array = NDArray[np.inexact[Any]]
AMPLITUDE_START = 12
"""Iterations that seek an amplitude object if `start` is "amplitude"."""


TV_PER_NOISE = 1.0
"""Weight of the total variation over the standard deviation of the noise of a step.

The noise counts as larger than stated by the ratio of the misfit to the misfit of noise alone, because
residuals that the model does not explain yet carry no detail.
"""

STEP, FRICTION = 1.3, 1.0
"""Length of a step, and a constant that limits the momentum: after j steps it is j / (j + `FRICTION`)."""

INNER_ITERATIONS, INNER_STEP_FACTOR = 4, 2.0
"""Inner iterations of a step, and the factor by which they lengthen it and its total variation.

They are used while the misfit is far from that of noise. Nearer to the noise they would fit the noise.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Reconstructed(Result):
    """A reconstructed object.

    Attributes
    ----------
    transmission : Field
        Transmission on the engine's object grid; 0 where there is no light.
    misfit : tuple of float
        Relative L2 difference between modelled and measured amplitudes of all planes, before each iteration.
    residual_maps : tuple of ndarray
        For each plane, modelled less measured amplitude, in the unit of the measured amplitude.
    scale : float
        Measured amplitude per unit of the modelled amplitude.
    stopped_because : {"noise", "converged", "iterations"}
        Reason for the end of the iterations.

        - "noise": the misfit has reached the value that noise alone leaves (discrepancy principle).
        - "converged": the misfit has converged.
        - "iterations": all iterations were used.
    tv_factor : float
        Factor of an automatic weight of the total variation.
    """

    heading = "Reconstructed object"

    transmission: Field
    misfit: tuple[float, ...]
    residual_maps: tuple[NDArray[np.floating[Any]], ...]
    scale: float
    stopped_because: Stop
    tv_factor: float = 1.0

    def _picture(self) -> NDArray[Any]:
        return np.atleast_2d(self.transmission.values)

    def table(self) -> list[tuple[str, str]]:
        grid, why = self.transmission.grid, STOPPED[self.stopped_because]
        return [
            ("samples", f"{' x '.join(map(str, grid.shape))} of {1e3 * grid.pitch_mm:.4g} µm"),
            ("iterations", f"{len(self.misfit)}, misfit {self.misfit[-1]:.5g}{why}"),
            ("planes", f"{len(self.residual_maps)}, scale {self.scale:.4g}"),
        ]


@dataclass(frozen=True, eq=False)
class SolverState:
    """State of the solver after an iteration: all that is needed to resume it.

    Attributes
    ----------
    transmission, ahead : ndarray
        Last iterate, and the extrapolated point at which the next gradient is taken. Both are real while an
        amplitude object is sought.
    momentum : float
        Number of steps since the last restart of the momentum.
    misfit : tuple of float
        Misfit of every iteration so far.
    scale : float or None
        Measured amplitude per unit of the modelled amplitude; None before it is known.
    stage, began : int
        Index of the current :class:`Stage`, and number of iterations before it.
    """

    transmission: Array
    ahead: Array
    momentum: float
    misfit: tuple[float, ...]
    scale: float | None
    stage: int
    began: int


class StepRule(NamedTuple):
    """Steps far from the noise.

    Attributes
    ----------
    relaxation : float
        Factor of a step with inner iterations.
    planes_in_turn : bool
        Whether inner iterations process the planes in turn (:meth:`ChannelModel.step`).
    """

    relaxation: float = 1.0
    planes_in_turn: bool = False


USUAL_STEPS = StepRule()
"""Steps of all iterations but the first ones of a whole field."""


class Stage(NamedTuple):
    """Stage of a search: kind of object, iteration at which it ends, and whether it has total variation."""

    kind: Kind
    until: int
    has_tv: bool = True


def reconstruct(
    engine: Operator,
    illumination: Field,
    recorded: Sequence[Measurement],
    *,
    kind: Kind = "complex",
    tv_weight: float | Literal["auto"] = 0.0,
    iterations: int = 80,
    until_noise: bool = False,
    scale: float | None = None,
    start: Field | Literal["amplitude"] | None = None,
    fill_factor: float = 0.0,
    progress: Callable[[int, float], None] | None = None,
    resume: SolverState | None = None,
    keep: Callable[[SolverState], None] | None = None,
    scratch: Scratch | None = None,
    modes: Sequence[SourceMode] = (),
    rows: Sequence[slice] = (),
    residuals: bool = True,
    inner_iterations: int = INNER_ITERATIONS,
    bounded: bool = True,
    tv_factor: float = 1.0,
    iterations_without_tv: int = 0,
    step_rule: StepRule = USUAL_STEPS,
) -> Reconstructed:
    """Find the transmission of the object behind measured amplitudes.

    The solver minimizes the weighted misfit of amplitudes plus a total variation by accelerated proximal
    gradient steps (:mod:`wavesim.reconstruction.object_solver`). :func:`wavesim.reconstruct_frames` prepares
    the arguments from frames.

    Parameters
    ----------
    engine
        Forward and adjoint operator from the object grid to a plane behind the lens.
    illumination
        Field on the engine's object grid, with the field stop applied. Its data type (complex64 or
        complex128) is that of the computation.
    recorded
        Measured amplitudes of one or more planes. Distances count from the engine's exit grid, in mm. Pixels
        are weighted by their standard deviation `sigma`; a pixel with infinite `sigma` is ignored.
    kind
        "complex"; "amplitude" for a real transmission between 0 and 1; or "phase" for a transmission of
        modulus 1.
    tv_weight
        Weight of the total variation, for transmissions of order 1; 0 disables it. With "auto" the weight is
        `TV_PER_NOISE` times the noise of a step, times the ratio of the misfit to that of noise alone. The
        noise of a step follows from `sigma` of all planes.
    iterations
        Largest number of iterations; fewer are made where the misfit converges.
    until_noise
        Whether iterations also end where the misfit reaches the value that noise alone would leave
        (:func:`wavesim.sensor.measurement.noise_misfit`).
    scale
        Measured amplitude per unit of the modelled amplitude, if a picture without an object has determined
        it. Default: fitted in the first iterations; the transmission is then known up to a factor.
    start
        Initial transmission; default: 1 everywhere. With "amplitude" the first `AMPLITUDE_START` iterations
        seek an amplitude object. This helps to find a complex object on a dark ground, which is far from 1.
    fill_factor
        Linear fill factor of a pixel: side of its photosensitive square over the pitch. 0 means samples at
        points, such as those of a simulated field.
    progress
        Callback `progress(index, misfit)`, called after every iteration.
    resume
        State of an interrupted run with the same arguments, which continues from there.
    keep
        Callback `keep(state)`, called after every iteration; `resume` accepts the state.
    scratch
        Storage of arrays that are kept from one iteration to the next; default: memory. Arrays of the caller
        stay where they are; :meth:`wavesim.runtime.scratch.Scratch.moved` moves them.
    modes
        Modes of the light of an extended or polychromatic source (:meth:`wavesim.scene.source.Source.modes`).
        Each mode passes separately through the engine for its wavelength.
    rows
        Rows of the engine's exit grid that hold the pixels of each plane, if the engine propagates directly
        to the planes. Default: planes are reached through free space.
    residuals
        Whether residual maps are computed, which takes one more forward propagation.
    inner_iterations
        Inner iterations behind the lens in each step, as long as the misfit is far above the noise.
    bounded
        Whether the amplitude is limited to 1. The fit of an unknown scale assumes an object that is bright
        everywhere. Bright parts of an object on a dark ground may then have to exceed 1: use False.
    tv_factor
        Factor of an automatic weight of the total variation.
    iterations_without_tv
        Largest number of additional first iterations without total variation, which end early where the
        misfit converges. The total variation holds edges where the first iterations have put them; without
        it, they move to where the measured amplitudes have them. Those that are not used are added to
        `iterations`.
    step_rule
        Steps far from the noise.

    Returns
    -------
    Reconstructed
        The object, the misfit of every iteration, and residual maps.

    Raises
    ------
    InputError
        If a value or a shape is invalid, planes are in different units, modes have another wavelength and
        the operator is not an engine of a lens, or the disk of the scratch files is full.

    References
    ----------
    A. Beck and M. Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse problems",
    SIAM J. Imaging Sci. 2, 183 (2009).

    Examples
    --------
    An opaque disk, from the amplitude on one plane, without noise:

    >>> import numpy as np
    >>> from lensdesign import load_design, scaled
    >>> from wavesim import Field, Measurement, engine_for, patch_scene, reconstruct
    >>> scene = patch_scene(scaled(load_design("designs/paper_singlet.toml"), 1 / 64), 0.02)
    >>> engine, grid = engine_for(scene, "eikonal", error=0.1), scene.object_grid
    >>> light = Field(grid, np.ones(grid.shape, complex), scene.wavelength_um)
    >>> disk = np.where(grid.radius_squared_mm2() < 0.004**2, 0.0, 1.0)
    >>> amplitude = np.abs(engine.forward(light.with_values(light.values * disk)).values)
    >>> found = reconstruct(engine, light, [Measurement(0.0, amplitude)], kind="amplitude", iterations=20)
    >>> round(float(np.corrcoef(found.transmission.values.real.ravel(), disk.ravel())[0, 1]), 2)
    1.0
    """
    validate_numbers(kind, tv_weight, iterations, scale, fill_factor)
    if kind == "phase" and isinstance(start, str):
        raise InputError(f"start = {start!r}: cannot be used for a phase object; give a field, or omit it")
    validate_measurements(engine.scene, illumination, recorded, start, rows)
    _validate_modes(engine, illumination, modes, rows)
    scratch = scratch or Scratch()
    unit, light_unit = amplitude_unit(recorded), power_of_two(float(np.abs(illumination.values).max()))
    if light_unit != 1.0:
        illumination = illumination.with_values(
            illumination.values / illumination.values.real.dtype.type(light_unit)
        )
    recorded = in_unit(recorded, unit)
    model = ChannelModel.of_source(
        engine,
        illumination,
        recorded,
        scale and scale * light_unit / unit,
        fill_factor,
        scratch,
        modes,
        rows,
    )
    weight, noise = (0.0, tv_factor * noise_of_step(model)) if tv_weight == "auto" else (tv_weight, None)
    descent = ProximalDescent(
        model,
        weight,
        noise,
        noise_misfit(recorded),
        until_noise,
        scale is None,
        progress,
        keep,
        scratch,
        inner_iterations,
        bounded,
        step_rule=step_rule,
    )
    stages = [Stage(kind, iterations_without_tv + iterations)]
    if iterations_without_tv:
        stages.insert(0, Stage(kind, iterations_without_tv, has_tv=False))
    if start == "amplitude":
        stages.insert(0, Stage("amplitude", min(AMPLITUDE_START, iterations)))
    # The list gives up the initial state, so that its arrays do not stay in memory to the end.
    stated = None if scale is None else model.scale
    initial = [resume or _initial_state(model, start, stages[0].kind, stated, scratch)]
    del resume
    state = descent.run(initial.pop(), stages)
    now, misfits, stop_reason = state.transmission, state.misfit, descent.stop(state) or "iterations"
    assert state.scale is not None
    found_scale, maps = state.scale, list[NDArray[np.floating[Any]]]()
    fits_scale = descent.fits_scale_after(kind, len(misfits) - 1)
    del state
    if residuals and fits_scale:
        maps, found_scale = model.fitted_amplitudes(now)
    elif residuals:
        maps = model.amplitudes(now, found_scale)
    for modelled, plane in zip(maps, recorded, strict=residuals):
        modelled -= plane.amplitude
        modelled *= modelled.dtype.type(unit)
    found = illumination.with_values(now.astype(illumination.values.dtype))
    found_scale *= unit / light_unit
    return Reconstructed(found, misfits, tuple(maps), found_scale, stop_reason, tv_factor)


def _initial_state(
    model: ChannelModel, start: Any, kind: Kind, scale: float | None, scratch: Scratch
) -> SolverState:
    """Return the state before the first iteration."""
    is_field = isinstance(start, Field)
    dtype = model.dtype if is_field or kind == "complex" else model.real
    now = scratch.array(model.lit.shape, dtype, "a step")
    np.multiply(start.values if is_field else 1.0, model.lit, out=now, casting="same_kind")
    return SolverState(now, now, 0.0, (), scale, 0, 0)


@dataclass(frozen=True, eq=False)
class ProximalDescent:
    """Accelerated proximal gradient steps; `prox` maps a point and a weight of the total variation."""

    model: ChannelModel
    tv_weight: float
    noise_at_scale_1: float | None
    misfit_of_noise: float | None
    until_noise: bool
    fits_scale: bool
    progress: Callable[[int, float], None] | None
    keep: Callable[[SolverState], None] | None
    scratch: Scratch
    inner_iterations: int
    bounded: bool
    prox: Callable[[Array, float], Array] = prox_tv
    step_rule: StepRule = USUAL_STEPS

    def run(self, state: SolverState, stages: Sequence[Stage]) -> SolverState:
        """Return the state after all stages."""
        for index, stage in enumerate(stages):
            if index < state.stage:
                continue
            if index > state.stage:
                now, misfit = state.transmission, state.misfit
                state = SolverState(now, now, 0.0, misfit, state.scale, index, len(misfit))
                del now
            while len(state.misfit) < stage.until:
                if self.stop(state) is not None:
                    break
                state = self._next_state(state, stage)
                if self.progress is not None:
                    self.progress(len(state.misfit) - 1, state.misfit[-1])
                if self.keep is not None:
                    self.keep(state)
        return state

    def fits_scale_after(self, kind: Kind, iterations: int) -> bool:
        """Return whether the next iteration fits the scale."""
        # Iterations in which an unknown scale is fitted. In later ones scale and transmission would drift.
        scale_iterations = 4
        # A pure phase cannot take over a part of the scale.
        return self.fits_scale and (kind == "phase" or iterations < scale_iterations)

    def _next_state(self, state: SolverState, stage: Stage) -> SolverState:
        kind = stage.kind
        now: Array = state.transmission.real if kind == "amplitude" else state.transmission
        is_far = self._is_far(state)
        point, misfit, scale = self._gradient_step(state, kind, self.inner_iterations if is_far else 1)
        weight = self._tv_weight(misfit, scale) if stage.has_tv else 0.0
        point = self.prox(point, STEP * (INNER_STEP_FACTOR if is_far else 1.0) * weight)
        if kind == "amplitude":
            np.clip(point, 0.0, 1.0 if self.bounded else None, out=point)
        elif kind == "phase":
            _project_on_unit_circle(point)
        dtype = self.model.real if kind == "amplitude" else self.model.dtype
        after = self.scratch.array(point.shape, dtype, "a step")
        np.multiply(point, self.model.lit, out=after)
        del point
        steps = 0.0 if _leads_uphill(now, state.ahead, after) else state.momentum
        ahead = self.scratch.array(after.shape, dtype, "a step")
        np.subtract(after, now, out=ahead)
        ahead *= steps / (steps + FRICTION)
        ahead += after
        return replace(
            state,
            transmission=after,
            ahead=ahead,
            momentum=steps + 1.0,
            misfit=(*state.misfit, misfit),
            scale=scale,
        )

    def _is_far(self, state: SolverState) -> bool:
        """Return whether the misfit is clearly above that of noise, or the noise is unknown.

        Planes with separate exit fields cannot use inner iterations on a common field.
        """
        if self.model.rows:
            return False
        known = self.misfit_of_noise is not None and state.misfit
        return not known or state.misfit[-1] > FAR * (self.misfit_of_noise or 0.0)

    def _gradient_step(self, state: SolverState, kind: Kind, inner_iterations: int) -> Step:
        """Return the point after a gradient step from the extrapolated point, and the misfit there."""
        rule = self.step_rule if inner_iterations > 1 else USUAL_STEPS
        step = self.model.step(
            state.ahead,
            inner_iterations,
            STEP,
            scale=state.scale,
            fits_scale=self.fits_scale_after(kind, len(state.misfit)),
            planes_in_turn=rule.planes_in_turn,
        )
        point = step.change
        point *= point.real.dtype.type(STEP * rule.relaxation)
        if kind == "amplitude":
            return step._replace(change=point.real + state.ahead.real)
        point += state.ahead
        return step

    def _tv_weight(self, misfit: float, scale: float) -> float:
        if self.noise_at_scale_1 is None or self.misfit_of_noise is None:
            return self.tv_weight
        weight = TV_PER_NOISE * self.noise_at_scale_1 / scale
        return weight * max(misfit / self.misfit_of_noise, 1.0)

    def stop(self, state: SolverState) -> Stop | None:
        """Return the reason to stop, or None if iterations continue."""
        misfits = state.misfit[state.began :]
        return stop_reason(misfits, self.misfit_of_noise, until_noise=self.until_noise)


def _project_on_unit_circle(values: Array) -> None:
    """Divide values by their moduli, in place; a value of 0 becomes 1."""
    for start in range(0, len(values), ROWS):
        block = values[start : start + ROWS]
        modulus = np.abs(block)
        block[modulus == 0.0] = modulus[modulus == 0.0] = 1.0
        block /= modulus


def _leads_uphill(now: Array, ahead: Array, after: Array) -> bool:
    """Return whether the last step points against the gradient, so that the momentum must restart."""
    # A few rows at a time: differences of whole fields would be the largest arrays of a step.
    blocks = (slice(start, start + 8) for start in range(0, len(now), 8))
    along = (np.vdot(ahead[rows] - after[rows], after[rows] - now[rows]) for rows in blocks)
    return sum(float(one.real) for one in along) > 0.0


def validate_numbers(
    kind: str, tv_weight: float | str, iterations: int, scale: float | None, fill_factor: float
) -> None:
    """Check that settings of :func:`wavesim.reconstruct` are within their range.

    Raises
    ------
    InputError
        If a setting is out of range.
    """
    validate_choice("kind", kind, get_args(Kind))
    if tv_weight != "auto" and (
        isinstance(tv_weight, str) or not (math.isfinite(tv_weight) and tv_weight >= 0.0)
    ):
        raise InputError(f"tv_weight = {tv_weight!r}: must be finite and not negative, or 'auto'")
    validate_whole_number("iterations", iterations, 1)
    if scale is not None:
        validate_positive("scale", scale)
    if not 0.0 <= fill_factor <= 1.0:
        raise InputError(f"fill_factor = {fill_factor!r}: must be from 0 to 1")


def validate_measurements(
    grids: Grids,
    illumination: Field,
    recorded: Sequence[Measurement],
    start: Any,
    rows: Sequence[slice],
) -> None:
    """Check that illumination, planes and start of :func:`wavesim.reconstruct` fit the grids of the engine.

    Raises
    ------
    InputError
        If a grid, a shape or the start does not fit.
    """
    if illumination.grid != grids.object_grid:
        raise InputError(f"illumination: its grid {illumination.grid} is not the engine's object grid")
    if not np.any(np.abs(illumination.values) > 0.0):
        raise InputError("illumination: is 0 everywhere")
    if not recorded:
        raise InputError("recorded: needs at least one plane")
    shape = grids.exit_grid.shape
    if rows:
        shape = (shape[0] // len(rows), *shape[1:])
    validate_planes(recorded, shape, "the exit grid's")
    if not (start is None or start == "amplitude" or isinstance(start, Field)):
        raise InputError(f"start = {start!r}: must be a field, or 'amplitude'")
    if isinstance(start, Field) and start.grid.shape != illumination.grid.shape:
        raise InputError(f"start: its shape {start.grid.shape} is not that of the object grid")


def _validate_modes(
    operator: Operator, illumination: Field, modes: Sequence[SourceMode], rows: Sequence[slice]
) -> None:
    others = {mode.wavelength_um for mode in modes} - {illumination.wavelength_um}
    if others and (rows or not isinstance(operator, Engine)):
        raise InputError(
            f"modes: must all be of {illumination.wavelength_um:g} µm, as the illumination is, because the "
            f"operator has no model for {min(others):g} µm"
        )
