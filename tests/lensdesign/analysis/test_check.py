"""The check report: the paper's lens, and each way in which a lens can fall short."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from places import DESIGNS

from lensdesign import Lens, Surface
from lensdesign.analysis.check import check_design
from lensdesign.analysis.oversampling import oversampling_of
from lensdesign.analysis.report import CheckReport


@pytest.fixture(scope="module")
def report(paper_lens: Lens) -> CheckReport:
    """The report on the paper's lens."""
    return check_design(paper_lens)


def test_the_paper_lens_misses_equation_2_and_nothing_else(report: CheckReport) -> None:
    assert not report.feasible
    (sentence,) = report.violations
    assert sentence.startswith("Eq. 2: the largest spread angle of 4.8105° exceeds the limit of 4.7682°")
    assert "by 0.9 %" in sentence
    assert "field height 1.5 mm" in sentence
    assert [c.name for c in report.constraints if not c.met] == ["largest spread angle (Eq. 2)"]


def test_a_design_file_will_do(paper_design: Path, report: CheckReport) -> None:
    assert check_design(paper_design) == check_design(str(paper_design)) == report


def test_the_report_shows_itself(report: CheckReport) -> None:
    assert repr(report).endswith("not met: 1, spread 4.8105 of 4.7682°, resolution 0.532 µm>")
    shown = report._repr_html_()
    assert "not met: 4.8105 ≤ 4.76821°" in shown
    assert shown.count("<tr>") == len(report.constraints) + len(report.oversampling) + 3
    assert "0.79, 0.97; all planes 1.77" in shown


def test_figures_of_the_paper_lens(report: CheckReport) -> None:
    assert report.sbp_object == pytest.approx(1.96155e7, rel=5e-6)
    assert report.sbp_sensor == pytest.approx(3.02257e7, rel=5e-6)
    assert report.spread_limit_deg == pytest.approx(4.7682, abs=5e-5)
    assert report.max_spread_deg == pytest.approx(4.810, abs=1e-3)
    assert report.resolution_um == pytest.approx(0.532)
    assert report.highest_frequency_lp_per_mm == pytest.approx(156.25)
    assert report.rms_spot_diameter_mm == pytest.approx((14.27, 14.26, 14.22), abs=5e-3)
    assert report.spot_heights_mm == (0.0, 0.75, 1.5)
    assert report.throughput == 1.0
    assert report.numerical_aperture == pytest.approx(0.49980, abs=1e-5)
    assert len(report.footprint_radius_mm) == 2
    assert max(report.footprint_radius_mm) < report.sensor_half_side_mm == pytest.approx(11.2)
    assert report.worst_ray.field_mm == pytest.approx((0.0, 1.5))
    assert report.worst_ray.wavelength_um == 0.532


def test_etendue_bound_holds(report: CheckReport) -> None:
    assert report.exit_beam_diameter_mm > report.smallest_exit_beam_diameter_mm
    sine = math.sin(math.radians(report.max_spread_deg))
    assert report.etendue_share == pytest.approx(3.0 * 0.5 / (report.exit_beam_diameter_mm * sine))
    assert report.etendue_share < 1.0


def test_the_report_is_plain_json(report: CheckReport) -> None:
    data = report.as_dict()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert {
        "title",
        "feasible",
        "violations",
        "constraints",
        "sbp_object",
        "sbp_sensor",
        "spread_limit_deg",
        "max_spread_deg",
        "worst_ray",
        "resolution_um",
        "highest_frequency_lp_per_mm",
        "footprint_radius_mm",
        "rms_spot_diameter_mm",
        "spot_plane_mm",
        "throughput",
        "edge_thickness_mm",
        "efl_mm",
        "bfl_mm",
        "wavelengths",
    } <= data.keys()


def test_an_afocal_lens_is_plain_json_too(paper_lens: Lens) -> None:
    lens = paper_lens.with_surface(0, radius_mm=None).with_surface(1, radius_mm=None, semi_diameter_mm=30.0)
    data = check_design(lens).as_dict()
    assert data["efl_mm"] is None
    json.dumps(data, allow_nan=False)


def relaxed(lens: Lens, **sensor: object) -> Lens:
    """The lens with another sensor."""
    return lens.replaced(sensor=lens.sensor.model_copy(update=sensor))


def test_a_lens_that_meets_everything(paper_lens: Lens) -> None:
    report = check_design(relaxed(paper_lens, pixel_pitch_um=3.1, pixels=(9400, 7300)))
    assert report.feasible
    assert report.violations == ()
    assert all(c.met and not c.miss for c in report.constraints)


