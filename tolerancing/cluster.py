"""Tasks done by the workers of a Dask cluster."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from lensdesign.errors import InputError
from tolerancing.executors import Batches, Perform, in_flight
from tolerancing.store_schema import toolkit_version
from tolerancing.tasks import Task

if TYPE_CHECKING:
    from distributed import Client

    from tolerancing.study_files import LoadedStudy

CONNECT_SECONDS = 10.0
"""How long to wait for the scheduler, and for its first worker."""

COUNT_SECONDS = 2.0
"""How often to ask how many workers there are."""

RETRIES = 2
"""How often a task is tried again that failed for reasons of the machine."""


@contextmanager
def cluster_workers(loaded: LoadedStudy, levels: Mapping[str, str], address: str) -> Iterator[Perform]:
    """Do tasks in a Dask cluster; its workers may come and go.

    Parameters
    ----------
    loaded
        The study. Its files are sent to the cluster once; from there each worker fetches them.
    levels
        The merits' levels by their labels.
    address
        Of the scheduler, as in ``tcp://host:8786``.

    Raises
    ------
    InputError
        If `distributed` is not installed, no scheduler answers there, it has no workers, or they have
        another version of the toolkit.
    """
    from tolerancing.workers import StudyParcel, deliver, work_in_cluster

    with _client(address) as client:
        _check_workers(client, address)
        parcel = StudyParcel(toolkit_version(), loaded.name, dict(loaded.files), loaded.fingerprint, levels)
        # A task's result, unlike scattered data, is made again when the workers that hold it die.
        sent = client.submit(deliver, parcel, pure=False)
        executor = client.get_executor(retries=RETRIES, pure=False)
        workers = _counter(client)

        def batches(tasks: Iterable[Task]) -> Batches:
            return in_flight(lambda task: executor.submit(work_in_cluster, sent, task), tasks, workers)

        try:
            yield batches
        finally:
            executor.shutdown(wait=False)


@contextmanager
def _client(address: str) -> Iterator[Client]:
    try:
        import dask
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "--cluster needs the package distributed: install transferlens with its extra cluster"
        ) from error
    waiting = f"{CONNECT_SECONDS:g}s"
    with _quiet(), dask.config.set({"distributed.comm.timeouts.connect": waiting}):
        try:
            client = Client(address, timeout=waiting, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--cluster {address}: no Dask scheduler answers there within {CONNECT_SECONDS:g} s"
            ) from error
        try:
            yield client
        finally:
            client.close(timeout=5.0)


@contextmanager
def _quiet() -> Iterator[None]:
    """What goes wrong is told by our own messages, so Dask need not log it."""
    known = logging.root.manager.loggerDict
    logs = [logging.getLogger(name) for name in known if name.split(".")[0] in ("distributed", "tornado")]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)


def _check_workers(client: Client, address: str) -> None:
    """Refuse a cluster without workers, or with a toolkit of another version."""
    from tolerancing.workers import toolkit_version as version_there

    try:
        client.wait_for_workers(1, timeout=CONNECT_SECONDS)
    except TimeoutError as error:
        raise InputError(
            f"--cluster {address}: no worker has joined the scheduler within {CONNECT_SECONDS:g} s"
        ) from error
    try:
        versions: dict[str, str] = client.run(version_there)
    except Exception as error:
        raise InputError(f"--cluster {address}: its workers cannot use this toolkit: {error}") from error
    for worker, version in sorted(versions.items()):
        if version != toolkit_version():
            raise InputError(
                f"--cluster {address}: worker {worker} has version {version} of the toolkit, this is "
                f"{toolkit_version()}: install the same version there"
            )


def _counter(client: Client) -> Callable[[], int]:
    """Number of tasks that the cluster can do at a time, asked for now and then."""
    known, asked = 0, -COUNT_SECONDS

    def count() -> int:
        nonlocal known, asked
        if time.monotonic() - asked > COUNT_SECONDS:
            known, asked = sum(client.nthreads().values()), time.monotonic()
        return known

    return count
