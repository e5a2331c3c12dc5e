"""Files made to do harm: endless, enormous, lying, reaching for other files or for the terminal."""

from __future__ import annotations

import csv
import io
import os
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
import tomli_w
from engine_checks import peak_bytes
from places import DESIGNS
from tests_studies import DECENTER, DESIGN, HEAD, SPREAD

from lensdesign import DesignError, InputError, Lens, Surface, load_design
from lensdesign.cli.commands import main
from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.input_files import (
    CATALOG_BYTES,
    LENS_FILE_BYTES,
    MESH_BYTES,
    TABLE_BYTES,
    TOML_BYTES,
    files_from,
)
from lensdesign.common.text import safe_cell, visible
from lensdesign.files import read_surface_figure_grid
from lensdesign.files.codev import read_seq, write_seq
from lensdesign.files.design import save_design
from lensdesign.files.draft import LossyImportError
from lensdesign.files.oslo import read_len
from lensdesign.files.zemax import read_zmx, write_zmx
from lensdesign.lens.catalogues.agf import read_agf
from lensdesign.manufacture.drawing.sheets import lens_drawing, write_drawing
from lensdesign.manufacture.mesh.reading import read_mesh
from lensdesign.optimization.specification.specification import load_specification
from tolerancing.cli.commands import main as tolerancing_main
from tolerancing.perturbations.distributions import Empirical
from tolerancing.store.file import check_is_store
from tolerancing.study.files import load_from_files, load_study
from wavesim.calibration.calibration_result import read_calibration
from wavesim.cli.commands import main as wavesim_main
from wavesim.sensor.frames import read_frame
from wavesim.targets.patterns import read_grey

LENS = load_design(DESIGNS / "paper_singlet.toml")
READERS: dict[str, tuple[Callable[[Path], object], float]] = {
    "design.toml": (load_design, TOML_BYTES),
    "specification.toml": (load_specification, TOML_BYTES),
    "study.toml": (load_study, TOML_BYTES),
    "lens.zmx": (read_zmx, LENS_FILE_BYTES),
    "lens.seq": (read_seq, LENS_FILE_BYTES),
    "lens.len": (read_len, LENS_FILE_BYTES),
    "glass.agf": (read_agf, CATALOG_BYTES),
    "figure.csv": (read_surface_figure_grid, TABLE_BYTES),
    "calibration.json": (lambda path: read_calibration(path, LENS), TABLE_BYTES),
    "mesh.stl": (read_mesh, MESH_BYTES),
    "mesh.ply": (read_mesh, MESH_BYTES),
    "mesh.obj": (read_mesh, TABLE_BYTES),
    "mesh.3mf": (read_mesh, TABLE_BYTES),
}
OPENERS: dict[str, Callable[[Path], object]] = {
    "picture.png": read_grey,
    "frame.tif": read_frame,
    "store.db": check_is_store,
}


@pytest.mark.parametrize("name", READERS)
def test_a_file_too_large_is_refused_unread(tmp_path: Path, name: str) -> None:
    """Of a line that never ends; the file is sparse, and reading it would take seconds and memory."""
    reader, most = READERS[name]
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(2**30 + 1)

    def refused() -> None:
        with pytest.raises(InputError, match=rf"{name}: 1073741825 bytes; at most {most} are read"):
            reader(path)

    assert peak_bytes(refused) < 1e7


@pytest.mark.parametrize("name", [*READERS, *OPENERS])
def test_pipes_devices_folders_and_names_of_nothing_are_refused(tmp_path: Path, name: str) -> None:
    reader = OPENERS.get(name) or READERS[name][0]
    path = tmp_path / name
    os.mkfifo(path)
    with pytest.raises(InputError, match="not a regular file"):
        reader(path)
    path.unlink()
    path.symlink_to("/dev/zero")
    with pytest.raises(InputError, match="not a regular file"):
        reader(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(InputError, match="Is a directory"):
        reader(path)
    with pytest.raises(InputError, match=r"\\x00"):
        reader(tmp_path / f"a\0{name}")
    with pytest.raises(InputError, match=rf"no{name}.*No such file"):
        reader(tmp_path / f"no{name}")


def test_devices_named_in_a_design_are_refused(tmp_path: Path, paper_lens: Lens) -> None:
    path = tmp_path / "lens.toml"
    save_design(paper_lens.replaced(glass_catalogs=(Path("/dev/zero"),)), path)
    with files_from("/"), pytest.raises(InputError, match="not a regular file"):
        load_design(path)
    save_design(paper_lens, path)
    path.write_text(path.read_text() + '\n[surface.figure]\nfile = "/dev/zero"\n')
    with files_from("/"), pytest.raises(InputError, match="not a regular file"):
        load_design(path)


def test_measured_tolerances_are_read_from_regular_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "values.csv")
    with pytest.raises(InputError, match="not a regular file"):
        Empirical(file=Path("values.csv"), column="a").loaded(tmp_path)


