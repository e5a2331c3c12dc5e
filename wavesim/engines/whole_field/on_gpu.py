"""The work of super-tiles on a device: that of the compiled loops, written for an array module alone.

Interpolation is a product with matrices of few values in each row; they are kept as dense blocks along the
diagonal, since graphics processors are quickest at matrix products. Carriers are made block by block of rows,
as :mod:`wavesim.engines.whole_field.kernel` makes them, with phases in float64. A tile's polynomials are
evaluated on the device too: what is left for this computer are a few small arrays for each tile, which its
threads get ready while the device works.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavesim.engines.whole_field.carried import CarriedStep
from wavesim.engines.whole_field.tiles import SuperTile, TileFrame, carry_tiles, tile_frame
from wavesim.fields.resampling import Weights
from wavesim.runtime.device import Device
from wavesim.runtime.threads import THREADS, one_blas_thread
from wavesim.scene.engine import Direction

MOST_ROWS, LEAST_ROWS = 512, 16
"""Rows of a block."""


class OnDevice:
    """Computes super-tiles on a device, as :class:`wavesim.engines.whole_field.on_cpu.OnCpu` on the
    processor.

    Super-tiles' fields come from this computer's memory and go there; the plane lies in the device's, or for
    :meth:`collect` in either.
    """

    def __init__(self, device: Device) -> None:
        self.device = device

    @property
    def memory_bytes(self) -> float:
        return self.device.memory_bytes

    def carry(self, direction: Direction, group: SuperTile, values: NDArray) -> NDArray[np.complex64]:
        """Propagate one super-tile."""
        given = self.device.to_device(values, np.complex64)
        result = self.device.xp.zeros(group.shape_of(direction), dtype=np.complex64)
        carry_tiles(self.device, partial(DeviceStep, self.device), direction, _frames(group), given, result)
        return self.device.to_host(result)

    def add(self, carried: CarriedStep, total: NDArray, plane: Any, first_row: int = 0) -> None:
        """Add a super-tile's field to rows of the plane."""
        self._step(carried).add(self.device.to_device(total, np.complex64), plane, first_row)

    def collect(self, carried: CarriedStep, plane: Any) -> NDArray[np.complex64]:
        """Apply the conjugate transpose of :meth:`add`; return a super-tile's field."""
        return self.device.to_host(self._step(carried).collect(plane))

    def _step(self, carried: CarriedStep) -> DeviceStep:
        turns, edge = (self.device.to_device(values) for values in (carried.turns, carried.edge))
        return DeviceStep(self.device, replace(carried, turns=turns, edge=edge))


def _frames(group: SuperTile) -> Iterator[TileFrame]:
    """Yield prepared tiles in their order; threads prepare them ahead of their use."""
    waiting, ready = iter(group.tiles), deque[Future[TileFrame]]()
    alike: dict[Any, Any] = {}
    with one_blas_thread(), ThreadPoolExecutor(THREADS) as pool:
        # Tiles that each thread prepares before the device needs them.
        ahead = 2
        while True:
            room = ahead * THREADS - len(ready)
            ready.extend(pool.submit(tile_frame, group, tile, alike) for tile in islice(waiting, room))
            if not ready:
                return
            yield ready.popleft().result()


@dataclass(frozen=True, eq=False)
class Blocks:
    """A banded matrix as dense blocks of rows on a device.

    Attributes
    ----------
    device : Device
    parts : tuple of (slice, slice, array)
        Rows, the columns that they need, and the dense block.
    shape : (int, int)
    """

    device: Device
    parts: tuple[tuple[slice, slice, Any], ...]
    shape: tuple[int, int]

    def times(self, values: Any) -> Any:
        """Return the product with an array of shape (columns, n)."""
        result = self.device.xp.empty((self.shape[0], values.shape[1]), dtype=values.dtype)
        for rows, columns, block in self.parts:
            result[rows] = product(block, values[columns])
        return result

    def transposed_times(self, values: Any) -> Any:
        """Return the product of the transpose with an array of shape (rows, n)."""
        result = self.device.xp.zeros((self.shape[1], values.shape[1]), dtype=values.dtype)
        for rows, columns, block in self.parts:
            result[columns] += product(block.T, values[rows])
        return result


