"""Both ways of reconstruction such that a run which was cut off goes on, and ends as if it had not been.

What the next iteration needs is kept: all of it, in either way.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from wavesim.fields.field import Field
from wavesim.reconstruction.from_field import (
    LIT,
    Array,
    RetrievalState,
    Retrieved,
    Start,
    residual_and_map,
    retrieve,
)
from wavesim.reconstruction.from_object import SolverState
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Engine
from wavesim.sensor.measurement import Measurement, amplitude_unit, in_unit

KEEP_SECONDS = 20.0
"""Between two iterations that are kept, at least."""

KEEP_SHARE = 0.02
"""Of the time of Appendix A that keeping may take: its iterations are short, and their fields large."""

MEDIAN = 64.0
"""Of lit amplitudes, to which recorded ones are scaled for the total-variation step of Appendix A."""

DARKEST = 0.5
"""Standard deviations below which no amplitude goes into Appendix A. The total-variation step divides by the
modulus, and pixels that noise has made 0 would destroy their neighbours."""

Progress = Callable[[int, float], None]


def progress_kept(checkpoint: Checkpoint | None, scratch: Scratch) -> SolverState | None:
    """Where an earlier run of :func:`wavesim.reconstruct` was cut off, if it was, for its `resume`.

    To be given away in the call: no name may hold its arrays to the end.
    """
    kept = checkpoint.load() if checkpoint else None
    if kept is None:
        return None
    return SolverState(
        scratch.moved(kept.pop("transmission"), "a step"),
        scratch.moved(kept.pop("ahead"), "a step"),
        float(kept["momentum"]),
        tuple(kept["misfit"].tolist()),
        float(kept["scale"]),
        int(kept["stage"]),
        int(kept["began"]),
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
    """The paper's phase retrieval on the engine's exit grid; cut off, the next run goes on from there.

    Parameters
    ----------
    engine, illumination, recorded
        As of :func:`wavesim.reconstruct`.
    checkpoint
        Where the last iteration is kept, no more often than every `KEEP_SECONDS`, and for a share
        `KEEP_SHARE` of the time at most.
    iterations
        In all.
    start
        "model": the field of the illumination without object; "uniform" or "random", as of
        :func:`wavesim.retrieve`.
    progress
        Called after every iteration with its number and correlation.
    scratch
        Where the amplitudes lie as Appendix A takes them; in memory if left out.

    Returns
    -------
    Retrieved
        With the field in the recorded units.
    residual_maps : tuple of ndarray
        As of :func:`wavesim.reconstruct`.
    """
    unit = amplitude_unit(recorded)
    recorded = in_unit(recorded, unit)
    planes, factor = _prepared(recorded, scratch or Scratch())
    kept = checkpoint.load() if checkpoint else None
    # Fields are given away in the call, so that the retrieval can let go of them.
    found = retrieve(
        engine.scene.exit_grid,
        illumination.wavelength_um,
        planes,
        _first(engine, illumination, start, factor) if kept is None else "uniform",
        iterations=iterations,
        progress=progress,
        resume=None if kept is None else _taken(kept),
        keep=keeper(checkpoint, KEEP_SHARE),
    )
    values = found.field.values
    values /= factor
    left = [residual_and_map(found.field, plane) for plane in recorded]
    for array in (values, *(there for _, there in left)) if unit != 1.0 else ():
        array *= unit
    return replace(found, residuals=tuple(one for one, _ in left)), tuple(there for _, there in left)


def _first(engine: Engine, illumination: Field, start: str, factor: np.float32) -> Start:
    """What a retrieval starts from."""
    if start == "model":
        return Field(
            engine.scene.exit_grid, engine.forward(illumination).values * factor, illumination.wavelength_um
        )
    return "uniform" if start == "uniform" else "random"


def _taken(kept: dict[str, Any]) -> RetrievalState:
    """Where a retrieval stood, its fields taken out of what was kept."""
    curves = (tuple(kept[name].tolist()) for name in ("correlation", "residual_curve"))
    return RetrievalState(kept.pop("now"), kept.pop("before"), *curves)


def keeper(checkpoint: Checkpoint | None, share: float = math.inf) -> Callable[[Any], None] | None:
    """Keeps states, if there is where to, so rarely that it takes no more than a share of the time."""
    if checkpoint is None:
        return None
    last, pause = time.monotonic(), KEEP_SECONDS

    def keep(state: SolverState | RetrievalState) -> None:
        nonlocal last, pause
        began = time.monotonic()
        if began - last < pause:
            return
        checkpoint.keep(**vars(state))
        last = time.monotonic()
        pause = max(KEEP_SECONDS, (last - began) / share)

    return keep


def _prepared(recorded: Sequence[Measurement], scratch: Scratch) -> tuple[list[Measurement], np.float32]:
    """Amplitudes for Appendix A, none of them darker than noise, and what they were multiplied by.

    Of standard deviations it asks only whether they are finite: they stay as they are.
    """
    planes = []
    for plane in recorded:
        lifted = scratch.array(plane.amplitude.shape, plane.amplitude.dtype, "amplitudes above the noise")
        for row in range(len(lifted)):
            least: Any = 0.0
            if plane.sigma is not None:
                least = DARKEST * np.where(np.isfinite(plane.sigma[row]), plane.sigma[row], 0.0)
            lifted[row] = np.maximum(plane.amplitude[row], least)
        planes.append(replace(plane, amplitude=lifted))
    first = planes[0].amplitude
    factor = np.float32(MEDIAN / float(np.median(first[first > LIT * first.max()])))
    for plane in planes:
        np.multiply(plane.amplitude, factor, out=plane.amplitude)
    return planes, factor