@pytest.mark.parametrize("text", ["a." * 3000 + "a = 1", "[" + "a." * 3000 + "a]", '"x" . ' * 3000 + "x = 1"])
def test_dotted_keys_without_end(tmp_path: Path, text: str) -> None:
    """tomllib takes minutes for twenty thousand bytes of them."""
    path = tmp_path / "lens.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"dotted key.* 8"):
        load_design(path)


@pytest.mark.parametrize("piece", ["[", "{a=", "[[", "(", '"""'])
def test_nesting_without_end(tmp_path: Path, piece: str) -> None:
    path = tmp_path / "lens.toml"
    path.write_text("a = " + piece * 200_000)
    with pytest.raises(InputError, match="not valid TOML"):
        load_design(path)


def test_faults_without_number_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "lens.toml"
    path.write_text("".join(f"key{i} = 1\n" for i in range(50_000)))
    with pytest.raises(InputError, match=r"\d+ more") as caught:
        load_design(path)
    assert len(str(caught.value)) < 20_000


@pytest.mark.parametrize(
    ("suffix", "write", "read"), [(".zmx", write_zmx, read_zmx), (".seq", write_seq, read_seq)]
)
def test_a_lens_file_never_has_another_file_opened(
    tmp_path: Path,
    paper_lens: Lens,
    monkeypatch: pytest.MonkeyPatch,
    suffix: str,
    write: Callable[[Lens, Path], None],
    read: Callable[..., object],
) -> None:
    """Neither catalogues of our own notes, nor coatings, nor anything else."""
    own = tmp_path / "own.agf"
    own.write_text("NM MY-GLASS 2 517642 1.5 64\nCD 1.04 0.006 0.23 0.02 1.01 103.5\nLD 0.4 0.7\n")
    path = tmp_path / f"lens{suffix}"
    write(paper_lens.replaced(glass_catalogs=(own,)), path)
    opened: list[str] = []
    whole = Path.open
    monkeypatch.setattr(
        Path, "open", lambda self, *a, **k: (opened.append(self.name), whole(self, *a, **k))[1]
    )
    with pytest.raises(LossyImportError, match=r"glass catalogues .*own.agf.* are not opened; give them"):
        read(path)
    assert read(path, lossy=True)
    assert set(opened) == {path.name}


LYING_MESHES = {
    "short.stl": (
        b"\0" * 80 + struct.pack("<I", 4_000_000_000) + b"\0" * 16,
        "the 4000000000 triangles of its header",
    ),
    "text.stl": (b"solid x\n facet normal 0 0 1\n", "1 faces declared, 0 found"),
    "rows.ply": (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\n"
        b"property float y\nproperty float z\nelement face 1\n"
        b"property list uchar int vertex_indices\nend_header\n",
        "declares 4000000000 rows",
    ),
    "lines.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n"
        b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n",
        "declares 4000000000 rows",
    ),
    "faces.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 99999999999\nproperty list uchar int vertex_indices\nend_header\n",
        "declares 99999999999 rows",
    ),
    "list.ply": (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        b"property float z\nelement face 1\nproperty list uint int vertex_indices\nend_header\n"
        + struct.pack("<fffI", 0, 0, 0, 2**32 - 1)
        + bytes(12),
        "not a valid PLY file",
    ),
    "less.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
        "2 faces declared, 1 found",
    ),
    "header.ply": (b"ply\n" + b"comment\n" * 100_000, "end_header must occur within"),
    "line.obj": (b"v 0 0 0 " + b"1 " * 6000, "holds no triangle"),
    "index.obj": (b"v 0 0 0\nf 1 2 999999999999999999999\n", "is not a valid face; 1 vertices"),
    "far.obj": (b"v 0 0 0\nv 1e300 0 0\nv 0 1 0\nf 1 2 3\n", "1e\\+300 mm"),
    "none.obj": (b"# nothing\n", "holds no triangle"),
}


