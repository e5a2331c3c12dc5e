"""The gallery: every specification gives its lens, every lens keeps its promises and its page is right."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import pytest
from places import DESIGNS, ROOT
from typer.testing import CliRunner

from lensdesign import Lens, load_design
from lensdesign.analysis.check import check_design
from lensdesign.analysis.exit_beam import footprint, largest_spread_angle
from lensdesign.analysis.report import CheckReport
from lensdesign.cli.commands import app
from lensdesign.lens.glass import refractive_index
from lensdesign.lens.solid import closed_elements
from lensdesign.manufacture.drawing.sheets import lens_drawing
from lensdesign.manufacture.mesh.mesh import lens_mesh
from lensdesign.optimization import load_specification, optimize
from lensdesign.optimization.as_built import as_built_by
from lensdesign.plots.plots import layout_figure, write_figure

SVG = "{http://www.w3.org/2000/svg}"
PAGE = ROOT / "docs" / "gallery.md"
OURS = (
    "feasible_singlet",
    "thinnest_singlet",
    "moulded_pair",
    "wide_field",
    "phone_lens",
    "q_type_lens",
    "stock_pair",
    "rectangular_sensor",
    "single_complex",
    "single_phase",
)
LENSES = ("paper_singlet", *OURS)
# Lenses whose terms may change together without a change of their goal.
FLAT = ("q_type_lens",)
# Edge in mm, slope in degrees.
MOULDED = {"moulded_pair": (1.0, 31.0), "phone_lens": (0.4, 34.0), "q_type_lens": (0.4, 41.0)}


@pytest.fixture(scope="module")
def lenses() -> dict[str, Lens]:
    return {name: load_design(DESIGNS / f"{name}.toml") for name in LENSES}


@pytest.fixture(scope="module")
def reports(lenses: dict[str, Lens]) -> dict[str, CheckReport]:
    return {name: check_design(lens) for name, lens in lenses.items()}


@pytest.mark.parametrize("name", OURS)
def test_specifications_give_their_lenses(name: str, lenses: dict[str, Lens], tmp_path: Path) -> None:
    """To the last digits on one machine; elsewhere the search may end a few parts in 100,000 beside."""
    path = tmp_path / f"{name}.toml"
    done = CliRunner().invoke(app, ["optimize", str(DESIGNS / f"{name}_spec.toml"), "-o", str(path)])
    assert done.exit_code == 0, done.output  # every constraint is met
    found = load_design(path)
    report = check_design(found)
    assert report.violations == ()  # which follows worst rays on its own
    if name in FLAT:
        assert report.max_spread_deg == pytest.approx(check_design(lenses[name]).max_spread_deg, rel=1e-4)
    else:
        assert numbers(found) == pytest.approx(numbers(lenses[name]), rel=1e-4)
    assert structure(found) == structure(lenses[name])


def numbers(lens: Lens) -> list[float]:
    """What a search may change."""
    shapes = [[*s.shape.terms, s.thickness_mm or 0.0] for s in lens.surfaces]
    return [lens.object.working_distance_mm, *(x for shape in shapes for x in shape)]


def structure(lens: Lens) -> list[object]:
    """What it may not."""
    media = [(s.material, s.kind, s.stop) for s in lens.surfaces]
    return [lens.title, lens.wavelengths_um, lens.sensor, lens.edges, *media]


@pytest.mark.parametrize("name", LENSES)
def test_lenses_meet_their_constraints(name: str, reports: dict[str, CheckReport]) -> None:
    report = reports[name]
    if name == "paper_singlet":
        (violation,) = report.violations
        assert violation.startswith("Eq. 2")
        assert "by 0.9 %" in violation
    else:
        assert report.feasible, report.violations


@pytest.mark.parametrize("name", LENSES)
def test_lenses_close_and_have_a_sheet_for_each_element(name: str, lenses: dict[str, Lens]) -> None:
    elements = closed_elements(lenses[name])
    assert len(elements) == (2 if name.endswith("pair") else 1)
    for element in elements:
        mesh = lens_mesh(lenses[name], chord_error_um=2.0, element=element.index)
        assert mesh.mesh.is_watertight
        assert mesh.mesh.volume == pytest.approx(element.volume_mm3, rel=5e-3)
    if all(element.rotational for element in elements):
        assert len(lens_drawing(lenses[name]).sheets) == len(elements)


@pytest.mark.parametrize("name", LENSES)
def test_the_page_shows_the_layout_as_it_is_drawn(name: str, lenses: dict[str, Lens], tmp_path: Path) -> None:
    """Words and the number of strokes: what they look like is another release's of Matplotlib."""
    write_figure(layout_figure(lenses[name]), tmp_path / "layout.svg")
    kept = ROOT / "docs" / "images" / "gallery" / f"{name}_layout.svg"
    drawn, shown = (ElementTree.parse(path).getroot() for path in (tmp_path / "layout.svg", kept))
    assert svg_words(shown) == svg_words(drawn)
    assert sum(1 for _ in shown.iter(f"{SVG}path")) == sum(1 for _ in drawn.iter(f"{SVG}path"))


def svg_words(root: ElementTree.Element) -> list[str]:
    """Texts of a picture, in order."""
    return ["".join(text.itertext()).strip() for text in root.iter(f"{SVG}text")]


