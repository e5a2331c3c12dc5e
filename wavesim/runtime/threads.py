"""Work on a large array in parts, by threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

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


def for_blocks(work: Callable[[int, int], Part], count: int, block: int) -> list[Part]:
    """What work gives for every block from a start to a stop, in order.

    Parameters
    ----------
    work
        Called with start and stop; must let go of Python's lock to gain from threads.
    count
        Where the last block stops.
    block
        Most between start and stop.
    """
    starts = range(0, count, block)

    def one_thread(first: int) -> list[Part]:
        return [work(start, min(start + block, count)) for start in starts[first::THREADS]]

    if len(starts) < 2:
        return one_thread(0)
    with ThreadPoolExecutor(THREADS) as pool:
        found = list(pool.map(one_thread, range(THREADS)))
    return [found[number % THREADS][number // THREADS] for number in range(len(starts))]


def rows_in(bytes_of_row: int, most_bytes: int = 2**19) -> int:
    """How many rows a block may have, so that it stays in a core's cache."""
    return max(1, most_bytes // bytes_of_row)
