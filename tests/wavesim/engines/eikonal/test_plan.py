"""How wide tiles are cut."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from lensdesign import Lens
from wavesim.engines.eikonal.plan import Probe, cut, hierarchy_is_cheaper
from wavesim.fields.field import Grid
from wavesim.scene.scene import Scene


@pytest.mark.parametrize(
    ("side", "rank", "sought"), [(1, 32, 5), (2, 20, 5), (3, 8, 5), (3, 13, 8), (4, 8, 8)]
)
def test_many_tiles_take_more_terms_than_few(side: int, rank: int, sought: int) -> None:
    """Sixteen of five terms at most; beyond these it is rays that cost."""
    residual: Any = SimpleNamespace(rank_for=lambda error: rank)
    tiles = cut(Grid((40, 40), 1e-3, 0.0), (side, side))
    assert Probe((side, side), tiles, (0,), (residual,)).target_rank(0.01) == sought


@pytest.mark.parametrize(
    ("width_mm", "pixels", "cheaper"),
    [(0.1, 7000, False), (0.6, 7000, False), (0.8, 7000, True), (1.9, 300, False), (2.1, 300, True)],
)
def test_a_hierarchy_is_for_many_tiles_or_much_memory(
    paper_lens: Lens, width_mm: float, pixels: int, cheaper: bool
) -> None:
    samples = round(width_mm / 0.4e-3)
    grids = Grid((samples, samples), 0.4e-3, -13.5), Grid((pixels, pixels), 20.0 / pixels, 12.7)
    assert hierarchy_is_cheaper(Scene(paper_lens, *grids, 0.532)) is cheaper
    line = Grid((samples,), 0.4e-3, -13.5), Grid((pixels,), 20.0 / pixels, 12.7)
    assert not hierarchy_is_cheaper(Scene(paper_lens, *line, 0.532))
