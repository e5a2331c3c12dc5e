"""Memory that is left, and the check of predicted arrays against it."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from lensdesign import InputError
from lensdesign.common import memory
from lensdesign.common.memory import MemoryLimitError, available_bytes, check_memory


def test_a_container_has_what_it_was_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limit, used = tmp_path / "max", tmp_path / "current"
    monkeypatch.setattr(memory, "CGROUPS", ((str(limit), str(used)),))
    monkeypatch.setattr(memory, "_machine_bytes", lambda: 8_000_000_000)
    assert available_bytes() == 8e9
    limit.write_text("max\n")
    used.write_text("5\n")
    assert available_bytes() == 8e9
    limit.write_text("3000000000\n")
    used.write_text("1000000000\n")
    assert available_bytes() == 2e9


def test_arrays_beyond_what_is_free_are_refused_with_both_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda: 10e9)
    check_memory(8e9, "a grid", "take fewer samples")
    with pytest.raises(MemoryLimitError, match=r"8\.1 GB.* 8 GB"):
        check_memory(8.1e9, "a grid", "take fewer samples")
    assert issubclass(MemoryLimitError, InputError)


def test_a_size_that_is_no_number_is_refused() -> None:
    for size in (math.inf, math.nan):
        with pytest.raises(MemoryLimitError):
            check_memory(size, "a grid", "take fewer samples")
    with pytest.raises(MemoryLimitError):
        check_memory(2.0, "a grid", "take fewer samples", limit_bytes=1.0)
