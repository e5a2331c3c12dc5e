"""Threads: how many share the work, and work on a large array in parts."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

Part = TypeVar("Part")

MOST_THREADS = 16
THREADS = min(
    MOST_THREADS, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
)
"""That share the work: one for each core that may be used."""

BLOCK = 1024
"""Rows that are worked on at one time: all of a whole field's, in double precision, would fill a memory."""


def row_blocks(count: int) -> Iterator[slice]:
    """Parts of a range of rows or columns, `BLOCK` of them at most in each."""
    return (slice(start, min(start + BLOCK, count)) for start in range(0, count, BLOCK))


def for_blocks(
    work: Callable[[int, int], Part], count: int, block: int, most_threads: int = THREADS
) -> list[Part]:
    """What work gives for every block from a start to a stop, in order.

    Parameters
    ----------
    work
        Called with start and stop; must let go of Python's lock to gain from threads.
    count
        Where the last block stops.
    block
        Most between start and stop.
    most_threads
        That share the work.
    """
    starts = range(0, count, block)
    found: list[Any] = [None] * len(starts)
    left = iter(enumerate(starts))  # the next goes to whoever is free: cores are not all as fast

    def one_thread(_: int) -> None:
        try:
            for number, start in left:
                found[number] = work(start, min(start + block, count))
        finally:  # where one failed, none begins another
            deque(left, 0)

    _each(one_thread, max(1, min(most_threads, len(starts))))
    return found


def _each(work: Callable[[int], Part], threads: int) -> list[Part]:
    """What work gives for every number from 0 on, each in a thread; the first in this one."""
    if threading.current_thread().name.startswith(_KEPT):  # no thread waits for others of its own pool
        return [work(number) for number in range(threads)]
    running = [_pool(threads - 1).submit(work, number) for number in range(1, threads)]
    try:
        return [work(0), *(one.result() for one in running)]
    finally:  # what is amiss in one must not be told while others still write
        wait(running)


_KEPT = "transferlens-share"


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Threads that are kept: to start them takes longer than the work on a small array."""
    return ThreadPoolExecutor(threads, _KEPT)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)


def rows_in(bytes_of_row: int, most_bytes: int = 2**19) -> int:
    """How many rows a block may have, so that it stays in a core's cache."""
    return max(1, most_bytes // bytes_of_row)


def share(work: Callable[[int, int], None], count: int, threads: int = THREADS) -> None:
    """Do even parts of a range, from a start to a stop, in threads; the first part in this one."""
    parts = list(pairwise(np.linspace(0, count, threads + 1).astype(int)))
    _each(lambda number: work(*parts[number]), threads)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS and LAPACK to one thread, where linear algebra comes in many small parts.

    Its threads would wait for each other longer than they work, and where other processes run beside they
    would wait ten times as long as the work takes. Fourier transforms and compiled loops keep theirs.
    """
    with _controller().limit(limits=1, user_api="blas"):
        yield


@cache
def _controller() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
