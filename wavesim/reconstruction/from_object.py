"""Object-domain reconstruction: the object itself from intensities behind the lens.

The object t (its complex transmission) under a known illumination u gives the fields A_n(u t) on the planes
n. Steps

    t <- prox( t + mean over n of conj(u) A_n*( P_n(A_n(u t)) - A_n(u t) ) / max |u|^2 ),

with P_n the replacement of the amplitude by the recorded one, go down the misfit of amplitudes. Engine and
free space are nearly unitary: the curvature is 1 at most, and steps with momentum are safe up to 4/3. Each
step is made of a few rounds of the same kind behind the lens, where planes cost little, before it comes back
to the object: an alternating descent of the field that the planes ask for and of the object behind it. The
proximal map of the total variation keeps edges and takes noise out; steps are accelerated (FISTA), and
momentum begins anew where it leads uphill. Where the illumination is dark, so is the object: a field stop is
a support.

Sources: A. Beck and M. Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse
problems", SIAM J. Imaging Sci. 2, 183 (2009); B. O'Donoghue and E. Candes, "Adaptive restart for accelerated
gradient schemes", Found. Comput. Math. 15, 715 (2015).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.notebook import html_picture, html_table
from wavesim.fields.field import Field
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.memory import Sizes, step_array
from wavesim.reconstruction.recording.refusals import validate_measurements, validate_numbers
from wavesim.reconstruction.total_variation import prox_tv
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Operator
from wavesim.scene.settings import Kind
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement, amplitude_unit, in_unit, noise_misfit, power_of_two

Array = NDArray[np.inexact[Any]]
Stop = Literal["noise", "rest", "iterations"]

STOPPED: dict[Stop, str] = {
    "noise": ", where the misfit came to the noise",
    "rest": ", where the misfit fell no more",
    "iterations": "",
}
"""Why iterations ended, in words."""

SCALE_ITERATIONS = 4
"""In which an unknown scale is fitted; longer, it and the transmission would drift against each other."""

AMPLITUDE_START = 12
"""Iterations in which an amplitude object is sought where that is the start."""

TV_PER_NOISE = 1.0
"""Weight of the total variation over the standard deviation of the noise of a step. The noise is taken for as
much larger than stated as the misfit is: what the model does not explain, or not yet, tells no detail."""

STEP, FRICTION = 1.3, 1.0
"""Length of a step, and how soon momentum grows: after j steps it is j / (j + friction)."""

ROUNDS, FARTHER, FAR = 4, 2.0, 1.2
"""Rounds of the field behind the lens in a step while the misfit is more than so many times what noise would
leave, which rounds would fit; how much farther than one they lead, and with them the total variation."""

FEW_ROWS = 8
"""Of the object, compared at a time."""

AT_NOISE = 1.01
"""Misfit over that of noise alone, down to which iterations have reached the noise. What the misfit hardly
tells, such as slow changes of phase, still gets better there, for as long as it falls."""

EARLY, NEAR_EARLY, AT_NOISE_EARLY, EARLY_GAIN = 5, 2, 1, 1e-3
"""At rest: over so many iterations, or so many near the noise or at it, the misfit falls by less than this
share; at the noise, too, where all further ones together would change it by less."""


@dataclass(frozen=True, eq=False)
class Reconstructed:
    """A reconstructed object.

    Attributes
    ----------
    transmission : Field
        On the engine's object grid; 0 where there is no light.
    misfit : tuple of float
        For every iteration, the relative L2 difference of all planes' amplitudes and the recorded ones.
    residual_maps : tuple of ndarray
        For each plane, amplitude of the result less the recorded one, in units of the recorded one.
    scale : float
        Recorded amplitude for a unit of the model's.
    stopped_because : str
        "noise" where the misfit came to what noise alone would leave, "rest" where it fell no more,
        "iterations" where they were used up.
    """

    transmission: Field
    misfit: tuple[float, ...]
    residual_maps: tuple[NDArray[np.floating[Any]], ...]
    scale: float
    stopped_because: Stop

    def __repr__(self) -> str:
        return f"Reconstructed({', '.join(f'{name} {value}' for name, value in self._rows())})"

    def _repr_html_(self) -> str:
        return html_table("Reconstructed object", self._rows(), html_picture(self.transmission.values))

    def _rows(self) -> list[tuple[str, str]]:
        grid, why = self.transmission.grid, STOPPED[self.stopped_because]
        return [
            ("samples", f"{grid.shape[0]} x {grid.shape[1]} of {1e3 * grid.pitch_mm:.4g} um"),
            ("iterations", f"{len(self.misfit)}, misfit {self.misfit[-1]:.5g}{why}"),
            ("planes", f"{len(self.residual_maps)}, scale {self.scale:.4g}"),
        ]


@dataclass(frozen=True, eq=False)
class SolverState:
    """Where a reconstruction stands after an iteration: all that it needs to go on.

    Attributes
    ----------
    transmission, ahead : ndarray
        The last step, and the point from which the next one goes; real while an amplitude object is sought.
    momentum : float
        Steps since it began to grow.
    misfit : tuple of float
        Of every iteration so far.
    scale : float or None
        Recorded amplitude for a unit of the model's; None where nothing is known of it yet.
    stage, began : int
        Kind of object that is being sought, of those that follow each other; iterations before it.
    """

    transmission: Array
    ahead: Array
    momentum: float
    misfit: tuple[float, ...]
    scale: float | None
    stage: int
    began: int


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
    rounds: int = ROUNDS,
    bounded: bool = True,
) -> Reconstructed:
    """Find the object behind recorded amplitudes.

    Parameters
    ----------
    engine
        From the object grid to a plane behind the lens.
    illumination
        On the engine's object grid, field stop included; in complex64 all is computed so.
    recorded
        One plane or more, with distances from the engine's exit grid. Pixels count by their `sigma`; where it
        is infinite, nothing is replaced.
    kind
        "complex", or "amplitude" for a transmission that is real and between 0 and 1.
    tv_weight
        Of the total variation, for transmissions of order 1; 0 leaves it out. "auto": `TV_PER_NOISE` times
        the noise of a step, which all planes' `sigma` tell, and as much more as the misfit is more than noise
        alone would leave.
    iterations
        At most; fewer where the misfit rests.
    until_noise
        Whether they end, too, where the misfit has come to what noise alone would leave
        (:func:`wavesim.sensor.measurement.noise_misfit`).
    scale
        Recorded amplitude for a unit of the model's, where a picture without object has told it. Left out,
        it is fitted in the first iterations: then the transmission is known but for a factor.
    start
        Transmission to start from; 1 if left out. "amplitude": the first `AMPLITUDE_START` iterations seek an
        amplitude object, so that a complex one on a dark ground is found, to which 1 is too far.
    fill_factor
        Side of a pixel's photosensitive square as a share of the pitch, over which the model takes means; 0
        for amplitudes at points, such as those of a simulated field.
    progress
        Called after every iteration with its number and misfit.
    resume
        Where a run with the same arguments was cut off: it goes on from there.
    keep
        Called after every iteration with what `resume` takes.
    scratch
        Where arrays lie that are kept from one iteration to the next; in memory if left out. What the caller
        holds stays where it is: move illumination and recorded arrays by :meth:`wavesim.Scratch.moved`.
    modes
        Of the light, if its source is wide (:meth:`wavesim.scene.Source.modes`): each goes through the engine
        of its own.
    rows
        Of the engine's exit grid, those of each plane's pixels, if it carries light straight to them.
    residuals
        Whether residual maps are made, for which the result goes through the lens once more.
    rounds
        Of the field behind the lens in a step, while the misfit is far from the noise.
    bounded
        Whether amplitudes are at most 1. An unknown scale is fitted to an object that is bright everywhere:
        the bright parts of an object on a dark ground may then have to exceed 1.

    Raises
    ------
    InputError
        If a value or a shape is not usable, planes are in different units, modes are of other wavelengths
        than the illumination, or the disk that holds the scratch files is full.
    """
    validate_numbers(kind, tv_weight, iterations, scale, fill_factor)
    validate_measurements(engine.scene, illumination, recorded, start, modes, rows)
    scratch = scratch or Scratch()
    unit, light_unit = amplitude_unit(recorded), power_of_two(float(np.abs(illumination.values).max()))
    if light_unit != 1.0:
        illumination = illumination.with_values(
            illumination.values / illumination.values.real.dtype.type(light_unit)
        )
    recorded = in_unit(recorded, unit)
    model = ForwardModel(
        engine,
        illumination,
        recorded,
        scale and scale * light_unit / unit,
        fill_factor,
        scratch,
        modes,
        rows,
    )
    weight, noise = (0.0, model.noise_of_step()) if tv_weight == "auto" else (tv_weight, None)
    distances = tuple(plane.distance_mm for plane in recorded)
    sizes = Sizes(engine.scene.object_grid.shape, engine.scene.exit_grid.shape, distances, dtype=model.dtype)
    descent = _Descent(
        model,
        weight,
        noise,
        noise_misfit(recorded),
        until_noise,
        scale is None,
        progress,
        keep,
        sizes,
        scratch,
        rounds,
        bounded,
    )
    stages = [(kind, iterations)]
    if start == "amplitude":
        stages.insert(0, ("amplitude", min(AMPLITUDE_START, iterations)))
    # Given away without a name for it: the arrays of a beginning would else be held to the end.
    begun = [resume or _beginning(model, start, stages[0][0], scratch)]
    del resume
    state = descent.run(begun.pop(), stages)
    now, misfits, stopped = state.transmission, state.misfit, descent.stop(state) or "iterations"
    del state
    maps = tuple(model.amplitudes(now)) if residuals else ()
    for modelled, plane in zip(maps, recorded, strict=residuals):
        modelled -= plane.amplitude
        modelled *= modelled.dtype.type(unit)
    found = illumination.with_values(now.astype(illumination.values.dtype))
    return Reconstructed(found, misfits, maps, model.scale * unit / light_unit, stopped)


def _beginning(model: ForwardModel, start: Any, kind: Kind, scratch: Scratch) -> SolverState:
    """Where no iteration has been made: at the start, or at 1."""
    is_field = isinstance(start, Field)
    dtype = model.dtype if is_field or kind == "complex" else model.real
    now = scratch.array(model.lit.shape, dtype, "a step")
    np.multiply(start.values if is_field else 1.0, model.lit, out=now, casting="same_kind")
    return SolverState(now, now, 0.0, (), model.scale if model.knows_scale else None, 0, 0)


@dataclass(frozen=True, eq=False)
class _Descent:
    """Accelerated proximal steps."""

    model: ForwardModel
    tv_weight: float
    noise_at_scale_1: float | None
    misfit_of_noise: float | None
    until_noise: bool
    fits_scale: bool
    progress: Callable[[int, float], None] | None
    keep: Callable[[SolverState], None] | None
    sizes: Sizes
    scratch: Scratch
    rounds: int
    bounded: bool

    def run(self, state: SolverState, stages: Sequence[tuple[Kind, int]]) -> SolverState:
        """Where it stands after all stages: kinds of object, and iterations at which they end."""
        if state.scale is not None:
            self.model.scale, self.model.knows_scale = state.scale, True
        for stage, (kind, until) in enumerate(stages):
            if stage < state.stage:
                continue
            if stage > state.stage:
                now, misfit = state.transmission, state.misfit
                state = SolverState(now, now, 0.0, misfit, self.model.scale, stage, len(misfit))
                del now
            while len(state.misfit) < until and self.stop(state) is None:
                state = self._stepped(state, kind)
                if self.progress is not None:
                    self.progress(len(state.misfit) - 1, state.misfit[-1])
                if self.keep is not None:
                    self.keep(state)
        return state

    def _stepped(self, state: SolverState, kind: Kind) -> SolverState:
        self.model.fits_scale = self.fits_scale and len(state.misfit) < SCALE_ITERATIONS
        now: Array = state.transmission.real if kind == "amplitude" else state.transmission
        far = self._is_far(state)
        point, misfit = self._farther(state.ahead, kind, self.rounds if far else 1)
        point = prox_tv(point, STEP * (FARTHER if far else 1.0) * self._tv_weight(misfit))
        if kind == "amplitude":
            np.clip(point, 0.0, 1.0 if self.bounded else None, out=point)
        step = step_array(self.sizes, kind)
        after = self.scratch.make(step)
        np.multiply(point, self.model.lit, out=after)
        del point
        steps = 0.0 if _uphill(now, state.ahead, after) else state.momentum
        ahead = self.scratch.make(step)
        np.subtract(after, now, out=ahead)
        ahead *= steps / (steps + FRICTION)
        ahead += after
        return SolverState(
            after, ahead, steps + 1.0, (*state.misfit, misfit), self.model.scale, state.stage, state.began
        )

    def _is_far(self, state: SolverState) -> bool:
        """Whether the misfit was more than noise leaves, as far as that is known.

        Where planes do not share a field behind the lens, they cannot go down the misfit together by itself.
        """
        if self.model.rows:
            return False
        known = self.misfit_of_noise is not None and state.misfit
        return not known or state.misfit[-1] > FAR * (self.misfit_of_noise or 0.0)

    def _farther(self, ahead: Array, kind: Kind, rounds: int) -> tuple[Array, float]:
        """Down the misfit from the point ahead, and the misfit there."""
        point, misfit = self.model.step(ahead, rounds, STEP)
        point *= point.real.dtype.type(STEP)
        if kind == "amplitude":
            return point.real + ahead.real, misfit
        point += ahead
        return point, misfit

    def _tv_weight(self, misfit: float) -> float:
        if self.noise_at_scale_1 is None or self.misfit_of_noise is None:
            return self.tv_weight
        weight = TV_PER_NOISE * self.noise_at_scale_1 / self.model.scale
        return weight * max(misfit / self.misfit_of_noise, 1.0)

    def stop(self, state: SolverState) -> Stop | None:
        """Why no more iterations are to be made; None where some are."""
        if len(state.misfit) - state.began == 0:
            return None
        misfits, noise = state.misfit[state.began :], self.misfit_of_noise
        over = misfits[-1] / noise if self.until_noise and noise else math.inf
        if over <= AT_NOISE and (_rests(misfits, AT_NOISE_EARLY) or _to_come(misfits) < EARLY_GAIN):
            return "noise"
        rests = len(misfits) > EARLY and _rests(misfits, NEAR_EARLY if over <= FAR else EARLY)
        return "rest" if rests else None


def _rests(misfits: Sequence[float], iterations: int) -> bool:
    """Whether the misfit has changed by next to nothing."""
    return len(misfits) > iterations and abs(misfits[-1 - iterations] / misfits[-1] - 1.0) < EARLY_GAIN


def _to_come(misfits: Sequence[float]) -> float:
    """Share by which further iterations would change the misfit, if changes shrank as the last three did."""
    changes = np.abs(np.diff(misfits[-4:]))
    if len(changes) < 3 or not changes[0] > changes[1] > changes[2]:
        return math.inf
    # The slower of the two: where rounds end, a change is small once.
    ratio = max(changes[1] / changes[0], changes[2] / changes[1])
    return float(changes[2] * ratio / ((1.0 - ratio) * misfits[-1]))


def _uphill(now: Array, ahead: Array, after: Array) -> bool:
    """Whether the way from one step to the next leads against the one from the point ahead."""
    # Few rows at a time: differences of whole fields would be the largest arrays of a step.
    blocks = (slice(start, start + FEW_ROWS) for start in range(0, len(now), FEW_ROWS))
    along = (np.vdot(ahead[rows] - after[rows], after[rows] - now[rows]) for rows in blocks)
    return sum(float(one.real) for one in along) > 0.0
