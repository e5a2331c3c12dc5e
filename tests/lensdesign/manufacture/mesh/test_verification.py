"""Meshes held against the design: our own agree, and each fault that a mesh can have is found and named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from places import GOLDEN
from programs import run_program

from lensdesign import InputError, Lens, Surface
from lensdesign.cli.commands import main
from lensdesign.lens.edges import Edge, Flange
from lensdesign.manufacture.mesh.mesh import lens_mesh, write_mesh
from lensdesign.manufacture.mesh.reading import TriangleMesh, read_mesh
from lensdesign.manufacture.mesh.verification import (
    UNITS_MM,
    MeshReport,
    closed_bodies,
    merged,
    verify_mesh,
)

CHORD_UM = 2.0


@pytest.fixture(scope="module")
def doublet(paper_lens: Lens) -> Lens:
    """A cemented lens of two elements and an air-spaced third one."""
    semi = 5.0
    return paper_lens.replaced(
        surfaces=(
            Surface(radius_mm=30.0, thickness_mm=5.0, material="N-BK7", semi_diameter_mm=semi, stop=True),
            Surface(radius_mm=-20.0, thickness_mm=2.0, material="N-SF11", semi_diameter_mm=semi),
            Surface(radius_mm=-60.0, thickness_mm=3.0, semi_diameter_mm=semi),
            Surface(radius_mm=None, thickness_mm=3.0, material="N-BK7", semi_diameter_mm=semi),
            Surface(radius_mm=40.0, conic=-2.0, semi_diameter_mm=semi),
        )
    )


@pytest.fixture(scope="module")
def coarse(paper_lens: Lens) -> trimesh.Trimesh:
    """The paper's lens."""
    return lens_mesh(paper_lens, CHORD_UM).mesh


def held(lens: Lens, mesh: trimesh.Trimesh, chord_error_um: float = CHORD_UM) -> MeshReport:
    return verify_mesh(lens, TriangleMesh(np.array(mesh.vertices), np.array(mesh.faces)), chord_error_um)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj", ".3mf"])
def test_what_we_write_agrees(tmp_path: Path, doublet: Lens, suffix: str) -> None:
    path = tmp_path / f"lens{suffix}"
    written = write_mesh(doublet, path, CHORD_UM)
    report = verify_mesh(doublet, read_mesh(path), CHORD_UM)
    assert report.faults == ()
    assert (report.bodies, report.elements, report.closed) == (3, 3, True)
    assert report.triangles == written.triangles
    assert report.volume_mm3 == pytest.approx(written.volume_mm3, rel=1e-6)
    assert report.exact_volume_mm3 == pytest.approx(written.exact_volume_mm3, rel=1e-12)
    assert [(d.element, d.surface) for d in report.distances] == [
        (1, 1),
        (1, 2),
        (2, 2),
        (2, 3),
        (3, 4),
        (3, 5),
    ]
    assert all(d.points > 100 for d in report.distances)
    curved = [d.greatest_um for d in report.distances if d.surface != 4]
    assert 0.5 * CHORD_UM < max(v for v in curved if v is not None) <= written.chord_error_um + 1e-3
    assert report.distances[4].greatest_um == pytest.approx(0.0, abs=1e-3)  # the plane


def test_distances_are_those_to_the_surface(paper_lens: Lens, coarse: trimesh.Trimesh) -> None:
    """A mesh moved along the axis stands off by that, times the cosine of the slope."""
    moved = coarse.copy()
    moved.apply_translation([0.0, 0.0, 0.01])
    front, back = held(paper_lens, moved).distances
    for side in (front, back):
        assert side.greatest_um is not None
        assert side.rms_um is not None
        assert 10.0 - CHORD_UM < side.greatest_um < 10.0 + CHORD_UM
        assert 5.0 < side.rms_um < 10.5
    assert len(held(paper_lens, moved).faults) == 2


def test_each_fault_is_found(paper_lens: Lens, coarse: trimesh.Trimesh) -> None:
    def faults(mesh: trimesh.Trimesh) -> str:
        return "\n".join(held(paper_lens, mesh).faults)

    assert faults(coarse) == ""
    opened = trimesh.Trimesh(coarse.vertices, coarse.faces[1:], process=False)
    assert faults(opened) == "the mesh is open: 3 edges without a counterpart"
    turned = trimesh.Trimesh(
        coarse.vertices, np.vstack([coarse.faces[:1, ::-1], coarse.faces[1:]]), process=False
    )
    assert faults(turned).startswith("the mesh is open: 3 edges without a counterpart")
    inside_out = trimesh.Trimesh(coarse.vertices, coarse.faces[:, ::-1], process=False)
    assert "the mesh is inside out" in faults(inside_out)
    speck = trimesh.creation.icosphere(2, 0.5)
    speck.apply_translation([0.0, 0.0, 5.0])
    assert "2 bodies, where the design has 1" in faults(trimesh.util.concatenate([coarse, speck]))
    inches = coarse.copy()
    inches.apply_scale(1.0 / 25.4)
    assert "µm off; allowed: 2 µm" in faults(inches)
    wall = coarse.faces[np.abs(coarse.face_normals[:, 2]) < 1e-6]
    tube = trimesh.Trimesh(coarse.vertices, wall, process=False)
    assert "no part of the mesh belongs to surface 2 of element 1" in faults(tube)
    dented = coarse.copy()
    middle = int(np.argmin(np.linalg.norm(coarse.vertices - coarse.vertices.mean(axis=0), axis=1)))
    dented.vertices[middle] += [0.0, 0.0, 0.003]
    assert "3" in faults(dented).split("µm off")[0]


