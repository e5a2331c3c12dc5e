"""Outlines in DXF: read back by ezdxf, every curve is that of the design, or no file is written."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import ezdxf
import numpy as np
import pytest
from hypothesis import given, reject, settings
from places import DESIGNS
from random_lenses import lenses
from small_lenses import lens_of
from typer.testing import CliRunner

from lensdesign import Lens, load_design
from lensdesign.analysis.outline import drawn_outline
from lensdesign.cli.commands import app
from lensdesign.errors import InputError
from lensdesign.lens.solid import closed_elements
from lensdesign.manufacture.dxf import outline
from lensdesign.manufacture.dxf.outline import write_outline


def curves_of(path: Path) -> dict[str, list[Any]]:
    """Entities of a file by layer; the file is in mm and ezdxf finds no fault in it."""
    document = ezdxf.readfile(path)
    assert document.header["$INSUNITS"] == 4
    assert document.header["$MEASUREMENT"] == 1
    assert not document.audit().errors
    found: dict[str, list[Any]] = {}
    for entity in document.modelspace():
        found.setdefault(entity.dxf.layer, []).append(entity)
    return found


def check_surface(entity: Any, lens: Lens, index: int, end_mm: float, allowed_mm: float) -> None:
    """Compare a curve with the sag of a surface, sampled without the exporter's own measurement."""
    surface, vertex_z_mm = lens.surfaces[index], lens.vertex_z_mm[index]
    if entity.dxftype() == "ARC":
        assert entity.dxf.radius == pytest.approx(abs(surface.radius_mm), abs=1e-9)
        assert entity.dxf.center.x == pytest.approx(vertex_z_mm + surface.radius_mm, abs=1e-9)
        assert entity.dxf.center.y == 0.0
        points = np.array([(point.x, point.y) for point in entity.flattening(1e-3)])
    elif entity.dxftype() == "LINE":
        points = np.array([tuple(point)[:2] for point in (entity.dxf.start, entity.dxf.end)])
    else:
        tool = entity.construction_tool()
        points = np.array([(p.x, p.y) for p in tool.points(np.linspace(0.0, tool.max_t, 301))])
    z, r = points.T
    assert max(abs(r)) == pytest.approx(end_mm, abs=1e-9)
    assert r[0] == pytest.approx(-r[-1], abs=1e-9)
    inside = np.abs(r) < end_mm * (1.0 - 1e-6)
    sag = vertex_z_mm + surface.sag_mm(np.abs(r[inside]))
    slope = np.abs(surface.slope(np.abs(r[inside])))
    assert np.all(np.abs(z[inside] - sag) <= allowed_mm * np.hypot(1.0, slope))


def test_the_paper_lens(paper_lens: Lens, tmp_path: Path) -> None:
    path = tmp_path / "outline.dxf"
    lens = drawn_outline(paper_lens).lens
    found = write_outline(lens, path)
    assert found.bytes == path.stat().st_size
    assert found.largest_deviation_mm < 1e-12
    layers = curves_of(path)
    assert set(layers) == {"AXIS", "ELEMENT_1_SURFACE_1", "ELEMENT_1_SURFACE_2", "ELEMENT_1_EDGE"}
    (element,) = closed_elements(lens)
    (arc,), (conic,) = layers["ELEMENT_1_SURFACE_1"], layers["ELEMENT_1_SURFACE_2"]
    assert (arc.dxftype(), conic.dxftype(), conic.dxf.degree) == ("ARC", "SPLINE", 2)
    check_surface(arc, lens, 0, element.front.end_mm, 1e-9)
    check_surface(conic, lens, 1, element.back.end_mm, 1e-9)
    edge = [(line.dxf.start, line.dxf.end) for line in layers["ELEMENT_1_EDGE"]]
    points = np.array([tuple(point) for ends in edge for point in ends])
    assert np.abs(points[:, 1]).max() == pytest.approx(0.5 * 22.5, abs=1e-12)
    (axis,) = layers["AXIS"]
    assert axis.dxf.start.x < 0.0 < paper_lens.vertex_z_mm[1] < axis.dxf.end.x
    assert axis.dxf.start.y == axis.dxf.end.y == 0.0


def test_edges_bevels_and_flanges_have_their_layers(tmp_path: Path) -> None:
    edge = {
        "semi_diameter_mm": 6.5,
        "front_flat_from_mm": 5.5,
        "back_bevel_mm": 0.2,
        "flange": {"semi_diameter_mm": 8.0, "distance_mm": 3.0, "thickness_mm": 1.0},
    }
    shapes = (
        {"radius_mm": 20.0, "thickness_mm": 6.0, "material": "N-BK7", "semi_diameter_mm": 5.0},
        {"radius_mm": -30.0, "asphere": [1e-5], "semi_diameter_mm": 5.0},
    )
    lens = lens_of(*shapes, edge=[edge])
    path = tmp_path / "outline.dxf"
    write_outline(lens, path)
    layers = curves_of(path)
    assert len(layers["ELEMENT_1_CHAMFER"]) == 2
    for line in layers["ELEMENT_1_CHAMFER"]:
        across = line.dxf.end - line.dxf.start
        assert (abs(across.x), abs(across.y)) == pytest.approx((0.2, 0.2), abs=1e-12)
    assert len(layers["ELEMENT_1_EDGE"]) == 2 * 6
    ends = [point for line in layers["ELEMENT_1_EDGE"] for point in (line.dxf.start, line.dxf.end)]
    assert max(point.y for point in ends) == 8.0
    (spline,) = layers["ELEMENT_1_SURFACE_2"]
    check_surface(spline, lens, 1, 6.3, 1e-6)


