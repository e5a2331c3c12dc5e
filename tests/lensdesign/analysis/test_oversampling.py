"""The oversampling ratio against counts of pixels and degrees of freedom by hand."""

import math
from collections.abc import Callable

import pytest

from lensdesign import load_design, scaled
from lensdesign.analysis.exit_beam import footprint
from lensdesign.analysis.oversampling import (
    Oversampling,
    measurements_in_light,
    oversampling_of,
    real_unknowns,
)
from lensdesign.errors import InputError

LENS = load_design("designs/paper_singlet.toml")


def test_sensor_that_light_fills_counts_its_inscribed_circle() -> None:
    pixels = math.pi * 3500.0**2
    assert measurements_in_light(50.0, (29.9, 22.4), 3.2, 1e9) == pytest.approx(pixels)


def test_fine_pixels_count_only_the_degrees_of_freedom_of_the_intensity() -> None:
    fine = measurements_in_light(1.0, (2.0, 2.0), 0.01, 1000.0)
    assert fine == 4000.0
    assert measurements_in_light(1.0, (2.0, 2.0), 0.005, 1000.0) == fine


def test_square_band_of_the_pixels_has_one_degree_of_freedom_per_pixel() -> None:
    # Light that fills a square band of half-width 1 / (2 pitch) has one degree of freedom per pixel.
    degrees = math.pi * 0.5**2 * (1.0 / 3.2e-3) ** 2
    assert measurements_in_light(1.0, (2.0, 2.0), 3.2, degrees) == pytest.approx(degrees)


def test_complex_objects_have_twice_the_unknowns_of_real_ones() -> None:
    real, phase, both = (real_unknowns(kind, 2.0, 0.3, [0.5]) for kind in ("amplitude", "phase", "complex"))
    assert real == phase == both / 2.0
    assert real == pytest.approx((math.pi * 1.0 * 0.3 / 0.5e-3) ** 2)


def test_ratio_is_the_same_for_a_twin_of_any_size() -> None:
    twin = scaled(LENS, 1.0 / 16.0)
    assert oversampling_of(twin).ratio == pytest.approx(oversampling_of(LENS).ratio, rel=1e-3)


def test_known_support_raises_the_ratio_by_light_over_unknowns() -> None:
    support = 0.8 * LENS.object.field_diameter_mm
    found = oversampling_of(LENS, support_mm=support, plane_distances_mm=(2.0,))
    lit = LENS.replaced(object=LENS.object.replaced(field_diameter_mm=support))
    pixels = math.pi * (footprint(lit, plane_distance_mm=2.0).radius_mm / 3.2e-3) ** 2
    unknowns = 2.0 * (math.pi * 0.5 * support * 0.5 / 0.532e-3) ** 2
    assert found.ratio == pytest.approx(pixels / unknowns, rel=1e-6)
    assert found.ratio > oversampling_of(LENS, plane_distances_mm=(2.0,)).ratio


def test_small_support_has_at_most_two_measurements_per_complex_unknown_and_plane() -> None:
    for fraction in (0.2, 0.4):
        support = fraction * LENS.object.field_diameter_mm
        found = oversampling_of(LENS, support_mm=support, plane_distances_mm=(2.0, 22.0))
        assert found.ratio == pytest.approx(4.0)


def test_wavelengths_recorded_one_by_one_keep_the_ratio_and_those_at_once_share_it() -> None:
    colours = (0.5, 0.55, 0.6)
    each = [oversampling_of(LENS, wavelengths_um=[colour]) for colour in colours]
    one_by_one = oversampling_of(LENS, wavelengths_um=colours)
    assert one_by_one.measurements == pytest.approx(sum(one.measurements for one in each))
    assert one_by_one.unknowns == pytest.approx(sum(one.unknowns for one in each))
    at_once = oversampling_of(LENS, wavelengths_um=colours, at_once=True)
    assert at_once.measurements == pytest.approx(max(one.measurements for one in each))


def test_planes_for_a_ratio_reach_it_and_one_less_does_not() -> None:
    found = oversampling_of(LENS, plane_distances_mm=(2.0, 22.0))
    each = found.ratio / 2.0
    count = found.planes_for(3.5)
    assert (count - 1) * each < 3.5 <= count * each


def test_layers_multiply_the_unknowns() -> None:
    assert oversampling_of(LENS, layers=3).ratio == pytest.approx(oversampling_of(LENS).ratio / 3.0)


INVALID: dict[str, Callable[[], Oversampling]] = {
    "support_mm = 3.1": lambda: oversampling_of(LENS, support_mm=3.1),
    "support_mm = 0.0": lambda: oversampling_of(LENS, support_mm=0.0),
    "kind = 'grey'": lambda: oversampling_of(LENS, "grey"),  # type: ignore[arg-type]
    "layers = 0": lambda: oversampling_of(LENS, layers=0),
    "wavelengths_um": lambda: oversampling_of(LENS, wavelengths_um=[]),
    "plane_distances_mm": lambda: oversampling_of(LENS, plane_distances_mm=[]),
}


@pytest.mark.parametrize("named", INVALID)
def test_values_out_of_range_are_named(named: str) -> None:
    with pytest.raises(InputError, match=named):
        INVALID[named]()