def test_the_biconic_lens_lights_more_of_the_longer_side(lenses: dict[str, Lens]) -> None:
    """Beyond half the shorter side, which no round footprint may be; what spreads less goes farther out."""
    lens = lenses["rectangular_sensor"]
    last = footprint(lens, 0.532, 22.0)
    assert last.inside
    assert last.radius_mm > last.sensor_half_side_mm + 1.0
    assert largest_spread_angle(lens, 0.532).spread_deg > 4.6


@pytest.mark.parametrize("name", sorted(MOULDED))
def test_moulded_lenses_can_be_moulded(name: str, lenses: dict[str, Lens]) -> None:
    """An edge to hold, walls of like thickness, and slopes that a mould lets go of, from vertex to edge."""
    edge, slope = MOULDED[name]
    for element in closed_elements(lenses[name]):
        assert element.edge_thickness_mm >= edge - 0.01
        assert element.back.vertex_z_mm - element.front.vertex_z_mm < 4.0 * element.edge_thickness_mm
        for meridian in (element.front, element.back):
            slopes = meridian.surface.slope([0.02 * i * meridian.end_mm for i in range(51)])
            assert max(abs(float(s)) for s in slopes) <= math.tan(math.radians(slope))


def test_q_type_aspheres_leave_room_for_tolerances_that_conics_do_not(lenses: dict[str, Lens]) -> None:
    """A small sibling of `benchmarks.q_type_yield`: the yield of both by the same trials."""
    lens = lenses["q_type_lens"]
    with_conics = load_specification(DESIGNS / "conic_phone_lens_spec.toml")
    settings = with_conics.optimize.replaced(starts=1, max_seconds=20.0)
    conic = optimize(with_conics.replaced(optimize=settings))
    assert not conic.feasible
    assert conic.lens.exit_vertex_z_mm == lens.exit_vertex_z_mm
    study = as_built_by(str(DESIGNS / "q_type_lens_tolerances.toml"), lens)
    ours, other = study.trials([("Q", lens), ("conic", conic.lens)], 200, 5).rows
    assert ours.good > 0.95
    assert other.good < 0.05


def test_stock_lenses_have_the_focal_length_of_their_catalogue(lenses: dict[str, Lens]) -> None:
    """f = 49.8 mm at 587.6 nm, radius / (n - 1) of a plano-convex lens."""
    for surface in lenses["stock_pair"].surfaces[1:3]:
        radius = abs(surface.radius_mm or 0.0)
        assert radius / (refractive_index("N-BK7", 0.5876) - 1.0) == pytest.approx(49.8, abs=0.05)


def key_figures(name: str, lens: Lens, report: CheckReport) -> list[str]:
    """Rows of the lens's table on the page."""
    sensor, scene = lens.sensor, lens.object
    planes = " and ".join(f"{d:g}" for d in report.plane_distances_mm)
    reach = ", ".join(f"{r:.3f}" for r in report.footprint_radius_mm)
    media = [str(s.material) for s in lens.surfaces if s.material is not None]
    resolution = [w / (2.0 * scene.numerical_aperture) for w in sorted(lens.wavelengths_um)]
    at = f" at {report.worst_ray.wavelength_um:.4g} µm" if len(resolution) > 1 else ""
    return [
        f"| field, NA | {scene.field_diameter_mm:g} mm, {scene.numerical_aperture:g} |",
        f"| wavelengths | {', '.join(f'{w:.4g}' for w in sorted(lens.wavelengths_um))} µm |",
        f"| sensor | {sensor.pixels[0]} × {sensor.pixels[1]} pixels of {sensor.pixel_pitch_um:g} µm, "
        f"{sensor.size_mm[0]:.2f} × {sensor.size_mm[1]:.2f} mm |",
        f"| largest spread; limit | {report.max_spread_deg:.3f}°; {report.spread_limit_deg:.3f}°{at} |",
        f"| light reaches, {planes} mm behind; half the sensor's shorter side | {reach}; "
        f"{report.sensor_half_side_mm:.3f} mm |",
        f"| first to last vertex; material | {lens.exit_vertex_z_mm:.3f} mm; {', '.join(media)} |",
        f"| resolution λ / (2 NA) | {' / '.join(f'{r:.3f}' for r in resolution)} µm |",
        f"| working distance | {scene.working_distance_mm:.2f} mm |",
        f"| filled fraction of the beam's étendue | {100.0 * report.etendue_share:.1f} % |",
    ]


@pytest.mark.parametrize("name", LENSES)
def test_the_page_shows_every_lens_as_it_is(
    name: str, lenses: dict[str, Lens], reports: dict[str, CheckReport]
) -> None:
    page = PAGE.read_text(encoding="utf-8")
    for row in key_figures(name, lenses[name], reports[name]):
        assert row in page
    if name in OURS:
        assert f"    lensdesign optimize designs/{name}_spec.toml -o designs/{name}.toml\n" in page
    for picture in ("layout", "spread"):
        path = PAGE.parent / "images" / "gallery" / f"{name}_{picture}.svg"
        assert f"(images/gallery/{path.name})" in page
        assert 5_000 < path.stat().st_size < 150_000
