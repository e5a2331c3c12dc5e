"""Polynomial maps of rays: exact on polynomials, equal to fresh rays, and refused on folds."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import Lens, Pose
from wavesim.fields.field import Grid
from wavesim.rays.maps import fit_map, ray_map
from wavesim.rays.ray_bundles import FoldError, trace_bundle
from wavesim.scene.scene import Scene


def scene_of(lens: Lens, dimensions: int) -> Scene:
    shape = (50,) * dimensions
    pose = Pose(tilt_x_deg=0.5, decenter_y_mm=0.1)
    return Scene(lens, Grid(shape, 1e-3, -13.5), Grid(shape, 0.4, 12.7), 0.532, pose=pose)


def test_polynomials_are_fitted_exactly() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-2.0, 3.0, (300, 2))
    y, x = points.T
    found = fit_map(points, np.array([y**3 - 2 * x * y + 1, x**4]), 4)
    axes = np.linspace(-1.5, 2.0, 5), np.linspace(-1.0, 2.5, 4)
    grid = found.on_axes(axes)
    expected = axes[0][:, None] ** 3 - 2 * axes[0][:, None] * axes[1] + 1
    assert grid[0] == pytest.approx(expected, abs=1e-10)
    scattered = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    assert found.at(scattered).reshape(grid.shape) == pytest.approx(grid, abs=1e-10)
    assert found.at(scattered[:0]).shape == (2, 0)


@pytest.mark.parametrize("dimensions", [1, 2])
def test_maps_agree_with_rays_that_they_have_not_seen(paper_lens: Lens, dimensions: int) -> None:
    scene, point = scene_of(paper_lens, dimensions), (0.0, 1.2)
    found = ray_map(scene, point, 12.7, 0.05)
    rng = np.random.default_rng(5)
    pupil = rng.uniform(-0.7, 0.7, (200, 2)) * [dimensions - 1, 1]
    rays = trace_bundle(scene, np.array(point), pupil, 12.7)
    path, amplitude, *cosines = found.maps.at(rays.sensor_mm)
    assert np.max(np.abs(path - rays.path_mm)) < 1e-4 * 0.532e-3
    assert amplitude == pytest.approx(rays.amplitude, rel=1e-4)
    assert np.max(np.abs(np.transpose(cosines) - rays.cosines)) < 1e-5


@pytest.mark.parametrize("dimensions", [1, 2])
def test_row_spans_hold_the_samples_inside_the_rim(paper_lens: Lens, dimensions: int) -> None:
    scene = scene_of(paper_lens, dimensions)
    found = ray_map(scene, (0.0, 0.0), 12.7, 0.05)
    grid = scene.exit_grid
    spans = found.row_spans((grid.y_mm, grid.x_mm)[:dimensions])
    middle = found.rim_mm.mean(axis=0)
    radius = np.linalg.norm(found.rim_mm - middle, axis=1)
    if dimensions == 1:
        inside = np.abs(grid.y_mm - middle[0]) < 0.5 * np.ptp(found.rim_mm)
        assert spans.tolist() == [[int(np.argmax(inside)), 50 - int(np.argmax(inside[::-1]))]]
        return
    distance = np.hypot(grid.y_mm[:, None] - middle[0], grid.x_mm - middle[1])
    columns = np.arange(50)
    marked = (columns >= spans[:, :1]) & (columns < spans[:, 1:])
    assert marked[distance < radius.min()].all()
    assert not marked[distance > radius.max()].any()


def test_fold_is_refused_by_name(paper_lens: Lens) -> None:
    scene = scene_of(paper_lens, 1)
    with pytest.raises(FoldError, match=r"fold.*z = 90 mm"):
        ray_map(scene, (0.0, 0.0), 90.0, 0.05)
