"""Computation of super-tiles by compiled loops, in all threads."""

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
from wavesim.scene.engine import Direction


class OnCpu:
    """Computes super-tiles in this computer's memory.

    Attributes
    ----------
    device : Device
        Device of the arrays.
    memory_bytes : float
        Memory that a plane may use.

    Parameters
    ----------
    threads
        Threads that share the work of a super-tile. Default: all.
    """

    memory_bytes = math.inf

    def __init__(self, threads: int = THREADS) -> None:
        self.device, self.threads = device_named("cpu"), threads

    def carry(self, direction: Direction, group: SuperTile, values: NDArray) -> NDArray[np.complex64]:
        """Propagate one super-tile.

        Parameters
        ----------
        direction
            Forward or adjoint.
        group
            The super-tile.
        values
            Field on `group.part` of the object, or on its own grid, in this computer's memory.

        Returns
        -------
        ndarray of complex64
            Field on its own grid, or on `group.part`, where it is 0 outside the tiles.
        """
        shape = group.shape_of(direction)
        parts = np.zeros(shape, np.complex64)

        def one_thread(thread: int) -> NDArray[np.complex64]:
            # The fields of tiles overlap in the forward direction; their parts of the object do not.
            result = np.zeros(shape, np.complex64) if direction == "forward" else parts
            alike: dict[Any, Any] = {}
            frames = (tile_frame(group, tile, alike) for tile in group.tiles[thread :: self.threads])
            carry_tiles(self.device, lambda carried: carried, direction, frames, values, result)
            return result

        with one_blas_thread(), ThreadPoolExecutor(self.threads) as pool:
            first, *others = pool.map(one_thread, range(self.threads))
        for other in others if direction == "forward" else ():
            first += other
        return first

    def add(self, carried: CarriedStep, total: NDArray, plane: NDArray, first_row: int = 0) -> None:
        """Add a super-tile's field to rows of the plane."""
        carried.add(total, plane, first_row, self.threads)

    def collect(self, carried: CarriedStep, plane: NDArray) -> NDArray[np.complex64]:
        """Apply the conjugate transpose of :meth:`add`; return a super-tile's field."""
        return carried.collect(plane, self.threads)
