"""Scattered light of rough surfaces: closed forms, ray-transfer matrices, and random phase screens."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from programs import run_program
from small_lenses import lens_of

from lensdesign import (
    CoverGlass,
    DesignError,
    InputError,
    Lens,
    SurfacePerturbation,
    SurfaceRoughness,
    load_design,
)
from lensdesign.analysis.roughness import (
    RoughnessReport,
    half_width_cosine,
    refractions,
    roughness_report,
    scattered_fraction,
)
from lensdesign.files.design import design_text, save_design
from lensdesign.lens.scaling import scaled
from lensdesign.raytrace.compiled import compile_system

WAVELENGTH = 0.532
INDEX = 1.5
ROUGH = {"rms_nm": 5.0, "correlation_length_um": 8.0}


def screens(phase_rad: float, length: float, count: int, samples: int = 256) -> np.ndarray:
    """Periodic random phases of a Gaussian autocorrelation with the length in samples, by filtered noise."""
    rng = np.random.default_rng(5)
    f = np.fft.fftfreq(samples)
    spectrum = np.exp(-((np.pi * length) ** 2) * (f[:, None] ** 2 + f**2))
    spectrum *= samples**2 / spectrum.sum()
    noise = rng.standard_normal((count, samples, samples))
    return phase_rad * np.fft.ifft2(np.sqrt(spectrum) * np.fft.fft2(noise)).real


@pytest.mark.parametrize("phase_rad", [0.05, 0.3, 1.0])
def test_phase_screens_scatter_the_fraction_of_formula_1(phase_rad: float) -> None:
    drawn = screens(phase_rad, 6.0, 24)
    direct = np.abs(np.exp(1j * drawn).mean(axis=(0, 1, 2))) ** 2
    # Six standard deviations, for as many independent values as areas of pi l^2 in the screens.
    error = 6.0 * phase_rad**2 * math.exp(-(phase_rad**2)) / math.sqrt(drawn.size / (math.pi * 6.0**2))
    assert 1.0 - direct == pytest.approx(float(scattered_fraction(np.array(phase_rad))), abs=error)
    assert error < 0.1 * (1.0 - direct)


@pytest.mark.parametrize(("phase_rad", "tolerance"), [(0.05, 0.02), (0.3, 0.04)])
def test_phase_screens_scatter_to_the_angles_of_formula_2(phase_rad: float, tolerance: float) -> None:
    """A smooth surface scatters once; at the limit of 0.3 rad it scatters 4.5 % twice, at wider angles."""
    length, pitch_um = 6.0, 1.5
    powers = np.mean(np.abs(np.fft.fft2(np.exp(1j * screens(phase_rad, length, 24)))) ** 2, axis=0)
    powers[0, 0] = 0.0
    cosine = np.fft.fftfreq(len(powers), pitch_um) * WAVELENGTH
    square = np.sum(powers * (cosine[:, None] ** 2 + cosine**2)) / powers.sum()
    expected = half_width_cosine(length * pitch_um, WAVELENGTH)
    assert math.sqrt(square) == pytest.approx(expected, rel=tolerance)
    inside = cosine[:, None] ** 2 + cosine**2 < expected**2
    assert powers[inside].sum() / powers.sum() == pytest.approx(1.0 - math.exp(-1.0), rel=2.0 * tolerance)


def test_interference_of_a_phase_screen_with_the_direct_light() -> None:
    """Far behind a weak screen, the intensity has the relative deviation sqrt(2 F)."""
    phase_rad, length, pitch_um = 0.05, 6.0, 1.5
    field = np.fft.fft2(np.exp(1j * screens(phase_rad, length, 24)))
    f = np.fft.fftfreq(field.shape[-1], pitch_um)
    far = np.exp(-1j * math.pi * WAVELENGTH * 2e4 * (f[:, None] ** 2 + f**2))
    intensity = np.abs(np.fft.ifft2(field * far)) ** 2
    expected = math.sqrt(2.0 * float(scattered_fraction(np.array(phase_rad))))
    assert intensity.std() / intensity.mean() == pytest.approx(expected, rel=0.03)


def plate(**changes: Any) -> Lens:
    """A plate of glass with a rough back, lit by nearly parallel light."""
    back = {"semi_diameter_mm": 2.0, "roughness": ROUGH} | changes
    return lens_of({"thickness_mm": 3.0, "material": INDEX, "semi_diameter_mm": 1e-3, "stop": True}, back)


def on_axis(lens: Lens, **changes: Any) -> RoughnessReport:
    report = roughness_report(lens, field_points_mm=[(0.0, 0.0)], **changes)
    assert report is not None
    return report


def test_a_smooth_lens_has_no_report(paper_lens: Lens) -> None:
    assert roughness_report(paper_lens) is None


def test_small_phases_at_normal_incidence() -> None:
    found = on_axis(plate())
    phase = 2.0 * math.pi / WAVELENGTH * (INDEX - 1.0) * 5e-3
    assert found.mean_fraction == pytest.approx(phase**2, rel=0.5 * phase**2 + 1e-6)
    assert found.surfaces[0].largest_phase_rad == pytest.approx(phase, rel=1e-6)
    assert found.surfaces[0].half_width_deg == pytest.approx(
        math.degrees(math.asin(WAVELENGTH / (math.pi * 8.0))), rel=1e-6
    )
    for distance, radius in zip((2.0, 20.0), found.halo_radius_mm, strict=True):
        assert radius == pytest.approx(distance * WAVELENGTH / (math.pi * 8.0), rel=1e-5)


def test_oblique_incidence() -> None:
    """The phase of a plate's back grows with the angle as n cos r - cos i does for the ray inside out."""
    lens = plate()
    system = compile_system(lens, WAVELENGTH)
    sine = np.array([0.0, 0.3, 0.6])
    directions = np.stack([0.0 * sine, sine, np.sqrt(1.0 - sine**2)], axis=-1)
    found = refractions(system, np.zeros((3, 3)) - [0.0, 0.0, 1e-4], directions)
    inside = np.sqrt(INDEX**2 - sine**2)
    expected = np.abs(inside - np.sqrt(1.0 - sine**2))
    assert found.path_per_height[:, 0] == pytest.approx(expected, rel=1e-12)
    assert found.path_per_height[:, 1] == pytest.approx(expected, rel=1e-12)
    assert found.normal[:, 0] == pytest.approx(np.tile([0.0, 0.0, 1.0], (3, 1)), abs=1e-12)


