"""Work in parts, by threads."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wavesim.runtime.threads import for_blocks, rows_in


@given(st.integers(0, 50), st.integers(1, 20))
def test_blocks_cover_all_in_order(count: int, block: int) -> None:
    found = for_blocks(lambda start, stop: (start, stop), count, block)
    assert [k for start, stop in found for k in range(start, stop)] == list(range(count))
    assert all(stop - start <= block for start, stop in found)


def test_what_goes_wrong_in_a_thread_is_told() -> None:
    with pytest.raises(ZeroDivisionError):
        for_blocks(lambda start, _: 1 // (start - 3), 10, 1)


def test_a_block_has_a_row_at_least() -> None:
    assert rows_in(10**9) == 1
    assert rows_in(1000, 10_000) == 10
