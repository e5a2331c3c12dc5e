"""Windows of surfaces, their plane waves, and the way of a field from one to the next."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import Lens, scaled
from lensdesign.errors import SamplingError
from wavesim.engines.slices.windows import Waves, arriving, surface_grids, transferred
from wavesim.engines.surfaces.grids import light_extent
from wavesim.engines.surfaces.waves import Medium
from wavesim.fields.field import Grid, relative_error
from wavesim.scene.patches import patch_scene
from wavesim.scene.scene import Scene

WAVELENGTH_UM = 0.5
BAND_PER_MM = 0.2 * 2e3 * math.pi / WAVELENGTH_UM


def waves(shape: tuple[int, ...], pitch_mm: float = 1e-3) -> Waves:
    middle = (0.0, 0.01) if len(shape) == 1 else (-0.02, 0.01)
    return Waves(Medium(Grid(shape, pitch_mm, 0.0, middle), WAVELENGTH_UM, 1.0, BAND_PER_MM))


def beam(grid: Grid, width_mm: float = 0.006) -> np.ndarray:
    """Narrow in space and in direction, beside the middle."""
    r2 = (grid.y_mm - 0.013) ** 2
    if not grid.is_line:
        r2 = r2[:, None] + (grid.x_mm + 0.024) ** 2
    tilt = grid.y_mm if grid.is_line else grid.y_mm[:, None] - 0.5 * grid.x_mm
    return np.asarray(np.exp(-0.5 * r2 / width_mm**2 + 0.3j * BAND_PER_MM * tilt))


@given(
    count=st.integers(90, 140),
    other=st.integers(80, 150),
    pitch=st.floats(0.8e-3, 1.2e-3),
    line=st.booleans(),
)
def test_a_field_goes_from_window_to_window(count: int, other: int, pitch: float, line: bool) -> None:
    """What lies in both stays what it is, at any samples."""
    sides = 1 if line else 2
    source, target = waves((count,) * sides), waves((other,) * sides, pitch)
    there = Grid((31,) * sides, 1.3e-3, 0.0, source.grid.centre_mm)
    spectrum = source.analyze(beam(source.grid), source.grid, source.orders)
    assert relative_error(source.synthesize(spectrum, there, source.orders), beam(there)) < 1e-3
    moved = transferred(spectrum, source, target)
    assert moved.shape == target.shape
    assert relative_error(target.synthesize(moved, there, target.orders), beam(there)) < 1e-3


@pytest.mark.parametrize("sides", [1, 2])
@pytest.mark.parametrize(("kind", "same"), [(complex, 1e-12), (np.complex64, 1e-5)])
def test_handing_over_backwards_is_the_adjoint(sides: int, kind: Any, same: float) -> None:
    source, target = waves((70,) * sides), waves((64,) * sides, 1.4e-3)
    rng = np.random.default_rng(sides)
    u, v = ((rng.normal(size=w.shape) + 1j * rng.normal(size=w.shape)).astype(kind) for w in (source, target))
    there = np.vdot(v, transferred(u, source, target)) / target.area
    back = np.vdot(transferred(v, target, source), u) / source.area
    assert there == pytest.approx(back, rel=same)


def test_sums_are_those_written_out() -> None:
    window = waves((40, 44))
    grid = Grid((5, 6), 3e-3, 0.0, (-0.025, 0.017))
    values = np.random.default_rng(3).normal(size=grid.shape) + 0j
    y0, x0 = window.grid.y_mm[0], window.grid.x_mm[0]
    sides = [2.0 * half for half in window.grid.half_widths_mm]
    down, across = (np.arange(-m, m + 1) / side for m, side in zip(window.orders, sides, strict=True))
    along_y = np.exp(-2j * np.pi * np.outer(down, grid.y_mm - y0))
    along_x = np.exp(-2j * np.pi * np.outer(grid.x_mm - x0, across))
    known = grid.cell * along_y @ values @ along_x
    found = window.analyze(values, grid, window.orders)
    assert found == pytest.approx(known, abs=1e-12 * np.abs(known).max())
    back = along_y.conj().T @ known @ along_x.conj().T / window.area
    assert window.synthesize(known, grid, window.orders) == pytest.approx(
        back, abs=1e-12 * np.abs(back).max()
    )


@pytest.fixture(scope="module")
def scene(paper_lens: Lens) -> Scene:
    """A small twin of the paper's lens."""
    return patch_scene(scaled(paper_lens, 1.0 / 50.0), 0.02, plane_distance_mm=0.04)


def test_every_surface_has_a_window_of_its_own(scene: Scene) -> None:
    light = light_extent(scene)
    grids = surface_grids(scene, light)
    assert grids[0].half_widths_mm[0] < grids[1].half_widths_mm[0]
    assert grids[0].pitch_mm < 0.9 * grids[1].pitch_mm
    for grid, reach in zip(grids, light.reach_mm, strict=True):
        assert grid.half_widths_mm[0] > reach
    finer, other = surface_grids(scene, light, 2e-4, 0.3)
    assert finer == other
    assert finer.pitch_mm == 2e-4
    assert finer.half_widths_mm[0] >= 0.3


def test_windows_keep_copies_from_both_ends(scene: Scene) -> None:
    """A far exit plane asks for a wider window of the last surface, a wide object for one of the first."""
    light = light_extent(scene)
    near = surface_grids(scene, light)
    far = Scene(scene.lens, scene.object_grid, scene.exit_grid.at(3.0), scene.wavelength_um)
    grids = surface_grids(far, light)
    assert grids[0] == near[0]
    assert grids[1].half_widths_mm[0] > 1.2 * near[1].half_widths_mm[0]
    with pytest.raises(SamplingError, match=r"half_width_mm = .*too narrow"):
        surface_grids(far, light, None, near[1].half_widths_mm[0])


def test_light_that_meets_the_lens_arrives_whole(scene: Scene) -> None:
    light = light_extent(scene)
    let = arriving(scene, light)
    leg = light.heights_mm[0][0] - scene.object_grid.z_mm
    assert let.passed_mm > light.reach_mm[0]
    assert let.passed_mm < let.stopped_mm <= leg * light.tangents[0] * (1.0 + 1e-9)
