"""The benchmark of attack, a little of it with a seed of its own."""

from __future__ import annotations

import pytest

from benchmarks.attack import COUNTS, RUNS, attack

SEED = 7


@pytest.mark.parametrize("kind", [kind for kind in COUNTS if kind not in RUNS])
def test_what_is_attacked_is_refused_or_right(kind: str) -> None:
    tally = attack(kind, SEED, max(COUNTS[kind] // 60, 15))
    assert tally.tried >= 15
    assert tally.refused > 0
    assert not tally.wrong


def test_damaged_logs_lose_no_row_that_was_there_before() -> None:
    tally = attack("damaged_logs", SEED, 10)
    assert tally.tried == 10
    assert not tally.wrong
