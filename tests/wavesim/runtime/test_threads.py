"""Work in parts, by threads."""

from __future__ import annotations

import os
import threading
import time
import weakref

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wavesim.runtime import threads
from wavesim.runtime.threads import for_blocks, rows_in


@given(st.integers(0, 50), st.integers(1, 20), st.integers(1, 4))
def test_blocks_cover_all_in_order(count: int, block: int, threads: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("wavesim.runtime.threads.THREADS", threads)
        found = for_blocks(lambda start, stop: (start, stop), count, block)
    assert [k for start, stop in found for k in range(start, stop)] == list(range(count))
    assert all(stop - start <= block for start, stop in found)


@pytest.mark.parametrize("wrong", range(10))
def test_what_goes_wrong_in_a_thread_is_told_when_all_have_ended(
    monkeypatch: pytest.MonkeyPatch, wrong: int
) -> None:
    monkeypatch.setattr(threads, "THREADS", 3)
    running = []

    def work(start: int, _: int) -> None:
        running.append(start)
        time.sleep(1e-3)
        running.remove(start)
        if start == wrong:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        for_blocks(work, 10, 1)
    assert not running


def test_after_a_failure_no_block_begins() -> None:
    failed, late = threading.Event(), []

    def work(start: int, _: int) -> None:
        if start == 0:
            failed.set()
            raise ZeroDivisionError
        failed.wait(10.0)
        time.sleep(0.05)  # the other thread says so meanwhile
        late.append(start)

    with pytest.raises(ZeroDivisionError):
        for_blocks(work, 100, 1, 2)
    assert len(late) <= 1


def test_a_slow_block_keeps_only_one_thread() -> None:
    others = threading.Semaphore(0)

    def work(start: int, _: int) -> None:
        if start == 0:
            assert all(others.acquire(timeout=10.0) for _ in range(9))
        else:
            others.release()

    for_blocks(work, 10, 1, 2)


def test_work_in_a_thread_may_share_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "THREADS", 3)
    found = for_blocks(lambda a, _: for_blocks(lambda c, _: (a, c), 4, 1), 4, 1)
    assert found == [[(a, c) for c in range(4)] for a in range(4)]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that are forked")
def test_a_forked_process_has_threads_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "THREADS", 2)
    for_blocks(lambda a, _: a, 4, 1)
    child = os.fork()
    if child == 0:
        os._exit(0 if for_blocks(lambda a, _: a, 4, 1) == [0, 1, 2, 3] else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_a_block_has_a_row_at_least() -> None:
    assert rows_in(10**9) == 1
    assert rows_in(1000, 10_000) == 10


def test_work_of_the_calling_thread_does_not_wait_for_other_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "THREADS", 2)
    caller, done = threading.current_thread(), threading.Event()

    def work(start: int, _: int) -> None:
        if threading.current_thread() is caller:
            for_blocks(lambda a, _: a, 4, 1, 2)  # while the other thread works, and waits for this one
            done.set()
        else:
            assert done.wait(10.0)

    for_blocks(work, 2, 1, 2)


def test_arrays_of_ended_work_are_released_while_other_threads_are_busy() -> None:
    started, may_end = threading.Semaphore(0), threading.Event()

    def occupy(_: int, __: int) -> None:
        started.release()
        assert may_end.wait(10.0)

    other = threading.Thread(target=lambda: for_blocks(occupy, 2, 1, 2))  # itself, and the thread of the pool
    other.start()
    assert all(started.acquire(timeout=10.0) for _ in range(2))
    array = np.zeros(8)
    released = weakref.ref(array)

    def fill(start: int, stop: int, array: np.ndarray = array) -> None:
        array[start:stop] = 1.0

    for_blocks(fill, 8, 1, 2)
    del array, fill
    is_released = released() is None
    may_end.set()
    other.join()
    assert is_released
