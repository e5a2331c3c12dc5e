"""Spoilt files of every format: a fault by name or a right result; never another exception, never a hang."""

from __future__ import annotations

import io
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from malformed import NUMBERS, malformed, outcomes
from places import DESIGNS, GOLDEN
from sample_lenses import SAMPLES

from lensdesign import Lens, Pose, load_design
from lensdesign.files.codev import read_seq, write_seq
from lensdesign.files.design import save_design
from lensdesign.files.draft import Supplement
from lensdesign.files.surface_figures import read_surface_figure_grid
from lensdesign.files.zemax import read_zmx, write_zmx
from lensdesign.lens.catalogues.agf import read_agf
from lensdesign.manufacture.mesh.mesh import write_mesh
from lensdesign.manufacture.mesh.reading import TriangleMesh, read_mesh
from lensdesign.optimization.specification.specification import Specification, load_specification

CATALOGUE = b"""CC Test catalogue
NM N-BK7 2 517642.251 1.516800 64.17 0 1 1
GC step 0.5 available
ED 7.100000 8.300000 2.510000 -0.000900 0
CD 1.039612120E+000 6.000698670E-003 2.317923440E-001 2.001791440E-002 1.010469450E+000 1.035606530E+002
TD 1.8600E-006 1.3100E-008 -1.3700E-011 4.3400E-007 6.2700E-010 1.7000E-001 2.000000E+001
LD 3.000000E-001 2.500000E+000
IT 3.00E-001 5.00E-002 2.50E+001
NM E-F2 1.00 620363 1.62004 36.30 0 1
CD 2.5561822 -0.010237038 0.022470348 0.00084580679 -3.3087089E-05 7.1054919E-06 0 0 0 0
LD 0.36501 1.01398
"""


def spoilt(seeds: list[bytes], count: int, seed: int, *own: bytes) -> list[bytes]:
    rng = np.random.default_rng(seed)
    return [malformed(seeds[i % len(seeds)], rng, own) for i in range(count)]


def test_glass_catalogues(tmp_path: Path) -> None:
    def check(glasses: Any) -> bool:
        return bool(glasses) and all(np.isfinite(g.coefficients).all() for g in glasses)

    found = outcomes(tmp_path / "own.agf", spoilt([CATALOGUE], 400, 1, b"NM", b"CD", b"LD"), read_agf, check)
    assert 40 < sum(found) < 360


def designs(folder: Path) -> list[bytes]:
    """The paper's lens, and one with all that a design file can hold."""
    (folder / "own.agf").write_bytes(CATALOGUE)
    (folder / "grid.csv").write_text(
        "# spacing_mm = 3\n# unit = um\n" + "\n".join(["0.1,0.2,0.3,0.2,0.1,0,0,0,0"] * 9) + "\n"
    )
    full = b"""title = "All of it"
wavelengths_um = [0.532, 0.5876]
glass_catalogs = ["own.agf"]
[object]
field_diameter_mm = 3.0
numerical_aperture = 0.5
working_distance_mm = 13.5
[sensor]
pixel_pitch_um = 3.2
pixels = [9344, 7000]
plane_distances_mm = [2.0, 22.0]
[[surface]]
radius_mm = 42.3
asphere = [1e-6, -2e-9]
thickness_mm = 9.7
material = "E-F2"
semi_diameter_mm = 8.26
stop = true
figure = { file = "grid.csv" }
[[surface]]
radius_mm = -12.0
conic = -0.89862
semi_diameter_mm = 10.0
figure = { zernike_um = { 4 = 0.1, 7 = -0.02 }, semi_diameter_mm = 10.0 }
"""
    return [(DESIGNS / "paper_singlet.toml").read_bytes(), full]


def with_each_number_replaced(data: bytes, values: list[bytes]) -> list[bytes]:
    spans = [m.span() for m in re.finditer(rb"(?<![\w.])-?\d+(\.\d+)?([eE][-+]?\d+)?(?![\w.])", data)]
    return [data[:start] + value + data[end:] for start, end in spans for value in values]


def test_designs_with_each_number_replaced(tmp_path: Path) -> None:
    _, full = designs(tmp_path)
    files = with_each_number_replaced(full, [*NUMBERS[:12], b"9" * 400, b"1e300", b"1e-300"])
    assert len(files) > 300
    outcomes(tmp_path / "lens.toml", files, load_design, lambda lens: isinstance(lens, Lens))


def test_designs(tmp_path: Path) -> None:
    path = tmp_path / "lens.toml"
    seeds = designs(tmp_path)
    for seed in seeds:
        path.write_bytes(seed)
        assert load_design(path)
    files = spoilt(seeds, 400, 2, b'"own.agf"', b'"grid.csv"', b'"/dev/zero"', b"'a\x00b'", b"1979-05-27")

    def check(lens: Any) -> bool:
        return isinstance(lens, Lens) and all(np.isfinite(lens.indices(w)).all() for w in lens.wavelengths_um)

    found = outcomes(path, files, load_design, check)
    assert 20 < sum(found) < 380


