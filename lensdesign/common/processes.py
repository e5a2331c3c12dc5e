"""Process pools: new processes, or copies of a server that was started in advance.

This module imports nothing heavy, so that the server starts before everything else.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, ParamSpec, Self, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing.process import BaseProcess

Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")

_server_started = False


def one_blas_thread() -> None:
    """Limit linear algebra to one thread in processes that load NumPy from now on.

    The matrix products of a run are small and many, so threads wait for each other longer than they
    compute. One thread also keeps the last bits of a sum independent of the number of processors.
    Environment variables that are already set stay unchanged.
    """
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def start_ahead(preload: str) -> None:
    """Start a fork server in the background. Worker processes of this process are its copies from now on.

    The server imports once what all workers need, so a copy is ready at once. Only commands use it: a process
    has a single fork server, whose imports are fixed when it starts. Programs that call functions of this
    toolkit keep theirs for their own purposes.

    Parameters
    ----------
    preload
        Name of the module that imports what the workers need.
    """
    from multiprocessing import forkserver, resource_tracker

    global _server_started
    if sys.platform != "linux":  # On other systems it is not safe to fork a process with these libraries.
        return
    one_blas_thread()
    forkserver.set_forkserver_preload([preload])
    with _signals_blocked():
        resource_tracker.ensure_running()  # First: it unblocks the signals again.
    with _signals_blocked():
        forkserver.ensure_running()
    _server_started = True


class Processes:
    """A number of processes that start with the first work, and start again after one of them has died.

    Parameters
    ----------
    count
        Number of processes.
    start
        Called in each process when it starts.
    *arguments
        Arguments of `start`.
    """

    def __init__(self, count: int, start: Callable[..., None], *arguments: Any) -> None:
        self.count, self._start, self._arguments = count, start, arguments
        self._pool: ProcessPoolExecutor | None = None
        self._started: set[BaseProcess] = set()

    def submit(
        self, work: Callable[Arguments, Result], *arguments: Arguments.args, **named: Arguments.kwargs
    ) -> Future[Result]:
        """Hand out work and return its future."""
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import active_children, get_context

        if self._pool is None:
            one_blas_thread()
            self._started = set()
            context: Any = get_context("forkserver" if _server_started else "spawn")
            if _server_started:  # After this idle first copy, the pool does not wait for the later ones.
                context.Process(target=int).start()
            self._pool = ProcessPoolExecutor(
                self.count, context, initializer=self._start, initargs=self._arguments
            )
        others = set(active_children())
        with _signals_blocked():
            future = self._pool.submit(work, *arguments, **named)
        self._started |= set(active_children()) - others
        return future

    def end(self) -> str:
        """End the processes and return what ended the first of them, such as ``SIGKILL`` or ``status 1``."""
        for process in self._started:
            process.terminate()
        self.close()
        return next((_ending_text(process.exitcode or 0) for process in self._started), "nothing")

    def close(self) -> None:
        """Wait for the processes to end."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.end()


def follow_parent() -> None:
    """Ignore interrupts in this worker process, and end it when its parent process ends.

    The terminal sends interrupts to the whole process group. Only the process with the open store or
    index may act on them.
    """
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Wait for the end of the parent. A run that is killed cannot end its workers itself."""
    from multiprocessing import parent_process
    from multiprocessing.connection import wait

    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """Block interrupts in processes that are started meanwhile, until they ignore them by themselves.

    Otherwise an interrupt during the start would end them with a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)


def _ending_text(code: int) -> str:
    names = {-one.value: one.name for one in signal.Signals}
    return names.get(code, f"status {code}")
