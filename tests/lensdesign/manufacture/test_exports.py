"""Exports state the outline of their bodies, in the file and on the terminal."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from places import DESIGNS, GOLDEN
from typer.testing import CliRunner

from lensdesign.cli.commands import app
from lensdesign.files.design import load_design
from lensdesign.files.formats import read_lens_file, write_lens_file
from lensdesign.lens.surface_roughness import SurfaceRoughness
from lensdesign.manufacture.exports import ExportOptions, export_lens
from lensdesign.manufacture.mesh.reading import read_mesh

STATEMENT = b"element 1 (surfaces 1 and 2): ground diameter 7.3 mm, chosen"


def exported(path: Path, design: Path, measured: bool = False):
    notes: list[str] = []
    made = export_lens(load_design(design), path, ExportOptions(5.0, measured, notes.append))
    return made, notes


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj", ".3mf", ".glb"])
def test_meshes_hold_their_outline(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"lens{suffix}"
    made, _ = exported(path, GOLDEN / "designer_b" / "thin.toml")
    assert made.values["ground_diameters_mm"] == [7.3]
    assert made.outline == tuple(made.values["outline"])
    if suffix == ".3mf":
        import zipfile

        data = zipfile.ZipFile(path).read("3D/3dmodel.model")
    else:
        data = path.read_bytes()
    assert STATEMENT in data
    if suffix == ".glb":
        bounds = trimesh.load(path).bounds * 1e3
    else:
        vertices = read_mesh(path).vertices_mm
        bounds = np.array([vertices.min(axis=0), vertices.max(axis=0)])
    assert bounds[1, 0] == pytest.approx(3.65, abs=0.01)


def test_step_files_hold_their_outline(tmp_path: Path) -> None:
    pytest.importorskip("OCP")
    made, _ = exported(tmp_path / "lens.step", GOLDEN / "designer_b" / "thin.toml")
    head = (tmp_path / "lens.step").read_bytes()[:800].replace(b"\n", b"")
    assert STATEMENT in head
    assert made.values["ground_diameters_mm"] == [7.3]


def test_measured_bodies_end_at_their_clear_apertures_and_say_so(tmp_path: Path) -> None:
    made, _ = exported(tmp_path / "lens.stl", DESIGNS / "measured_singlet.toml", measured=True)
    (statement,) = made.outline
    assert "diameter 20 mm (clear aperture" in statement
    assert (tmp_path / "lens.stl").read_bytes()[:80].startswith(b"transferlens element 1")


@pytest.mark.parametrize("suffix", [".zmx", ".seq"])
def test_files_of_other_programs_name_the_coatings_that_they_lack(suffix: str, tmp_path: Path) -> None:
    lens = load_design(DESIGNS / "paper_singlet.toml").with_surface(0, coating="mgf2")
    rough = SurfaceRoughness(rms_nm=2.0, correlation_length_um=5.0)
    notes: list[str] = []
    path = tmp_path / f"lens{suffix}"
    made = export_lens(lens.with_surface(1, roughness=rough), path, ExportOptions(5.0, False, notes.append))
    assert notes == [
        f"surface 1: a {suffix} file cannot contain its coating; omitted: MgF2, quarter wave at 532 nm",
        f"surface 2: a {suffix} file cannot contain its roughness; omitted",
    ]
    assert made.values["surfaces_without_their_coating"] == [1]
    assert made.values["surfaces_without_their_roughness"] == [2]
    assert {surface.coating for surface in read_lens_file(path).lens.surfaces} == {"ideal"}
    with pytest.warns(UserWarning, match="surface 1: a .* cannot contain its coating"):
        write_lens_file(lens, path)
    assert exported(path, DESIGNS / "paper_singlet.toml")[1] == []


def command(*arguments: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    return done.exit_code, done.stdout, done.stderr


def test_commands_state_the_outline(tmp_path: Path) -> None:
    """Export and drawing of one design have one diameter, and both say which."""
    design = DESIGNS / "paper_singlet.toml"
    code, out, err = command("export", design, tmp_path / "lens.stl", "--chord-error-um", "5")
    assert code == 0
    assert err == (
        "outline: element 1 (surfaces 1 and 2): ground diameter 22.5 mm, chosen as for a drawing "
        "(clear 20 mm), edge 2.78 mm thick\n"
    )
    assert out.startswith("wrote")
    _, _, notes = command("drawing", design, "-o", tmp_path / "sheet.svg")
    assert "ground diameter 22.5 mm chosen" in notes
    code, out, err = command("scene", design, "-o", tmp_path / "scene.glb", "--json")
    assert (code, err) == (0, "")
    assert "ground diameter 22.5 mm" in json.loads(out)["outline"][0]
    code, out, _ = command("verify", design, tmp_path / "lens.stl", "--chord-error-um", "6")
    assert code == 0
    assert out.startswith("outline of the design: element 1 (surfaces 1 and 2): ground diameter 22.5 mm")
