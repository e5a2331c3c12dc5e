"""STEP files: valid solids, exact when read back, named, the same each time; or not written at all."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError
from random_lenses import lenses, numbers, signed
from small_lenses import lens_of
from typer.testing import CliRunner

from lensdesign import Lens
from lensdesign.cli.commands import app
from lensdesign.errors import InputError
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.solid import closed_elements
from lensdesign.manufacture.step import solids as cad_solids
from lensdesign.manufacture.step import writing as cad
from lensdesign.manufacture.step.solids import subshapes
from lensdesign.manufacture.step.step_files import read_solids, silent_ocp, step_text
from lensdesign.manufacture.step.writing import StepReport, write_step

Array = NDArray[np.float64]


def singlet(front: dict[str, Any], back: dict[str, Any], thickness_mm: float, edge_mm: float) -> Lens:
    glass = {"thickness_mm": thickness_mm, "material": "N-BK7"}
    return lens_of({"semi_diameter_mm": edge_mm} | front | glass, {"semi_diameter_mm": edge_mm} | back)


@pytest.fixture(scope="module")
def doublet() -> Lens:
    return lens_of(
        {"radius_mm": 40.0, "thickness_mm": 6.0, "material": "N-BK7", "semi_diameter_mm": 9.0},
        {"radius_mm": -30.0, "thickness_mm": 2.0, "material": 1.75, "semi_diameter_mm": 9.0},
        {"radius_mm": -90.0, "semi_diameter_mm": 9.0},
        title="Doublet",
    )


def exported(lens: Lens, path: Path | None = None) -> StepReport:
    if path is not None:
        return write_step(lens, path)
    with TemporaryDirectory() as folder:
        return write_step(lens, Path(folder) / "lens.step")


def surface_points(path: Path, solid: int, face: int) -> Array:
    """Points of one face of a file, read and sampled without the exporter's own measurement."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.BRepTools import BRepTools
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopoDS import TopoDS

    with silent_ocp():
        shape = read_solids(path)[solid]
    found = TopoDS.Face(subshapes(shape, TopAbs_ShapeEnum.TopAbs_FACE)[face])
    surface, (u0, u1, v0, v1) = BRepAdaptor_Surface(found), BRepTools.UVBounds_s(found)
    share = np.random.default_rng(1).random((3000, 2))
    where = [u0, v0] + share * [u1 - u0, v1 - v0]
    points = (surface.Value(float(u), float(v)) for u, v in where)
    return np.array([(p.X(), p.Y(), p.Z()) for p in points])


def names_in(path: Path) -> tuple[str, list[str]]:
    """Title in the header, and names of the products, an assembly before its parts."""
    from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
    from OCP.collections import Sequence_TDF_Label
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDF import TDF_Label
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFDoc import XCAFDoc_DocumentTool, XCAFDoc_ShapeTool

    def name(label: Any) -> str:
        attribute = TDataStd_Name()
        assert label.FindAttribute(TDataStd_Name.GetID_s(), attribute)
        return str(attribute.Get().ToExtString())

    reader, document = STEPCAFControl_Reader(), TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
    with silent_ocp():
        reader.ReadFile(str(path))
        reader.Transfer(document)
    roots = Sequence_TDF_Label()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetFreeShapes(roots)
    assert roots.Length() == 1
    parts, names = Sequence_TDF_Label(), [name(roots.Value(1))]
    XCAFDoc_ShapeTool.GetComponents_s(roots.Value(1), parts)
    for i in range(1, parts.Length() + 1):
        part = TDF_Label()
        XCAFDoc_ShapeTool.GetReferredShape_s(parts.Value(i), part)
        names.append(name(part))
    title = APIHeaderSection_MakeHeader(reader.ChangeReader().StepModel()).Name()
    return title.ToCString(), names


def decoded(text: str) -> str:
    """What a string of ISO 10303-21 stands for."""
    text = text.replace("''", "'")
    return re.sub(r"\\X[24]\\([0-9A-F]+)\\X0\\", lambda match: chr(int(match[1], 16)), text)


