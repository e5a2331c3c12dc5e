"""The work of super-tiles: tiles summed on a super-tile's grid, and taken from there. Most time goes there.

Each super-tile is a task of its own, for the threads of this process or for another machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wavesim.engines.whole_field.tiles import FieldTile, SuperTile
from wavesim.runtime.blas import one_blas_thread
from wavesim.runtime.threads import THREADS

Way = Literal["forward", "adjoint"]

Task = tuple[int, NDArray[np.complexfloating]]
"""Number of a super-tile; values on its part of the object (forward), or on its own grid (adjoint)."""

Perform = Callable[[Way, Iterable[Task]], Iterator[Task]]
"""Does tasks, in their order, with the same numbers in what comes back: values of the other kind."""


def carry(way: Way, group: SuperTile, values: NDArray) -> NDArray[np.complex64]:
    """Do one super-tile's task with all threads.

    Parameters
    ----------
    way
        Forward or adjoint.
    group
        The super-tile.
    values
        On `group.part` of the object, or on its own grid.

    Returns
    -------
    ndarray of complex64
        On its own grid, or on `group.part`; 0 there where it has no tile.
    """
    with one_blas_thread(), ThreadPoolExecutor(THREADS) as pool:
        if way == "forward":
            shares = pool.map(lambda thread: _sum_of(group, thread, values), range(THREADS))
            result = next(shares)
            for share in shares:
                result += share
            return result
        height, width = (part.stop - part.start for part in group.part)
        back = np.zeros((height, width), np.complex64)
        found = pool.map(lambda tile: FieldTile(group, tile).collect(values), group.tiles)
        for tile, part in zip(group.tiles, found, strict=True):
            back[group.within(tile)] = part
        return back


def _sum_of(group: SuperTile, thread: int, values: NDArray) -> NDArray[np.complex64]:
    """What one thread adds to a super-tile's grid."""
    result = np.zeros(group.shape, np.complex64)
    for tile in group.tiles[thread::THREADS]:
        FieldTile(group, tile).add(values[group.within(tile)], result)
    return result
