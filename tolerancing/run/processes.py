"""Processes that do what they are handed, started anew, or as copies of a server that was started ahead.

Imports nothing heavy: what is started first comes first.
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

from tolerancing.run.threads import one_blas_thread

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing.process import BaseProcess

Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")

PRELOADED = "tolerancing.run.preloaded"

_ahead = False


def start_ahead() -> None:
    """Start, beside what goes on here, a server whose copies the processes of this one are from now on.

    It imports once what they need, and a copy is there at once. For commands: a process has but one
    such server, as it was when it started, so programs that run a study themselves are left theirs.
    """
    from multiprocessing import forkserver, resource_tracker

    global _ahead
    if sys.platform != "linux":  # elsewhere copies of a process with such libraries are not safe
        return
    one_blas_thread()
    forkserver.set_forkserver_preload([PRELOADED])
    with _not_heard():
        resource_tracker.ensure_running()  # first, since it lets signals through again
    with _not_heard():
        forkserver.ensure_running()
    _ahead = True


class Processes:
    """Some processes, started when there is work, and started anew after one of them has died."""

    def __init__(self, number: int, start: Callable[..., None], *arguments: Any) -> None:
        self.number, self._start, self._arguments = number, start, arguments
        self._pool: ProcessPoolExecutor | None = None
        self._started: set[BaseProcess] = set()

    def submit(
        self, work: Callable[Arguments, Result], *arguments: Arguments.args, **named: Arguments.kwargs
    ) -> Future[Result]:
        """Hand out work."""
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import active_children, get_context

        if self._pool is None:
            one_blas_thread()
            self._started = set()
            context: Any = get_context("forkserver" if _ahead else "spawn")
            if _ahead:  # a copy that does nothing: with it there, none of the others is waited for in vain
                context.Process(target=int).start()
            self._pool = ProcessPoolExecutor(
                self.number, context, initializer=self._start, initargs=self._arguments
            )
        others = set(active_children())
        with _not_heard():
            future = self._pool.submit(work, *arguments, **named)
        self._started |= set(active_children()) - others
        return future

    def end(self) -> str:
        """End the processes; what ended the first of them, which may have died by itself."""
        for process in self._started:
            process.terminate()
        self.close()
        return next((_end_of(process.exitcode or 0) for process in self._started), "nothing")

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
    """Leave signals to the process that started this one, and end with it."""
    # They go to the whole group; only the process that holds the store may act on them.
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A run that is killed cannot end its workers; they would wait for tasks for ever."""
    from multiprocessing import parent_process
    from multiprocessing.connection import wait

    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def _not_heard() -> Iterator[None]:
    """Keep signals to stop, which go to the whole group, from processes that are started meanwhile.

    They would end with a traceback before they can leave them to the process that started them.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_of(code: int) -> str:
    names = {-number.value: number.name for number in signal.Signals}
    return names.get(code, f"status {code}")
