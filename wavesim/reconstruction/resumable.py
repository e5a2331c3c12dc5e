"""Both kinds of reconstruction with checkpoints: an interrupted run continues as if it had not been
interrupted.

A checkpoint holds the complete state that the next iteration needs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from wavesim.fields.field import Field
from wavesim.reconstruction.object_solver import SolverState
from wavesim.reconstruction.phase_retrieval import (
    LIT,
    Array,
    RetrievalState,
    Retrieved,
    Start,
    residual_and_map,
    retrieve,
)
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Engine
from wavesim.sensor.measurement import Measurement, amplitude_unit, in_unit

SAVE_INTERVAL_S = 20.0
"""Shortest time between two saved iterations, in s."""

SAVE_TIME_FRACTION = 0.02
"""Largest fraction of the time of Appendix A for saving. Its iterations are short, and its fields are
large.
"""

Progress = Callable[[int, float], None]


def saved_state(checkpoint: Checkpoint | None, scratch: Scratch) -> SolverState | None:
    """Return the state at which an earlier run of :func:`wavesim.reconstruct` was interrupted, or None.

    Pass the result on without a name, so that its arrays do not stay in memory to the end.
    """
    saved = checkpoint.load() if checkpoint else None
    return None if saved is None else state_of(saved, scratch)


def state_of(saved: dict[str, Any], scratch: Scratch) -> SolverState:
    """Return the state that a checkpoint holds; its arrays are removed from `saved`."""
    return SolverState(
        scratch.moved(saved.pop("transmission"), "a step"),
        scratch.moved(saved.pop("ahead"), "a step"),
        float(saved["momentum"]),
        tuple(saved["misfit"].tolist()),
        float(saved["scale"]),
        int(saved["stage"]),
        int(saved["began"]),
    )


def retrieve_resumably(
    engine: Engine,
    illumination: Field,
    recorded: Sequence[Measurement],
    checkpoint: Checkpoint | None = None,
    *,
    iterations: int = 500,
    start: str = "model",
    progress: Progress | None = None,
    scratch: Scratch | None = None,
) -> tuple[Retrieved, tuple[Array, ...]]:
    """Run the paper's phase retrieval on the engine's exit grid; an interrupted run continues.

    Parameters
    ----------
    engine, illumination, recorded
        See :func:`wavesim.reconstruct`.
    checkpoint
        File of the last iteration, saved at most every `SAVE_INTERVAL_S` and for at most the fraction
        `SAVE_TIME_FRACTION` of the time.
    iterations
        Total number of iterations.
    start
        "model": the field of the illumination without an object; "uniform" or "random": see
        :func:`wavesim.retrieve`.
    progress
        Callback `progress(index, correlation)`, called after every iteration.
    scratch
        Storage of the prepared amplitudes; default: memory.

    Returns
    -------
    Retrieved
        Result with the field in the measured unit.
    residual_maps : tuple of ndarray
        For each plane, modelled less measured amplitude.
    """
    unit = amplitude_unit(recorded)
    recorded = in_unit(recorded, unit)
    planes, factor = _scaled_planes(recorded, scratch or Scratch())
    saved = checkpoint.load() if checkpoint else None
    # The fields have no other reference, so that the retrieval can release them.
    found = retrieve(
        engine.scene.exit_grid,
        illumination.wavelength_um,
        planes,
        _start_field(engine, illumination, start, factor) if saved is None else "uniform",
        iterations=iterations,
        progress=progress,
        resume=None if saved is None else _retrieval_state(saved),
        keep=state_saver(checkpoint, SAVE_TIME_FRACTION),
    )
    values = found.field.values
    values /= factor
    residuals = [residual_and_map(found.field, plane) for plane in recorded]
    for array in (values, *(residual_map for _, residual_map in residuals)) if unit != 1.0 else ():
        array *= unit
    return replace(found, residuals=tuple(relative_error for relative_error, _ in residuals)), tuple(
        residual_map for _, residual_map in residuals
    )


def _start_field(engine: Engine, illumination: Field, start: str, factor: np.float32) -> Start:
    """Return the initial field of a retrieval."""
    if start == "model":
        return Field(
            engine.scene.exit_grid, engine.forward(illumination).values * factor, illumination.wavelength_um
        )
    return "uniform" if start == "uniform" else "random"


def _retrieval_state(saved: dict[str, Any]) -> RetrievalState:
    """Return a saved state of a retrieval; its fields are removed from `saved`."""
    curves = (tuple(saved[name].tolist()) for name in ("correlation", "residual_curve"))
    return RetrievalState(saved.pop("now"), saved.pop("before"), *curves)


def state_saver(
    checkpoint: Checkpoint | None,
    time_fraction: float = math.inf,
    extra: Callable[[], dict[str, Any]] = dict,
) -> Callable[[Any], None] | None:
    """Return a callback that saves states, or None without a checkpoint.

    States are saved so rarely that saving takes at most the given fraction of the time. `extra` returns what
    is saved with them.
    """
    if checkpoint is None:
        return None
    last_save, interval = time.monotonic(), SAVE_INTERVAL_S

    def keep(state: SolverState | RetrievalState) -> None:
        nonlocal last_save, interval
        save_start = time.monotonic()
        if save_start - last_save < interval:
            return
        checkpoint.keep(**vars(state), **extra())
        last_save = time.monotonic()
        interval = max(SAVE_INTERVAL_S, (last_save - save_start) / time_fraction)

    return keep


def _scaled_planes(recorded: Sequence[Measurement], scratch: Scratch) -> tuple[list[Measurement], np.float32]:
    """Return amplitudes for Appendix A, at least as large as the noise, and their scale factor.

    The standard deviations stay as they are, because Appendix A only uses whether they are finite.
    """
    planes = []
    # Amplitudes below this number of standard deviations are raised to it in Appendix A. The total-variation
    # step divides by the modulus, so that pixels near 0 would destroy their neighbours.
    least_deviations = 0.5
    for plane in recorded:
        raised = scratch.array(plane.amplitude.shape, plane.amplitude.dtype, "amplitudes above the noise")
        for row in range(len(raised)):
            lowest: Any = 0.0
            if plane.sigma is not None:
                lowest = least_deviations * np.where(np.isfinite(plane.sigma[row]), plane.sigma[row], 0.0)
            raised[row] = np.maximum(plane.amplitude[row], lowest)
        planes.append(replace(plane, amplitude=raised))
    first = planes[0].amplitude
    # Median of lit amplitudes after the scaling for the total-variation step of Appendix A.
    scaled_median = 64.0
    factor = np.float32(scaled_median / float(np.median(first[first > LIT * first.max()])))
    for plane in planes:
        np.multiply(plane.amplitude, factor, out=plane.amplitude)
    return planes, factor
