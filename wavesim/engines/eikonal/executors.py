"""Execution of the super-tiles of a field, on this computer or on others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wavesim.engines.eikonal.super_tiles import SuperTile, propagate_tiles
from wavesim.runtime.threads import THREADS

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
    """

    groups: Sequence[SuperTile]
    shape: tuple[int, ...]

    def plane(self, parts: Iterable[Part], progress: Progress) -> NDArray[np.complex64]:
        result = np.zeros(self.shape, np.complex64)
        for number, total in self._carried(parts, progress):
            self.groups[number].interpolation.add(total, result, threads=THREADS)
        return result

    def bands(self, parts: Iterable[Part], sums: Sums, rows: int, progress: Progress) -> Iterator[Band]:
        sums.update(self._carried(parts, progress))
        height, width = self.shape
        for start in range(0, height, rows):
            band = np.zeros((min(rows, height - start), width), np.complex64)
            for number, group in enumerate(self.groups):
                group.interpolation.add(sums[number], band, start, THREADS)
            yield slice(start, start + len(band)), band

    def parts(
        self, plane: NDArray[np.complex64], numbers: Sequence[int], progress: Progress
    ) -> Iterator[Part]:
        for number in numbers:
            yield number, part_of(self.groups[number], plane, THREADS)
            progress()

    def _carried(self, parts: Iterable[Part], progress: Progress) -> Iterator[Part]:
        """Yield the super-tiles' fields on their own grids."""
        for number, values in parts:
            yield number, propagate_tiles("forward", self.groups[number], values, THREADS)
            progress()


def part_of(group: SuperTile, plane: NDArray, threads: int) -> NDArray[np.complex64]:
    """Apply the conjugate transpose of a super-tile to the plane; return its part of the object."""
    return propagate_tiles("adjoint", group, group.interpolation.collect(plane, threads), threads)
