"""Equations 1 and 2 and the etendue bound, against the paper's figures."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from random_lenses import numbers

from lensdesign import DesignError, Lens
from lensdesign.analysis.space_bandwidth import (
    match,
    sbp_object,
    sbp_sensor,
    sensor_spread_sine,
    spread_limit_sine,
)


def test_figures_of_the_paper(paper_lens: Lens) -> None:
    m = match(paper_lens, 0.532)
    assert m.sbp_object == pytest.approx(1.96155e7, rel=5e-6)
    assert m.sbp_sensor == pytest.approx(3.02257e7, rel=5e-6)
    assert m.sbp_ratio == pytest.approx(3.02257 / 1.96155, rel=1e-5)
    assert m.spread_limit_deg == pytest.approx(4.7682, abs=5e-5)
    assert m.highest_frequency_lp_per_mm == pytest.approx(156.25)
    assert m.resolution_um == pytest.approx(0.532)
    assert m.smallest_exit_beam_diameter_mm == pytest.approx(3.0 * 0.5 / math.sin(math.radians(4.7682)), 1e-5)


def test_shortest_side_counts(paper_lens: Lens) -> None:
    turned = paper_lens.sensor.model_copy(update={"pixels": (7000, 9344)})
    lens = paper_lens.replaced(sensor=turned)
    assert match(lens, 0.532).sbp_sensor == match(paper_lens, 0.532).sbp_sensor


def test_pixels_below_half_a_wavelength_resolve_every_angle(paper_lens: Lens) -> None:
    lens = paper_lens.replaced(sensor=paper_lens.sensor.model_copy(update={"pixel_pitch_um": 0.2}))
    m = match(lens, 0.532)
    assert m.spread_limit_deg == 90.0
    assert m.smallest_exit_beam_diameter_mm == pytest.approx(1.5)
    assert spread_limit_sine(0.5, 0.25) == 1.0


@pytest.mark.parametrize("index", [1.0, 1.333, 1.7])
def test_the_medium_in_front_of_the_sensor_shortens_the_wavelength_of_equation_2(
    paper_lens: Lens, index: float
) -> None:
    """The fringes of two plane waves, from the wave vectors in the medium, have two pixels at the limit."""
    lens = paper_lens.with_surface(1, material=index)
    angle, pitch_um = math.radians(match(lens, 0.532).spread_limit_deg), lens.sensor.pixel_pitch_um
    wavenumber = 2.0 * math.pi * index / 0.532
    assert 2.0 * math.pi / (wavenumber * math.sin(angle)) == pytest.approx(2.0 * pitch_um, rel=1e-12)
    # A plane face refracts the limit in air to that in the medium; the beam of the etendue stays as wide.
    in_air = match(paper_lens, 0.532)
    assert math.sin(math.radians(in_air.spread_limit_deg)) == pytest.approx(
        index * math.sin(angle), rel=1e-12
    )
    narrowest_mm = match(lens, 0.532).smallest_exit_beam_diameter_mm
    assert narrowest_mm == pytest.approx(in_air.smallest_exit_beam_diameter_mm, rel=1e-12)


def test_a_dispersive_medium_has_a_limit_at_each_wavelength(paper_lens: Lens) -> None:
    lens = paper_lens.with_surface(1, material="N-BK7")
    for wavelength_um in (0.45, 0.65):
        sine = wavelength_um / (2.0 * lens.indices(wavelength_um)[-1] * 3.2)
        assert sensor_spread_sine(lens, wavelength_um) == pytest.approx(sine, rel=1e-12)


@given(field=numbers(0.1, 10.0), na=numbers(0.01, 0.95), wavelength=numbers(0.3, 1.0))
def test_equation_1_is_met_with_equality_by_a_relay_at_unit_magnification(
    field: float, na: float, wavelength: float
) -> None:
    """A sensor as wide as the field, whose pixels just resolve the NA, has the object's product."""
    pitch = wavelength / (2.0 * na)
    assert sbp_sensor(field, pitch) == pytest.approx(sbp_object(field, na, wavelength), rel=1e-12)


@pytest.mark.parametrize(
    ("section", "change"),
    [
        ("object", {"field_diameter_mm": 1e-300}),
        ("object", {"numerical_aperture": 1e-300}),
        ("sensor", {"pixel_pitch_um": 1e-300}),
    ],
)
def test_what_is_too_small_to_compute_with_is_named(
    paper_lens: Lens, section: str, change: dict[str, float]
) -> None:
    """Either when the lens is stated or when it is matched."""
    ((name, _),) = change.items()
    with pytest.raises(DesignError, match=name):
        match(paper_lens.replaced(**{section: getattr(paper_lens, section).replaced(**change)}), 0.532)