def test_halo_of_the_front_surface_follows_from_ray_transfer_matrices() -> None:
    radius, thickness = -9.0, 3.0
    lens = lens_of(
        {
            "radius_mm": 40.0,
            "thickness_mm": thickness,
            "material": INDEX,
            "semi_diameter_mm": 1e-2,
            "stop": True,
            "roughness": ROUGH,
        },
        {"radius_mm": radius, "semi_diameter_mm": 2.0},
    )
    found = on_axis(lens)
    power = (1.0 - INDEX) / radius
    slope = 1.0 - power * thickness / INDEX  # of the ray behind the lens, for a kick of 1 behind the front
    width = half_width_cosine(8.0, WAVELENGTH)
    assert found.half_width_deg == pytest.approx(math.degrees(math.asin(abs(slope) * width)), rel=1e-4)
    for distance, halo in zip((2.0, 20.0), found.halo_radius_mm, strict=True):
        assert halo == pytest.approx(width * abs(thickness / INDEX + distance * slope), rel=1e-4)


def test_fractions_of_surfaces_combine_as_independent_phases() -> None:
    front = {"thickness_mm": 3.0, "material": INDEX, "semi_diameter_mm": 1e-3, "stop": True}
    rough = {"rms_nm": 100.0, "correlation_length_um": 8.0}
    found = on_axis(lens_of(front | {"roughness": rough}, {"semi_diameter_mm": 2.0, "roughness": rough}))
    one, other = found.surfaces
    assert 1.0 - found.mean_fraction == pytest.approx(
        (1.0 - one.mean_fraction) * (1.0 - other.mean_fraction), rel=1e-9
    )
    assert one.mean_fraction > 0.2