@pytest.mark.parametrize("name", LYING_MESHES)
def test_meshes_that_lie_about_themselves(tmp_path: Path, name: str) -> None:
    import tracemalloc

    content, message = LYING_MESHES[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):  # libraries that are imported for it count not
        read_mesh(path)
    tracemalloc.start()
    with pytest.raises(InputError, match=message) as caught:
        read_mesh(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert name in str(caught.value)
    assert peak < 20e6


def test_materials_of_an_obj_file_are_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "lens.obj"
    path.write_text("mtllib ../../etc/passwd\nusemtl /dev/zero\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1/1 2//2 -1\n")
    opened: list[str] = []
    whole = Path.open
    monkeypatch.setattr(
        Path, "open", lambda self, *a, **k: (opened.append(self.name), whole(self, *a, **k))[1]
    )
    assert read_mesh(path).faces.tolist() == [[0, 1, 2]]
    assert opened == ["lens.obj"]


TRIANGLE = (
    '<mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/>'
    '</vertices><triangles><triangle v1="0" v2="1" v3="2"/></triangles></mesh>'
)


def three_mf(model: str | bytes, *names: str, head: str = "") -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", model)
        for name in names:
            archive.writestr(name, "x")
    return made.getvalue()


def model(objects: str, items: str = '<item objectid="1"/>', unit: str = "inch", head: str = "") -> str:
    return (
        f'<?xml version="1.0"?>{head}<model unit="{unit}" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/'
        f'2015/02"><resources>{objects}</resources><build>{items}</build></model>'
    )


def test_three_mf_with_units_components_and_transforms(tmp_path: Path) -> None:
    path = tmp_path / "part.3mf"
    objects = f'<object id="1">{TRIANGLE}</object><object id="2"><components>'
    objects += '<component objectid="1" transform="1 0 0 0 1 0 0 0 1 5 0 0"/><component objectid="1"/>'
    objects += "</components></object>"
    path.write_bytes(three_mf(model(objects, '<item objectid="2" transform="0 1 0 -1 0 0 0 0 1 0 0 1"/>')))
    mesh = read_mesh(path)
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    first = np.array([[0, 5, 1], [0, 6, 1], [-1, 5, 1]])
    np.testing.assert_allclose(mesh.vertices_mm[:3] / 25.4, first, atol=1e-12)
    np.testing.assert_allclose(mesh.vertices_mm[3:] / 25.4, first - [0, 5, 0], atol=1e-12)


BOMB = "".join(
    f'<object id="{n}"><components>{f"<component objectid=chr{n - 1}chr/>".replace("chr", chr(34)) * 10}'
    "</components></object>"
    for n in range(2, 12)
)
ENTITIES = (
    '<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 10}">' for i in range(9))
    + "]>"
)
OUTSIDE = '<!DOCTYPE m [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
ONE = f'<object id="1">{TRIANGLE}</object>'
HOSTILE_ARCHIVES = {
    "slip": (three_mf(model(ONE), "../../evil"), "outside of itself"),
    "absolute": (three_mf(model(ONE), "/etc/passwd"), "outside of itself"),
    "drive": (three_mf(model(ONE), "C:\\evil"), "outside of itself"),
    "two": (three_mf(model(ONE), "other.model"), "holds 2 models"),
    "many": (three_mf(model(ONE), *(f"a{i}" for i in range(1100))), "more than 1000 entries"),
    "entities": (three_mf(model(ONE, head=ENTITIES)), "document type"),
    "outside": (three_mf(model(ONE, head=OUTSIDE)), "document type"),
    "components": (three_mf(model(ONE + BOMB, '<item objectid="11"/>')), "more than 10000 objects placed"),
    "circle": (
        three_mf(model('<object id="1"><components><component objectid="1"/></components></object>')),
        "contains itself",
    ),
    "nothing": (three_mf(model(ONE, '<item objectid="7"/>')), "'7' is placed, but not defined"),
    "unit": (three_mf(model(ONE, unit="parsec")), "unit 'parsec'"),
    "transform": (three_mf(model(ONE, '<item objectid="1" transform="nan"/>')), "not a valid 3MF file"),
    "infinite": (
        three_mf(model(ONE, '<item objectid="1" transform="inf 0 0 0 1 0 0 0 1 0 0 0"/>')),
        "not a finite number",
    ),
    "index": (three_mf(model(ONE.replace('v3="2"', 'v3="3"'))), "a vertex that does not exist"),
    "long tag": (three_mf("<model a='" + "x" * 5_000_000 + "'/>"), "holds no triangle"),
    "deep": (three_mf("<a>" * 200_000), "valid 3MF file: Excessive depth"),
    "no zip": (b"PK\x03\x04 nothing", "valid 3MF file: File is not a zip file"),
}


