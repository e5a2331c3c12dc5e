"""Where a retrieval by Appendix A stands: at its start, after an iteration, where it was cut off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid

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
