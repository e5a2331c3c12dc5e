"""Where a retrieval by Appendix A stands: at its start, after an iteration, where it was cut off."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid

if TYPE_CHECKING:
    from wavesim.reconstruction.from_field import Recorded
    from wavesim.reconstruction.retrieval_steps import Passes

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]
Start = Field | Literal["uniform", "random"]


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


def begun(grid: Grid, start: Start, amplitude: Array, seed: int) -> RetrievalState:
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


def resumed(grid: Grid, state: RetrievalState) -> RetrievalState:
    """A copy, of which the arrays may be used."""
    if state.now.shape != grid.shape or state.before.shape != grid.shape:
        raise InputError(f"resume: its shape {state.now.shape} is not that of the field sought, {grid.shape}")
    now, before = (np.array(values, order="C") for values in (state.now, state.before))
    return RetrievalState(now, before, state.correlation, state.residual_curve)


@contextmanager
def passes_for(
    grid: Grid, wavelength_um: float, recorded: Sequence[Recorded], dtype: Any
) -> Iterator[Passes]:
    """The passes of iterations over recorded planes, for fields of a complex type, with their threads."""
    from wavesim.reconstruction.retrieval_steps import Passes, plane_for

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
