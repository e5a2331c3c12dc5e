"""Tiles of a whole field in two levels, against tiles in one level; the maps they stand on."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from engine_checks import engine_peak_bytes
from numpy.typing import NDArray

from lensdesign import Lens, Pose, scaled
from lensdesign.errors import InputError
from lensdesign.lens.poses import SurfacePerturbation
from wavesim.engines.eikonal import cost, executors, ray_maps
from wavesim.engines.eikonal.engine import FlatTiles, HierarchicalTiles
from wavesim.engines.eikonal.ray_maps import maps_over_object, region_of_object
from wavesim.engines.eikonal.super_tiles import ObjectTile
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.rays.maps import RayMapError
from wavesim.rays.ray_bundles import FoldError
from wavesim.scene.scene import Scene

WAVELENGTH_UM = 0.532
POSE = Pose(tilt_x_deg=0.4, decenter_x_mm=0.05, tilt_y_deg=0.2)


def plane_scene(
    lens: Lens, centre: tuple[float, float] = (0.0, 0.0), samples: int = 220, **changes: Any
) -> Scene:
    """A patch of 0.11 mm, on a plane of which every twentieth pixel or so is looked at."""
    ends = Grid((samples, samples + 20), 0.5e-3, -13.5, centre), Grid((290, 300), 0.065, 12.7)
    return Scene(lens, *ends, WAVELENGTH_UM, **changes)


def noise(grid: Grid, seed: int = 1) -> Field:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=grid.shape) + 1j * rng.normal(size=grid.shape)
    return Field(grid, values.astype(np.complex64), WAVELENGTH_UM)


@pytest.fixture(scope="module", autouse=True)
def two_threads() -> Iterator[None]:
    """Whatever number of cores there is."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (cost, executors):
            patch.setattr(module, "THREADS", 2)
        yield


@pytest.fixture(scope="module")
def displaced(paper_lens: Lens) -> HierarchicalTiles:
    """Through a lens that is displaced, perturbed and bare."""
    changes = {1: SurfacePerturbation(tilt_x_deg=0.2, radius_mm=0.05)}
    scene = plane_scene(paper_lens, (-0.4, 0.3), pose=POSE, coating="bare", surface_perturbations=changes)
    return HierarchicalTiles(scene, error=1e-2, tiles_across=2, tile_width_mm=0.03)


def assert_agrees_with_one_level(engine: HierarchicalTiles, error: float) -> None:
    scene = engine.scene
    field = noise(scene.object_grid)
    one = FlatTiles(scene, error=1e-3, tile_width_mm=0.06).forward(
        Field(scene.object_grid, field.values.astype(complex), WAVELENGTH_UM)
    )
    # The rim, drawn soft in one and sharp in the other, is left out.
    y, x = scene.exit_grid.y_mm, scene.exit_grid.x_mm
    bright = np.abs(one.values) > 0.0
    middle = np.array([np.mean(np.nonzero(bright)[i]) for i in (0, 1)])
    rows, columns = np.indices(bright.shape)
    inside = np.hypot(rows - middle[0], columns - middle[1]) * (y[1] - y[0]) < 8.3
    assert x[1] - x[0] == pytest.approx(y[1] - y[0])
    two = engine.forward(field)
    assert relative_error(two.values[inside], one.values[inside]) < error
    assert relative_error(two.values, one.values) < engine.predicted_error()


def test_two_levels_give_what_one_level_gives(paper_lens: Lens) -> None:
    scene = plane_scene(paper_lens, (0.2, 1.2), samples=140)
    assert_agrees_with_one_level(
        HierarchicalTiles(scene, error=1e-3, tiles_across=2, tile_width_mm=0.03), 1e-3
    )


def test_displaced_and_perturbed_lenses_are_followed(displaced: HierarchicalTiles) -> None:
    assert_agrees_with_one_level(displaced, 1e-2)


def test_adjoint_is_the_conjugate_transpose(displaced: HierarchicalTiles) -> None:
    scene = displaced.scene
    here, there = noise(scene.object_grid, 1), noise(scene.exit_grid, 2)
    out = displaced.forward(here).values.astype(complex)
    back = displaced.adjoint(there).values.astype(complex)
    left = np.vdot(there.values.astype(complex), out) * scene.exit_grid.cell
    right = np.vdot(back, here.values.astype(complex)) * scene.object_grid.cell
    size = np.linalg.norm(out) * np.linalg.norm(there.values) * scene.exit_grid.cell
    assert abs(left - right) < 1e-6 * size


