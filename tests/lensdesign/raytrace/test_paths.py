"""Rays as polylines: where they begin and end, and how large surfaces of no given size are."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import Lens, Surface
from lensdesign.errors import InputError
from lensdesign.raytrace.bundles import pupil_fan, pupil_hexapolar
from lensdesign.raytrace.paths import ray_paths, sized_lens


def test_paths_run_from_object_to_last_plane(paper_lens: Lens) -> None:
    paths = ray_paths(paper_lens, (0.3, 1.2), pupil_hexapolar(2).points)
    assert paths.shape == (19, 4, 3)
    assert np.all(paths[:, 0] == [0.3, 1.2, -13.5])
    assert paths[:, -1, 2] == pytest.approx(31.7)
    for i, surface in enumerate(paper_lens.surfaces):
        r = np.hypot(paths[:, i + 1, 0], paths[:, i + 1, 1])
        assert paths[:, i + 1, 2] == pytest.approx(paper_lens.vertex_z_mm[i] + surface.sag_mm(r), abs=1e-12)


def test_a_clipped_ray_ends_at_the_ground_edge(paper_lens: Lens) -> None:
    lens = paper_lens.with_surface(1, semi_diameter_mm=8.3)
    free = ray_paths(paper_lens, (0.0, 0.0), pupil_fan(11).points)
    paths = ray_paths(lens, (0.0, 0.0), pupil_fan(11).points)
    rim = paths[[0, -1]]
    assert np.hypot(rim[:, 2, 0], rim[:, 2, 1]) == pytest.approx(8.3)
    assert np.all(rim[:, 2] == rim[:, 3])
    along, cut = free[-1, 2] - free[-1, 1], paths[-1, 2] - paths[-1, 1]
    assert np.cross(along, cut) == pytest.approx(0.0, abs=1e-12)
    assert 0.0 < np.linalg.norm(cut) < np.linalg.norm(along)
    assert paths[1:-1] == pytest.approx(free[1:-1])


def test_a_totally_reflected_ray_ends_where_it_was_reflected(paper_lens: Lens) -> None:
    steep = paper_lens.with_surface(1, radius_mm=-10.2, conic=-0.2, semi_diameter_mm=10.0)
    paths = ray_paths(steep, (0.0, -1.5), pupil_fan(41).points)
    lost = paths[:, -1, 2] < 31.0
    assert 0 < np.count_nonzero(lost) < 41
    assert np.all(paths[lost, -1] == paths[lost, -2])
    assert np.max(paths[lost, -1, 2]) <= steep.exit_vertex_z_mm


def test_missing_semi_diameters_come_from_the_footprint(paper_lens: Lens) -> None:
    unsized = paper_lens.with_surface(1, semi_diameter_mm=None)
    sized = sized_lens(unsized)
    heights = np.linspace(-1.5, 1.5, 13)
    reached = max(
        np.max(np.abs(ray_paths(unsized, (0.0, h), pupil_fan(101).points)[:, 2, 1])) for h in heights
    )
    assert sized.surfaces[1].semi_diameter_mm == pytest.approx(reached, rel=1e-6)
    assert sized.surfaces[0] == paper_lens.surfaces[0]
    assert sized_lens(paper_lens) is paper_lens


def test_a_surface_that_no_ray_reaches_needs_a_size(paper_lens: Lens) -> None:
    surfaces = (
        Surface(thickness_mm=5.0, semi_diameter_mm=5.0, stop=True),
        Surface(thickness_mm=5.0, semi_diameter_mm=1e-4),
        Surface(radius_mm=50.0),
    )
    with pytest.raises(InputError, match=r"surface 3 .*semi_diameter_mm"):
        sized_lens(paper_lens.replaced(surfaces=surfaces))
