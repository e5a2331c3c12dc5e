"""The paper's dual-plane phase retrieval: a field from intensities alone (Appendix A).

In every iteration the field at the exit vertex is carried to all planes (A1), takes the amplitudes that were
recorded there (A2), is carried back (A3), smoothed along the gradient of its total variation (A4), averaged
over the planes, and pushed on by a weighted feedback (A5). The correlation of amplitudes at the first plane
(A6) tells how well the data are met. It does not tell that the field is right: near 1 it may belong to
another field with almost the same intensities. A plane that was held out tells more.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError, validate_whole_number
from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.retrieval.steps import (
    Array,
    ComplexArray,
    Match,
    Passes,
    plane_for,
)
from wavesim.sensor.measurement import Measurement, amplitude_unit

Start = Field | Literal["uniform", "random"]

FEEDBACK = (0.7, 0.5)
"""Weights a and b of A5."""

TV_STEP = 0.05
"""Step t of A4."""

LIT, LARGEST_TV_SHARE = 1e-4, 2e-2
"""Amplitudes above this share of the largest are lit; the step may be this share of their median at most."""

WATCHED, LEAST_GAIN = 50, 1e-3
"""Stagnation: over so many iterations what a correlation lacks to 1 shrinks by less than this share."""


@dataclass(frozen=True, eq=False)
class Retrieved:
    """A retrieved field, and what speaks for it.

    Attributes
    ----------
    field : Field
        At the plane sought.
    correlation : tuple of float
        A6 at the first plane, for every iteration.
    residuals : tuple of float
        For each plane, the L2 norm of the difference of amplitudes over that of the recorded one.
    held_out_residual : float or None
        The same for the plane that was not used.
    stagnated_at : int or None
        Iteration from which on nothing more was gained; None while it still gained.
    residual_curve : tuple of float
        For every iteration, the relative L2 difference of amplitudes at the first plane.
    """

    field: Field
    correlation: tuple[float, ...]
    residuals: tuple[float, ...]
    held_out_residual: float | None
    stagnated_at: int | None
    residual_curve: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class RetrievalState:
    """Where a retrieval stands after an iteration: all that it needs to go on.

    Attributes
    ----------
    now, before : ndarray
        The field sought, after this iteration and after the one before.
    correlation, residual_curve : tuple of float
        Of every iteration so far, as of :class:`Retrieved`.
    """

    now: ComplexArray
    before: ComplexArray
    correlation: tuple[float, ...]
    residual_curve: tuple[float, ...]


def retrieve(
    grid: Grid,
    wavelength_um: float,
    recorded: Sequence[Measurement],
    start: Start = "uniform",
    *,
    iterations: int = 500,
    feedback: tuple[float, float] = FEEDBACK,
    tv_step: float = TV_STEP,
    held_out: Measurement | None = None,
    seed: int = 0,
    progress: Callable[[int, float], None] | None = None,
    resume: RetrievalState | None = None,
    keep: Callable[[RetrievalState], None] | None = None,
) -> Retrieved:
    """Find the field whose amplitudes were recorded.

    Parameters
    ----------
    grid
        Of the field sought; amplitudes lie on the same samples of their planes.
    wavelength_um
        Vacuum wavelength.
    recorded
        Two planes or more.
    start
        A field on the grid (that of the forward model, amplitude and phase), or an even or a random phase
        with the first plane's amplitude.
    iterations
        Number of iterations, with those of `resume`.
    feedback
        Weights a and b of A5.
    tv_step
        Step t of A4; 0 leaves it out. It adds up to about t to the field, whatever the field's scale. A
        bright field spans five decades of intensity: scaled to a peak of 1 it is destroyed by the paper's
        0.05, scaled to a median of 64 where it is lit it is not.
    held_out
        A plane that is not used, to judge the result.
    seed
        Of a random start.
    progress
        Called after every iteration with its number and correlation.
    resume
        Where a run with the same arguments was cut off: it goes on from there, as if it had not been.
    keep
        Called after every iteration with what `resume` takes. The next iterations use its arrays again: write
        or copy them before returning.

    Raises
    ------
    InputError
        If shapes, distances or weights are not usable, there are fewer than two planes, amplitudes
        cannot be squared, or the step of the total variation is too large for these amplitudes.
    """
    _refuse(grid, recorded, iterations, feedback, tv_step)
    state = _begun(grid, start, recorded[0].amplitude, seed) if resume is None else _resumed(grid, resume)
    del start, resume  # copied: who keeps no other reference to their arrays has that memory again
    with passes_for(grid, wavelength_um, recorded, state.now.dtype) as passes:
        state = iterated(passes, state, iterations, feedback, tv_step, progress, keep)
    found = Field(grid, state.now, wavelength_um)
    correlation, curve = state.correlation, state.residual_curve
    del state, passes
    return Retrieved(
        found,
        correlation,
        tuple(residual(found, plane) for plane in recorded),
        None if held_out is None else residual(found, held_out),
        stagnation(correlation),
        curve,
    )


def _begun(grid: Grid, start: Start, amplitude: Array, seed: int) -> RetrievalState:
    """Before the first iteration."""
    dtype: Any = np.complex64 if amplitude.dtype == np.float32 else np.complex128
    if isinstance(start, Field):
        if start.grid != grid:
            raise InputError(f"start: its grid {start.grid} is not that of the field sought, {grid}")
        now = np.array(start.values, dtype, order="C")
    elif start == "uniform":
        now = np.array(amplitude, dtype, order="C")
    elif start == "random":
        rng, now = np.random.default_rng(seed), np.empty(grid.shape, dtype)
        for row, recorded in zip(np.atleast_2d(now), np.atleast_2d(amplitude), strict=True):
            row[:] = recorded * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, len(row)))
    else:
        raise InputError(f"start = {start!r}: must be a field, 'uniform' or 'random'")
    return RetrievalState(now, np.zeros_like(now), (), ())


def _resumed(grid: Grid, state: RetrievalState) -> RetrievalState:
    """A copy, of which the arrays may be used."""
    if state.now.shape != grid.shape or state.before.shape != grid.shape:
        raise InputError(f"resume: its shape {state.now.shape} is not that of the field sought, {grid.shape}")
    now, before = (np.array(values, order="C") for values in (state.now, state.before))
    return RetrievalState(now, before, state.correlation, state.residual_curve)


@contextmanager
def passes_for(
    grid: Grid, wavelength_um: float, recorded: Sequence[Measurement], dtype: Any
) -> Iterator[Passes]:
    """The passes of iterations over recorded planes, for fields of a complex type, with their threads."""
    planes = [plane_for(grid, wavelength_um, p.distance_mm, p.amplitude, p.known, dtype) for p in recorded]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        yield Passes(planes, pool)


def iterated(
    passes: Passes,
    state: RetrievalState,
    iterations: int,
    feedback: tuple[float, float],
    tv_step: float,
    progress: Callable[[int, float], None] | None,
    keep: Callable[[RetrievalState], None] | None,
) -> RetrievalState:
    """Iterations up to their number; the arrays of `state` are used for them."""
    a, b = feedback
    rows = (-1, state.now.shape[-1])
    passes.begin(state.now.reshape(rows))
    for k in range(len(state.correlation), iterations):
        weights = (1.0, 0.0, 0.0) if k < 2 else (1.0 + a + b, a, b)
        met = passes.step(state.now.reshape(rows), state.before.reshape(rows), weights, tv_step)
        state = RetrievalState(
            state.before,
            state.now,
            (*state.correlation, met.correlation),
            (*state.residual_curve, met.residual),
        )
        if progress is not None:
            progress(k, met.correlation)
        if keep is not None:
            keep(state)
    return state


def amplitude_correlation(a: Array, b: Array) -> float:
    """Correlation of two amplitudes (A6)."""
    x, y = a - a.mean(dtype=float), b - b.mean(dtype=float)
    norm = math.sqrt(float(np.sum(x * x, dtype=float)) * float(np.sum(y * y, dtype=float)))
    return float(np.sum(x * y, dtype=float)) / norm if norm > 0.0 else 0.0


def residual(field: Field, plane: Measurement) -> float:
    """Relative L2 difference of a field's amplitude on a plane and the recorded one, in known pixels."""
    return _met(field, plane)[0].residual


