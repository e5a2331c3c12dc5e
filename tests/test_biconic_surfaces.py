"""Engines against each other on a lens that focuses differently along x and y."""

from __future__ import annotations

import pytest
from small_twins import small_spot, stopped_down

from lensdesign.errors import InputError
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.engines.slices.engine import AnnularSlices
from wavesim.engines.thin_lens import ThinLens
from wavesim.fields.field import correlation, relative_error
from wavesim.scene.scene import Scene

pytestmark = pytest.mark.filterwarnings("ignore::wavesim.fields.sampling_checks.SamplingWarning")


def small_scene(radius_x_mm: float) -> Scene:
    """A stopped-down lens with a front of another radius along x."""
    return stopped_down(front={"shape_type": "biconic", "radius_x_mm": radius_x_mm})


def test_tiles_and_slices_agree() -> None:
    """Exit fields change by more than half with the radius along x, and in the same way for both."""
    round_, flat = small_scene(42.3 / 8), small_scene(1.2)
    source = small_spot(round_.object_grid)
    tiles = [FlatTiles(scene, error=0.02).forward(source).values for scene in (round_, flat)]
    slices = [AnnularSlices(scene, 8, "oblique").forward(source).values for scene in (round_, flat)]
    assert relative_error(tiles[1], tiles[0]) > 0.5
    for mine, theirs in zip(tiles, slices, strict=True):
        assert correlation(mine, theirs) > 0.9995


def test_a_thin_lens_refuses_it() -> None:
    with pytest.raises(InputError, match="not rotationally symmetric"):
        ThinLens(small_scene(1.2)).forward(small_spot(small_scene(1.2).object_grid))
