"""Who carries the super-tiles of a field and adds them up: this computer, or others."""

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
"""Number of a super-tile, and values on its part of the object."""

Band = tuple[slice, NDArray[np.complex64]]
"""Rows of the plane, and values there."""

Sums = MutableMapping[int, NDArray[np.complex64]]
"""Super-tiles' fields on their own grids, by number."""

Tell = Callable[[], None]
"""Called after every super-tile."""


class Executor(Protocol):
    """Has super-tiles carried, and adds them up; fields are those of :class:`SuperTile`, without the cell."""

    def plane(self, parts: Iterable[Part], tell: Tell) -> NDArray[np.complex64]:
        """The whole plane of some parts of the object."""

    def bands(self, parts: Iterable[Part], sums: Sums, rows: int, tell: Tell) -> Iterator[Band]:
        """The plane some rows at a time, of what is in `sums`; fields of these parts are put there first."""

    def parts(self, plane: NDArray[np.complex64], numbers: Sequence[int], tell: Tell) -> Iterator[Part]:
        """Conjugate transpose: super-tiles' parts of the object, in their order."""


@dataclass(frozen=True, eq=False)
class ThisComputer:
    """Does one super-tile after another.

    Attributes
    ----------
    groups : sequence of SuperTile
        All of the field.
    shape : (int, int)
        Of the plane.
    worker : OnCpu or OnDevice
        Does the work of each.
    """

    groups: Sequence[SuperTile]
    shape: tuple[int, ...]
    worker: OnCpu | OnDevice

    def plane(self, parts: Iterable[Part], tell: Tell) -> NDArray[np.complex64]:
        height, width = self.shape
        rows = int(min(self.worker.memory_bytes / (COMPLEX64 * width), height))
        if rows < height:
            return np.concatenate([band for _, band in self.bands(parts, {}, max(rows, 1), tell)])
        result = self._dark(height)
        for number, total in self._carried(parts, tell):
            self.worker.add(self.groups[number].carried, total, result)
        return self.worker.device.to_host(result)

    def bands(self, parts: Iterable[Part], sums: Sums, rows: int, tell: Tell) -> Iterator[Band]:
        sums.update(self._carried(parts, tell))
        height = self.shape[0]
        for start in range(0, height, rows):
            band = self._dark(min(rows, height - start))
            for number, group in enumerate(self.groups):
                self.worker.add(group.carried, sums[number], band, start)
            yield slice(start, start + len(band)), self.worker.device.to_host(band)

    def parts(self, plane: NDArray[np.complex64], numbers: Sequence[int], tell: Tell) -> Iterator[Part]:
        worker = self.worker
        there = plane if plane.nbytes > worker.memory_bytes else worker.device.to_device(plane)
        for number in numbers:
            yield number, part_of(worker, self.groups[number], there)
            tell()

    def _carried(self, parts: Iterable[Part], tell: Tell) -> Iterator[Part]:
        """Super-tiles' fields on their own grids."""
        for number, values in parts:
            yield number, self.worker.carry("forward", self.groups[number], values)
            tell()

    def _dark(self, rows: int) -> Any:
        """Rows of the plane, in the memory of what does the work."""
        return self.worker.device.xp.zeros((rows, self.shape[1]), dtype=np.complex64)


def part_of(worker: OnCpu | OnDevice, group: SuperTile, plane: Any) -> NDArray[np.complex64]:
    """A super-tile's part of the object, from the plane."""
    return worker.carry("adjoint", group, worker.collect(group.carried, plane))