@pytest.mark.parametrize(
    ("pitch", "pixels", "start"),
    [
        (3.2, (5000, 4000), "Eq. 1: the sensor's space-bandwidth product of 9.87e+06 is less than"),
        (
            3.1,
            (7000, 7200),
            "footprint: 22 mm behind the exit vertex, light reaches 11.1650 mm from the axis",
        ),
    ],
)
def test_sensors_that_do_not_do(paper_lens: Lens, pitch: float, pixels: tuple[int, int], start: str) -> None:
    report = check_design(relaxed(paper_lens, pixel_pitch_um=pitch, pixels=pixels))
    assert any(v.startswith(start) for v in report.violations)
    assert not report.feasible


def test_vignetting(paper_lens: Lens) -> None:
    report = check_design(paper_lens.with_surface(1, semi_diameter_mm=8.0))
    assert report.throughput < 1.0
    (sentence,) = report.violations
    assert sentence.startswith("throughput: ")
    assert f"{100.0 * report.throughput:.4g} %" in sentence
    assert "at 0.532 µm" in sentence


def test_numerical_aperture_that_is_not_reached(paper_lens: Lens) -> None:
    report = check_design(paper_lens.with_surface(0, semi_diameter_mm=8.0))
    (sentence,) = (v for v in report.violations if v.startswith("numerical aperture"))
    assert "0.48" in sentence
    assert "less than the design's 0.5 by 2." in sentence
    larger = check_design(paper_lens.with_surface(0, semi_diameter_mm=8.3))
    assert not any(v.startswith("numerical aperture") for v in larger.violations)


def test_an_edge_that_is_no_edge(paper_lens: Lens) -> None:
    report = check_design(paper_lens.with_surface(0, thickness_mm=4.0, semi_diameter_mm=8.0))
    assert report.edge_thickness_mm is not None
    assert report.edge_thickness_mm < 0.0
    assert any(v.startswith("edge thickness: -") for v in report.violations)


def test_the_worst_wavelength_counts(paper_lens: Lens) -> None:
    lens = paper_lens.replaced(wavelengths_um=(0.656, 0.486, 0.588))
    report = check_design(lens)
    rows = {r.wavelength_um: r for r in report.wavelengths}
    assert set(rows) == {0.656, 0.486, 0.588}
    assert report.sbp_object == rows[0.486].sbp_object
    assert report.resolution_um == rows[0.656].resolution_um
    assert report.worst_ray.wavelength_um == 0.486  # its limit, lambda / (2 pitch), is the tightest
    assert report.spread_limit_deg == rows[0.486].spread_limit_deg
    assert report.max_spread_deg == rows[0.486].max_spread_deg
    assert report.efl_mm == rows[0.656].efl_mm
    radii = np.array([r.footprint_radius_mm for r in report.wavelengths])
    assert report.footprint_radius_mm == pytest.approx(radii.max(axis=0))


def test_a_lens_without_a_glass_element_has_no_edge(paper_lens: Lens) -> None:
    lens = paper_lens.replaced(surfaces=(Surface(semi_diameter_mm=8.26),))
    report = check_design(lens)
    assert report.edge_thickness_mm is None
    assert "edge thickness" not in [c.name for c in report.constraints]


@pytest.mark.parametrize("name", ["paper_singlet", "moulded_pair", "rectangular_sensor"])
def test_a_check_without_refinement_is_near_the_one_with_it(name: str) -> None:
    whole, quick = (check_design(DESIGNS / f"{name}.toml", refined=refined) for refined in (True, False))
    for exact, near in zip(whole.constraints, quick.constraints, strict=True):
        assert near.name == exact.name
        assert near.value == pytest.approx(exact.value, rel=1e-3)
    assert quick.max_spread_deg < whole.max_spread_deg  # the search did something


def test_ratios_of_the_report_are_those_of_the_oversampling_function(
    paper_lens: Lens, report: CheckReport
) -> None:
    assert [one.kind for one in report.oversampling] == ["amplitude", "phase", "complex"]
    for one in report.oversampling:
        found = oversampling_of(paper_lens, one.kind)  # type: ignore[arg-type]
        assert one.of_planes == pytest.approx(found.ratio_of_planes, rel=1e-12)
        assert one.all_planes == pytest.approx(found.ratio, rel=1e-12)


def test_ratio_of_one_plane_is_pixels_in_its_footprint_over_unknowns(report: CheckReport) -> None:
    pixels = [math.pi * (radius / 3.2e-3) ** 2 for radius in report.footprint_radius_mm]
    for one, unknowns in zip(report.oversampling, (1.0, 1.0, 2.0), strict=True):
        expected = [count / (unknowns * report.sbp_object) for count in pixels]
        assert one.of_planes == pytest.approx(expected, rel=1e-6)
    assert report.as_dict()["oversampling"][2]["of_planes"] == list(report.oversampling[2].of_planes)
