"""The connection to a Dask cluster, and plain words where it cannot be used."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from typing import TYPE_CHECKING

from lensdesign.errors import InputError

if TYPE_CHECKING:
    from distributed import Client

CONNECT_SECONDS = 10.0
"""How long to wait for the scheduler, and for its first worker."""

COUNT_SECONDS = 2.0
"""How often to ask how many workers there are."""

RETRIES = 2
"""How often a task is tried again that failed for reasons of the machine."""


def toolkit_version() -> str:
    """Version of the installed toolkit."""
    return version("transferlens")


@contextmanager
def cluster_client(address: str) -> Iterator[Client]:
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
    with _quiet(), dask.config.set({"distributed.comm.timeouts.connect": waiting}):
        try:
            client = Client(address, timeout=waiting, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--cluster {address}: no Dask scheduler answers there within {CONNECT_SECONDS:g} s"
            ) from error
        try:
            _check_workers(client, address)
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


def thread_counter(client: Client) -> Callable[[], int]:
    """Tells how many tasks the cluster can do at a time; asks it now and then."""
    known, asked = 0, -COUNT_SECONDS

    def count() -> int:
        nonlocal known, asked
        if time.monotonic() - asked > COUNT_SECONDS:
            known, asked = sum(client.nthreads().values()), time.monotonic()
        return known

    return count
