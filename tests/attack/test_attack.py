"""The benchmark of attack, a little of it with a seed of its own."""

from __future__ import annotations

import pytest

import benchmarks.attack as module
from benchmarks.attack import COUNTS, RUNS, attack

SEED = 7


# A run of each of these merits starts a process. For other ways out see test_python and test_run_faults.
FEW_WAYS = tuple(
    way for way in module.WAYS if any(word in way for word in ("HYPERLINK", "f(trial)", "print"))
)


@pytest.mark.parametrize("kind", [kind for kind in COUNTS if kind not in RUNS])
def test_what_is_attacked_is_refused_or_right(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WAYS", FEW_WAYS)
    least = len(FEW_WAYS) if kind == "hostile_merits" else max(COUNTS[kind] // 60, 15)
    tally = attack(kind, SEED, least)
    assert tally.tried == least
    assert tally.refused > 0
    assert not tally.wrong


def test_damaged_logs_lose_no_row_that_was_there_before() -> None:
    tally = attack("damaged_logs", SEED, 10)
    assert tally.tried == 10
    assert not tally.wrong
