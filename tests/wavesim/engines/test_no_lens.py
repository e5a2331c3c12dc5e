"""No lens: free space over the distance between both grids."""

from __future__ import annotations

import math

import numpy as np
import pytest
from engine_checks import dot_product_mismatch, engine_peak_bytes

from lensdesign import Lens
from lensdesign.errors import SamplingError
from wavesim.analytic.beam import Beam
from wavesim.engines.no_lens import NoLens
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.scene.scene import Scene

WAVELENGTH_UM = 0.532


@pytest.fixture(scope="module")
def scene(paper_lens: Lens) -> Scene:
    """Meridional, over 23.5 mm."""
    return Scene(
        paper_lens, Grid((400,), 1e-3, -paper_lens.object.working_distance_mm), Grid((2000,), 5e-4, 10.0),
        WAVELENGTH_UM,
    )  # fmt: skip


def noise(grid: Grid, seed: int) -> Field:
    rng = np.random.default_rng(seed)
    return Field(grid, rng.normal(size=grid.shape) + 1j * rng.normal(size=grid.shape), WAVELENGTH_UM)


def test_beam_spreads_as_in_free_space(scene: Scene) -> None:
    beam = Beam(WAVELENGTH_UM, 2e-3, scene.object_grid.z_mm)
    start = Field(
        scene.object_grid, beam.field(scene.object_grid.y_mm, scene.object_grid.z_mm), WAVELENGTH_UM
    )
    end = beam.field(scene.exit_grid.y_mm, scene.exit_grid.z_mm)
    assert relative_error(NoLens(scene).forward(start).values, end) < 1e-5


@pytest.mark.parametrize("shape", [(60,), (24, 30)])
def test_adjoint(paper_lens: Lens, shape: tuple[int, ...]) -> None:
    small = Scene(
        paper_lens, Grid(shape, 1e-3, -0.2), Grid(tuple(n + 6 for n in shape), 2e-3, 9.8), WAVELENGTH_UM
    )
    assert dot_product_mismatch(NoLens(small)) <= 1e-10


def test_says_that_the_lens_is_left_out(scene: Scene) -> None:
    (left_out,) = NoLens(scene).error_terms()
    assert "lens" in left_out.description
    assert math.isnan(left_out.relative_error)
    assert NoLens(scene).settings() == {}


def test_linear(scene: Scene) -> None:
    engine, a, b = NoLens(scene), noise(scene.object_grid, 3), noise(scene.object_grid, 4)
    both = engine.forward(a.with_values(2.0 * a.values + 1j * b.values)).values
    apart = 2.0 * engine.forward(a).values + 1j * engine.forward(b).values
    assert relative_error(both, apart) < 1e-12


@pytest.mark.parametrize("shape", [(4000,), (150, 160)])
def test_predicts_its_memory_and_time(paper_lens: Lens, shape: tuple[int, ...]) -> None:
    engine = NoLens(Scene(paper_lens, Grid(shape, 5e-4, -0.3), Grid(shape, 1e-3, 9.8), WAVELENGTH_UM))
    cost, field = engine.cost(), noise(engine.scene.object_grid, 5)
    engine.forward(field)
    peak = engine_peak_bytes(engine, field)
    assert cost.peak_bytes == pytest.approx(peak, rel=0.3)
    wide = tuple(16 * n for n in shape)
    wider = NoLens(Scene(paper_lens, Grid(wide, 5e-4, -0.3), Grid(wide, 1e-3, 9.8), WAVELENGTH_UM))
    # Held against the time that is taken by benchmarks.chooser.
    assert 0.0 < 2.0 * cost.seconds < wider.cost().seconds


def test_a_huge_plane_is_refused(paper_lens: Lens) -> None:
    grids = Grid((9000, 9000), 2.5e-4, -13.5), Grid((9000, 7000), 3.2e-3, 12.7)
    engine = NoLens(Scene(paper_lens, *grids, WAVELENGTH_UM))
    with pytest.raises(SamplingError, match=r"samples .*bytes.*force = True"):
        engine.forward(Field(grids[0], np.broadcast_to(1.0 + 0j, grids[0].shape), WAVELENGTH_UM))
