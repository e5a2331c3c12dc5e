"""Work done by a Dask cluster, and plain words where it cannot be."""

from __future__ import annotations

import logging
import os
import socket
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from lensdesign.errors import InputError, TransferLensError

if TYPE_CHECKING:
    from concurrent.futures import Future

    from distributed import Client

Result = TypeVar("Result")
Held_co = TypeVar("Held_co", covariant=True)

CONNECT_SECONDS = 30.0
"""How long to wait for the scheduler, and for its first worker: on a busy machine one takes ten seconds."""

LARGE_GRAPH = "distributed.admin.large-graph-warning-threshold"
"""Dask's setting: how large a task may be before it warns."""

COUNT_SECONDS = 2.0
"""How often to ask how many workers there are."""

TELL_SECONDS, WAIT_SECONDS = 3.0, 15.0
"""How long a cluster may have no worker before that is reported, and before work in it ends: a worker that
died may be started anew."""

LOOK_SECONDS = 0.5
"""How often whoever waits for a result looks whether there are workers."""

FETCH_SECONDS = 5.0
"""How long to fetch a finished result before its workers are looked for again; doubled each time."""

RETRIES = 2
"""How often a task is tried again that failed for reasons of the machine."""


def toolkit_version() -> str:
    """Version of the installed toolkit."""
    return version("transferlens")


class ClusterError(TransferLensError):
    """Workers of a cluster died, or it went away; what was kept before stays."""


class Held(Protocol[Held_co]):
    """A result that lies in a cluster."""

    @property
    def status(self) -> str: ...

    def result(self, timeout: float | None = None) -> Held_co: ...


