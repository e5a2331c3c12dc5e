"""Tasks on a Dask cluster, with clear messages if the cluster fails."""

from __future__ import annotations

import logging
import math
import os
import socket
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from lensdesign.errors import InputError, TransferLensError

if TYPE_CHECKING:
    from concurrent.futures import Future

    from distributed import Client

Result = TypeVar("Result")
Stored_co = TypeVar("Stored_co", covariant=True)

CONNECT_SECONDS = 30.0
"""Time limit for the scheduler and for its first worker; on a busy machine a worker starts in ten seconds."""

COUNT_SECONDS = 2.0
"""Interval between counts of the workers."""

REPORT_SECONDS, WAIT_SECONDS = 3.0, 15.0
"""Time without any worker after which a warning is printed, and after which the work fails. A dead worker
may be restarted in the meantime."""

CHECK_SECONDS = 0.5
"""Interval between checks for workers while waiting for a result."""

ANSWER_SECONDS = 5.0
"""Time limit for an answer of the scheduler, or of a worker that is asked alone."""

SILENT_WORKER_SECONDS, SILENT_SCHEDULER_SECONDS = 60.0, 60.0
"""Time without a sign of life after which a warning about a worker is printed, and after which the work fails
because of the scheduler. A worker that computes outside Python gives none for some seconds, too.
"""

RETRIES = 2
"""Number of retries of a task that failed because of its machine."""


def toolkit_version() -> str:
    """Return the version of the installed toolkit."""
    return version("transferlens")


class ClusterError(TransferLensError):
    """Workers of a cluster died, or its scheduler ended; results stored before remain."""


class ClusterResult(Protocol[Stored_co]):
    """A result that is stored in a cluster."""

    @property
    def status(self) -> str: ...

    def result(self, timeout: float | None = None) -> Stored_co: ...


@dataclass
class _SignOfLife:
    """Time of a worker's last message by the scheduler's clock, and of its first sight by this machine's."""

    last_seen: float
    seen_at: float
    is_reported: bool = False