def test_paper_lens(paper_lens: Lens, tmp_path: Path) -> None:
    path = tmp_path / "lens.step"
    found = exported(paper_lens, path)
    assert found.solids == 1
    assert found.bytes == path.stat().st_size < 100_000
    assert found.largest_error_mm < 1e-12
    assert found.volume_mm3 == pytest.approx(found.exact_volume_mm3, rel=1e-11)
    for index, face in ((0, 0), (1, -1)):
        x, y, z = surface_points(path, 0, face).T
        sag = paper_lens.surfaces[index].sag_mm(np.hypot(x, y))
        assert z == pytest.approx(paper_lens.vertex_z_mm[index] + sag, abs=1e-11)
        assert np.max(np.hypot(x, y)) > 9.99
    title, names = names_in(path)
    assert title == paper_lens.title
    assert names == ["element 1 (surfaces 1 and 2), N-BK7"]
    assert [p.name for p in tmp_path.iterdir()] == ["lens.step"]


def test_kinds_of_surfaces_in_the_file(tmp_path: Path) -> None:
    shapes = [{"radius_mm": 30.0}, {}, {"radius_mm": -30.0, "conic": -2.0}, {"asphere": [1e-5]}]
    faces = []
    for number, shape in enumerate(shapes):
        path = tmp_path / f"{number}.step"
        write_step(singlet(shape, {}, 9.0, 5.0), path)
        kinds = r"#\d+ = (SPHERICAL_SURFACE|PLANE|SURFACE_OF_REVOLUTION|CYLINDRICAL_SURFACE)\("
        text = path.read_text(encoding="ascii")
        faces.append(re.findall(kinds, text))
        assert ("RATIONAL_B_SPLINE_CURVE" in text) == (number == 2)
    assert faces == [
        [first, "CYLINDRICAL_SURFACE", "PLANE"]
        for first in ("SPHERICAL_SURFACE", "PLANE", "SURFACE_OF_REVOLUTION", "SURFACE_OF_REVOLUTION")
    ]


def test_control_points_in_the_text_are_those_of_the_conic(paper_lens: Lens, tmp_path: Path) -> None:
    write_step(paper_lens, tmp_path / "lens.step")
    text = (tmp_path / "lens.step").read_text(encoding="ascii").replace("\n", "")
    # The meridian stands in the plane y = 0; its weights follow the knots.
    curve = re.search(
        r"B_SPLINE_CURVE\(2,\((#\d+),(#\d+),(#\d+)\).*?RATIONAL_B_SPLINE_CURVE\(\((.*?)\)\)", text
    )
    assert curve is not None
    at = {n: re.search(rf"{n} = CARTESIAN_POINT\('',\((.*?)\)\)", text) for n in curve.groups()[:3]}
    points = np.array([[float(x) for x in found[1].split(",")] for found in at.values() if found])
    weights = np.array([float(w) for w in curve[4].split(",")])
    t = np.linspace(0.0, 1.0, 200)[:, None]
    shares = np.hstack([(1.0 - t) ** 2, 2.0 * t * (1.0 - t), t**2]) * weights
    x, y, z = (shares @ points / np.sum(shares, axis=1, keepdims=True)).T
    assert np.all(y == 0.0)
    assert z == pytest.approx(9.7 + paper_lens.surfaces[1].sag_mm(x), abs=1e-11)
    assert x[-1] == pytest.approx(10.0, abs=1e-12)


def test_volumes_against_closed_forms() -> None:
    plate = exported(singlet({}, {}, 3.0, 5.0))
    assert plate.volume_mm3 == pytest.approx(75.0 * math.pi, rel=1e-12)
    hemisphere = exported(singlet({"radius_mm": 4.0}, {}, 5.0, 4.0))
    assert hemisphere.volume_mm3 == pytest.approx(math.pi * 64.0 * (2.0 / 3.0 + 0.25), rel=1e-12)
    length = 2.0 * math.sqrt(25.0 - 4.9**2)
    ball = exported(singlet({"radius_mm": 5.0}, {"radius_mm": -5.0}, 10.0, 4.9))
    assert ball.volume_mm3 == pytest.approx(math.pi * (500.0 - 0.5 * length**3) / 3.0, rel=1e-12)
    paraboloid = exported(singlet({"radius_mm": 6.0, "conic": -1.0}, {}, 4.0, 6.0))
    assert paraboloid.volume_mm3 == pytest.approx(math.pi * 36.0 * (0.5 * 3.0 + 1.0), rel=1e-12)
    ellipsoid = exported(singlet({"radius_mm": 8.0, "conic": 1.0}, {}, 6.0, 8.0 / math.sqrt(2.0)))
    assert ellipsoid.volume_mm3 == pytest.approx(math.pi * 32.0 * (2.0 / 3.0 * 4.0 + 2.0), rel=1e-12)


