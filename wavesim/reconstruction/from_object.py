"""Object-domain reconstruction: the object itself from intensities behind the lens.

The object t (its complex transmission) under a known illumination u gives the fields A_n(u t) on the planes
n. Steps

    t <- prox( t + mean over n of conj(u) A_n*( P_n(A_n(u t)) - A_n(u t) ) / max |u|^2 ),

with P_n the replacement of the amplitude by the recorded one, go down the misfit of amplitudes; because the
engine and free space are nearly unitary, the unit step is safe. The proximal map of the total variation keeps
edges and takes noise out; steps are accelerated (FISTA). Where the illumination is dark, so is the object:
a field stop is a support.

Source: A. Beck and M. Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse
problems", SIAM J. Imaging Sci. 2, 183 (2009).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.notebook import html_picture, html_table
from lensdesign.errors import InputError, refuse_not_positive, refuse_not_whole, refuse_other
from wavesim.camera.recorded import Recorded, amplitude_unit, in_unit, power_of_two
from wavesim.fields.field import Field
from wavesim.reconstruction.from_field import refuse_planes
from wavesim.reconstruction.recording_model import RecordingModel
from wavesim.reconstruction.total_variation import prox_tv
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Engine

Array = NDArray[np.inexact[Any]]
Kind = Literal["complex", "amplitude"]

SCALE_ITERATIONS = 4
"""In which an unknown scale is fitted; longer, it and the transmission would drift against each other."""

AMPLITUDE_START = 12
"""Iterations in which an amplitude object is sought where that is the start."""

TV_PER_NOISE = 1.0
"""Weight of the total variation over the standard deviation of the noise of a step."""

LEAST_TV = {"amplitude": 0.01, "complex": 0.02}
"""Smallest weight by the noise. Objects on a dark ground, to which the start is far, and complex ones, which
have as many unknowns as two planes have amplitudes, need the total variation without noise too."""

EARLY, EARLY_GAIN = 5, 1e-3
"""Early stop: over so many iterations the misfit falls by less than this share."""


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
    stopped_early : bool
        Whether the misfit fell no more before the iterations were used up.
    """

    transmission: Field
    misfit: tuple[float, ...]
    residual_maps: tuple[NDArray[np.floating[Any]], ...]
    scale: float
    stopped_early: bool

    def __repr__(self) -> str:
        return f"Reconstructed({', '.join(f'{name} {value}' for name, value in self._rows())})"

    def _repr_html_(self) -> str:
        return html_table("Reconstructed object", self._rows(), html_picture(self.transmission.values))

    def _rows(self) -> list[tuple[str, str]]:
        grid, stopped = self.transmission.grid, ", stopped early" if self.stopped_early else ""
        return [
            ("samples", f"{grid.shape[0]} x {grid.shape[1]} of {1e3 * grid.pitch_mm:.4g} um"),
            ("iterations", f"{len(self.misfit)}, misfit {self.misfit[-1]:.5g}{stopped}"),
            ("planes", f"{len(self.residual_maps)}, scale {self.scale:.4g}"),
        ]


@dataclass(frozen=True, eq=False)
class Progressed:
    """Where a reconstruction stands after an iteration: all that it needs to go on.

    Attributes
    ----------
    transmission, ahead : ndarray
        The last step, and the point from which the next one goes; real while an amplitude object is sought.
    momentum : float
        Of the acceleration.
    misfit : tuple of float
        Of every iteration so far.
    scale : float
        Recorded amplitude for a unit of the model's.
    stage, began : int
        Kind of object that is being sought, of those that follow each other; iterations before it.
    """

    transmission: Array
    ahead: Array
    momentum: float
    misfit: tuple[float, ...]
    scale: float
    stage: int
    began: int