class Cluster:
    """A connection through which a cluster's workers, which may come and go, do tasks."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._executor = client.get_executor(retries=RETRIES, pure=False)
        self._threads, self._asked = 0, -COUNT_SECONDS
        self._alone_since: float | None = None
        self._is_told = False

    def send(self, parcel: Result) -> Held[Result]:
        """Keep something in the cluster, from where each worker that needs it fetches it once."""
        # A task's result, unlike scattered data, is made again when the workers that hold it die.
        return self.hold(_unchanged, parcel)

    def hold(self, work: Callable[..., Result], *arguments: Any) -> Held[Result]:
        """Hand out a task whose result stays in the cluster, as long as something refers to it."""
        held: Held[Result] = self._client.submit(work, *arguments, retries=RETRIES, pure=False)
        return held

    def finish(self, held: Iterable[Held[Any]]) -> None:
        """Wait until results are there, in the cluster.

        Raises
        ------
        ClusterError
            As :func:`result_of`.
        """
        waiting = list(held)
        with _in_plain_words(), self._client.as_current():
            while any(one.status in ("pending", "lost") for one in waiting):
                self.check_workers()
                self._wait(waiting)
            for one in waiting:
                if one.status != "finished":
                    one.result()

    def _wait(self, waiting: list[Held[Any]]) -> None:
        """Wait until all results are there, but no longer than until workers are to be looked for again."""
        from distributed import wait

        with suppress(TimeoutError):
            wait(waiting, timeout=LOOK_SECONDS)

    def result(self, future: Future[Result] | Held[Result]) -> Result:
        """What a task came to; as :func:`result_of`, as long as there are workers.

        Raises
        ------
        ClusterError
            As :func:`result_of`, and if the cluster has had no worker for a while.
        """
        from concurrent.futures import Future, wait

        if isinstance(future, Future):
            while not wait((future,), timeout=LOOK_SECONDS).done:
                self.check_workers()
            return result_of(future)
        patience = FETCH_SECONDS
        while True:
            self.finish((future,))
            # The worker that holds a finished result may die before it has been fetched.
            with _in_plain_words(), suppress(TimeoutError):
                return future.result(timeout=patience)
            patience *= 2.0  # a large result may take longer

    def check_workers(self) -> None:
        """Say so where the cluster has had no worker for some seconds, and give up after some more.

        Raises
        ------
        ClusterError
            If it has had none for `WAIT_SECONDS`.
        """
        if self.threads() > 0:
            self._alone_since, self._is_told = None, False
            return
        now = time.monotonic()
        self._alone_since = now if self._alone_since is None else self._alone_since
        if now - self._alone_since > WAIT_SECONDS:
            raise ClusterError(
                f"the cluster's last worker is gone, and none has joined within {WAIT_SECONDS:g} s"
            )
        if now - self._alone_since > TELL_SECONDS and not self._is_told:
            self._is_told = True
            print(
                f"the cluster's last worker is gone; waiting {WAIT_SECONDS:g} s for another one",
                file=sys.stderr,
                flush=True,
            )

    def submit(self, work: Callable[..., Result], *arguments: Any) -> Future[Result]:
        """Hand out a task; what the cluster holds may stand among its arguments."""
        future: Future[Result] = self._executor.submit(work, *arguments)
        return future

    def threads(self) -> int:
        """How many tasks the cluster can do at a time; it is asked now and then."""
        if time.monotonic() - self._asked > (COUNT_SECONDS if self._threads else LOOK_SECONDS):
            with suppress(OSError):  # the scheduler is gone, as the results that are waited for will tell
                self._threads = sum(self._client.nthreads().values())
            self._asked = time.monotonic()
        return self._threads

    def close(self) -> None:
        """Hand out no more."""
        self._executor.shutdown(wait=False)


def result_of(future: Future[Result] | Held[Result]) -> Result:
    """What a task came to.

    Raises
    ------
    ClusterError
        If the scheduler is gone, or the task ended several workers.
    """
    with _in_plain_words():
        return future.result()


@contextmanager
def _in_plain_words() -> Iterator[None]:
    from concurrent.futures import CancelledError

    try:
        yield
    except CancelledError as error:
        raise ClusterError("the cluster's scheduler is gone") from error
    except Exception as error:
        if type(error).__name__ == "KilledWorker":
            raise ClusterError(
                "a task ended several workers of the cluster (out of memory, perhaps)"
            ) from error
        raise


def worker_name() -> str:
    """What messages call the worker that this process is."""
    return f"worker on {socket.gethostname()} (process {os.getpid()})"


def check_same_version(wanted: str) -> None:
    """Refuse, in a worker, a toolkit of another version than the one that sent the task."""
    if toolkit_version() != wanted:
        raise InputError(
            f"{worker_name()} has version {toolkit_version()} of the toolkit, this is {wanted}: install "
            "the same version there"
        )


def _unchanged(parcel: Any) -> Any:
    """Runs in a worker."""
    return parcel


@contextmanager
def open_cluster(address: str) -> Iterator[Cluster]:
    """A connection to a cluster whose workers can do our work.

    Parameters
    ----------
    address
        Of the scheduler, as in ``tcp://host:8786``.

    Raises
    ------
    InputError
        If `distributed` is not installed, no scheduler answers there, it has no workers, or they have
        another version of the toolkit.
    """
    try:
        import dask
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "--cluster needs the package distributed: install transferlens with its extra cluster"
        ) from error
    waiting = f"{CONNECT_SECONDS:g}s"
    # Parts of a field travel with their tasks, on purpose: each is needed once.
    settings = {"distributed.comm.timeouts.connect": waiting, LARGE_GRAPH: "1 TB"}
    with _quiet(), dask.config.set(settings):
        try:
            client = Client(address, timeout=waiting, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--cluster {address}: no Dask scheduler answers there within {CONNECT_SECONDS:g} s"
            ) from error
        try:
            _check_workers(client, address)
            cluster = Cluster(client)
            try:
                yield cluster
            finally:
                cluster.close()
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
    try:
        client.wait_for_workers(1, timeout=CONNECT_SECONDS)
    except TimeoutError as error:
        raise InputError(
            f"--cluster {address}: no worker has joined the scheduler within {CONNECT_SECONDS:g} s"
        ) from error
    try:
        versions: dict[str, str] = client.run(_version_there)
    except Exception as error:
        raise InputError(f"--cluster {address}: its workers cannot use this toolkit: {error}") from error
    for worker, there in sorted(versions.items()):
        if there != toolkit_version():
            raise InputError(
                f"--cluster {address}: worker {worker} has version {there} of the toolkit, this is "
                f"{toolkit_version()}: install the same version there"
            )


def _version_there() -> str:
    """Runs in a worker."""
    return version("transferlens")
