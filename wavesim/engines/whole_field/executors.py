"""Execution of the super-tiles of a field, on this computer or on others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from wavesim.engines.whole_field.on_cpu import OnCpu
from wavesim.engines.whole_field.on_gpu import OnDevice
from wavesim.engines.whole_field.tiles import SuperTile
from wavesim.runtime.memory import COMPLEX64

Part = tuple[int, NDArray[np.complex64]]
"""Index of a super-tile, and values on its part of the object."""

Band = tuple[slice, NDArray[np.complex64]]
"""Rows of the plane, and their values."""

Sums = MutableMapping[int, NDArray[np.complex64]]
"""Fields of super-tiles on their own grids, by index."""

Progress = Callable[[], None]
"""Progress callback after every super-tile, without arguments."""


class Executor(Protocol):
    """Propagates super-tiles and sums their fields, without the factor of a sample's area."""

    def plane(self, parts: Iterable[Part], progress: Progress) -> NDArray[np.complex64]:
        """Return the field on the whole plane for some parts of the object."""

    def bands(self, parts: Iterable[Part], sums: Sums, rows: int, progress: Progress) -> Iterator[Band]:
        """Yield the plane in bands of rows, from the fields in `sums` and those of `parts`."""

    def parts(
        self, plane: NDArray[np.complex64], numbers: Sequence[int], progress: Progress
    ) -> Iterator[Part]:
        """Apply the conjugate transpose; yield the super-tiles' parts of the object in their order."""


@dataclass(frozen=True, eq=False)
class ThisComputer:
    """Computes one super-tile after another on this computer.

    Attributes
    ----------
    groups : sequence of SuperTile
        All super-tiles of the field.
    shape : (int, int)
        Shape of the plane.
    worker : OnCpu or OnDevice
        Worker that computes each super-tile.
    """

    groups: Sequence[SuperTile]
    shape: tuple[int, ...]
    worker: OnCpu | OnDevice

    def plane(self, parts: Iterable[Part], progress: Progress) -> NDArray[np.complex64]:
        height, width = self.shape
        rows = int(min(self.worker.memory_bytes / (COMPLEX64 * width), height))
        if rows < height:
            return np.concatenate([band for _, band in self.bands(parts, {}, max(rows, 1), progress)])
        result = self._dark(height)
        for number, total in self._carried(parts, progress):
            self.worker.add(self.groups[number].carried, total, result)
        return self.worker.device.to_host(result)

    def bands(self, parts: Iterable[Part], sums: Sums, rows: int, progress: Progress) -> Iterator[Band]:
        sums.update(self._carried(parts, progress))
        height = self.shape[0]
        for start in range(0, height, rows):
            band = self._dark(min(rows, height - start))
            for number, group in enumerate(self.groups):
                self.worker.add(group.carried, sums[number], band, start)
            yield slice(start, start + len(band)), self.worker.device.to_host(band)

    def parts(
        self, plane: NDArray[np.complex64], numbers: Sequence[int], progress: Progress
    ) -> Iterator[Part]:
        worker = self.worker
        on_device = plane if plane.nbytes > worker.memory_bytes else worker.device.to_device(plane)
        for number in numbers:
            yield number, part_of(worker, self.groups[number], on_device)
            progress()

    def _carried(self, parts: Iterable[Part], progress: Progress) -> Iterator[Part]:
        """Yield the super-tiles' fields on their own grids."""
        for number, values in parts:
            yield number, self.worker.carry("forward", self.groups[number], values)
            progress()

    def _dark(self, rows: int) -> Any:
        """Return rows of zeros of the plane, in the memory of the worker's device."""
        return self.worker.device.xp.zeros((rows, self.shape[1]), dtype=np.complex64)


def part_of(worker: OnCpu | OnDevice, group: SuperTile, plane: Any) -> NDArray[np.complex64]:
    """Apply the conjugate transpose of a super-tile to the plane; return its part of the object."""
    return worker.carry("adjoint", group, worker.collect(group.carried, plane))
