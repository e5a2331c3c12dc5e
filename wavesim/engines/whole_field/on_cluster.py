"""Super-tiles carried, and added up, by the workers of a Dask cluster.

A worker gets the scene once and fits its own maps of the field. Forward, super-tiles' fields stay with the
workers that carried them; bands of the plane are added up by workers, which get those fields' rows that they
need, and come back. Back, each worker gets the plane, and parts of the object come back. Whoever is quick,
sums are made in the same order.
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
    Held,
    check_same_version,
    open_cluster,
    toolkit_version,
)
from lensdesign.errors import InputError
from wavesim.engines.whole_field.engine import WholeFieldEngine
from wavesim.engines.whole_field.executors import Band, Part, Sums, Tell, part_of
from wavesim.engines.whole_field.on_cpu import OnCpu
from wavesim.engines.whole_field.on_gpu import OnDevice
from wavesim.runtime.memory import COMPLEX64
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene

if TYPE_CHECKING:
    from concurrent.futures import Future

Values = NDArray[np.complex64]

TASKS_IN_FLIGHT = 2
"""Handed out at a time for each thread of the cluster."""

ROUND = 16
"""Super-tiles added in one task, at least; the fields of two rounds lie in the cluster at a time."""

BAND_BYTES, MOST_BANDS = 64_000_000, 64
"""Size of a band at most, and into how many a plane is cut so that many threads may share it."""


@dataclass(frozen=True, eq=False)
class ScenePacket:
    """A scene as it travels to a cluster.

    Attributes
    ----------
    toolkit_version : str
        Of the toolkit that sent it.
    scene : Scene
    settings : dict
        Of the engine.
    key : str
        Of the engine (:meth:`wavesim.scene.engine.Engine.key`).
    """

    toolkit_version: str
    scene: Scene
    settings: dict[str, Any]
    key: str


@dataclass(frozen=True, eq=False)
class ClusterExecutor:
    """Has super-tiles carried and added up by a cluster.

    What a worker had that dies is made again by others, for which the scheduler keeps the object's parts.

    Attributes
    ----------
    cluster : Cluster
    sent : Held of ScenePacket
        The engine's scene.
    shape : (int, int)
        Of the plane.
    """

    cluster: Cluster
    sent: Held[ScenePacket]
    shape: tuple[int, ...]

    def plane(self, parts: Iterable[Part], tell: Tell) -> Values:
        plane = np.empty(self.shape, np.complex64)
        for place, total in self._totals(map(self._carried, parts), 1, lambda number, field: tell()):
            plane[place] = self.cluster.result(total)
        return plane

    def bands(self, parts: Iterable[Part], sums: Sums, rows: int, tell: Tell) -> Iterator[Band]:
        kept = sorted(sums)
        there = ((number, self.cluster.send(np.asarray(sums[number]))) for number in kept)
        fields = merge(there, map(self._carried, parts), key=lambda field: field[0])

        def keep(number: int, field: Held[Values]) -> None:
            if number not in kept:
                sums[number] = self.cluster.result(field)
                tell()

        for place, total in self._totals(fields, rows, keep):
            values = self.cluster.result(total)
            for start in range(place.start, place.stop, rows):
                stop = min(start + rows, place.stop)
                yield slice(start, stop), values[start - place.start : stop - place.start]

    def parts(self, plane: Values, numbers: Sequence[int], tell: Tell) -> Iterator[Part]:
        there = self.cluster.send(plane)
        waiting, pending = iter(numbers), deque[tuple[int, "Future[Values]"]]()
        try:
            while True:
                room = TASKS_IN_FLIGHT * self._threads - len(pending)
                for number in islice(waiting, max(room, 0)):
                    pending.append((number, self.cluster.submit(collect, self.sent, number, there)))
                if not pending:
                    return
                number, future = pending.popleft()
                yield number, self.cluster.result(future)
                tell()
        finally:
            for _, future in pending:
                future.cancel()

    @property
    def _threads(self) -> int:
        return max(self.cluster.threads(), 1)

    def _carried(self, part: Part) -> tuple[int, Held[Values]]:
        return part[0], self.cluster.hold(carry, self.sent, *part)

    def _totals(
        self,
        fields: Iterator[tuple[int, Held[Values]]],
        rows: int,
        done: Callable[[int, Held[Values]], None],
    ) -> Iterator[tuple[slice, Held[Values]]]:
        """Bands of the plane, in which all fields are added up in their order.

        Parameters
        ----------
        fields
            Of super-tiles, by number.
        rows
            Of which bands hold a multiple.
        done
            Told of each field that is there.
        """
        bands = self._bands(rows)
        totals: list[Held[Values] | None] = [None] * len(bands)
        under_way = deque[tuple[list[tuple[int, Held[Values]]], list[Held[Values]]]]()

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
        """Rows of the plane that are added up in one place, in multiples of some."""
        height, width = self.shape
        least = math.ceil(COMPLEX64 * height * width / BAND_BYTES)
        count = max(least, min(TASKS_IN_FLIGHT * self._threads, MOST_BANDS))
        step = rows * math.ceil(height / (count * rows))
        return [slice(start, min(start + step, height)) for start in range(0, height, step)]

    def _added(
        self, fields: Sequence[tuple[int, Held[Values]]], band: slice, total: Held[Values] | None
    ) -> Held[Values]:
        """A band to which some super-tiles are added."""
        place, hold = (band.start, band.stop), self.cluster.hold
        needed = [hold(rows_for, self.sent, number, place, field) for number, field in fields]
        return hold(add, self.sent, place, total, [number for number, _ in fields], needed)


def validate_tiled(engine: Engine) -> WholeFieldEngine:
    """The engine, if a cluster can do its work.

    Raises
    ------
    InputError
        If it has no super-tiles.
    """
    if not isinstance(engine, WholeFieldEngine):
        raise InputError(f"--cluster: engine {engine.name} is done here; a cluster needs engine two-level")
    return engine


@contextmanager
def tiles_in(address: str | None) -> Iterator[Callable[[Engine], Engine]]:
    """What has an engine's super-tiles done by a cluster, whose workers may come and go, and returns it.

    Without an address, the engine stays as it is.

    Parameters
    ----------
    address
        Of the scheduler, as in ``tcp://host:8786``.

    Raises
    ------
    InputError
        As of :func:`lensdesign.common.clusters.open_cluster`, or if an engine has no super-tiles.
    ClusterError
        While it is used, if the scheduler goes away or a task ends several workers.
    """
    if address is None:
        yield lambda engine: engine
        return
    with open_cluster(address) as cluster, ExitStack() as taken:

        def take(engine: Engine) -> Engine:
            tiles = validate_tiled(engine)
            packet = ScenePacket(toolkit_version(), engine.scene, engine.settings(), engine.key())
            tiles.elsewhere = ClusterExecutor(cluster, cluster.send(packet), engine.scene.exit_grid.shape)
            taken.callback(setattr, tiles, "elsewhere", None)
            return engine

        yield take


_engines: dict[str, WholeFieldEngine] = {}
_making = threading.Lock()


def engine_of(packet: ScenePacket) -> WholeFieldEngine:
    """The engine that a worker's threads share.

    Raises
    ------
    InputError
        If the worker's toolkit is of another version.
    """
    with _making:
        if packet.key not in _engines:
            check_same_version(packet.toolkit_version)
            _engines.clear()
            made = WholeFieldEngine(packet.scene, **packet.settings)
            made.groups  # noqa: B018
            _engines[packet.key] = made
        return _engines[packet.key]


def carry(packet: ScenePacket, number: int, values: Values) -> Values:
    """Runs in a worker: a super-tile's field on its own grid."""
    engine = engine_of(packet)
    return _worker_of(engine).carry("forward", engine.groups[number], values)