@pytest.mark.parametrize("suffix", [".zmx", ".seq"])
@pytest.mark.parametrize("lossy", [True, False])
def test_lens_files(tmp_path: Path, paper_lens: Lens, suffix: str, lossy: bool) -> None:
    """Of makers, of ours with a pose, and those with odd commands."""
    reader, write = {".zmx": (read_zmx, write_zmx), ".seq": (read_seq, write_seq)}[suffix]
    write(paper_lens, tmp_path / f"own{suffix}", Pose(0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    odd = sorted((GOLDEN / "imports").glob(f"*{suffix}"))
    seeds = [s.text.encode() for s in SAMPLES.values() if s.suffix == suffix]
    seeds += [path.read_bytes() for path in (tmp_path / f"own{suffix}", *odd)]
    own = [b"INFINITY", b"MIRROR", b"REFL", b"COORDBRK", b"S99", b"&", b"'", b";", b"()"]
    supplement = Supplement(500.0, 1.0, 0.005, 3.2, (1000, 800))

    def check(found: Any) -> bool:
        return all(np.isfinite(found.lens.indices(w)).all() for w in found.lens.wavelengths_um)

    files = spoilt(seeds, 350, 7 + lossy, *own)
    found = outcomes(tmp_path / f"lens{suffix}", files, lambda p: reader(p, supplement, lossy), check)
    assert 10 < sum(found) < 340


def test_measured_figures(tmp_path: Path) -> None:
    designs(tmp_path)
    seed = (tmp_path / "grid.csv").read_bytes()
    path = tmp_path / "grid.csv"
    found = outcomes(
        path,
        spoilt([seed], 200, 6, b"um", b"waves_633nm"),
        read_surface_figure_grid,
        lambda r: r[0].ndim == 2 and r[1] > 0,
    )
    assert 10 < sum(found) < 190


def test_specifications(tmp_path: Path) -> None:
    seeds = [
        data
        for path in sorted((DESIGNS).rglob("*.toml"))
        if b"[optimize]" in (data := path.read_bytes()) or b"[[variable" in data
    ]
    assert seeds
    path = tmp_path / "specification.toml"
    found = outcomes(path, spoilt(seeds, 200, 3), load_specification, lambda s: isinstance(s, Specification))
    assert 10 < sum(found) < 190


def test_studies_with_each_number_replaced(tmp_path: Path, paper_lens: Lens) -> None:
    from tolerancing.study.files import load_study

    save_design(paper_lens, tmp_path / "paper_singlet.toml")
    data = (DESIGNS / "paper_figure_7.toml").read_bytes()
    files = with_each_number_replaced(data, [b"nan", b"0", b"1e300", b"9" * 24, b"9" * 400])
    assert len(files) > 50
    outcomes(tmp_path / "study.toml", files, load_study, lambda s: s is not None)


def test_studies(tmp_path: Path, paper_lens: Lens) -> None:
    from tolerancing.study.files import load_study

    save_design(paper_lens, tmp_path / "paper_singlet.toml")
    seeds = [
        data for path in sorted((DESIGNS).rglob("*.toml")) if b"[[perturbation" in (data := path.read_bytes())
    ]
    assert seeds
    found = outcomes(tmp_path / "study.toml", spoilt(seeds, 200, 4), load_study, lambda s: s is not None)
    assert sum(found) < 190


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory, paper_lens: Lens) -> dict[str, bytes]:
    """A coarse lens in each format, and by the name of the format in its other variants."""
    folder = tmp_path_factory.mktemp("meshes")
    result = {}
    for suffix in ("stl", "ply", "obj", "3mf"):
        mesh = write_mesh(paper_lens, folder / f"lens.{suffix}", 200.0).mesh
        result[suffix] = (folder / f"lens.{suffix}").read_bytes()
    result["text stl"] = mesh.export(file_type="stl_ascii").encode()
    result["text ply"] = mesh.export(file_type="ply", encoding="ascii")
    with zipfile.ZipFile(io.BytesIO(result["3mf"])) as archive:
        result["model"] = archive.read("3D/3dmodel.model")
    return result


def packed(model: bytes, **others: bytes) -> bytes:
    """A 3MF archive around a model."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", model)
        for name, content in others.items():
            archive.writestr(name, content)
    return made.getvalue()


OWN_WORDS = {
    "stl": [],
    "text stl": [b"vertex", b"endfacet"],
    "ply": [b"list", b"double", b"4294967295"],
    "text ply": [b"list", b"double", b"binary_little_endian"],
    "obj": [b"f", b"v", b"-1", b"1//2", b"mtllib"],
    "3mf": [],
    "model": [b"inch", b"<component", b'"3"'],
}


@pytest.mark.parametrize("kind", OWN_WORDS)
def test_meshes(tmp_path: Path, meshes: dict[str, bytes], kind: str) -> None:
    files = spoilt([meshes[kind]], 200, 5, *OWN_WORDS[kind])
    suffix = kind.split()[-1]
    if kind == "model":
        files, suffix = [packed(f) for f in files], "3mf"
    path = tmp_path / f"lens.{suffix}"
    path.write_bytes(packed(meshes[kind]) if kind == "model" else meshes[kind])
    whole = read_mesh(path)
    assert len(whole.faces) > 50

    def check(mesh: Any) -> bool:
        return (
            isinstance(mesh, TriangleMesh)
            and np.isfinite(mesh.vertices_mm).all()
            and 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices_mm)
            and len(mesh.faces) < 3 * len(whole.faces)
        )

    assert sum(outcomes(path, files, read_mesh, check)) < 180
