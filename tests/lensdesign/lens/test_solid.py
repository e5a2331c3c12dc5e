"""Exact glass bodies: volumes against closed forms, edges, refusals."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from small_lenses import lens_of

from lensdesign.errors import InputError
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.solid import closed_elements, glass_elements, smallest_gap
from lensdesign.lens.surface import Surface


def cap_mm3(radius: float, height: float) -> float:
    return math.pi * height**2 * (3.0 * radius - height) / 3.0


def test_volume_of_a_ball_ground_to_a_cylinder() -> None:
    lens = lens_of(
        {"radius_mm": 5.0, "thickness_mm": 10.0, "material": "N-BK7", "semi_diameter_mm": 4.5},
        {"radius_mm": -5.0, "semi_diameter_mm": 4.5},
    )
    (element,) = closed_elements(lens)
    height = 5.0 - math.sqrt(25.0 - 4.5**2)
    assert element.edge_thickness_mm == pytest.approx(10.0 - 2.0 * height, rel=1e-14)
    expected = 2.0 * cap_mm3(5.0, height) + math.pi * 4.5**2 * (10.0 - 2.0 * height)
    assert element.volume_mm3 == pytest.approx(expected, rel=1e-13)


def test_volume_of_a_hemisphere_whose_tangent_stands_upright_at_the_edge() -> None:
    lens = lens_of({"radius_mm": 4.0, "thickness_mm": 5.0, "material": "N-BK7", "semi_diameter_mm": 4.0}, {})
    (element,) = closed_elements(lens.with_surface(1, semi_diameter_mm=4.0))
    expected = 2.0 / 3.0 * math.pi * 64.0 + math.pi * 16.0 * 1.0
    assert element.volume_mm3 == pytest.approx(expected, rel=1e-13)
    assert np.all(np.isfinite(element.outline()))


def test_volume_between_paraboloid_and_plane() -> None:
    lens = lens_of(
        {"thickness_mm": 4.0, "material": "N-BK7", "semi_diameter_mm": 6.0},
        {"radius_mm": -9.0, "conic": -1.0, "semi_diameter_mm": 6.0},
    )
    height = 36.0 / 18.0
    expected = math.pi * 36.0 * (4.0 - height) + 0.5 * math.pi * 36.0 * height
    assert closed_elements(lens)[0].volume_mm3 == pytest.approx(expected, rel=1e-13)


def test_volume_under_an_asphere() -> None:
    lens = lens_of(
        {"asphere": [1e-4, -2e-7], "thickness_mm": 4.0, "material": "N-BK7", "semi_diameter_mm": 7.0},
        {"semi_diameter_mm": 7.0},
    )
    removed = 2.0 * math.pi * (1e-4 * 7.0**6 / 6.0 - 2e-7 * 7.0**8 / 8.0)
    expected = math.pi * 49.0 * 4.0 - removed
    assert closed_elements(lens)[0].volume_mm3 == pytest.approx(expected, rel=1e-13)


def test_flat_annulus_where_the_conic_ends_before_the_edge() -> None:
    lens = lens_of(
        {"radius_mm": 8.0, "thickness_mm": 9.0, "material": "N-BK7", "semi_diameter_mm": 6.0},
        {"semi_diameter_mm": 10.0},
    )
    (element,) = closed_elements(lens)
    height = 8.0 - math.sqrt(64.0 - 36.0)
    assert element.edge_mm == 10.0
    assert element.edge_thickness_mm == pytest.approx(9.0 - height, rel=1e-14)
    expected = cap_mm3(8.0, height) + math.pi * 100.0 * (9.0 - height)
    assert element.volume_mm3 == pytest.approx(expected, rel=1e-13)
    rim = element.outline()[np.isclose(element.outline()[:, 0], 10.0)]
    assert rim[:, 1] == pytest.approx([height, 9.0])


def test_a_surface_goes_on_with_its_own_sag_to_the_mechanical_edge() -> None:
    lens = lens_of(
        {"radius_mm": 42.3, "thickness_mm": 9.7, "material": "N-BK7", "semi_diameter_mm": 8.26},
        {"radius_mm": -12.0, "conic": -0.89862, "semi_diameter_mm": 10.0},
    )
    outline = closed_elements(lens)[0].outline()
    front, back = np.split(outline, 2)
    assert front[:, 1] == pytest.approx(lens.surfaces[0].sag_mm(front[:, 0]), abs=1e-13)
    assert back[:, 1] == pytest.approx(9.7 + lens.surfaces[1].sag_mm(back[:, 0]), abs=1e-13)
    assert front[-1, 0] == back[0, 0] == 10.0


@pytest.mark.parametrize(
    "surface",
    [
        Surface(radius_mm=-12.0, conic=-0.9),
        Surface(radius_mm=12.0, conic=-2.5),
        Surface(radius_mm=30.0, conic=0.7, asphere=(1e-5, 2e-8)),
        Surface(asphere=(3e-5,)),
    ],
)
def test_tangents_are_the_derivatives_of_the_points(surface: Surface) -> None:
    meridian = SurfaceMeridian(surface, 1.5, 8.0)
    t = np.linspace(0.05, 0.95, 19)
    numeric = (meridian.points(t + 1e-6) - meridian.points(t - 1e-6)) / 2e-6
    assert meridian.tangents(t) == pytest.approx(numeric, abs=1e-7)
    assert meridian.parameters(meridian.points(t)[:, 0]) == pytest.approx(t, abs=1e-13)
    assert meridian.points(1.0)[0] == pytest.approx(8.0, rel=1e-14)


def test_distances_to_a_sphere_are_radial() -> None:
    meridian = SurfaceMeridian(Surface(radius_mm=10.0), 0.0, 8.0)
    angle = np.linspace(0.1, 0.9, 7)
    for radius in (9.5, 10.0, 10.3):
        points = np.stack([radius * np.sin(angle), 10.0 - radius * np.cos(angle)], axis=-1)
        assert meridian.distances(points) == pytest.approx(np.full(7, abs(radius - 10.0)), abs=1e-12)


def test_each_glass_of_a_cemented_group_is_an_element_and_air_is_none() -> None:
    lens = lens_of(
        {"radius_mm": 40.0, "thickness_mm": 6.0, "material": "N-BK7", "semi_diameter_mm": 9.0},
        {"radius_mm": -30.0, "thickness_mm": 2.0, "material": "N-SF6", "semi_diameter_mm": 9.0},
        {"radius_mm": -90.0, "thickness_mm": 4.0, "material": "AIR", "semi_diameter_mm": 9.0},
        {"radius_mm": 50.0, "thickness_mm": 3.0, "material": 1.6, "semi_diameter_mm": 7.0},
        {"semi_diameter_mm": 7.0},
    )
    elements = closed_elements(lens)
    assert [e.surfaces for e in elements] == [(0, 1), (1, 2), (3, 4)]
    assert elements[2].name == "element 3 (surfaces 4 and 5)"
    assert elements[2].edge_mm == 9.0


def test_smallest_gap_of_two_profiles() -> None:
    front = np.array([[0.0, 0.0], [2.0, 1.0]])
    back = np.array([[0.0, 2.0], [1.0, 0.8], [2.0, 2.0]])
    assert smallest_gap(front, back) == pytest.approx((1.0, 0.3))


def test_surfaces_that_cross_at_the_edge_are_refused_with_the_numbers() -> None:
    lens = lens_of(
        {"radius_mm": 42.3, "thickness_mm": 4.5, "material": "N-BK7", "semi_diameter_mm": 8.26},
        {"radius_mm": -12.0, "conic": -0.89862, "semi_diameter_mm": 10.0},
    )
    assert len(glass_elements(lens)) == 1
    edge = 4.5 + float(lens.surfaces[1].sag_mm(10.0)) - float(lens.surfaces[0].sag_mm(10.0))
    message = f"element 1 (surfaces 1 and 2) does not close: its edge thickness is {edge:.6g} mm"
    with pytest.raises(InputError, match=re.escape(message)):
        closed_elements(lens)


def test_surfaces_that_cross_between_axis_and_edge_are_refused() -> None:
    lens = lens_of(
        {"radius_mm": 20.0, "thickness_mm": 0.6, "material": "N-BK7", "semi_diameter_mm": 2.0},
        {"asphere": [1.4e-4], "semi_diameter_mm": 16.0},
    )
    with pytest.raises(InputError, match=r"cross.*height"):
        closed_elements(lens)


def test_a_lens_without_glass_is_refused() -> None:
    with pytest.raises(InputError, match="no glass"):
        glass_elements(lens_of({"thickness_mm": 2.0, "semi_diameter_mm": 5.0}, {"radius_mm": 20.0}))


def test_an_element_without_size_is_refused() -> None:
    lens = lens_of(
        {"thickness_mm": 2.0, "semi_diameter_mm": 5.0, "stop": True},
        {"radius_mm": 20.0, "thickness_mm": 3.0, "material": "N-BK7"},
        {},
    )
    with pytest.raises(InputError, match=r"surface 2 or 3.*semi_diameter_mm"):
        glass_elements(lens)


def test_a_conic_that_ends_before_the_edge_needs_a_size() -> None:
    lens = lens_of({"thickness_mm": 9.0, "material": "N-BK7", "semi_diameter_mm": 9.0}, {"radius_mm": -8.0})
    with pytest.raises(InputError, match=r"surface 2 .*8 mm"):
        glass_elements(lens)
