"""What a run may take, and what is said of it."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from lensdesign.errors import InputError
from wavesim.runtime.memory import Memory, MemoryLimitError, MemoryNeed, available_bytes, memory_limit

NEED = MemoryNeed(most_bytes=9_000_000_000, least_bytes=3_000_000_000, file_bytes=1_000_000_000)


def test_a_limit_is_what_was_given_or_a_share_of_what_is_free() -> None:
    assert memory_limit(2.5) == 2.5e9
    assert 0.0 < memory_limit(None) < available_bytes()
    for wrong in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="--memory-gb"):
            memory_limit(wrong)


def test_arrays_are_moved_where_they_must_be() -> None:
    assert Memory(NEED, 10e9).room_for_arrays("it") == math.inf
    assert Memory(NEED, 5e9).room_for_arrays("it") == 2e9
    with pytest.raises(MemoryLimitError, match=r"it needs at least 3 GB .*allowed: 2\.5 GB.* --memory-gb 3"):
        Memory(NEED, 2.5e9).room_for_arrays("it")


def test_the_estimate_names_memory_and_files() -> None:
    place = Path("results")
    assert Memory(NEED, 20e9).line(place) == (
        "memory: about 9 GB of 20 GB allowed, 1 GB in files under results"
    )
    assert Memory(NEED, 5e9).line(place) == "memory: about 5 GB of 5 GB allowed, 5 GB in files under results"
    assert (
        Memory(MemoryNeed(10_000_000, 10_000_000), 5e9).line(place) == "memory: about 0.01 GB of 5 GB allowed"
    )