def test_a_surface_between_equal_media_scatters_nothing() -> None:
    found = on_axis(plate(material=INDEX))
    assert found.mean_fraction == 0.0
    assert found.halo_radius_mm == (0.0, 0.0)


def test_edge_rays_of_the_paper_lens_scatter_more(paper_lens: Lens) -> None:
    lens = paper_lens.with_surface(1, roughness=SurfaceRoughness(rms_nm=5.0, correlation_length_um=1.0))
    report = roughness_report(lens)
    assert report is not None
    phase = 2.0 * math.pi / WAVELENGTH * (float(lens.indices(WAVELENGTH)[1]) - 1.0) * 5e-3
    assert phase**2 < report.mean_fractions[0] < report.largest_fractions[0] < 1.5 * phase**2
    assert report.field_points_mm == ((0.0, 0.0), (0.0, 1.5))


def test_a_twin_scatters_as_much_to_the_same_angles(paper_lens: Lens) -> None:
    lens = paper_lens.with_surface(0, roughness=SurfaceRoughness(rms_nm=5.0, correlation_length_um=1.0))
    large, small = roughness_report(lens), roughness_report(scaled(lens, 1 / 32))
    assert large is not None
    assert small is not None
    assert small.mean_fractions == pytest.approx(large.mean_fractions, rel=1e-9)
    assert small.half_width_deg == pytest.approx(large.half_width_deg, rel=1e-6)
    assert np.multiply(32.0, small.halo_radius_mm) == pytest.approx(large.halo_radius_mm, rel=1e-6)


def test_perturbations_add_to_the_stated_roughness() -> None:
    lens = plate()
    rougher = on_axis(lens, surface_perturbations={1: SurfacePerturbation(roughness_rms_nm=5.0)})
    assert rougher.mean_fraction == pytest.approx(4.0 * on_axis(lens).mean_fraction, rel=1e-2)
    smooth = on_axis(lens, surface_perturbations={1: SurfacePerturbation(roughness_rms_nm=-5.0)})
    assert smooth.mean_fraction == 0.0
    with pytest.raises(InputError, match=r"surface 1: roughness_rms_nm: the design states no roughness"):
        on_axis(lens, surface_perturbations={0: SurfacePerturbation(roughness_rms_nm=1.0)})


def test_a_lens_without_light_is_refused(paper_lens: Lens) -> None:
    lens = paper_lens.with_surface(1, roughness=SurfaceRoughness(**ROUGH), semi_diameter_mm=1e-6)
    with pytest.raises(DesignError, match="no ray passes"):
        roughness_report(lens, field_points_mm=[(0.0, 1.5)])


@pytest.mark.parametrize(
    ("roughness", "words"),
    [
        ({"rms_nm": 60.0, "correlation_length_um": 0.6}, "exceeds the 0.3 rad of a smooth surface"),
        ({"rms_nm": 2.0, "correlation_length_um": 0.4}, "shorter than the wavelength of 0.532"),
        ({"rms_nm": 2.0, "correlation_length_um": 30.0}, "State the heights of one lens as the figure"),
    ],
)
def test_notes_on_the_range_of_the_model(roughness: dict[str, float], words: str) -> None:
    (note,) = on_axis(plate(roughness=roughness)).notes
    assert note.startswith("surface 2: ")
    assert words in note


def test_no_notes_within_the_range() -> None:
    report = on_axis(plate(roughness={"rms_nm": 2.0, "correlation_length_um": 1.0}))
    assert report.notes == ()
    # Of a half-width L / (pi l), the pixels of a pitch p sample up to L / (2 p).
    assert report.resolved_fraction == pytest.approx(1.0 - math.exp(-((math.pi / 6.4) ** 2)), rel=1e-4)
    sampled = 2.0 * report.mean_fraction * report.resolved_fraction
    assert report.interference_rms == pytest.approx(math.sqrt(sampled), rel=1e-6)