def reconstruct(
    engine: Engine,
    illumination: Field,
    recorded: Sequence[Recorded],
    *,
    kind: Kind = "complex",
    tv_weight: float | Literal["auto"] = 0.0,
    iterations: int = 30,
    scale: float | None = None,
    start: Field | Literal["amplitude"] | None = None,
    active_width: float = 0.0,
    progress: Callable[[int, float], None] | None = None,
    resume: Progressed | None = None,
    keep: Callable[[Progressed], None] | None = None,
    scratch: Scratch | None = None,
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
        the noise of a step, which all planes' `sigma` tell, or `LEAST_TV` if that is more.
    iterations
        At most.
    scale
        Recorded amplitude for a unit of the model's, where a picture without object has told it. Left out,
        it is fitted in the first iterations: then the transmission is known but for a factor.
    start
        Transmission to start from; 1 if left out. "amplitude": the first `AMPLITUDE_START` iterations seek an
        amplitude object, so that a complex one on a dark ground is found, to which 1 is too far.
    active_width
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

    Raises
    ------
    InputError
        If a value or a shape is not usable, planes are in different units, or the disk that holds the scratch
        files is full.
    """
    _refuse(engine, illumination, recorded, kind, tv_weight, iterations, scale)
    if not (start is None or start == "amplitude" or isinstance(start, Field)):
        raise InputError(f"start = {start!r}: must be a field, or 'amplitude'")
    if isinstance(start, Field) and start.grid.shape != illumination.grid.shape:
        raise InputError(f"start: its shape {start.grid.shape} is not that of the object grid")
    if not 0.0 <= active_width <= 1.0:
        raise InputError(f"active_width = {active_width!r}: must be from 0 to 1")
    scratch = scratch or Scratch()
    unit, light_unit = amplitude_unit(recorded), power_of_two(float(np.abs(illumination.values).max()))
    if light_unit != 1.0:
        illumination = illumination.with_values(
            illumination.values / illumination.values.real.dtype.type(light_unit)
        )
    recorded = in_unit(recorded, unit)
    model = RecordingModel(
        engine, illumination, recorded, scale and scale * light_unit / unit, active_width, scratch
    )
    weight, noise = (0.0, model.noise_of_step()) if tv_weight == "auto" else (tv_weight, None)
    descent = _Descent(model, weight, noise, scale is None, progress, keep, scratch)
    stages = [(kind, iterations)]
    if start == "amplitude":
        stages.insert(0, ("amplitude", min(AMPLITUDE_START, iterations)))
    # Given away without a name for it: the arrays of a beginning would else be held to the end.
    begun = [resume or _beginning(model, start, stages[0][0], scratch)]
    del resume
    state = descent.run(begun.pop(), stages)
    now, misfits, stopped = state.transmission, state.misfit, _settled(state)
    del state
    maps = tuple(model.amplitudes(now))
    for modelled, plane in zip(maps, recorded, strict=True):
        modelled -= plane.amplitude
        modelled *= modelled.dtype.type(unit)
    values = now.astype(illumination.values.dtype)
    found = Field(engine.scene.object_grid, values, illumination.wavelength_um)
    return Reconstructed(found, misfits, maps, model.scale * unit / light_unit, stopped)


def _beginning(model: RecordingModel, start: Any, kind: Kind, scratch: Scratch) -> Progressed:
    """Where no iteration has been made: at the start, or at 1."""
    is_field = isinstance(start, Field)
    dtype = model.dtype if is_field or kind == "complex" else model.real
    now = scratch.array(model.lit.shape, dtype, "the start")
    np.multiply(start.values if is_field else 1.0, model.lit, out=now, casting="same_kind")
    return Progressed(now, now, 1.0, (), model.scale, 0, 0)


@dataclass(frozen=True, eq=False)
class _Descent:
    """Accelerated proximal steps."""

    model: RecordingModel
    tv_weight: float
    noise_at_scale_1: float | None
    fits_scale: bool
    progress: Callable[[int, float], None] | None
    keep: Callable[[Progressed], None] | None
    scratch: Scratch

    def run(self, state: Progressed, stages: Sequence[tuple[Kind, int]]) -> Progressed:
        """Where it stands after all stages: kinds of object, and iterations at which they end."""
        self.model.scale = state.scale
        for stage, (kind, until) in enumerate(stages):
            if stage < state.stage:
                continue
            if stage > state.stage:
                now, misfit = state.transmission, state.misfit
                state = Progressed(now, now, 1.0, misfit, self.model.scale, stage, len(misfit))
                del now
            while len(state.misfit) < until and not _settled(state):
                state = self._stepped(state, kind)
                if self.progress is not None:
                    self.progress(len(state.misfit) - 1, state.misfit[-1])
                if self.keep is not None:
                    self.keep(state)
        return state

    def _stepped(self, state: Progressed, kind: Kind) -> Progressed:
        self.model.fits_scale = self.fits_scale and len(state.misfit) < SCALE_ITERATIONS
        now: Array = state.transmission.real if kind == "amplitude" else state.transmission
        point, misfit = self._farther(state.ahead, kind)
        point = prox_tv(point, self._tv_weight(kind))
        if kind == "amplitude":
            np.clip(point, 0.0, 1.0, out=point)
        after = self.scratch.array(point.shape, point.dtype, "a step")
        np.multiply(point, self.model.lit, out=after)
        del point
        momentum = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * state.momentum**2))
        ahead = self.scratch.array(after.shape, after.dtype, "a step")
        np.subtract(after, now, out=ahead)
        ahead *= (state.momentum - 1.0) / momentum
        ahead += after
        return Progressed(
            after, ahead, momentum, (*state.misfit, misfit), self.model.scale, state.stage, state.began
        )

    def _farther(self, ahead: Array, kind: Kind) -> tuple[Array, float]:
        """Down the misfit from the point ahead, and the misfit there."""
        point, misfit = self.model.step(ahead)
        if kind == "amplitude":
            return point.real + ahead.real, misfit
        point += ahead
        return point, misfit

    def _tv_weight(self, kind: Kind) -> float:
        if self.noise_at_scale_1 is None:
            return self.tv_weight
        return max(TV_PER_NOISE * self.noise_at_scale_1 / self.model.scale, LEAST_TV[kind])


def _settled(state: Progressed) -> bool:
    """Whether the misfit has fallen by next to nothing over the last iterations."""
    if len(state.misfit) - state.began <= EARLY:
        return False
    before, misfit = state.misfit[-1 - EARLY], state.misfit[-1]
    return 0.0 <= before - misfit < EARLY_GAIN * misfit


def _refuse(
    engine: Engine,
    illumination: Field,
    recorded: Sequence[Recorded],
    kind: str,
    tv_weight: float | str,
    iterations: int,
    scale: float | None,
) -> None:
    if illumination.grid != engine.scene.object_grid:
        raise InputError(f"illumination: its grid {illumination.grid} is not the engine's object grid")
    if not np.any(np.abs(illumination.values) > 0.0):
        raise InputError("illumination: is all dark")
    if not recorded:
        raise InputError("recorded: must be one plane at least")
    refuse_planes(recorded, engine.scene.exit_grid.shape, "the exit grid's")
    refuse_other("kind", kind, ("complex", "amplitude"))
    if tv_weight != "auto" and (
        isinstance(tv_weight, str) or not (math.isfinite(tv_weight) and tv_weight >= 0.0)
    ):
        raise InputError(f"tv_weight = {tv_weight!r}: must be finite and not negative, or 'auto'")
    refuse_not_whole("iterations", iterations, 1)
    if scale is not None:
        refuse_not_positive("scale", scale)