def test_a_mesh_turned_about_the_axis_is_the_same(paper_lens: Lens, coarse: trimesh.Trimesh) -> None:
    turned = coarse.copy()
    turned.apply_transform(trimesh.transformations.rotation_matrix(1.234, [0, 0, 1]))
    assert held(paper_lens, turned).faults == ()


def test_a_coarse_edge_is_not_taken_for_a_surface(paper_lens: Lens, coarse: trimesh.Trimesh) -> None:
    """Edge facets that stand inside of the cylinder and end near the rim, cut small."""
    wall = np.abs(coarse.face_normals[:, 2]) < 1e-6
    vertices, faces = np.array(coarse.vertices), np.array(coarse.faces)
    for _ in range(3):
        vertices, faces = trimesh.remesh.subdivide(vertices, faces, np.flatnonzero(wall))
        wall = np.abs(trimesh.Trimesh(vertices, faces, process=False).face_normals[:, 2]) < 1e-6
    report = held(paper_lens, trimesh.Trimesh(vertices, faces, process=False))
    assert [f for f in report.faults if "off" in f] == []


def test_bodies_that_touch_are_told_apart() -> None:
    first, second = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1))
    for shift, bodies in [((1, 0, 0), 2), ((1, 1, 0), 2), ((2, 0, 0), 2)]:
        other = second.copy()
        other.apply_translation(shift)
        both = trimesh.util.concatenate([first, other])
        mesh = TriangleMesh(np.array(both.vertices), np.array(both.faces))
        assert closed_bodies(*merged(mesh)) == (bodies, 0)
    # A tunnel of no width: one body that meets itself along an edge.
    corner = first.copy()
    assert closed_bodies(np.array(corner.vertices), np.array(corner.faces)) == (1, 0)
    assert closed_bodies(np.array(corner.vertices), np.array(corner.faces[:-1])) == (1, 3)
    assert closed_bodies(np.empty((0, 3)), np.empty((0, 3), np.int64)) == (0, 0)


def test_the_command(
    paper_design: Path, tmp_path: Path, paper_lens: Lens, capsys: pytest.CaptureFixture
) -> None:
    def command(*words: object) -> tuple[int, str, str]:
        import sys
        from unittest import mock

        with (
            mock.patch.object(sys, "argv", ["lensdesign", *map(str, words)]),
            pytest.raises(SystemExit) as stop,
        ):
            main()
        out, err = capsys.readouterr()
        return int(stop.value.code or 0), out, err

    path = tmp_path / "lens.stl"
    write_mesh(paper_lens, path, CHORD_UM)
    code, out, _ = command("verify", paper_design, path, "--chord-error-um", CHORD_UM)
    assert code == 0
    assert "closed, 1 body (design: 1)" in out
    assert out.endswith("the mesh agrees with the design within 2 µm\n")
    code, out, _ = command("verify", paper_design, path)
    assert code == 1
    assert "not met: surface 1 of element 1" in out
    code, out, _ = command("verify", paper_design, path, "--json")
    data = json.loads(out)
    assert (code, data["agrees"], data["closed"], len(data["faults"])) == (1, False, True, 2)
    path.write_bytes(path.read_bytes()[:-1])
    assert command("verify", paper_design, path)[0] == 2
    assert command("verify", paper_design, tmp_path / "none.stl")[0] == 2
    assert command("verify", paper_design, path, "--chord-error-um", "nan")[0] == 2


def test_what_cannot_be_asked_is_refused(paper_lens: Lens, coarse: trimesh.Trimesh) -> None:
    for bad in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="must be above 0 and finite"):
            held(paper_lens, coarse, bad)


def test_bevels_flats_and_a_flange_belong_to_the_edge(paper_lens: Lens) -> None:
    edge = Edge(
        semi_diameter_mm=11.0,
        front_flat_from_mm=10.0,
        back_flat_from_mm=10.2,
        front_bevel_mm=0.3,
        back_bevel_mm=0.2,
        flange=Flange(semi_diameter_mm=12.5, distance_mm=3.0, thickness_mm=1.5),
    )
    lens = paper_lens.replaced(edges=(edge,))
    report = held(lens, lens_mesh(lens, CHORD_UM).mesh)
    assert report.faults == ()
    assert report.edge_greatest_um is not None
    assert report.edge_greatest_um <= 10.0


def test_a_mesh_in_inches_is_recognised(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    files = (GOLDEN / "study_units" / "p.toml", GOLDEN / "mesh_units" / "inches.stl")
    arguments = ["verify", *map(str, files), "--chord-error-um", "20"]
    code, out, _ = run_program(monkeypatch, capsys, "lensdesign", *arguments, "--json")
    found = json.loads(out)
    assert (code, found["unit"], found["agrees_in_unit"], found["agrees"]) == (1, "inches", True, False)
    _, out, err = run_program(monkeypatch, capsys, "lensdesign", *arguments)
    assert "after a factor of 25.4; is it in inches?" in " ".join((out + err).split())


@pytest.mark.parametrize("unit", sorted(UNITS_MM))
def test_other_units_are_recognised_by_the_width(
    paper_lens: Lens, coarse: trimesh.Trimesh, unit: str
) -> None:
    """A shifted mesh has the size of the design, but does not agree; a lens of another size has no unit."""
    mm = UNITS_MM[unit]
    for shift_mm, agrees in ((0.0, True), (1.0, False)):
        vertices = (np.array(coarse.vertices) + np.array([0.0, 0.0, shift_mm])) / mm
        report = verify_mesh(paper_lens, TriangleMesh(vertices, np.array(coarse.faces)), CHORD_UM)
        assert (report.unit, report.agrees_in_unit) == (unit, agrees)
        assert f"{mm:g}" in report.faults[0]
    smaller = TriangleMesh(0.7 * np.array(coarse.vertices), np.array(coarse.faces))
    assert verify_mesh(paper_lens, smaller, CHORD_UM).unit is None
