"""What memory an object-domain reconstruction takes, told before it runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from wavesim.engine import Engine
from wavesim.memory import BASE_BYTES, Need
from wavesim.reconstruction import Kind
from wavesim.retrieval import retrieval_bytes
from wavesim.scratch import Scratch

LIT_BYTES = 1
"""For each sample of the object: whether there is light."""

LIGHT_BYTES, READ_BYTES = 60, 60
"""For each sample of the object, while the illumination is made and while a true object is read. Measured."""

REFOCUSED_BYTES, JUDGED_BYTES, DRAWN_BYTES = 250, 40, 60
"""For each sample that is carried along the axis, compared with the truth, and drawn. Measured."""

PLANE_BYTES = 30
"""For each pixel, while residuals of a plane are drawn. Measured."""


@dataclass(frozen=True)
class MemoryRange:
    """Bytes beside Python and its libraries, which take some 0.3 GB.

    Attributes
    ----------
    most_bytes : int
        With all arrays in memory, illumination and recorded arrays included.
    least_bytes : int
        With all those in files that can be, by :class:`wavesim.Scratch`: illumination, recorded arrays and
        last steps.
    """

    most_bytes: int
    least_bytes: int


def reconstruction_bytes(
    engine: Engine,
    distances_mm: Sequence[float],
    *,
    kind: Kind = "complex",
    active_width: float = 0.0,
    with_sigma: bool = True,
    itemsize: int = 8,
) -> MemoryRange:
    """Memory that :func:`wavesim.reconstruct` takes.

    Parameters
    ----------
    engine
        As of :func:`wavesim.reconstruct`.
    distances_mm
        Of the recorded planes, from the engine's exit grid.
    kind, active_width
        As of :func:`wavesim.reconstruct`.
    with_sigma
        Whether recorded amplitudes come with standard deviations.
    itemsize
        Bytes of a complex sample: 8 for complex64, 16 for complex128.
    """
    scene, planes = engine.scene, len(distances_mm)
    source, behind = itemsize * scene.object_grid.size, itemsize * scene.exit_grid.size
    step = source // 2 if kind == "amplitude" else source
    movable = source + 2 * step + planes * behind * (1.0 if with_sigma else 0.5)
    far = sum(distance != 0.0 for distance in distances_mm)
    ways = LIT_BYTES * scene.object_grid.size + 0.25 * far * behind
    carrying = engine.cost().peak_bytes + source + behind
    least = ways + max(carrying, behind * _planes_share(planes, far, active_width), 4.0 * step)
    return MemoryRange(round(movable + least), round(least))


def _planes_share(planes: int, far: int, active_width: float) -> float:
    """Fields of the exit grid's size at one time while they take the amplitudes recorded.

    Pixels that integrate: the spectrum, twice as many rows of the field and their intensity, and what planes
    before have changed. At points: the field, its spectrum, what is changed of each, and the field on a plane
    with its intensity.
    """
    if active_width > 0.0:
        return 4.5 + (planes > 1)
    if far == 0:
        return 3.5
    return 4.5 + (planes > 2)


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
    item, planes = 8, len(distances_mm)
    source, behind = engine.scene.object_grid.size, engine.scene.exit_grid.size
    true = item * source if truth else 0
    held = item * (source + planes * behind) + true
    if method == "object":
        told = reconstruction_bytes(engine, distances_mm, kind=kind, active_width=active_width)
        most, least, found = told.most_bytes + true, told.least_bytes, item * source
        kept = item * source if kind == "amplitude" else 2 * item * source
    else:
        least = max(
            retrieval_bytes(engine.scene.exit_grid.shape, distances_mm),
            engine.cost().peak_bytes + 2 * item * behind,
        )
        most, found = least + held + planes * item // 2 * behind, item * behind
        kept = 2 * item * behind
    judging = engine.cost().peak_bytes + item * (2 * shown + behind)
    after = planes * item // 2 * behind + found + item * shown
    after += max(
        judging, JUDGED_BYTES * shown, DRAWN_BYTES * shown, REFOCUSED_BYTES * carried, PLANE_BYTES * behind
    )
    reading = max(LIGHT_BYTES, item + READ_BYTES if truth else 0) * source + frames_bytes
    reading = max(reading, frames_bytes + held)
    movable_after = held + (3 * item * shown if truth else 0)
    return Need(
        round(BASE_BYTES + max(most, after + movable_after, reading)),
        round(BASE_BYTES + max(least, after, reading)),
        # A new one is written before the earlier one goes.
        2 * kept,
    )


def held(scratch: Scratch, values: Any, what: str) -> Any:
    """An array where large ones lie: itself, or moved there if not all of them fit into memory."""
    return values if scratch.folder is None else scratch.moved(values, what)
