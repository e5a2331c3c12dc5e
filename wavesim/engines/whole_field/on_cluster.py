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

from lensdesign.common.clusters import (
    Cluster,
    open_cluster,
    refuse_other_version,
    result_of,
    toolkit_version,
)
from lensdesign.errors import InputError
from wavesim.engines.whole_field.engine import WholeFieldEngine
from wavesim.scene.engine import Engine, Task, Way
from wavesim.scene.scene import Scene

if TYPE_CHECKING:
    from concurrent.futures import Future

TASKS_IN_FLIGHT = 2
"""Handed out at a time for each thread of the cluster."""


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


def _in_order(cluster: Cluster, sent: Any, way: Way, tasks: Iterable[Task]) -> Iterator[Task]:
    """Results in the order of tasks, so that sums do not depend on who is quick."""
    waiting, pending = iter(tasks), deque[tuple[int, "Future[Any]"]]()
    try:
        while True:
            room = TASKS_IN_FLIGHT * max(cluster.threads(), 1) - len(pending)
            for number, values in islice(waiting, max(room, 0)):
                pending.append((number, cluster.submit(work, sent, way, number, values)))
            if not pending:
                return
            number, future = pending.popleft()
            yield number, result_of(future)
    finally:
        for _, future in pending:
            future.cancel()


def refuse_no_tiles(engine: Engine) -> WholeFieldEngine:
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
    with open_cluster(address) as cluster:

        def take(engine: Engine) -> Engine:
            tiles = refuse_no_tiles(engine)
            packet = ScenePacket(toolkit_version(), engine.scene, engine.settings(), engine.key())
            sent = cluster.send(packet)
            tiles.perform = lambda way, tasks: _in_order(cluster, sent, way, tasks)
            return engine

        yield take


_engines: dict[str, WholeFieldEngine] = {}
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
            refuse_other_version(packet.toolkit_version)
            _engines.clear()
            made = WholeFieldEngine(packet.scene, **packet.settings)
            made.groups  # noqa: B018
            _engines[packet.key] = made
        engine = _engines[packet.key]
    return engine.carry(way, number, values)