def residual_and_map(field: Field, plane: Measurement) -> tuple[float, Array]:
    """The same, and the field's amplitude less the recorded one in every pixel."""
    met, there = _met(field, plane)
    left = np.abs(there)
    left -= plane.amplitude
    return met.residual, left


def _met(field: Field, plane: Measurement) -> tuple[Match, ComplexArray]:
    """How well a field meets a plane, and the field there."""
    values = np.ascontiguousarray(field.values)
    now = values.reshape(-1, values.shape[-1])
    with passes_for(field.grid, field.wavelength_um, [plane], now.dtype) as passes:
        passes.begin(now)
        passes.arrive()
        met, there = passes.match(now, passes.planes[0])
    return met, there.reshape(values.shape)


def stagnation(correlation: Sequence[float]) -> int | None:
    """First iteration from which on hardly anything was gained to the end; None if something was."""
    missing = 1.0 - np.asarray(correlation, float)
    found = None
    for k in reversed(range(max(len(missing) - WATCHED, 0))):
        if missing[k + WATCHED] <= (1.0 - LEAST_GAIN) * missing[k]:
            break
        found = k
    return found


def agreement(fields: Sequence[Field]) -> float:
    """Smallest correlation of any two fields, those of several starts; 1 where they differ by a factor.

    Raises
    ------
    InputError
        If there are fewer than two.
    """
    if len(fields) < 2:
        raise InputError(f"agreement of {len(fields)} field(s): must be of two at least")
    values = [np.ravel(f.values) / np.linalg.norm(f.values) for f in fields]
    return min(float(abs(np.vdot(u, v))) for i, u in enumerate(values) for v in values[:i])


