"""Semantic tolerances in STEP AP242: every number of the sheet comes back on the face to which it belongs."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from drawing_checks import lens_of, singlet
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from places import DESIGNS
from random_lenses import lenses, numbers
from typer.testing import CliRunner

from lensdesign import Lens, load_design
from lensdesign.cli.commands import app
from lensdesign.errors import InputError
from lensdesign.lens.solid import closed_elements
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances, SurfaceTolerances
from lensdesign.manufacture.step import writing
from lensdesign.manufacture.step.semantic_tolerances import SemanticTolerances, semantic_tolerances
from lensdesign.manufacture.step.step_files import read_semantic_tolerances, silent_ocp
from lensdesign.manufacture.step.writing import write_step

pytest.importorskip("OCP")


def maybe(low: float, high: float) -> st.SearchStrategy[float | None]:
    return st.none() | numbers(low, high)


@st.composite
def sides(draw: st.DrawFn) -> SurfaceTolerances:
    values = {
        "irregularity_fringes": draw(maybe(0.01, 5.0)),
        "centring_arcmin": draw(maybe(0.01, 60.0)),
        "decenter_mm": draw(maybe(1e-4, 0.1)),
        draw(st.sampled_from(["radius_mm", "radius_fringes"])): draw(maybe(1e-3, 10.0)),
    }
    return SurfaceTolerances.model_validate(values)


sheets = st.builds(
    DrawingTolerances,
    left=sides(),
    right=sides(),
    thickness_mm=maybe(1e-3, 0.5),
    diameter_mm=maybe(1e-3, 1.0),
    fringe_wavelength_um=numbers(0.4, 0.8),
)


def test_the_datum_of_an_edge_with_draft_is_its_cone() -> None:
    lens = singlet(30.0, -40.0, 5.0, (6.0, 6.0))
    stated = DrawingTolerances(
        left=SurfaceTolerances(centring_arcmin=3.0),
        right=SurfaceTolerances(),
        thickness_mm=0.1,
        diameter_mm=0.1,
    )
    kinds = []
    for draft in (None, 2.0):
        edge = {"semi_diameter_mm": 8.0, "draft_deg": draft}
        (element,) = closed_elements(lens.replaced(edges=(edge,)))
        found = semantic_tolerances(element, stated)
        assert found.datum_faces == (1,)
        assert [one.kind for one in found.geometric] == ["circular run-out"]
        kinds.append([one.kind for one in found.dimensions])
    # A cone has no size that a diameter could state.
    assert kinds == [["linear distance", "diameter"], ["linear distance"]]


@settings(max_examples=20)
@given(lens=lenses(), sheet=sheets, other=sheets)
def test_random_lenses_and_sheets(lens: Lens, sheet: DrawingTolerances, other: DrawingTolerances) -> None:
    try:
        elements = closed_elements(lens)
    except InputError:
        reject()
    tolerances = [(sheet, other)[element.index % 2] for element in elements]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "lens.step"
        report = write_step(lens, path, tolerances=tolerances)
        with silent_ocp():
            found = read_semantic_tolerances(path)
        assert tuple(found) == report.tolerances
        text = path.read_text(encoding="ascii").replace("\n", "")
    assert "AP242" in text
    for element, stated, body in zip(elements, tolerances, found, strict=True):
        check(semantic_tolerances(element, stated), body)
        sizes = {one.kind: (one.value_mm, one.tolerance_mm) for one in body.dimensions}
        thickness = lens.surfaces[element.surfaces[0]].thickness_mm
        assert_close(sizes["linear distance"], (thickness, stated.thickness_mm))
        assert_close(sizes["diameter"], (2.0 * element.edge_mm, stated.diameter_mm))
    plus_minus = re.findall(r"TOLERANCE_VALUE\((#\d+),(#\d+)\)", text)
    sizes_of_all = [one for body in found for one in body.dimensions]
    assert len(plus_minus) == sum(one.tolerance_mm is not None for one in sizes_of_all)
    for lower, upper in plus_minus:
        low, high = (
            float(re.search(rf"{entity} = MEASURE_WITH_UNIT\((.*?),#", text)[1]) for entity in (lower, upper)
        )
        assert low == pytest.approx(-high, rel=1e-11)
        assert low < 0.0
    # Every number is in mm: the file has one unit of length.
    assert set(re.findall(r"SI_UNIT\(([^)]*)METRE", text)) == {".MILLI.,."}


def check(stated: SemanticTolerances, found: SemanticTolerances) -> None:
    """Compare tolerances number by number, whatever their order."""
    assert found.datum_faces == stated.datum_faces
    for name in ("dimensions", "geometric"):
        pairs = [sorted(getattr(one, name), key=repr_of) for one in (stated, found)]
        assert len(pairs[0]) == len(pairs[1])
        for own, other in zip(*pairs, strict=True):
            assert repr_of(own) == repr_of(other)
            fields = [name for name in ("value_mm", "tolerance_mm", "zone_mm") if hasattr(own, name)]
            assert_close(*([getattr(item, name) for name in fields] for item in (other, own)))


def assert_close(found: Sequence[float | None], stated: Sequence[float | None]) -> None:
    """Compare numbers to the 13 digits of a file; None means no tolerance."""
    assert [value is None for value in found] == [value is None for value in stated]
    assert [value or 0.0 for value in found] == pytest.approx([value or 0.0 for value in stated], rel=1e-11)


def repr_of(one: Any) -> tuple[Any, ...]:
    return one.kind, getattr(one, "faces", None) or one.face, getattr(one, "datum", "")


def test_zones_are_those_of_the_indications(tmp_path: Path) -> None:
    lens = singlet(-50.0, None, 4.0, (10.0, 9.0))
    left = SurfaceTolerances(
        radius_fringes=4.0, irregularity_fringes=1.0, centring_arcmin=3.0, decenter_mm=0.02
    )
    right = SurfaceTolerances(radius_fringes=2.0, test_diameter_mm=5.0)
    sheet = DrawingTolerances(left=left, right=right, thickness_mm=0.05, fringe_wavelength_um=0.6)
    (element,) = closed_elements(lens)
    stated = semantic_tolerances(element, sheet)
    profile, runout, coaxiality = stated.geometric  # the test diameter leaves no zone of the right surface
    assert profile.zone_mm == pytest.approx(5.0 * 0.3e-3)
    assert runout.zone_mm == pytest.approx(20.0 * math.sin(math.radians(0.05)))
    assert coaxiality.zone_mm == pytest.approx(0.04)
    assert (profile.datum, runout.datum, coaxiality.datum) == ("", "A", "A")
    assert stated.datum_faces == (1,)
    # A radius tolerance is the sagitta error that it causes, as a number of fringe spacings is.
    (radius,) = (one for one in stated.dimensions if one.kind == "spherical radius")
    by_radius = sheet.replaced(left=left.replaced(radius_fringes=None, radius_mm=radius.tolerance_mm))
    assert semantic_tolerances(element, by_radius).geometric[0].zone_mm == pytest.approx(profile.zone_mm)
    report = write_step(lens, tmp_path / "lens.step", tolerances=[sheet])
    check(stated, report.tolerances[0])


def test_a_flange_divides_the_cylinder_of_datum_and_diameter(tmp_path: Path) -> None:
    edge = {
        "semi_diameter_mm": 6.5,
        "front_bevel_mm": 0.2,
        "flange": {"semi_diameter_mm": 8.0, "distance_mm": 3.0, "thickness_mm": 1.0},
    }
    shapes = (
        {"radius_mm": 20.0, "thickness_mm": 6.0, "material": "N-BK7", "semi_diameter_mm": 5.0},
        {"radius_mm": -30.0, "semi_diameter_mm": 5.0},
    )
    side = SurfaceTolerances(centring_arcmin=1.0)
    sheet = DrawingTolerances(left=side, right=side, diameter_mm=0.1)
    report = write_step(lens_of(*shapes, edge=[edge]), tmp_path / "lens.step", tolerances=[sheet])
    (body,) = report.tolerances
    assert body.datum_faces == (2, 6)
    assert body.dimensions[1].faces == ((2, 6), ())


def test_a_biconic_has_no_run_out(tmp_path: Path) -> None:
    lens = load_design(DESIGNS / "rectangular_sensor.toml")
    side = SurfaceTolerances(irregularity_fringes=1.0, centring_arcmin=1.0)
    sheet = DrawingTolerances(left=side, right=side)
    (body,) = write_step(lens, tmp_path / "lens.step", tolerances=[sheet]).tolerances
    assert [one.kind for one in body.geometric] == ["surface profile"] * 2


def test_same_bytes_and_no_tolerances_without_a_sheet(paper_lens: Lens, tmp_path: Path) -> None:
    side = SurfaceTolerances(irregularity_fringes=1.0, centring_arcmin=1.0)
    sheet = DrawingTolerances(left=side, right=side, thickness_mm=0.1)
    paths = [tmp_path / f"{name}.step" for name in "abc"]
    for path in paths[:2]:
        write_step(paper_lens, path, tolerances=[sheet])
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert write_step(paper_lens, paths[2]).tolerances == ()
    text = paths[2].read_text(encoding="ascii")
    assert "AUTOMOTIVE_DESIGN" in text
    assert "TOLERANCE" not in text


def test_nothing_is_written_if_a_tolerance_comes_back_otherwise(
    paper_lens: Lens, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sheet = DrawingTolerances(thickness_mm=0.1)
    with pytest.raises(InputError, match="2 elements, but the lens has 1"):
        write_step(paper_lens, tmp_path / "lens.step", tolerances=[sheet, sheet])
    right = writing.write_solids

    def wrong(*arguments: Any) -> None:
        *others, (body,) = arguments
        size, *rest = body.dimensions
        off = replace(body, dimensions=(replace(size, tolerance_mm=0.1000001), *rest))
        right(*others, (off,))

    monkeypatch.setattr(writing, "write_solids", wrong)
    with pytest.raises(InputError, match="tolerances read back differ"):
        write_step(paper_lens, tmp_path / "lens.step", tolerances=[sheet])
    assert not list(tmp_path.iterdir())


def test_the_drawing_command_writes_the_tolerances_of_the_sheet(tmp_path: Path) -> None:
    sheet, path = tmp_path / "sheet.toml", tmp_path / "lens.step"
    sheet.write_text(
        "[[tolerances]]\nthickness_mm = 0.05\ndiameter_mm = 0.02\n"
        "[tolerances.left]\nirregularity_nm = 200\ncentring_arcmin = 1\n",
        encoding="utf-8",
    )
    arguments = ["drawing", str(DESIGNS / "paper_singlet.toml"), "--sheet", str(sheet), "-o", str(path)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.exception
    assert done.stdout.startswith(f"wrote {path}: 1 solid with 4 semantic tolerances, read back")
    done = CliRunner().invoke(app, [*arguments, "--json"])
    (body,) = json.loads(done.stdout)["tolerances"]
    assert [(one["kind"], one["tolerance_mm"]) for one in body["dimensions"]] == [
        ("linear distance", 0.05),
        ("diameter", 0.02),
    ]
    assert body["geometric"][0]["zone_mm"] == pytest.approx(200e-6)
    done = CliRunner().invoke(app, [*arguments[:-1], str(tmp_path / "sheet.dwg")])
    assert isinstance(done.exception, InputError)
    assert ".pdf, .svg, .dxf, .step or .stp" in str(done.exception)
