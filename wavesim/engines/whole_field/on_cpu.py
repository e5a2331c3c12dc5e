"""The work of super-tiles by compiled loops, in all threads. Most time goes there."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavesim.engines.whole_field.carried import CarriedStep
from wavesim.engines.whole_field.tiles import SuperTile, carry_tiles, tile_frame
from wavesim.runtime.device import device_named
from wavesim.runtime.threads import THREADS, one_blas_thread
from wavesim.scene.engine import Way


class OnCpu:
    """Does super-tiles' work in this computer's memory.

    Attributes
    ----------
    device : Device
        Whose arrays it works on.
    memory_bytes : float
        That a plane may take.

    Parameters
    ----------
    threads
        That share a super-tile's work; all by default.
    """

    memory_bytes = math.inf

    def __init__(self, threads: int = THREADS) -> None:
        self.device, self.threads = device_named("cpu"), threads

    def carry(self, way: Way, group: SuperTile, values: NDArray) -> NDArray[np.complex64]:
        """Do one super-tile's task.

        Parameters
        ----------
        way
            Forward or adjoint.
        group
            The super-tile.
        values
            On `group.part` of the object, or on its own grid; in this computer's memory, as the result.

        Returns
        -------
        ndarray of complex64
            On its own grid, or on `group.part`; 0 there where it has no tile.
        """
        shape = group.shape_of(way)
        back = np.zeros(shape, np.complex64)

        def one_thread(thread: int) -> NDArray[np.complex64]:
            # Forward, the fields of tiles overlap; back, each has a part of its own.
            result = np.zeros(shape, np.complex64) if way == "forward" else back
            alike: dict[Any, Any] = {}
            frames = (tile_frame(group, tile, alike) for tile in group.tiles[thread :: self.threads])
            carry_tiles(self.device, lambda carried: carried, way, frames, values, result)
            return result

        with one_blas_thread(), ThreadPoolExecutor(self.threads) as pool:
            first, *others = pool.map(one_thread, range(self.threads))
        for other in others if way == "forward" else ():
            first += other
        return first

    def add(self, carried: CarriedStep, total: NDArray, plane: NDArray, first_row: int = 0) -> None:
        """Add a super-tile's field to rows of the plane."""
        carried.add(total, plane, first_row, self.threads)

    def collect(self, carried: CarriedStep, plane: NDArray) -> NDArray[np.complex64]:
        """Conjugate transpose of :meth:`add`: a super-tile's field from the plane."""
        return carried.collect(plane, self.threads)
