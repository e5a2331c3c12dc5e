"""Effects of coatings on the light: Fresnel's equations integrated over the stop, and the command."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from places import DESIGNS
from programs import Command
from scipy.integrate import quad
from small_lenses import lens_of

from lensdesign import Coating, CoatingLayer, DesignError, InputError, check_design, load_design
from lensdesign.analysis.coatings import coating_report

INDEX, DISTANCE_MM, STOP_MM = 1.5, 10.0, 6.0


def plate():
    """A plate with the stop on its front, 10 mm behind the object."""
    lens = lens_of(
        {"thickness_mm": 2.0, "material": INDEX, "semi_diameter_mm": STOP_MM, "stop": True},
        {"semi_diameter_mm": 12.0},
    )
    return lens.replaced(object=lens.object.replaced(working_distance_mm=DISTANCE_MM))


def fresnel(radius_mm: float) -> tuple[float, float]:
    """Amplitudes of s and p light through both faces, for an axial ray at a radius of the stop."""
    i = math.atan(radius_mm / DISTANCE_MM)
    r = math.asin(math.sin(i) / INDEX)
    if radius_mm == 0.0:
        reflected = ((INDEX - 1.0) / (INDEX + 1.0)) ** 2
        return 1.0 - reflected, 1.0 - reflected
    rs, rp = (math.sin(i - r) / math.sin(i + r)) ** 2, (math.tan(i - r) / math.tan(i + r)) ** 2
    return 1.0 - rs, 1.0 - rp


def mean(function) -> float:
    return quad(lambda r: 2.0 * r / STOP_MM**2 * function(*fresnel(r)), 0.0, STOP_MM, epsabs=1e-13)[0]


def test_a_bare_plate_follows_fresnels_equations():
    report = coating_report(plate().with_coating("bare"))
    centre, (front, back) = report.centre, report.surfaces
    transmittance = mean(lambda s, p: 0.5 * (s * s + p * p))
    assert centre.transmittance == pytest.approx(transmittance, abs=1e-9)
    assert centre.uncoated_transmittance == centre.transmittance
    amplitude = mean(lambda s, p: math.sqrt(0.5 * (s * s + p * p)))
    deviation = mean(lambda s, p: (math.sqrt(0.5 * (s * s + p * p)) - amplitude) ** 2)
    assert centre.apodization_rms == pytest.approx(math.sqrt(deviation) / amplitude, rel=1e-6)
    s, p = fresnel(STOP_MM)
    assert centre.largest_diattenuation == pytest.approx((p * p - s * s) / (p * p + s * s), rel=1e-9)
    # In the direction f of the stop, the crossed amplitude is (p - s) sin f cos f.
    crossed = mean(lambda s, p: (p - s) ** 2 / 8.0) / transmittance
    assert centre.crossed_rms == pytest.approx(math.sqrt(crossed), rel=1e-6)
    assert centre.largest_retardance_deg < 1e-9
    assert front.transmittance == pytest.approx(0.96)
    for surface, incidence in ((front, None), (back, "inside")):
        steepest = math.atan((STOP_MM + 0.5 * plate().object.field_diameter_mm) / DISTANCE_MM)
        if incidence:
            steepest = math.asin(math.sin(steepest) / INDEX)
        assert surface.largest_incidence_deg == pytest.approx(math.degrees(steepest), abs=1e-9)
    s, p = fresnel(STOP_MM + 0.5 * plate().object.field_diameter_mm)
    assert front.transmittance_at_largest == pytest.approx(0.5 * (s + p), abs=1e-12)
    assert back.transmittance_at_largest == pytest.approx(0.5 * (s + p), abs=1e-12)


def test_ideal_coatings_lose_nothing_and_rotate_skew_rays():
    report = coating_report(load_design(DESIGNS / "paper_singlet.toml"))
    assert report.is_ideal
    assert [one.coating for one in report.surfaces] == ["ideal", "ideal"]
    for point in report.points:
        assert point.transmittance == pytest.approx(1.0, abs=1e-12)
        assert point.largest_diattenuation < 1e-12
        assert 0.9 < point.uncoated_transmittance < 0.92
    assert report.centre.crossed_rms < 1e-12
    assert report.edge.crossed_rms == pytest.approx(0.0074, abs=1e-4)
    assert report.edge.largest_retardance_deg > 1.0


def test_the_edge_has_the_worst_value_of_each_quantity():
    lens = load_design(DESIGNS / "paper_singlet.toml").with_coating("bare")
    points = [(0.0, 0.0), (0.0, 1.0), (1.5, 0.0)]
    report = coating_report(lens, 0.6, points)
    assert [point.field_mm for point in report.points] == points
    assert report.edge.transmittance == min(point.transmittance for point in report.points[1:])
    assert report.edge.crossed_rms == max(point.crossed_rms for point in report.points[1:])
    alone = coating_report(lens, 0.6, points[:1])
    assert alone.edge == alone.centre


def test_a_point_without_light_and_a_short_table_are_named(tmp_path):
    lens = plate()
    narrow = lens.with_surface(0, semi_diameter_mm=1.0).with_surface(1, semi_diameter_mm=0.3)
    with pytest.raises(DesignError, match=r"no ray from the object point \(40, 0\) mm passes at 0.55 µm"):
        coating_report(narrow, 0.55, [(40.0, 0.0)])
    path = tmp_path / "short.csv"
    rows = [f"0.55,{a},0.99,0,0.99,0" for a in (0, 10)]
    header = "wavelength_um,incidence_deg,ts_amplitude,ts_phase_deg,tp_amplitude,tp_phase_deg"
    path.write_text("\n".join([header, *rows]))
    with pytest.raises(InputError, match=r"surface 1, coating: .*short.csv: ends at an angle .* of 10 deg"):
        coating_report(lens.with_surface(0, coating=Coating(file=path)), 0.55)


def test_the_check_has_the_coatings_at_each_wavelength():
    lens = load_design(DESIGNS / "paper_singlet.toml").replaced(wavelengths_um=(0.532, 0.45, 0.65))
    layer = CoatingLayer(material="MgF2", quarter_waves=1.0)
    coated = lens.with_coating(Coating(layers=(layer,), design_wavelength_um=0.65))
    report = check_design(coated, refined=False)
    assert [one.wavelength_um for one in report.coatings] == [0.532, 0.45, 0.65]
    assert report.darkest is report.coatings[1]
    assert "transmittance on the axis" in report._repr_html_()
    assert "transmittance" not in check_design(lens, refined=False)._repr_html_()


def test_the_command_prints_coatings_and_replaces_them(command: Command):
    path = DESIGNS / "feasible_singlet.toml"
    code, out, err = command("check", path)
    assert (code, err) == (0, "")
    assert "ideal coatings: all light is transmitted; uncoated surfaces would transmit 91." in out
    assert "Coatings at" not in out
    code, out, err = command("check", path, "--coating", "mgf2")
    assert (code, err) == (0, "")
    assert "MgF2, quarter wave at 532 nm" in out
    assert "Light behind the lens at 0.532 µm" in out
    assert "ideal coatings" not in out
    report = json.loads(command("check", path, "--coating", "bare", "--json")[1])["coatings"][0]
    assert report["surfaces"][0]["coating"] == "bare"
    assert report["points"][0]["transmittance"] == pytest.approx(0.913, abs=2e-3)
    assert np.isfinite([point["crossed_rms"] for point in report["points"]]).all()