sizes = st.floats(1e-3, 1e3)


@given(rms_nm=sizes, correlation_length_um=sizes)
def test_a_design_keeps_its_roughness(
    tmp_path_factory: pytest.TempPathFactory, paper_design: Path, rms_nm: float, correlation_length_um: float
) -> None:
    roughness = SurfaceRoughness(rms_nm=rms_nm, correlation_length_um=correlation_length_um)
    lens = load_design(paper_design).with_surface(1, roughness=roughness)
    path = tmp_path_factory.getbasetemp() / "rough.toml"
    save_design(lens, path)
    assert load_design(path) == lens
    report = on_axis(lens)
    assert 0.0 <= report.mean_fraction <= 1.0
    assert all(math.isfinite(radius) for radius in report.halo_radius_mm)


def test_a_smooth_design_has_no_word_of_roughness(paper_lens: Lens) -> None:
    assert "rough" not in design_text(paper_lens)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (
            "{ rms_nm = 0, correlation_length_um = 1.0 }",
            "surface 2, roughness, rms_nm = 0: must be greater than 0",
        ),
        ("{ rms_nm = 1.0 }", "surface 2, roughness, correlation_length_um: missing key"),
        (
            "{ rms_nm = 1.0, correlation_length_um = -2 }",
            "correlation_length_um = -2: must be greater than 0",
        ),
        ("{ rms = 1.0, correlation_length_um = 2 }", "roughness, rms: unknown key"),
        ("5.0", "surface 2, roughness = 5.0"),
    ],
)
def test_wrong_tables_are_refused_by_name(tmp_path: Path, paper_design: Path, table: str, words: str) -> None:
    path = tmp_path / "lens.toml"
    path.write_text(paper_design.read_text() + f"roughness = {table}\n")
    with pytest.raises(DesignError) as refused:
        load_design(path)
    assert words in str(refused.value)


def test_the_check_prints_scattered_light(
    tmp_path: Path, paper_design: Path, run: Callable[..., Any]
) -> None:
    path = tmp_path / "lens.toml"
    text = "roughness = { rms_nm = 5.0, correlation_length_um = 10.0 }\n"
    path.write_text(paper_design.read_text() + text)
    shown = run("check", path).stdout
    assert "Scattered light at 0.532 µm" in shown
    assert "0.114, 0.138 %" in shown
    assert "a pattern of 4.8 % rms of the intensity in the pixels" in shown
    assert "warning: surface 2: correlation_length_um = 10" in shown
    data = json.loads(run("check", path, "--json").stdout)["roughness"]
    assert data["surfaces"][0]["rms_nm"] == 5.0
    assert data["mean_fractions"][0] == pytest.approx(1.14e-3, rel=5e-3)
    assert json.loads(run("check", paper_design, "--json").stdout)["roughness"] is None


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    return lambda *arguments: run_program(monkeypatch, capsys, "lensdesign", *arguments)


def test_a_halo_is_smaller_by_the_path_that_a_cover_glass_saves() -> None:
    """Behind the last surface a plate of thickness t shortens the way in air by t (1 - 1 / n)."""
    rough = load_design("designs/paper_singlet.toml").with_surface(1, roughness=SurfaceRoughness(**ROUGH))
    glass = CoverGlass(thickness_mm=1.0, material=INDEX, distance_mm=0.5)
    glazed = rough.replaced(sensor=rough.sensor.replaced(cover_glass=glass))
    without, with_glass = (np.array(roughness_report(one).halo_radius_mm) for one in (rough, glazed))
    # The surface lies in front of its vertex by a mean height, which both radii give.
    ratio = without[0] / without[1]
    height_mm = (22.0 * ratio - 2.0) / (1.0 - ratio)
    away_mm = np.array([2.0, 22.0]) + height_mm
    assert with_glass / without == pytest.approx(1.0 - (1.0 - 1.0 / INDEX) / away_mm, abs=0.005)
