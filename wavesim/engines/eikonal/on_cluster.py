"""Execution of super-tiles by the workers of a Dask cluster.

A worker receives the scene once and fits its own maps of the field. In the forward direction the fields of
super-tiles stay with their workers. Other workers sum bands of the plane from the rows of these fields that
they need and return them. For the adjoint each worker receives the plane and returns parts of the object. The
order of summation does not depend on the speed of the workers.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from heapq import merge
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.clusters import (
    Cluster,
    ClusterResult,
    check_same_version,
    open_cluster,
    toolkit_version,
)
from lensdesign.errors import InputError
from wavesim.engines.eikonal.engine import HierarchicalTiles
from wavesim.engines.eikonal.executors import Band, Part, Progress, Sums, part_of
from wavesim.engines.eikonal.super_tiles import propagate_tiles
from wavesim.runtime.memory import COMPLEX64
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene

if TYPE_CHECKING:
    from concurrent.futures import Future

Values = NDArray[np.complex64]

THREADS_OF_TASK = 1
"""Threads of a task; the cluster starts one task for each core."""

TASKS_IN_FLIGHT = 2
"""Tasks that are submitted at a time for each thread of the cluster."""

ROUND = 16
"""Least number of super-tiles that one task adds. The cluster holds the fields of two rounds at a time."""

BAND_BYTES, MOST_BANDS = 64_000_000, 64
"""Largest size of a band, and largest number of bands of a plane for many threads."""


@dataclass(frozen=True, eq=False)
class ScenePacket:
    """Data of an engine that is sent to a cluster.

    Attributes
    ----------
    toolkit_version : str
        Version of the sending toolkit.
    scene : Scene
    settings : dict
        Settings of the engine.
    key : str
        Key of the engine (:meth:`wavesim.scene.engine.Engine.key`).
    """

    toolkit_version: str
    scene: Scene
    settings: dict[str, Any]
    key: str


@dataclass(frozen=True, eq=False)
class ClusterExecutor:
    """Propagates and sums super-tiles on a cluster.

    If a worker dies, others recompute its results; the scheduler keeps the parts of the object for this
    purpose.

    Attributes
    ----------
    cluster : Cluster
    sent : ClusterResult of ScenePacket
        Data of the engine.
    shape : (int, int)
        Shape of the plane.
    """

    cluster: Cluster
    sent: ClusterResult[ScenePacket]
    shape: tuple[int, ...]

    def plane(self, parts: Iterable[Part], progress: Progress) -> Values:
        plane = np.empty(self.shape, np.complex64)
        for place, total in self._totals(map(self._propagated, parts), 1, lambda number, field: progress()):
            plane[place] = self.cluster.result(total)
        return plane

    def bands(self, parts: Iterable[Part], sums: Sums, rows: int, progress: Progress) -> Iterator[Band]:
        kept = sorted(sums)
        stored = ((number, self.cluster.send(np.asarray(sums[number]))) for number in kept)
        fields = merge(stored, map(self._propagated, parts), key=lambda field: field[0])

        def keep(number: int, field: ClusterResult[Values]) -> None:
            if number not in kept:
                sums[number] = self.cluster.result(field)
                progress()

        for place, total in self._totals(fields, rows, keep):
            values = self.cluster.result(total)
            for start in range(place.start, place.stop, rows):
                stop = min(start + rows, place.stop)
                yield slice(start, stop), values[start - place.start : stop - place.start]

    def parts(self, plane: Values, numbers: Sequence[int], progress: Progress) -> Iterator[Part]:
        sent_plane = self.cluster.send(plane)
        waiting, pending = iter(numbers), deque[tuple[int, "Future[Values]"]]()
        try:
            while True:
                free = TASKS_IN_FLIGHT * self._threads - len(pending)
                for number in islice(waiting, max(free, 0)):
                    pending.append((number, self.cluster.submit(collect, self.sent, number, sent_plane)))
                if not pending:
                    return
                number, future = pending.popleft()
                yield number, self.cluster.result(future)
                progress()
        finally:
            for _, future in pending:
                future.cancel()

    @property
    def _threads(self) -> int:
        return max(self.cluster.threads(), 1)

    def _propagated(self, work: Part) -> tuple[int, ClusterResult[Values]]:
        return work[0], self.cluster.hold(propagate_tile, self.sent, *work)

    def _totals(
        self,
        fields: Iterator[tuple[int, ClusterResult[Values]]],
        rows: int,
        done: Callable[[int, ClusterResult[Values]], None],
    ) -> Iterator[tuple[slice, ClusterResult[Values]]]:
        """Return bands of the plane, multiples of `rows`, in which all fields are summed in their order."""
        bands = self._bands(rows)
        totals: list[ClusterResult[Values] | None] = [None] * len(bands)
        under_way = deque[tuple[list[tuple[int, ClusterResult[Values]]], list[ClusterResult[Values]]]]()

        def finish() -> None:
            together, sums = under_way.popleft()
            for number, field in together:
                self.cluster.finish([field])
                done(number, field)
            self.cluster.finish(sums)

        while together := list(islice(fields, max(ROUND, TASKS_IN_FLIGHT * self._threads))):
            sums = [self._added(together, *band) for band in zip(bands, totals, strict=True)]
            under_way.append((together, sums))
            totals[:] = sums
            if len(under_way) > 1:
                finish()
        while under_way:
            finish()
        yield from zip(bands, filter(None, totals), strict=True)

    def _bands(self, rows: int) -> list[slice]:
        """Return the rows of each band of the plane, in multiples of a number."""
        height, width = self.shape
        least = math.ceil(COMPLEX64 * height * width / BAND_BYTES)
        count = max(least, min(TASKS_IN_FLIGHT * self._threads, MOST_BANDS))
        step = rows * math.ceil(height / (count * rows))
        return [slice(start, min(start + step, height)) for start in range(0, height, step)]

    def _added(
        self,
        fields: Sequence[tuple[int, ClusterResult[Values]]],
        band: slice,
        total: ClusterResult[Values] | None,
    ) -> ClusterResult[Values]:
        """Return a band to which some super-tiles are added."""
        place, hold = (band.start, band.stop), self.cluster.hold
        needed = [hold(rows_for, self.sent, number, place, field) for number, field in fields]
        return hold(add, self.sent, place, total, [number for number, _ in fields], needed)


def validate_tiled(engine: Engine) -> HierarchicalTiles:
    """Return the engine if a cluster can run it.

    Raises
    ------
    InputError
        If the engine has no super-tiles.
    """
    if not isinstance(engine, HierarchicalTiles):
        raise InputError(
            f"--cluster: engine {engine.name} runs only on this machine; a cluster needs engine hierarchical"
        )
    return engine


@contextmanager
def tiles_in(address: str | None) -> Iterator[Callable[[Engine], Engine]]:
    """Return a function that assigns an engine's super-tiles to a cluster and returns the engine.

    Workers may join and leave at any time. Without an address, the function returns the engine unchanged.

    Parameters
    ----------
    address
        Address of the scheduler, such as ``tcp://host:8786``.

    Raises
    ------
    InputError
        If the cluster cannot be used (:func:`lensdesign.common.clusters.open_cluster`), or an engine has no
        super-tiles.
    ClusterError
        During use, if the scheduler disappears or a task kills several workers.
    """
    if address is None:
        yield lambda engine: engine
        return
    with open_cluster(address) as cluster, ExitStack() as assigned:

        def assign(engine: Engine) -> Engine:
            tiles = validate_tiled(engine)
            packet = ScenePacket(toolkit_version(), engine.scene, engine.settings(), engine.key())
            tiles.elsewhere = ClusterExecutor(cluster, cluster.send(packet), engine.scene.exit_grid.shape)
            assigned.callback(setattr, tiles, "elsewhere", None)
            return engine

        yield assign


_engines: dict[str, HierarchicalTiles] = {}
_making = threading.Lock()


def engine_of(packet: ScenePacket) -> HierarchicalTiles:
    """Return the engine that a worker's threads share.

    Raises
    ------
    InputError
        If the worker's toolkit is of another version.
    """
    with _making:
        if packet.key not in _engines:
            check_same_version(packet.toolkit_version)
            _engines.clear()
            made = HierarchicalTiles(packet.scene, **packet.settings)
            made.groups  # noqa: B018
            _engines[packet.key] = made
        return _engines[packet.key]


def propagate_tile(packet: ScenePacket, number: int, values: Values) -> Values:
    """Return a super-tile's field on its own grid; runs in a worker."""
    engine = engine_of(packet)
    return propagate_tiles("forward", engine.groups[number], values, THREADS_OF_TASK)


def rows_for(packet: ScenePacket, number: int, band: tuple[int, int], field: Values) -> Values:
    """Return the rows of a super-tile's field that a band of the plane uses; runs in a worker."""
    _, needed = engine_of(packet).groups[number].interpolation.onto_rows(*band)
    return field[needed].copy()


def add(
    packet: ScenePacket,
    band: tuple[int, int],
    total_before: Values | None,
    numbers: Sequence[int],
    fields: Sequence[Values],
) -> Values:
    """Return a band of the plane with further super-tiles, as a new array; runs in a worker."""
    engine = engine_of(packet)
    shape = band[1] - band[0], engine.scene.exit_grid.shape[1]
    total = np.zeros(shape, np.complex64) if total_before is None else total_before.copy()
    for number, field in zip(numbers, fields, strict=True):
        part, _ = engine.groups[number].interpolation.onto_rows(*band)
        part.add(field, total, band[0], THREADS_OF_TASK)
    return total


def collect(packet: ScenePacket, number: int, plane: Values) -> Values:
    """Apply a super-tile's conjugate transpose to the plane; runs in a worker."""
    return part_of(engine_of(packet).groups[number], plane, THREADS_OF_TASK)
