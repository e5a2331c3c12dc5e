"""Maps of ghosts on a plane against the powers and radii that listed paths have, and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import CoverGlass, InputError, load_design
from lensdesign.analysis.double_reflections import ghost_paths
from lensdesign.analysis.ghost_maps import ghost_maps, sum_on_pixels

PAPER = load_design("designs/paper_singlet.toml")
CENTRE = np.zeros((1, 2)), np.ones(1)


def with_sensor():
    glass = CoverGlass(thickness_mm=0.7, material=1.52, distance_mm=0.5)
    lens = PAPER.replaced(sensor=PAPER.sensor.replaced(cover_glass=glass, reflectance=0.05))
    return lens.with_coating("bare")


def test_maps_have_the_power_of_their_paths():
    """A field of no size: all of its light comes from the centre."""
    lens = with_sensor()
    lens = lens.replaced(object=lens.object.replaced(field_diameter_mm=1e-6))
    listed = {(p.first, p.second): p for p in ghost_paths(lens).paths if p.plane_distance_mm == 2.0}
    maps = ghost_maps(lens, *CENTRE, 2.0, lens.sensor.size_mm, rays=40_000)
    assert {(one.first, one.second) for one in maps} == set(listed)
    for one in maps:
        path = listed[one.first, one.second]
        # Rays of maps are random; those of the list are on rings, some of which the rim cuts.
        assert one.power == pytest.approx(path.power_on_sensor, rel=0.08, abs=3e-6)
        assert one.fractions.min() >= 0.0


def test_a_ghost_is_where_its_rays_arrive():
    lens = with_sensor()
    width = 2.0 * 9.0 / 48
    (found,) = (
        one
        for one in ghost_maps(lens, *CENTRE, 2.0, (18.0, 18.0), rays=40_000)
        if (one.first, one.second) == ("cover glass front", "surface 1")
    )
    y, x = (np.indices((48, 48)) - 23.5) * width
    total = found.fractions.sum()
    assert abs(float((x * found.fractions).sum() / total)) < 0.05
    radius = np.sqrt(2.0 * float(((x**2 + y**2) * found.fractions).sum()) / total)
    listed = {(p.first, p.second): p for p in ghost_paths(lens).paths if p.plane_distance_mm == 2.0}
    expected = listed["cover glass front", "surface 1"].radius_mm
    # Smoothing widens it by a cell. Few steep rays determine the radius.
    assert radius == pytest.approx(np.hypot(expected, 2.0 * width), rel=0.15)


def test_paths_within_the_lens_can_be_left_out():
    lens = with_sensor()
    names = {
        (one.first, one.second)
        for one in ghost_maps(lens, *CENTRE, 2.0, (30.0, 22.0), rays=5000, only_beyond_lens=True)
    }
    assert ("surface 2", "surface 1") not in names
    assert len(names) == 9


def test_ideal_coatings_have_no_ghosts():
    assert ghost_maps(PAPER, *CENTRE, 2.0, (30.0, 22.0), rays=2000) == ()
    assert not sum_on_pixels((), (5, 7)).any()
    narrow = PAPER.with_surface(1, semi_diameter_mm=1e-3)
    with pytest.raises(InputError, match="no ray of the object points"):
        ghost_maps(narrow, np.array([[0.0, 1.0]]), np.ones(1), 2.0, (30.0, 22.0), rays=1000)


def test_pixels_keep_the_power_of_the_maps():
    maps = ghost_maps(with_sensor(), *CENTRE, 2.0, (30.0, 22.0), rays=5000)
    for shape in ((219, 292), (48, 48), (10, 13)):
        pixels = sum_on_pixels(maps, shape)
        assert pixels.shape == shape
        assert pixels.sum() == pytest.approx(sum(one.power for one in maps), rel=1e-12)