@pytest.fixture(scope="module")
def small_field(paper_lens: Lens) -> HierarchicalTiles:
    """All of the field of a twin, and corners beyond it."""
    twin = scaled(paper_lens, 1.0 / 16.0)
    grid = Grid((400, 400), 0.5e-3, twin.object_z_mm)
    return HierarchicalTiles(
        Scene(twin, grid, Grid((500, 500), 3.0e-3, twin.sensor_z_mm[0]), WAVELENGTH_UM), error=3e-2
    )


def test_light_beyond_the_field_is_left_out(small_field: HierarchicalTiles) -> None:
    grid, radius = small_field.scene.object_grid, small_field.scene.lens.half_field_mm
    outside = grid.radius_squared_mm2() > radius**2
    field = noise(grid)
    whole = small_field.forward(field).values
    field.values[outside] = 0.0
    assert np.array_equal(small_field.forward(field).values, whole)
    back = small_field.adjoint(noise(small_field.scene.exit_grid)).values
    assert np.all(back[outside] == 0.0)
    assert np.all(back[~outside] != 0.0)


def test_a_field_in_focus_comes_back(small_field: HierarchicalTiles) -> None:
    """Nearly unitary: what the aperture takes in comes back."""
    grid = small_field.scene.object_grid
    radius = np.sqrt(grid.radius_squared_mm2())
    smooth = np.exp(-((radius / 0.05) ** 2)) * (1.0 + np.cos(2.0 * np.pi * 200.0 * grid.x_mm))
    back = small_field.adjoint(small_field.forward(Field(grid, smooth.astype(np.complex64), WAVELENGTH_UM)))
    assert relative_error(back.values, smooth) < 0.05


def test_progress_is_told(small_field: HierarchicalTiles) -> None:
    calls: list[tuple[int, int]] = []
    small_field.progress = lambda done, count: calls.append((done, count))
    small_field.forward(noise(small_field.scene.object_grid))
    small_field.progress = None
    assert calls == [(i + 1, len(small_field.groups)) for i in range(len(small_field.groups))]
    assert len(calls) > 1


@pytest.mark.parametrize("rows", [1, 77, 10_000])
def test_bands_make_the_plane(small_field: HierarchicalTiles, rows: int) -> None:
    field = noise(small_field.scene.object_grid)
    whole = small_field.forward(field).values
    sums: dict[int, NDArray[Any]] = {}
    bands = list(small_field.forward_in_bands(field, rows, sums))
    assert [b.start for b, _ in bands] == list(range(0, len(whole), rows))
    np.testing.assert_allclose(np.concatenate([values for _, values in bands]), whole, rtol=0.0, atol=1e-6)
    assert sorted(sums) == list(range(len(small_field.groups)))


def test_sums_that_are_there_are_not_made_again(small_field: HierarchicalTiles) -> None:
    field = noise(small_field.scene.object_grid)
    sums: dict[int, NDArray[Any]] = {}
    whole = np.concatenate([v for _, v in small_field.forward_in_bands(field, 100, sums)])
    del sums[1], sums[3]
    calls: list[tuple[int, int]] = []
    small_field.progress = lambda done, count: calls.append((done, count))
    again = np.concatenate([v for _, v in small_field.forward_in_bands(field, 100, sums)])
    small_field.progress = None
    assert np.array_equal(whole, again)
    count = len(small_field.groups)
    assert calls == [(count - 1, count), (count, count)]


@pytest.mark.parametrize("back", [False, True])
def test_memory_is_what_was_predicted(small_field: HierarchicalTiles, back: bool) -> None:
    scene = small_field.scene
    field = noise(scene.exit_grid if back else scene.object_grid)
    used = engine_peak_bytes(small_field, field, "adjoint" if back else "forward")
    assert used < 1.3 * small_field.cost().peak_bytes + field.values.nbytes