@pytest.mark.parametrize(
    ("front", "back", "thickness", "edge"),
    [
        ({"radius_mm": 12.0, "conic": -2.0}, {"radius_mm": -12.0, "conic": -1e4}, 9.0, 10.0),
        ({"radius_mm": 5.0, "conic": 3.0}, {"radius_mm": 5.0, "conic": 3.0}, 4.0, 2.5),
        ({"radius_mm": 999.999999}, {"radius_mm": -1000.0001}, 12.0, 50.0),
        ({"radius_mm": 1e7}, {"radius_mm": -1e6, "conic": 2.0}, 2.0, 5.0),
        ({"radius_mm": -6.0}, {"radius_mm": 6.0}, 1.0, 5.9),
    ],
)
def test_conics_are_exact(front: dict[str, Any], back: dict[str, Any], thickness: float, edge: float) -> None:
    found = exported(singlet(front, back, thickness, edge))
    assert found.largest_error_mm < 1e-9
    assert found.volume_mm3 == pytest.approx(found.exact_volume_mm3, rel=1e-10)


@settings(max_examples=25)
@given(
    radii=st.tuples(signed(6.0, 300.0), signed(6.0, 300.0)),
    conics=st.tuples(numbers(-9.0, 2.0), numbers(-9.0, 2.0)),
    thickness=numbers(0.5, 12.0),
    edge=numbers(1.0, 8.0),
)
def test_random_conics(
    radii: tuple[float, float], conics: tuple[float, float], thickness: float, edge: float
) -> None:
    first, second = ({"radius_mm": r, "conic": k} for r, k in zip(radii, conics, strict=True))
    try:
        lens = singlet(first, second, thickness, edge)
        closed_elements(lens)
    except (ValidationError, InputError):
        reject()
    found = exported(lens)
    assert found.largest_error_mm < 1e-10
    assert found.volume_mm3 == pytest.approx(found.exact_volume_mm3, rel=1e-10)


@settings(max_examples=40)
@given(lens=lenses())
def test_random_lenses(lens: Lens) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "lens.stp"
        try:
            elements = closed_elements(lens)
        except InputError as error:
            with pytest.raises(InputError, match=re.escape(str(error))):
                write_step(lens, path)
            assert not path.exists()
            return
        found = write_step(lens, path)
        assert found.solids == len(elements)
        for body, element in zip(found.bodies, elements, strict=True):
            for error, index in zip(body.surface_errors_mm, element.surfaces, strict=True):
                limit = 1.1e-7 if lens.surfaces[index].kind == "even asphere" else 1e-10
                assert error <= limit
            assert body.volume_mm3 == pytest.approx(element.volume_mm3, rel=1e-7)


def test_asphere_with_an_inflection(tmp_path: Path) -> None:
    shape = {"radius_mm": 15.0, "conic": -0.5, "asphere": [-3e-4, 5e-7]}
    lens = singlet(shape, {"radius_mm": -60.0}, 5.0, 9.0)
    path = tmp_path / "lens.step"
    found = exported(lens, path)
    assert 1e-9 < found.bodies[0].surface_errors_mm[0] < 1e-7
    x, y, z = surface_points(path, 0, 0).T
    # The sag differs by more than the distance where the surface slopes.
    slope = float(np.max(np.abs(lens.surfaces[0].slope(np.linspace(0.0, 9.0, 100)))))
    assert np.max(np.abs(z - lens.surfaces[0].sag_mm(np.hypot(x, y)))) < 1e-7 * math.hypot(1.0, slope)


def test_asphere_up_to_its_upright_edge() -> None:
    found = exported(singlet({"radius_mm": 9.0, "asphere": [1e-6, 5e-9]}, {}, 12.0, 9.0))
    assert found.largest_error_mm < 1e-7


def test_rims_with_flats_bevels_and_a_flange(tmp_path: Path) -> None:
    edge = {
        "semi_diameter_mm": 6.5,
        "front_flat_from_mm": 5.5,
        "back_bevel_mm": 0.2,
        "flange": {"semi_diameter_mm": 8.0, "distance_mm": 3.0, "thickness_mm": 1.0},
    }
    shapes = (
        {"radius_mm": 20.0, "thickness_mm": 6.0, "material": "N-BK7", "semi_diameter_mm": 5.0},
        {"radius_mm": -30.0, "semi_diameter_mm": 5.0},
    )
    lens = lens_of(*shapes, edge=[edge])
    path = tmp_path / "lens.step"
    found = exported(lens, path)
    assert found.volume_mm3 == pytest.approx(found.exact_volume_mm3, rel=1e-10)
    assert "CONICAL_SURFACE" in path.read_text(encoding="ascii")
    for face, end in ((0, 5.5), (-1, 6.3)):
        x, y, _ = surface_points(path, 0, face).T
        assert 0.999 * end < np.max(np.hypot(x, y)) <= end


