"""Super-tiles done by the workers of a Dask cluster; what comes back is added up here.

A worker gets the scene once, fits its own maps of the field, and then does one super-tile after another.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any

from lensdesign.common.clusters import RETRIES, cluster_client, thread_counter, toolkit_version
from lensdesign.errors import InputError, TransferLensError
from wavesim.engines.whole_field.engine import TwoLevelTiles
from wavesim.scene.engine import Engine, Task, Way
from wavesim.scene.scene import Scene

if TYPE_CHECKING:
    from concurrent.futures import Executor, Future

TASKS_IN_FLIGHT = 2
"""Handed out at a time for each thread of the cluster."""


class ClusterError(TransferLensError):
    """Workers of a cluster died, or it went away; what was kept before stays."""


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


class TileCluster:
    """A connection through which engines have their super-tiles done."""

    def __init__(self, client: Any, executor: Executor) -> None:
        self._client, self._executor = client, executor
        self._workers = thread_counter(client)

    def take(self, engine: Engine) -> None:
        """Have an engine's super-tiles done by the cluster from now on.

        Raises
        ------
        InputError
            If the engine has none.
        """
        tiles = refuse_no_tiles(engine)
        packet = ScenePacket(toolkit_version(), engine.scene, engine.settings(), engine.key())
        # A task's result, unlike scattered data, is made again when the workers that hold it die.
        sent = self._client.submit(deliver, packet, pure=False)

        def perform(way: Way, tasks: Iterable[Task]) -> Iterator[Task]:
            return self._in_order(sent, way, tasks)

        tiles.perform = perform

    def _in_order(self, sent: Any, way: Way, tasks: Iterable[Task]) -> Iterator[Task]:
        """Results in the order of tasks, so that sums do not depend on who is quick."""
        waiting, pending = iter(tasks), deque[tuple[int, "Future[Any]"]]()
        try:
            while True:
                room = TASKS_IN_FLIGHT * max(self._workers(), 1) - len(pending)
                for number, values in islice(waiting, max(room, 0)):
                    pending.append((number, self._executor.submit(work, sent, way, number, values)))
                if not pending:
                    return
                number, future = pending.popleft()
                yield number, _result(future)
        finally:
            for _, future in pending:
                future.cancel()


def refuse_no_tiles(engine: Engine) -> TwoLevelTiles:
    """The engine, if a cluster can do its work.

    Raises
    ------
    InputError
        If it has no super-tiles.
    """
    if not isinstance(engine, TwoLevelTiles):
        raise InputError(f"--cluster: engine {engine.name} is done here; a cluster needs engine two-level")
    return engine


@contextmanager
def tile_cluster(address: str) -> Iterator[TileCluster]:
    """A cluster that does super-tiles; its workers may come and go.

    Parameters
    ----------
    address
        Of the scheduler, as in ``tcp://host:8786``.

    Raises
    ------
    InputError
        As of :func:`lensdesign.common.clusters.cluster_client`.
    ClusterError
        While it is used, if the scheduler goes away or a task ends several workers.
    """
    with cluster_client(address) as client:
        executor = client.get_executor(retries=RETRIES, pure=False)
        try:
            yield TileCluster(client, executor)
        finally:
            executor.shutdown(wait=False)


@contextmanager
def tiles_in(address: str | None) -> Iterator[Callable[[Engine], Engine]]:
    """What hands an engine's tiles to a cluster and returns it; without an address, it stays as it is.

    Raises
    ------
    InputError, ClusterError
        As of :func:`tile_cluster`.
    """
    if address is None:
        yield lambda engine: engine
        return
    with tile_cluster(address) as tiles:

        def take(engine: Engine) -> Engine:
            tiles.take(engine)
            return engine

        yield take


def deliver(packet: ScenePacket) -> ScenePacket:
    """Keep a packet in the cluster, from where each worker fetches it once."""
    return packet


_engines: dict[str, TwoLevelTiles] = {}
_making = threading.Lock()


def work(packet: ScenePacket, way: Way, number: int, values: Any) -> Any:
    """Do one super-tile in a worker.

    Raises
    ------
    InputError
        If the worker's toolkit is of another version.
    """
    with _making:  # a worker's threads share one engine
        if packet.key not in _engines:
            if toolkit_version() != packet.toolkit_version:
                raise InputError(
                    f"a worker has version {toolkit_version()} of the toolkit, this is "
                    f"{packet.toolkit_version}: install the same version there"
                )
            _engines.clear()
            made = TwoLevelTiles(packet.scene, **packet.settings)
            made.groups  # noqa: B018
            _engines[packet.key] = made
        engine = _engines[packet.key]
    return engine.carry(way, number, values)


def _result(future: Future[Any]) -> Any:
    from concurrent.futures import CancelledError

    try:
        return future.result()
    except CancelledError as error:
        raise ClusterError("the cluster's scheduler is gone") from error
    except Exception as error:
        if type(error).__name__ == "KilledWorker":
            raise ClusterError("a super-tile ended several workers (out of memory, perhaps)") from error
        raise
