"""Memory of a whole run of `wavesim reconstruct`, from its frames to its results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from wavesim.reconstruction.from_field import retrieval_bytes
from wavesim.reconstruction.from_object import Kind
from wavesim.reconstruction.memory import MemoryRange, reconstruction_bytes
from wavesim.reconstruction.refocusing import MOST_JUDGED
from wavesim.runtime.memory import BASE_BYTES, Need
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Engine

ITEM = 8
"""Bytes of a complex sample."""

LIGHT_BYTES, READ_BYTES = 49, 24
"""For each sample of the object, while the illumination is made and while a true object is read. Measured."""

REFOCUSED_BYTES, CARRIED_BYTES, JUDGED_BYTES, DRAWN_BYTES = 330, 85, 30, 30
"""For each sample whose sharpness is asked for, that is carried along the axis with these, compared with the
truth, and drawn. Measured."""

PLANE_BYTES = 20
"""For each pixel, while residuals of a plane are drawn. Measured."""


def run_need(
    engine: Engine,
    distances_mm: Sequence[float],
    *,
    method: str,
    kind: Kind,
    active_width: float,
    frames_bytes: int,
    shown: int,
    carried: int,
    truth: bool,
) -> Need:
    """Memory that the command `wavesim reconstruct` takes, from reading its frames to writing its results.

    Parameters
    ----------
    engine, distances_mm, kind, active_width
        As of :func:`reconstruction_bytes`; amplitudes are of float32 and come with standard deviations.
    method
        "object" or "paper".
    frames_bytes
        Of all frames as they are read.
    shown
        Samples of the object that are judged and written.
    carried
        Samples that are carried along the axis for refocusing; 0 without it.
    truth
        Whether a true object is compared.
    """
    planes, source, behind = len(distances_mm), engine.scene.object_grid.size, engine.scene.exit_grid.size
    true = ITEM * source if truth else 0
    movable = ITEM * (source + planes * behind) + true
    iterating, kept = _iterating(engine, distances_mm, method, kind, active_width)
    found = ITEM * (source if method == "object" else behind)
    after = planes * ITEM // 2 * behind + found + ITEM * shown
    after += max(
        engine.cost().peak_bytes + ITEM * (2 * shown + behind),
        max(JUDGED_BYTES, DRAWN_BYTES) * shown,
        REFOCUSED_BYTES * min(carried, MOST_JUDGED**2),
        CARRIED_BYTES * carried,
        PLANE_BYTES * behind,
    )
    reading = max(LIGHT_BYTES, ITEM + READ_BYTES if truth else 0) * source + frames_bytes
    reading = max(reading, frames_bytes + movable)
    passed = 3 * ITEM * shown if truth else 0
    return Need(
        round(BASE_BYTES + max(iterating.most_bytes + true, after + movable + passed, reading)),
        round(BASE_BYTES + max(iterating.least_bytes, after, reading)),
        # A new checkpoint is written before the earlier one goes.
        2 * kept,
    )


def _iterating(
    engine: Engine, distances_mm: Sequence[float], method: str, kind: Kind, active_width: float
) -> tuple[MemoryRange, int]:
    """What iterations take, and what is kept of one."""
    source, behind = engine.scene.object_grid.size, engine.scene.exit_grid.size
    if method == "object":
        told = reconstruction_bytes(engine, distances_mm, kind=kind, active_width=active_width)
        return told, ITEM * source * (1 if kind == "amplitude" else 2)
    own = retrieval_bytes(engine.scene.exit_grid.shape, distances_mm)
    least = max(own, engine.cost().peak_bytes + 2 * ITEM * behind)
    # Recorded amplitudes are there twice, as they were recorded and as Appendix A takes them.
    most = least + ITEM * source + len(distances_mm) * (ITEM + ITEM // 2) * behind
    return MemoryRange(most, least), 2 * ITEM * behind


def held(scratch: Scratch, values: Any, what: str) -> Any:
    """An array where large ones lie: itself, or moved there if not all of them fit into memory."""
    return values if scratch.folder is None else scratch.moved(values, what)
