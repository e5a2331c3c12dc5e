"""How wide tiles are cut."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from wavesim.engines.eikonal.plan import Probe, cut
from wavesim.fields.field import Grid


@pytest.mark.parametrize(
    ("side", "rank", "sought"), [(1, 32, 5), (2, 20, 5), (3, 8, 5), (3, 13, 8), (4, 8, 8)]
)
def test_many_tiles_take_more_terms_than_few(side: int, rank: int, sought: int) -> None:
    """Sixteen of five terms at most; beyond these it is rays that cost."""
    residual: Any = SimpleNamespace(rank_for=lambda error: rank)
    tiles = cut(Grid((40, 40), 1e-3, 0.0), (side, side))
    assert Probe((side, side), tiles, (0,), (residual,)).target_rank(0.01) == sought