def test_cemented_elements_are_an_assembly_of_named_solids(doublet: Lens, tmp_path: Path) -> None:
    path = tmp_path / "lens.step"
    found = exported(doublet, path)
    names = [
        f"element {i} (surfaces {i} and {i + 1}), {glass}" for i, glass in ((1, "N-BK7"), (2, "n = 1.75"))
    ]
    assert [body.name for body in found.bodies] == names
    assert names_in(path) == ("Doublet", ["Doublet", *names])
    for solid, face in ((0, -1), (1, 0)):
        x, y, z = surface_points(path, solid, face).T
        assert np.linalg.norm([x, y, z + 24.0], axis=0) == pytest.approx(30.0, abs=1e-11)


HOSTILE = "it's \"q\" \\ \\X2\\00E9\\X0\\ \\S\\a\nü 透镜 😀\t'); #1 = END-ISO-10303-21; ' ,'',) /* */"
LONG = HOSTILE + 30 * " long" + "'"


def test_hostile_titles_are_read_back(doublet: Lens, paper_lens: Lens, tmp_path: Path) -> None:
    path = tmp_path / "lens.step"
    write_step(doublet.replaced(title=LONG), path)
    title, names = names_in(path)
    assert title == names[0] == LONG
    header = re.search(r"FILE_NAME\(\s*'((?:[^']|'')*)'", path.read_text(encoding="ascii"))
    assert header is not None
    assert decoded(header[1]) == LONG
    write_step(paper_lens.replaced(title="a\0b"), path)
    assert names_in(path)[0] == "a�b"


@settings(max_examples=20)
@given(st.text(alphabet="'(),;\\X024é\n #=/*$&.\t", max_size=12))
def test_random_titles_are_read_back(paper_lens: Lens, title: str) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "lens.step"
        write_step(paper_lens.replaced(title=title), path)
        # OCP's reader drops spaces at the end.
        assert names_in(path)[0].rstrip(" ") == title.rstrip(" ")


@given(st.text())
def test_texts_are_plain_and_lose_nothing(text: str) -> None:
    written = step_text(text)
    assert re.fullmatch(r"[ -~]*", written)
    assert "\\" not in re.sub(r"\\X2\\[0-9A-F]{4}\\X0\\|\\X4\\[0-9A-F]{8}\\X0\\", "", written)
    assert decoded(written.replace("'", "''")) == text.replace("\0", "�")


def test_the_same_lens_gives_the_same_file(doublet: Lens, paper_lens: Lens, tmp_path: Path) -> None:
    write_step(doublet, tmp_path / "first.step")
    write_step(paper_lens, tmp_path / "other.step")
    write_step(doublet, tmp_path / "second.stp")
    assert (tmp_path / "first.step").read_bytes() == (tmp_path / "second.stp").read_bytes()


def test_mm_whatever_the_process_had_set(paper_lens: Lens, tmp_path: Path) -> None:
    from OCP.Interface import Interface_Static

    write_step(paper_lens, tmp_path / "first.step")
    assert Interface_Static.SetCVal_s("write.step.unit", "INCH")
    found = exported(paper_lens, tmp_path / "second.step")
    assert found.largest_error_mm < 1e-12
    assert (tmp_path / "first.step").read_bytes() == (tmp_path / "second.step").read_bytes()