@pytest.mark.parametrize("name", HOSTILE_ARCHIVES)
def test_hostile_archives(tmp_path: Path, name: str) -> None:
    content, message = HOSTILE_ARCHIVES[name]
    path = tmp_path / "part.3mf"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_mesh(path)
    assert list(tmp_path.iterdir()) == [path]


def test_a_zip_bomb_is_not_unpacked(tmp_path: Path) -> None:
    """A size declared beyond the bound, and one declared smaller than it is."""
    squeezer = zlib.compressobj(9, zlib.DEFLATED, -15)
    block = b" " * 2**20
    packed = b"".join(squeezer.compress(block) for _ in range(64)) + squeezer.flush()
    path = tmp_path / "bomb.3mf"
    for size, message in [(2**31, f"at most {TABLE_BYTES}"), (1000, "not a valid 3MF file")]:
        name = b"3D/3dmodel.model"
        fields = (20, 0, 8, 0, 33, 0, len(packed), size, len(name), 0)
        local = struct.pack("<4s5H3L2H", b"PK\x03\x04", *fields) + name + packed
        central = struct.pack("<4s6H3L5H2L", b"PK\x01\x02", 20, *fields, 0, 0, 0, 0, 0) + name
        end = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 1, 1, len(central), len(local), 0)
        path.write_bytes(local + central + end)
        with pytest.raises(InputError, match=message):
            read_mesh(path)


@pytest.mark.parametrize("name", ["a\0b.toml", "a\nb.toml", "-rf.toml"])
def test_names_of_outputs(tmp_path: Path, paper_lens: Lens, name: str) -> None:
    path = tmp_path / name
    if "\0" in name:
        with pytest.raises(InputError, match=r"a\\x00b\.toml"):
            save_design(paper_lens, path)
        assert list(tmp_path.iterdir()) == []
        return
    save_design(paper_lens, path)
    assert load_design(path) == paper_lens


def test_links_that_outputs_are(tmp_path: Path) -> None:
    """A link stays one; a link into nothing makes its target; one in a circle is refused."""
    link, target = tmp_path / "link", tmp_path / "folder" / "target"
    link.symlink_to(target)
    with atomic_path(link) as temporary:
        temporary.write_text("x")
    assert link.is_symlink()
    assert target.read_text() == "x"
    circle = tmp_path / "circle"
    circle.symlink_to(circle)
    with pytest.raises(InputError, match="cannot write"), atomic_path(circle) as temporary:
        temporary.write_text("x")
    for device in (Path("/dev/null"), tmp_path / "pipe"):
        if not device.exists():
            os.mkfifo(device)
        with pytest.raises(InputError, match="not a regular file"), atomic_path(device) as temporary:
            temporary.write_text("x")


@pytest.mark.parametrize(
    ("text", "cell"),
    [
        ("=1+1", "'=1+1"),
        ("+cmd|' /C calc'!A0", "'+cmd|' /C calc'!A0"),
        ("-2+3", "'-2+3"),
        ("@SUM(A1)", "'@SUM(A1)"),
        ("\t=1", "'\t=1"),
        ("\r=1", "'\r=1"),
        ("-0.5", "'-0.5"),
        ("a=b", "a=b"),
        ("", ""),
    ],
)
def test_formulas_in_cells(text: str, cell: str) -> None:
    assert safe_cell(text) == cell


def test_formulas_in_the_tables_of_a_comparison(tmp_path: Path) -> None:
    from wavesim.runtime.result_files import write_csv

    write_csv(
        [{"scene": "=HYPERLINK(1)", "error": -0.5}, {"scene": "fine", "error": 1.0}], tmp_path / "a.csv"
    )
    with (tmp_path / "a.csv").open(newline="") as file:
        assert list(csv.reader(file)) == [["scene", "error"], ["'=HYPERLINK(1)", "-0.5"], ["fine", "1.0"]]