class Cluster:
    """A connection to a cluster whose number of workers may change."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._executor = client.get_executor(retries=RETRIES, pure=False)
        self._threads, self._counted_at = 0, -math.inf
        self._answered_at = time.monotonic()
        self._signs = dict[str, _SignOfLife]()
        self._alone_since: float | None = None
        self._is_reported = False

    def send(self, parcel: Result) -> ClusterResult[Result]:
        """Store a value in the cluster; each worker that needs it fetches it once."""
        # Unlike scattered data, the result of a task is computed again when its workers die.
        return self.hold(_unchanged, parcel)

    def hold(self, work: Callable[..., Result], *arguments: Any) -> ClusterResult[Result]:
        """Submit a task whose result stays in the cluster as long as it is referenced."""
        stored: ClusterResult[Result] = self._client.submit(work, *arguments, retries=RETRIES, pure=False)
        return stored

    def finish(self, results: Iterable[ClusterResult[Any]]) -> None:
        """Wait until results are available in the cluster.

        Raises
        ------
        ClusterError
            If the scheduler has ended, a task ended several workers, or no worker is left.
        """
        waiting = list(results)
        with _clear_errors(), self._client.as_current():
            while any(one.status in ("pending", "lost") for one in waiting):
                self.check_workers()
                self._wait(waiting)
            for one in waiting:
                if one.status != "finished":
                    one.result()

    def _wait(self, waiting: list[ClusterResult[Any]]) -> None:
        """Wait until all results are available, but at most until the next check for workers."""
        from distributed import wait

        with suppress(TimeoutError):
            wait(waiting, timeout=CHECK_SECONDS)

    def result(self, future: Future[Result] | ClusterResult[Result]) -> Result:
        """Return the result of a task.

        Raises
        ------
        ClusterError
            If the scheduler has ended, the task ended several workers, or no worker is left.
        """
        from concurrent.futures import Future, wait

        if isinstance(future, Future):
            while not wait((future,), timeout=CHECK_SECONDS).done:
                self.check_workers()
            return result_of(future)
        # Time limit to fetch a finished result before its workers are checked again; doubled each time.
        patience = 5.0
        while True:
            self.finish((future,))
            # The worker that stores a finished result may die before the result is fetched.
            with _clear_errors(), suppress(TimeoutError):
                return future.result(timeout=patience)
            patience *= 2.0  # a large result may take longer

    def check_workers(self) -> None:
        """Report workers that do not answer, and a lack of workers, which is an error after some seconds.

        Raises
        ------
        ClusterError
            If there has been no worker for `WAIT_SECONDS`, or no answer of the scheduler for
            `SILENT_SCHEDULER_SECONDS`.
        """
        threads, now = self.threads(), time.monotonic()
        if now - self._answered_at > SILENT_SCHEDULER_SECONDS:
            raise ClusterError(
                f"the cluster's scheduler has not answered for {SILENT_SCHEDULER_SECONDS:g} s: it hangs, or "
                "its machine cannot be reached"
            )
        self._report_silent_workers(now)
        if threads > 0:
            self._alone_since, self._is_reported = None, False
            return
        self._alone_since = now if self._alone_since is None else self._alone_since
        if now - self._alone_since > WAIT_SECONDS:
            raise ClusterError(
                f"the cluster's last worker is gone, and none has joined within {WAIT_SECONDS:g} s"
            )
        if now - self._alone_since > REPORT_SECONDS and not self._is_reported:
            self._is_reported = True
            print(
                f"the cluster's last worker is gone; waiting {WAIT_SECONDS:g} s for another one",
                file=sys.stderr,
                flush=True,
            )

    def _report_silent_workers(self, now: float) -> None:
        """Print once which workers give no sign of life; their tasks wait for them."""
        for address, sign in self._signs.items():
            if now - sign.seen_at > SILENT_WORKER_SECONDS and not sign.is_reported:
                sign.is_reported = True
                print(
                    f"worker {address} has not answered for {SILENT_WORKER_SECONDS:g} s, and its tasks wait: "
                    "end it if it hangs; otherwise the scheduler gives them to other workers when it counts "
                    "it as lost (by default after 5 to 10 minutes)",
                    file=sys.stderr,
                    flush=True,
                )

    def submit(self, work: Callable[..., Result], *arguments: Any) -> Future[Result]:
        """Submit a task; results stored in the cluster may be among its arguments."""
        future: Future[Result] = self._executor.submit(work, *arguments)
        return future

    def threads(self) -> int:
        """Return the number of tasks that the cluster can run at a time; it is updated every few seconds."""
        if time.monotonic() - self._counted_at > (COUNT_SECONDS if self._threads else CHECK_SECONDS):
            # If the scheduler has ended, waiting for results reports it; if it hangs, `check_workers` does.
            with suppress(OSError):
                workers: dict[str, Any] = self._client.sync(
                    self._client.scheduler.identity, callback_timeout=ANSWER_SECONDS
                )["workers"]
                self._note_workers(workers)
            self._counted_at = time.monotonic()
        return self._threads

    def _note_workers(self, workers: Mapping[str, Any]) -> None:
        """Note the number of threads and the signs of life in an answer of the scheduler."""
        self._threads, self._answered_at = sum(one["nthreads"] for one in workers.values()), time.monotonic()
        before, self._signs = self._signs, {}
        for address, one in workers.items():
            sign = before.get(address)
            # The times are of the scheduler's clock, which may differ from that of this machine, and be set.
            if sign is None or sign.last_seen != one["last_seen"]:
                sign = _SignOfLife(one["last_seen"], self._answered_at)
            self._signs[address] = sign

    def close(self) -> None:
        """Submit no more tasks."""
        self._executor.shutdown(wait=False)


def result_of(future: Future[Result] | ClusterResult[Result]) -> Result:
    """Return the result of a task.

    Raises
    ------
    ClusterError
        If the scheduler has ended, or the task ended several workers.
    """
    with _clear_errors():
        return future.result()


@contextmanager
def _clear_errors() -> Iterator[None]:
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
    """Return the name of this worker process in messages."""
    return f"worker on {socket.gethostname()} (process {os.getpid()})"


def check_same_version(required: str) -> None:
    """Raise InputError, in a worker, if its toolkit has another version than the one that sent the task."""
    if toolkit_version() != required:
        raise InputError(
            f"{worker_name()} has version {toolkit_version()} of the toolkit, but the task was sent by "
            f"version {required}: install the same version on the workers"
        )


def _unchanged(parcel: Any) -> Any:
    """Return the argument; runs in a worker."""
    return parcel


@contextmanager
def open_cluster(address: str) -> Iterator[Cluster]:
    """Open a connection to a cluster whose workers have the same version of the toolkit.

    Parameters
    ----------
    address
        Address of the scheduler, such as ``tcp://host:8786``.

    Raises
    ------
    InputError
        If `distributed` is not installed, no scheduler answers, it has no workers, or they have another
        version of the toolkit.
    """
    try:
        import dask
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "--cluster needs the package distributed: install transferlens with its extra cluster"
        ) from error
    waiting = f"{CONNECT_SECONDS:g}s"
    # Blocks of a field are sent with their tasks, because each is needed once; Dask must not warn of that.
    large_graph = "distributed.admin.large-graph-warning-threshold"
    settings = {"distributed.comm.timeouts.connect": waiting, large_graph: "1 TB"}
    with _quiet(), dask.config.set(settings):
        try:
            _check_scheduler(address)
            client = Client(address, timeout=waiting, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--cluster {address}: no Dask scheduler answers within {CONNECT_SECONDS:g} s"
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
    """Silence the logs of Dask, since the toolkit reports errors itself."""
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


def _check_scheduler(address: str) -> None:
    """Raise OSError if a scheduler does not answer in time; a client would wait for one that hangs."""
    from distributed import Security
    from distributed.comm import connect
    from distributed.utils import LoopRunner, sync

    async def probe() -> None:
        connection = Security().get_connection_args("client")
        comm = await connect(address, timeout=CONNECT_SECONDS, **connection)
        await comm.close()

    runner = LoopRunner()
    runner.start()
    try:
        sync(runner.loop, probe, callback_timeout=CONNECT_SECONDS)
    finally:
        runner.stop()


def _check_workers(client: Client, address: str) -> None:
    """Refuse a cluster without workers, or with a toolkit of another version."""
    try:
        client.wait_for_workers(1, timeout=CONNECT_SECONDS)
    except TimeoutError as error:
        raise InputError(
            f"--cluster {address}: no worker has joined the scheduler within {CONNECT_SECONDS:g} s"
        ) from error
    try:
        versions: dict[str, str] = client.run(version, "transferlens", callback_timeout=CONNECT_SECONDS)
    except TimeoutError as error:
        silent = ", ".join(filter(partial(_is_silent, client), client.nthreads())) or "some of its workers"
        raise InputError(
            f"--cluster {address}: no answer within {CONNECT_SECONDS:g} s from {silent}: end the workers "
            "that hang, and start others if need be"
        ) from error
    except Exception as error:
        raise InputError(f"--cluster {address}: its workers cannot use this toolkit: {error}") from error
    for worker, found in sorted(versions.items()):
        if found != toolkit_version():
            raise InputError(
                f"--cluster {address}: worker {worker} has version {found} of the toolkit, but this computer "
                f"has {toolkit_version()}: install the same version on the workers"
            )


def _is_silent(client: Client, worker: str) -> bool:
    """Return whether a worker does not answer."""
    try:
        client.run(int, workers=[worker], callback_timeout=ANSWER_SECONDS)
    except TimeoutError:
        return True
    return False