def replace_amplitude(
    field: NDArray[np.complexfloating], amplitude: Array, known: NDArray[np.bool_] | None = None
) -> None:
    """A2, in place, in pixels that are known; where the field vanishes it takes the phase 0."""
    from wavesim.reconstruction.retrieval.kernel import replace

    rows, wanted, told = (None if v is None else np.atleast_2d(v) for v in (field, amplitude, known))
    assert rows is not None
    replace(rows.view(rows.real.dtype), wanted, told)


def validate_planes(recorded: Sequence[Measurement], shape: tuple[int, ...], whose: str) -> None:
    """Refuse amplitudes that cannot be those of a field; `whose` names the grid that has the shape.

    Raises
    ------
    InputError
        If a shape or a distance does not fit, or amplitudes are not finite, negative, or all dark.
    """
    for number, plane in enumerate(recorded, start=1):
        if plane.amplitude.shape != shape:
            raise InputError(f"plane {number}: its shape {plane.amplitude.shape} is not {whose} {shape}")
        if not math.isfinite(plane.distance_mm):
            raise InputError(f"plane {number}: distance_mm = {plane.distance_mm!r}: must be finite")
        if not all(map(math.isfinite, plane.shift_mm)):
            raise InputError(f"plane {number}: shift_mm = {plane.shift_mm!r}: must be finite")
        behind = plane.background
        if behind is not None and (
            behind.shape != shape or not np.all((behind >= 0.0) & np.isfinite(behind))
        ):
            raise InputError(
                f"plane {number}: background must be finite and not negative, of the shape {shape}"
            )
        if not np.all(np.isfinite(plane.amplitude)) or np.any(plane.amplitude < 0.0):
            raise InputError(f"plane {number}: amplitudes must be finite and not negative")
        if not np.any(plane.amplitude > 0.0):
            raise InputError(f"plane {number}: is all dark")
        if plane.sigma is not None:
            if plane.sigma.shape != shape or not np.all(plane.sigma > 0.0):
                raise InputError(f"plane {number}: sigma must be above 0, of the shape {shape}")
            if not np.any(np.isfinite(plane.sigma) & (plane.amplitude > 0.0)):
                raise InputError(f"plane {number}: is dark or not known (infinite sigma) in all pixels")


def _refuse(
    grid: Grid,
    recorded: Sequence[Measurement],
    iterations: int,
    feedback: tuple[float, float],
    tv_step: float,
) -> None:
    if len(recorded) < 2:
        raise InputError(f"{len(recorded)} plane(s) recorded: must be two at least")
    validate_planes(recorded, grid.shape, "the grid's")
    for number, plane in enumerate(recorded, start=1):
        if any(plane.shift_mm) or plane.background is not None:
            raise InputError(
                f"plane {number}: Appendix A knows neither shifts nor backgrounds; method object takes both"
            )
    if len({plane.distance_mm for plane in recorded}) < len(recorded):
        raise InputError("two planes have the same distance_mm: they must differ")
    if (unit := amplitude_unit(recorded)) != 1.0:
        raise InputError(
            f"plane 1: amplitudes reach {float(recorded[0].amplitude.max()):.3g}, whose squares overflow or "
            f"vanish: divide planes and start by {unit:.3g}"
        )
    validate_whole_number("iterations", iterations, 1)
    if not (all(map(math.isfinite, feedback)) and math.isfinite(tv_step) and tv_step >= 0.0):
        raise InputError(
            f"feedback = {feedback}, tv_step = {tv_step!r}: must be finite, the step not negative"
        )
    first = recorded[0].amplitude
    typical = float(np.median(first[first > LIT * first.max()]))
    if tv_step > LARGEST_TV_SHARE * typical:
        raise InputError(
            f"tv_step = {tv_step:g}: would destroy plane 1, whose amplitudes have a median of {typical:.3g} "
            f"where it is lit; scale planes and start by {64.0 / typical:.3g}, or take a smaller step"
        )