HOSTILE = "</title><script>alert(1)</script>&<b>\x1b[31m[red]\x07\u202e\"'\\ $\\frac{"


def test_markup_in_drawings(tmp_path: Path, paper_lens: Lens) -> None:
    write_drawing(lens_drawing(paper_lens.replaced(title=HOSTILE)), tmp_path / "sheet.svg")
    root = ElementTree.parse(tmp_path / "sheet.svg").getroot()
    assert not [e for e in root.iter() if e.tag.endswith(("script", "b"))]
    write_drawing(lens_drawing(paper_lens.replaced(title=HOSTILE)), tmp_path / "sheet.pdf")
    assert (tmp_path / "sheet.pdf").read_bytes().startswith(b"%PDF")
    write_drawing(lens_drawing(paper_lens.replaced(title=HOSTILE + "\n  0\nEOF\n")), tmp_path / "sheet.dxf")
    assert not ezdxf.readfile(tmp_path / "sheet.dxf").audit().errors


def test_what_reaches_the_terminal(
    tmp_path: Path, paper_lens: Lens, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "lens.toml"
    save_design(paper_lens.replaced(title=HOSTILE), path)
    monkeypatch.setattr("sys.argv", ["lensdesign", "check", str(path)])
    with pytest.raises(SystemExit):
        main()
    out, _ = capsys.readouterr()
    assert "\x1b" not in out
    assert "\x07" not in out
    assert "\u202e" not in out
    assert "[red]" in out
    path.write_text(path.read_text().replace('"N-BK7"', '"\\u001b]0;owned\\u0007"'))
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert "\x1b" not in capsys.readouterr().err


def test_titles_of_studies_on_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Markup that closes what it never opened would end a command with an error of the library's."""
    title = tomli_w.dumps({"title": "[/nothing] [red]\x1b]0;owned\x07"}).strip()
    (tmp_path / "design.toml").write_text(DESIGN)
    study = (
        (HEAD + DECENTER + SPREAD).replace('title = "a study"', title).replace("trials = 40", "trials = 2")
    )
    (tmp_path / "study.toml").write_text(study)
    store = str(tmp_path / "a.store")
    for words in (
        ["run", str(tmp_path / "study.toml"), "--store", store, "--workers", "1"],
        ["show", store],
        ["show", store, "--trial", "1"],
    ):
        monkeypatch.setattr("sys.argv", ["tolerancing", *words])
        with pytest.raises(SystemExit) as stop:
            tolerancing_main()
        out, err = capsys.readouterr()
        assert not stop.value.code, err
        assert "\x1b" not in out
        assert "\x07" not in out
    assert "[/nothing] [red]" in out


def test_titles_on_figures_and_the_terminal_of_wavesim(
    tmp_path: Path, paper_lens: Lens, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A dollar sign starts no formula: an unfinished one would be an error of the library's."""
    save_design(paper_lens.replaced(title=HOSTILE), tmp_path / "lens.toml")
    words = ["pupil", str(tmp_path / "lens.toml"), "--samples", "64", "-o", str(tmp_path / "a.svg")]
    monkeypatch.setattr("sys.argv", ["wavesim", *words])
    with pytest.raises(SystemExit) as stop:
        wavesim_main()
    out, err = capsys.readouterr()
    assert not stop.value.code, err
    assert "\x1b" not in out
    tags = {e.tag.rpartition("}")[2] for e in ElementTree.parse(tmp_path / "a.svg").iter()}
    assert not tags & {"script", "b"}


def test_visible_text() -> None:
    assert visible("Ångström – µm\x1b[0m\t\n\x9b") == "Ångström – µm\\x1b[0m\\t\\n\\x9b"
    assert visible("x" * 5000) == "x" * 1997 + "..."


def test_glass_names_in_files_of_other_programs(tmp_path: Path, paper_lens: Lens) -> None:
    """A catalogue's glass whose name holds commands of the format does not add any."""
    own = tmp_path / "own.agf"
    own.write_text("NM X;STO;!& 2 517642 1.5 64\nCD 1.04 0.006 0.23 0.02 1.01 103.5\nLD 0.4 0.7\n")
    lens = paper_lens.replaced(glass_catalogs=(own,)).with_surface(0, material="X;STO;!&")
    from lensdesign.files.draft import Supplement

    for write, read, name in ((write_zmx, read_zmx, "a.zmx"), (write_seq, read_seq, "a.seq")):
        write(lens, tmp_path / name)
        assert read(tmp_path / name, Supplement(glass_catalogs=(own,))).lens == lens
    assert isinstance(lens.surfaces[0], Surface)


GLASS = "NM OWN 2 517642 1.5 64\nCD 1.04 0.006 0.23 0.02 1.01 103.5\nLD 0.4 0.7\n"


@pytest.mark.parametrize("way", ["catalogue", "figure", "link"])
def test_files_outside_a_designs_folder_need_consent(
    tmp_path: Path, paper_lens: Lens, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They would be read, and kept in a store that goes back to whoever made the design."""
    own = tmp_path / "own.agf"
    own.write_text(GLASS)
    (tmp_path / "grid.csv").write_text("# spacing_mm = 3\n# unit = um\n" + "0,0,0,0,0,0,0,0,0\n" * 9)
    design = tmp_path / "strange" / "lens.toml"
    save_design(paper_lens, design)
    text = design.read_text()
    if way == "figure":
        text += '\n[surface.figure]\nfile = "../grid.csv"\n'
    else:
        (design.parent / "near.agf").symlink_to(own)
        named = str(own) if way == "catalogue" else "near.agf"
        text = f'glass_catalogs = ["{named}"]\n' + text
    design.write_text(text)
    with pytest.raises(DesignError, match=r"(own\.agf|grid\.csv) .*outside .*strange"):
        load_design(design)
    with files_from(tmp_path):
        assert load_design(design).surfaces
    study = design.parent / "study.toml"
    study.write_text((HEAD + DECENTER + SPREAD).replace("design.toml", "lens.toml"))
    with pytest.raises(DesignError, match="lies outside"):
        load_study(study)
    for words, code in ((["check", str(design)], 2), (["--outside-files", "check", str(design)], 1)):
        monkeypatch.setattr("sys.argv", ["lensdesign", *words])
        with pytest.raises(SystemExit) as stop:
            main()
        assert stop.value.code == code


@pytest.mark.parametrize(
    "part",
    [
        '[[merit]]\nkind = "python"\nfunction = "../mine.py:f"\nat_least = 0.0\n',
        '[[perturbation]]\ntarget = "lens"\nparameter = "tilt_x_deg"\ndistribution = "empirical"\n'
        'file = "../measured.csv"\ncolumn = "a"\n',
    ],
)
def test_files_outside_a_studys_folder_need_consent(tmp_path: Path, part: str) -> None:
    (tmp_path / "mine.py").write_text("def f(trial):\n    return 1.0\n")
    (tmp_path / "measured.csv").write_text("a\n0.1\n0.2\n0.3\n")
    study = tmp_path / "strange" / "study.toml"
    study.parent.mkdir()
    study.write_text(HEAD + DECENTER + SPREAD + part)
    (study.parent / "design.toml").write_text(DESIGN)
    with pytest.raises(DesignError, match=r"(merit|perturbation) 2: .*outside .*strange"):
        load_study(study)
    with files_from("/"):
        held = load_study(study)
    assert "strange/study.toml" in held.files
    again = load_from_files(held.name, held.files, tmp_path / "again")
    assert again.fingerprint == held.fingerprint


@pytest.mark.parametrize("change", ['glass_catalogs = ["{own}"]\n', "design"])
def test_a_store_reads_no_file_of_its_reader(tmp_path: Path, change: str) -> None:
    (tmp_path / "own.agf").write_text(GLASS)
    (tmp_path / "design.toml").write_text(DESIGN)
    study, design = HEAD + DECENTER + SPREAD, DESIGN
    if change == "design":
        study = study.replace("design.toml", str(tmp_path / "design.toml"))
    else:
        design = change.format(own=tmp_path / "own.agf") + design
    files = {"study.toml": study.encode(), "design.toml": design.encode()}
    with files_from("/"), pytest.raises(DesignError, match="lies outside"):
        load_from_files("study.toml", files, tmp_path / "again")
