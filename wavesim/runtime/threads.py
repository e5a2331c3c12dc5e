"""Threads: their number, and processing of large arrays in blocks."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

Result = TypeVar("Result")

THREADS = min(16, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
"""Number of threads: one for each core that the process may use, at most 16."""

BLOCK = 1024
"""Rows that are processed at a time, since a whole field in double precision might not fit into memory."""


def row_blocks(count: int) -> Iterator[slice]:
    """Return blocks of a range of rows or columns, of at most `BLOCK` each."""
    return (slice(start, min(start + BLOCK, count)) for start in range(0, count, BLOCK))


def for_blocks(
    work: Callable[[int, int], Result], count: int, block: int, most_threads: int = THREADS
) -> list[Result]:
    """Return the results of a function for all blocks of a range, in order.

    Parameters
    ----------
    work
        Function of start and stop. It gains from threads only if it releases Python's lock.
    count
        End of the range.
    block
        Size of a block.
    most_threads
        Most threads.
    """
    starts = range(0, count, block)
    found: list[Any] = [None] * len(starts)
    remaining = iter(enumerate(starts))  # the next block goes to a free thread, since cores differ in speed

    def one_thread() -> None:
        try:
            for number, start in remaining:
                found[number] = work(start, min(start + block, count))
        finally:  # after a failure no thread starts another block
            deque(remaining, 0)

    _in_threads(one_thread, max(1, min(most_threads, len(starts))))
    return found


def _in_threads(work: Callable[[], None], threads: int) -> None:
    """Call a function in this thread and in others; each call takes blocks until none remain."""
    if threading.current_thread().name.startswith(_KEPT):  # a thread must not wait for others of its own pool
        work()
        return
    # Busy threads are late to take cancelled tasks from their queue, and to let go of ended ones. Tasks share
    # a list that gives up the work, and with it the arrays on which it works.
    given = [work]

    def work_if_given() -> None:
        for one in given:
            one()

    running = [_pool(threads - 1).submit(work_if_given) for _ in range(threads - 1)]
    try:
        work()
    finally:
        # Tasks that no thread has started are cancelled, because nothing is left for them. Others must end
        # before an exception reaches the caller, because they still write.
        started = [one for one in running if not one.cancel()]
        wait(started)
        given.clear()
    for one in started:
        one.result()


_KEPT = "transferlens-share"


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Return a pool of threads that is kept, since starting threads takes longer than small arrays need."""
    return ThreadPoolExecutor(threads, _KEPT)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)


def at_once(works: Sequence[Callable[[], Result]]) -> list[Result]:
    """Return the results of functions, each called in a thread.

    Threads within one transform would take several times its work where other processes run on the machine.
    """
    return for_blocks(lambda index, _: works[index](), len(works), 1)


def rows_in(bytes_of_row: int, most_bytes: int = 2**19) -> int:
    """Return the number of rows of a block that fits into a core's cache."""
    return max(1, most_bytes // bytes_of_row)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS and LAPACK to one thread, for linear algebra in many small parts.

    Their threads would wait for each other longer than they work, and ten times as long where other processes
    run. Fourier transforms and compiled loops keep their threads.
    """
    with _controller().limit(limits=1, user_api="blas"):
        yield


@cache
def _controller() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