def rows_for(packet: ScenePacket, number: int, band: tuple[int, int], field: Values) -> Values:
    """Runs in a worker: those rows of a super-tile's field that a band of the plane takes."""
    _, needed = engine_of(packet).groups[number].carried.onto_rows(*band)
    return field[needed].copy()


def add(
    packet: ScenePacket,
    band: tuple[int, int],
    before: Values | None,
    numbers: Sequence[int],
    fields: Sequence[Values],
) -> Values:
    """Runs in a worker: a band of the plane with some super-tiles more; `before` stays as it is."""
    engine = engine_of(packet)
    worker, shape = _worker_of(engine), (band[1] - band[0], engine.scene.exit_grid.shape[1])
    total = worker.device.to_device(np.zeros(shape, np.complex64) if before is None else before.copy())
    for number, field in zip(numbers, fields, strict=True):
        part, _ = engine.groups[number].carried.onto_rows(*band)
        worker.add(part, field, total, band[0])
    return worker.device.to_host(total)


def collect(packet: ScenePacket, number: int, plane: Values) -> Values:
    """Runs in a worker: a super-tile's part of the object, from the plane."""
    engine = engine_of(packet)
    return part_of(_worker_of(engine), engine.groups[number], plane)


def _worker_of(engine: WholeFieldEngine) -> OnCpu | OnDevice:
    """What does a task: one thread, since the cluster's own are as many as its processors'."""
    return OnCpu(threads=1) if engine.device is None else engine.worker