@settings(max_examples=25)
@given(lens=lenses())
def test_random_lenses(lens: Lens) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "outline.DXF"
        try:
            elements = closed_elements(lens)
        except InputError:
            reject()
        found = write_outline(lens, path)
        layers = curves_of(path)
        stated = {curve.layer: curve.deviation_mm for curve in found.curves}
        for element in elements:
            for index, meridian in zip(element.surfaces, (element.front, element.back), strict=True):
                layer = f"ELEMENT_{element.index + 1}_SURFACE_{index + 1}"
                (curve,) = layers[layer]
                allowed = 1.01 * stated[layer] + 1e-9
                check_surface(curve, lens, index, meridian.end_mm, allowed)
            # Every end of a curve or line is shared by exactly two of them: the outline is closed.
            ends: list[tuple[float, float]] = []
            for layer, entities in layers.items():
                if layer.startswith(f"ELEMENT_{element.index + 1}_"):
                    ends += [end for entity in entities for end in ends_of(entity)]
            distances = np.linalg.norm(np.array(ends)[:, None] - np.array(ends), axis=-1)
            assert np.all(np.sum(distances < 1e-7, axis=1) == 2)


def ends_of(entity: Any) -> list[tuple[float, float]]:
    if entity.dxftype() == "SPLINE":
        return [tuple(entity.control_points[i][:2]) for i in (0, -1)]
    names = ("start_point", "end_point") if entity.dxftype() == "ARC" else ("start", "end")
    of = entity if entity.dxftype() == "ARC" else entity.dxf
    return [tuple(getattr(of, name))[:2] for name in names]


def test_a_biconic_has_both_principal_sections(tmp_path: Path) -> None:
    lens = drawn_outline(load_design(DESIGNS / "rectangular_sensor.toml")).lens
    path = tmp_path / "outline.dxf"
    write_outline(lens, path)
    layers = curves_of(path)
    shape = lens.surfaces[0].shape
    for plane, curvature in (("YZ", shape.term("curvature")), ("XZ", shape.term("curvature_x"))):
        (arc,) = layers[f"ELEMENT_1_{plane}_SURFACE_1"]
        assert arc.dxf.radius == pytest.approx(1.0 / abs(curvature), abs=1e-9)


def test_same_bytes_each_time(paper_lens: Lens, tmp_path: Path) -> None:
    paths = [tmp_path / "a.dxf", tmp_path / "b.dxf"]
    for path in paths:
        write_outline(paper_lens.replaced(title="Ø \udcff 名"), path, statement="ground")
    assert paths[0].read_bytes() == paths[1].read_bytes()
    properties = ezdxf.readfile(paths[0]).header.custom_vars
    assert properties.get("outline") == "ground"
    assert properties.get("title") == "Ø \ufffd 名"


def test_nothing_is_written_if_the_file_deviates(
    paper_lens: Lens, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = outline.conic_bezier

    def off(meridian: Any) -> Any:
        points, weights = right(meridian)
        return points + np.array([0.0, 1e-6]), weights

    monkeypatch.setattr(outline, "conic_bezier", off)
    with pytest.raises(InputError, match="ELEMENT_1_SURFACE_2 is 1e-06 mm off"):
        write_outline(paper_lens, tmp_path / "outline.dxf")
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"must end in \.dxf"):
        write_outline(paper_lens, tmp_path / "outline.dwg")


def test_the_command(tmp_path: Path) -> None:
    path = tmp_path / "outline.dxf"
    arguments = ["export", str(DESIGNS / "measured_singlet.toml"), str(path)]
    done = CliRunner().invoke(app, [*arguments, "--json"])
    assert done.exit_code == 0
    values = json.loads(done.stdout)
    assert [curve["curve"] for curve in values["curves"]] == ["arc", "spline"]
    assert max(curve["deviation_mm"] for curve in values["curves"]) < 1e-9
    assert values["surfaces_without_their_figure"] == [1, 2]
    assert "surface 1: the nominal shape was written" in done.stderr
    done = CliRunner().invoke(app, arguments)
    assert "nm of the true surface" in done.stdout
    path.unlink()
    done = CliRunner().invoke(app, [*arguments, "--measured"])
    assert isinstance(done.exception, InputError)
    assert "--measured" in str(done.exception)
    assert not path.exists()


def test_arcs_of_long_radii_keep_their_digits(tmp_path: Path) -> None:
    for power in (3, 5, 7, 9):
        surface = {"radius_mm": 10.0**power / 3.0, "semi_diameter_mm": 9.0}
        lens = lens_of(surface | {"thickness_mm": 3.0, "material": 1.5}, {"semi_diameter_mm": 9.0})
        found = write_outline(lens, tmp_path / "outline.dxf")
        assert found.largest_deviation_mm < 1e-9
        assert found.curves[0].curve == ("arc" if power < 7 else "spline")