def test_settings_that_cannot_be_are_refused(paper_lens: Lens) -> None:
    scene = plane_scene(paper_lens)
    for wrong in ({"tile_width_mm": math.nan}, {"tiles_across": 0}, {"error": 1e-6}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            HierarchicalTiles(scene, **wrong)  # type: ignore[arg-type]
    line = Scene(paper_lens, Grid((20,), 1e-3, -13.5), Grid((20,), 1e-3, 12.7), WAVELENGTH_UM)
    with pytest.raises(InputError, match="use engine eikonal"):
        HierarchicalTiles(line)


def test_tiles_too_wide_are_refused_by_name(paper_lens: Lens) -> None:
    with pytest.raises(RayMapError, match="make tiles narrower"):
        HierarchicalTiles(plane_scene(paper_lens, samples=1600), tile_width_mm=0.8).groups  # noqa: B018


def test_a_fold_on_the_plane_is_refused(paper_lens: Lens) -> None:
    lens = paper_lens.with_surface(1, radius_mm=-6.0, semi_diameter_mm=7.5)
    grids = Grid((100, 100), 0.5e-3, -13.5), Grid((50, 50), 0.1, 20.0)
    with pytest.raises(FoldError, match=r"fold.*z = 20 mm"):
        HierarchicalTiles(Scene(lens, *grids, WAVELENGTH_UM)).groups  # noqa: B018


def test_maps_follow_rays_that_they_have_not_seen(paper_lens: Lens) -> None:
    grid = Grid((6000, 6000), 0.5e-3, -13.5)
    scene = Scene(paper_lens, grid, Grid((100, 100), 0.1, 12.7), WAVELENGTH_UM, POSE)
    region = region_of_object(scene)
    assert region.is_disc
    maps = maps_over_object(scene, region, 12.7, 0.09, 1e-4)
    path, amplitude, direction = maps.errors
    assert path < 1e-4
    assert amplitude < 1e-3
    assert direction < 1e-4
    for at in ([0.02, -0.01], [0.6, 0.4], [-1.2, 0.3], [0.9, -1.15]):  # slopes of directions, by differences
        point = np.array(at)
        carrier, step = maps.carriers.at((at[0], at[1])), 1e-3
        side = np.linspace(-0.99, 0.99, 81)
        unit = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
        places = carrier.middle + carrier.half_width * unit
        places = places[carrier.at(places)[4] <= 1.0]
        found = [
            np.max(np.abs(carrier.at(places + move)[2:4] - carrier.at(places - move)[2:4]), axis=1)
            / (2.0 * step)
            for move in (np.array([step, 0.0]), np.array([0.0, step]))
        ]
        predicted = maps.slopes_per_mm(point[None])
        assert np.all(np.transpose(found) < 1.01 * predicted)
        assert np.all(predicted.diagonal() < 1.05 * np.diagonal(found))


def test_tiles_share_an_interpolation_only_from_grids_alike(paper_lens: Lens) -> None:
    """Here some grids have one sample more than others of as many fine samples, by rounding."""
    twin = scaled(paper_lens, 1.0 / 32.0)
    before, behind = Grid((120, 120), 0.4256e-3, twin.object_z_mm), Grid((432, 432), 1.6e-3, 0.994625)
    engine = HierarchicalTiles(Scene(twin, before, behind, WAVELENGTH_UM), error=0.03, tile_width_mm=0.006)
    for group in engine.groups:
        cache: dict[Any, Any] = {}
        for tile in group.tiles:
            shared, own = (ObjectTile(group, tile, kept)._interpolation for kept in (cache, {}))
            for one, other in zip(shared.weights.field, own.weights.field, strict=True):
                # Where a fine sample lies on a coarse one, rounding says which of them is its first.
                np.testing.assert_allclose(
                    *(weights.matrix().toarray() for weights in (one, other)), atol=1e-5
                )


def test_maps_that_cannot_be_so_accurate_are_refused(
    paper_lens: Lens, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ray_maps, "SENSOR_ORDERS", (12, 16))
    monkeypatch.setattr(ray_maps, "OBJECT_ORDERS", (4, 6))
    scene = plane_scene(paper_lens)
    region = region_of_object(scene)
    assert not region.is_disc
    with pytest.raises(RayMapError, match="too rough"):
        maps_over_object(scene, region, 12.7, 0.09, 1e-11)


def test_corners_of_a_vignetted_stop_are_told(paper_lens: Lens) -> None:
    grid, radius = Grid((6000, 6000), 0.5e-3, -13.5), Grid((100, 100), 0.1, 12.7)
    found = []
    for semi_diameter in (10.0, 8.0):
        scene = Scene(paper_lens.with_surface(1, semi_diameter_mm=semi_diameter), grid, radius, WAVELENGTH_UM)
        found.append(maps_over_object(scene, region_of_object(scene), 12.7, 0.09, 1e-4).edge_error_mm)
    assert found[0] < 1e-5
    assert 1e-4 < found[1] < 0.1