def blocks_of(device: Device, weights: Weights, rows: int) -> Blocks:
    """Return the interpolation along one axis as blocks of a number of rows."""
    parts = []
    count, taps = weights.weight.shape
    for start in range(0, count, rows):
        first, weight = weights.first[start : start + rows], weights.weight[start : start + rows]
        low, high = int(first.min()), int(first.max()) + taps
        block = np.zeros((len(first), high - low), weight.dtype)
        block[np.arange(len(first))[:, None], first[:, None] - low + np.arange(taps)] = weight
        parts.append((slice(start, start + len(first)), slice(low, high), device.to_device(block)))
    return Blocks(device, tuple(parts), (count, weights.coarse))


def product(block: Any, values: Any) -> Any:
    """Return the product of a real matrix and C-contiguous values, which may be complex."""
    if values.dtype.kind != "c":
        return block @ values
    return (block @ values.view(block.dtype)).view(values.dtype)


class DeviceStep:
    """Interpolation from a coarse grid to a window of a fine one, times its carrier, on a device.

    Parameters
    ----------
    device
        Device that computes.
    carried
        The step, with phase and edge on the device.
    """

    def __init__(self, device: Device, carried: CarriedStep) -> None:
        self.device, self.window, ways = device, carried.window, carried.ways
        width = self.window[1].stop - self.window[1].start
        # Memory for a sample of a row block while its carrier is computed.
        sample_bytes = 64
        rows = int(np.clip(device.memory_bytes // (sample_bytes * width), LEAST_ROWS, MOST_ROWS))
        self.along_y, self.along_x = (blocks_of(device, weights, rows) for weights in ways.field)
        cubic = [
            Weights(first, share, count)
            for first, share, count in zip(ways.first, ways.share, carried.turns.shape, strict=True)
        ]
        self.smooth_y, across = (blocks_of(device, weights, rows) for weights in cubic)
        self.turns, self.edge = (
            self._swapped(across.times(self._swapped(v))) for v in (carried.turns, carried.edge)
        )

    def _swapped(self, values: Any) -> Any:
        return self.device.xp.ascontiguousarray(values.T)

    def _carrier(self, number: int, rows: slice) -> Any:
        """Return exp(2 pi i turns) times 3 e^2 - 2 e^3 of the edge, for some rows of a block."""
        xp, (_, smooth, shares) = self.device.xp, self.smooth_y.parts[number]
        turns = shares[rows] @ self.turns[smooth]
        turns -= xp.floor(turns + 0.5)
        angle = (2.0 * math.pi * turns).astype(np.float32)
        edge = xp.clip((shares[rows] @ self.edge[smooth]).astype(np.float32), 0.0, 1.0)
        passed = edge * edge * (3.0 - 2.0 * edge)
        carrier = xp.empty(angle.shape, dtype=np.complex64)
        carrier.real = passed * xp.cos(angle)
        carrier.imag = passed * xp.sin(angle)
        return carrier

    def add(self, coarse: Any, fine: Any, first_row: int = 0) -> None:
        """Add a coarse field to a fine one, or to its rows from `first_row` on."""
        middle = self._swapped(self.along_x.times(self._swapped(coarse)))
        top, end = self.window[0].start, first_row + fine.shape[0]
        for number, (rows, columns, block) in enumerate(self.along_y.parts):
            start, stop = max(top + rows.start, first_row), min(top + rows.stop, end)
            if start < stop:
                own = slice(start - top - rows.start, stop - top - rows.start)
                band = product(block[own], middle[columns])
                band *= self._carrier(number, own)
                fine[start - first_row : stop - first_row, self.window[1]] += band

    def collect(self, fine: Any) -> Any:
        """Apply the conjugate transpose to a fine field in either memory; the result is on the device."""
        xp, (inside, across) = self.device.xp, self.window
        shape = self.along_y.shape[1], across.stop - across.start
        middle = xp.zeros(shape, dtype=np.complex64)
        for number, (rows, columns, block) in enumerate(self.along_y.parts):
            own = slice(inside.start + rows.start, inside.start + rows.stop)
            band = self._carrier(number, slice(None)).conj()
            band *= xp.asarray(fine[own, across])
            middle[columns] += product(block.T, band)
        return self._swapped(self.along_x.transposed_times(self._swapped(middle)))
