"""Arrays in memory up to a limit, and in files beyond it."""

from __future__ import annotations

import errno
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.runtime import scratch
from wavesim.runtime.scratch import Scratch


def test_arrays_lie_in_memory_until_they_are_too_many(tmp_path: Path) -> None:
    room = Scratch(tmp_path, 100_000)
    first = room.array((100, 100), np.float64)
    assert (room.bytes_in_memory, room.bytes_in_files) == (80_000, 0)
    second = room.array((50, 100), np.complex64)
    assert (room.bytes_in_memory, room.bytes_in_files) == (80_000, 40_000)
    for array in (first, second):
        assert not array.any()
        array += 1.0
        np.testing.assert_array_equal(array, 1.0)
    assert list(tmp_path.iterdir()) == []


def test_room_comes_back_with_the_last_view_on_an_array(tmp_path: Path) -> None:
    room = Scratch(tmp_path, 1000)
    array = room.array((125,), np.float64)
    view = array[10:20]
    del array
    assert room.bytes_in_memory == 1000
    in_file = room.array((125,), np.float64)
    del view
    assert (room.bytes_in_memory, room.bytes_in_files) == (0, 1000)
    del in_file
    assert (room.bytes_in_memory, room.bytes_in_files) == (0, 0)


def test_what_lies_in_files_takes_no_memory(tmp_path: Path) -> None:
    values = np.random.default_rng(1).random((500, 400))
    room = Scratch(tmp_path, 0.0)
    tracemalloc.start()
    try:
        moved = room.moved(values)
        assert tracemalloc.get_traced_memory()[1] < 0.1 * values.nbytes
    finally:
        tracemalloc.stop()
    assert not np.shares_memory(moved, values)
    np.testing.assert_array_equal(moved, values)


def test_without_a_folder_all_lie_in_memory() -> None:
    room = Scratch()
    room.array((1000,), np.float64).fill(1.0)
    kept = room.array((3, 0), np.float64), room.array((1000,), np.float64)
    assert kept[0].shape == (3, 0)
    assert (room.bytes_in_memory, room.bytes_in_files) == (8000, 0)


def test_a_full_disk_is_told_before_anything_is_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def full(handle: int, offset: int, size: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    room = Scratch(tmp_path, 0.0)
    with pytest.raises(InputError, match=r"0\.02 GB.*\d+ MB are free"):
        room.array((1000, 2500), np.complex64, "the last step")
    assert list(tmp_path.iterdir()) == []
    assert (room.bytes_in_memory, room.bytes_in_files) == (0, 0)


def test_files_whose_room_cannot_be_reserved_are_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delattr(os, "posix_fallocate")
    monkeypatch.setattr(scratch, "WRITTEN", 4096)
    array = Scratch(tmp_path, 0.0).array((1001,), np.float64)
    assert not array.any()
    array[:] = 2.0
    assert array.sum() == 2002.0


def test_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing.*weights"):
        Scratch(tmp_path / "missing", 0.0).array((10,), np.float64, "weights")
    for limit in (-1.0, float("nan")):
        with pytest.raises(InputError, match=f"memory_bytes = {limit}: must be 0 or more"):
            Scratch(tmp_path, limit)
    with pytest.raises(InputError, match=r"memory_bytes = 10: .*folder"):
        Scratch(None, 10.0)