def test_nothing_reaches_the_terminal(
    doublet: Lens, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    from OCP.Message import Message

    before = list(Message.DefaultMessenger_s().Printers())
    assert before
    write_step(doublet, tmp_path / "lens.step")
    assert capfd.readouterr() == ("", "")
    assert len(list(Message.DefaultMessenger_s().Printers())) == len(before)


def test_measured_figures_are_named(tmp_path: Path) -> None:
    figure = {"zernike_um": {"7": 1.5}, "semi_diameter_mm": 5.0}
    lens = singlet({"radius_mm": 30.0}, {"figure": figure}, 4.0, 5.0)
    notes: list[str] = []
    write_step(lens, tmp_path / "lens.step", warn=notes.append)
    (note,) = notes
    assert note.startswith("surface 2: ")


@pytest.mark.parametrize("wrong", ["surface", "rim", "units"])
def test_a_file_that_departs_from_the_lens_is_refused(
    paper_lens: Lens, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong: str
) -> None:
    if wrong == "surface":
        right = cad_solids.conic_bezier

        def off(meridian: SurfaceMeridian) -> tuple[Array, Array]:
            points, weights = right(meridian)
            return points, weights * [1.0, 1.0 + 1e-7, 1.0]

        monkeypatch.setattr(cad_solids, "conic_bezier", off)
        message = r"surface 2 is \S+e-08 mm off when read back; allowed: 1e-09 mm"
    elif wrong == "rim":
        corners = cad_solids.rim_corners

        def wider(element: Any) -> Array:
            first, last = corners(element)
            return np.array([first, 0.5 * (first + last) + [1e-3, 0.0], last])

        monkeypatch.setattr(cad_solids, "rim_corners", wider)
        monkeypatch.setattr(cad, "rim_corners", wider)
        message = r"has a volume of 2197\.6\d+ mm\^3 when read back, not 2197\.516"
    else:
        write = cad.write_solids

        def in_inches(*given: Any) -> None:
            write(*given)
            path = given[3]
            text = path.read_text(encoding="ascii")
            path.write_text(text.replace("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT(.CENTI.,.METRE.)"))

        monkeypatch.setattr(cad, "write_solids", in_inches)
        message = "unit of length is centimetre, not mm"
    path = tmp_path / "lens.step"
    path.write_text("old")
    with pytest.raises(InputError, match=message):
        write_step(paper_lens, path)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["lens.step"]


def test_what_cannot_be_written_leaves_nothing(paper_lens: Lens, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="there is a file where a folder is needed"):
        write_step(paper_lens, tmp_path / "file" / "lens.step")
    (tmp_path / "folder.step").mkdir()
    with pytest.raises(InputError, match="it is a folder"):
        write_step(paper_lens, tmp_path / "folder.step")
    with pytest.raises(InputError, match=r"\.iges'.*\.step, \.stp"):
        write_step(paper_lens, tmp_path / "lens.iges")
    with pytest.raises(InputError, match=r"edge thickness.* -0\.\d+ mm"):
        write_step(paper_lens.with_surface(0, thickness_mm=4.5), tmp_path / "lens.step")
    with pytest.raises(InputError, match=r"element 1 .*1e-07 mm.*1e-06"):
        write_step(singlet({"radius_mm": 50.0}, {"radius_mm": 50.0}, 1e-7, 2.0), tmp_path / "lens.step")
    with pytest.raises(InputError, match=r"element 1 .*OCP failed: "):
        write_step(singlet({}, {}, 1.0, 1e-8), tmp_path / "lens.step")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder.step"]


def test_names_of_files_may_be_any_text(paper_lens: Lens, tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "Linse 'ü' 透镜 😀.StEp"
    write_step(paper_lens, path)
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    assert names_in(path)[0] == paper_lens.title
    path.unlink()
    with pytest.raises(InputError, match="file name in UTF-8"):
        write_step(paper_lens, path.parent / "\udcff.step")
    assert not list(path.parent.iterdir())


def test_missing_ocp_says_what_to_install(
    paper_lens: Lens, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "OCP", None)
    with pytest.raises(InputError, match=r"transferlens\[cad\]"):
        write_step(paper_lens, tmp_path / "lens.step")
    assert not list(tmp_path.iterdir())


def test_ocp_is_imported_only_when_writing() -> None:
    code = (
        "import sys, lensdesign.manufacture.step.writing, lensdesign.cli.commands; "
        "raise SystemExit('OCP' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_command(paper_design: Path, tmp_path: Path) -> None:
    path = tmp_path / "lens.STP"
    result = CliRunner().invoke(app, ["export", str(paper_design), str(path)])
    assert result.exit_code == 0
    assert re.fullmatch(
        r"wrote \S+: 1 solid, read back within \S+ nm of the true surface, .*\n", result.stdout
    )
    assert result.stderr.startswith("outline: element 1 (surfaces 1 and 2): ground diameter 22.5 mm, chosen")
    assert "ground diameter 22.5 mm" in path.read_text(encoding="ascii")[:600].replace("\n", "")
    result = CliRunner().invoke(app, ["export", str(paper_design), str(path), "--json"])
    assert f'"bytes": {path.stat().st_size},' in result.output
    path.unlink()
    result = CliRunner().invoke(app, ["export", str(paper_design), str(path), "--measured"])
    assert isinstance(result.exception, InputError)
    assert not path.exists()
