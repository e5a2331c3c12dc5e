"""Lenses at other temperatures, against closed forms."""

import numpy as np
import pytest

from lensdesign import load_design, save_design
from lensdesign.errors import MaterialError
from lensdesign.lens.lens import Lens
from lensdesign.lens.temperature import ALUMINIUM_PER_K, lens_at_temperature, thermal_expansion


def lens_of(*surfaces, **changes) -> Lens:
    return Lens.model_validate(
        {
            "wavelengths_um": [0.532, 0.633],
            "object": {"field_diameter_mm": 1.0, "numerical_aperture": 0.1, "working_distance_mm": 20.0},
            "sensor": {"pixel_pitch_um": 3.2, "pixels": [1000, 1000], "plane_distances_mm": [2.0, 10.0]},
            "surface": list(surfaces),
            **changes,
        }
    )


FRONT = {"radius_mm": 30.0, "thickness_mm": 4.0, "material": "N-BK7", "semi_diameter_mm": 5.0}
BACK = {"radius_mm": -25.0, "conic": -0.5, "semi_diameter_mm": 6.0}


def test_a_lens_of_one_expansion_is_the_lens_scaled():
    """A mount that expands as the glass does: every length grows alike, whatever the shapes."""
    asphere = {**FRONT, "asphere": [1e-5, -2e-7]}
    gap = {**BACK, "thickness_mm": 3.0}
    lens = lens_of(asphere, gap, {**FRONT, "radius_mm": -40.0}, {**BACK, "radius_mm": -20.0})
    hot = lens_at_temperature(lens, 70.0, mount_expansion_per_k=7.1e-6)
    factor = 1.0 + 50.0 * 7.1e-6
    for cold, warm in zip(lens.surfaces, hot.surfaces, strict=True):
        assert warm.radius_mm == pytest.approx(factor * cold.radius_mm, rel=1e-12)
        assert warm.semi_diameter_mm == pytest.approx(factor * cold.semi_diameter_mm, rel=1e-12)
        r = 4.0
        assert warm.sag_mm(factor * r) == pytest.approx(factor * cold.sag_mm(r), rel=1e-12)
        if cold.thickness_mm:
            assert warm.thickness_mm == pytest.approx(factor * cold.thickness_mm, rel=1e-9)
    assert hot.object.working_distance_mm == pytest.approx(factor * 20.0, rel=1e-9)
    assert hot.sensor.plane_distances_mm == pytest.approx((factor * 2.0, factor * 10.0), rel=1e-9)


def test_a_space_follows_the_edges_that_its_mount_stands_on():
    """Spheres: the mount between two edges grows by itself, then the sags are taken off anew."""
    lens = lens_of(FRONT, {**BACK, "thickness_mm": 3.0}, {**FRONT, "material": "PMMA"}, BACK)
    hot = lens_at_temperature(lens, 60.0)
    glass, plastic = 1.0 + 40.0 * 7.1e-6, 1.0 + 40.0 * 67.4e-6
    back, front = lens.surfaces[1:3]
    edge = 3.0 + float(front.sag_mm(5.0)) - float(back.sag_mm(6.0))
    grown = edge * (1.0 + 40.0 * ALUMINIUM_PER_K)
    expected = grown + glass * float(back.sag_mm(6.0)) - plastic * float(front.sag_mm(5.0))
    assert hot.surfaces[1].thickness_mm == pytest.approx(expected, rel=1e-12)
    assert hot.surfaces[2].radius_mm == pytest.approx(30.0 * plastic)


def test_a_cemented_surface_grows_by_the_mean():
    lens = lens_of(FRONT, {**BACK, "thickness_mm": 3.0, "material": "N-SF5"}, {"radius_mm": -50.0})
    grown = thermal_expansion(lens).surfaces_per_k
    assert grown == pytest.approx([7.1e-6, 0.5 * (7.1e-6 + 7.94e-6), 7.94e-6], rel=0.01)


def test_at_20_degrees_it_is_as_designed_and_saved_as_it_is(tmp_path):
    lens = lens_of({**FRONT, "stop": True}, BACK)
    same, hot = lens_at_temperature(lens, 20.0), lens_at_temperature(lens, 43.7)
    assert np.array_equal(same.indices(0.633), lens.indices(0.633))
    assert same.surfaces[0].radius_mm == lens.surfaces[0].radius_mm
    save_design(hot, tmp_path / "hot.toml")
    assert load_design(tmp_path / "hot.toml") == hot


def test_a_vacuum_follows_the_index_of_hot_air():
    """The index of air minus 1 is proportional to its density, nearly 1 / T."""
    lens = lens_of({**FRONT, "stop": True}, {**BACK, "material": "VACUUM"})
    hot = lens_at_temperature(lens, 60.0).indices(0.633)[2]
    cold = lens.indices(0.633)[2]
    assert (1.0 / hot - 1.0) / (1.0 / cold - 1.0) == pytest.approx(293.15 / 333.15, abs=2e-3)


def test_focal_length_changes_as_the_closed_form_says():
    """Thin lens: df / f = (a - n' / (n - 1)) dT, with n' relative to air."""
    from lensdesign.analysis.paraxial import first_order

    thin = {**FRONT, "thickness_mm": 0.01, "radius_mm": 200.0, "semi_diameter_mm": 1.0}
    lens = lens_of(thin, {"radius_mm": -200.0})
    hot = lens_at_temperature(lens, 21.0)
    n, warmer = lens.indices(0.532)[1], hot.indices(0.532)[1]
    f, g = (first_order(one, 0.532).efl_mm for one in (lens, hot))
    assert (g - f) / f == pytest.approx(7.1e-6 - (warmer - n) / (n - 1.0), rel=1e-3)


@pytest.mark.parametrize(
    ("material", "message"),
    [
        (1.5, "surface 1, 1.5 .constant.: its thermal expansion is not known"),
        ("SILICA", "surface 1, SILICA .*thermal expansion is not known"),
        ("N-BK7@50C", "already given at a temperature"),
    ],
)
def test_a_glass_of_which_too_little_is_known_is_refused_by_name(material, message):
    with pytest.raises(MaterialError, match=message):
        lens_at_temperature(lens_of({**FRONT, "material": material}, BACK), 50.0)
