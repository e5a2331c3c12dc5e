"""What memory an object-domain reconstruction takes, told before it runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from wavesim.reconstruction.from_object import Kind
from wavesim.scene.engine import Engine

LIT_BYTES = 1
"""For each sample of the object: whether there is light."""


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
