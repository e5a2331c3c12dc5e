"""Soft edges of tiles of a whole field: the integral in closed form, and points whose own edge is drawn."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lensdesign import Lens, scaled
from wavesim.engines.eikonal.edge import SOFT, missed
from wavesim.engines.eikonal.engine import FlatTiles, HierarchicalTiles
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.scene.scene import Scene


def test_a_sharp_edge_misses_what_fresnel_integrals_hold() -> None:
    assert missed(0.0, 0.0) == pytest.approx(1.0 / math.sqrt(2.0 * math.pi), rel=2e-3)


@pytest.mark.parametrize("moved", [0.0, 0.35, 0.7])
def test_the_width_is_the_best(moved: float) -> None:
    assert missed(SOFT, moved) < 0.75 * missed(0.0, moved)
    assert all(missed(SOFT, moved) < missed(f * SOFT, moved) for f in (0.7, 1.3))


def test_points_of_a_tile_err_by_what_is_told(paper_lens: Lens) -> None:
    """Each held against a tile of its own, whose edge is drawn; a one-sixteenth twin."""
    lens = scaled(paper_lens, 1 / 16)
    # Fine enough for light of all directions that the lens takes, and beyond.
    start = Grid((105, 105), 0.3e-3, lens.object_z_mm)
    scene = Scene(lens, start, Grid((280, 280), 4.4e-3, lens.exit_vertex_z_mm + 2 / 16), 0.532)
    engine = HierarchicalTiles(scene)
    errors = []
    for place in ((52, 52), (75, 33), (8, 83)):
        own = Grid((3, 3), start.pitch_mm, start.z_mm, (start.x_mm[place[1]], start.y_mm[place[0]]))
        alone = FlatTiles(replace(scene, object_grid=own), tile_width_mm=start.pitch_mm)
        values = np.zeros(start.shape, complex)
        values[place] = 1.0
        middle = np.zeros(own.shape, complex)
        middle[1, 1] = 1.0
        expected = alone.forward(Field(own, middle, 0.532)).values
        errors.append(relative_error(engine.forward(Field(start, values, 0.532)).values, expected))
    predicted = max(part.relative_error for part in engine.error_terms())
    assert 0.7 * predicted < math.sqrt(np.mean(np.square(errors))) < 1.1 * predicted
    assert max(errors) < engine.predicted_error() < 3.0 * max(errors)
