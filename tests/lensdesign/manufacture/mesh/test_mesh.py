"""Meshes: closed, as near to the glass as asked, of known volume, and readable by others."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.spatial import cKDTree
from small_lenses import lens_of

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import mechanical_semi_diameter_mm
from lensdesign.manufacture.mesh.mesh import MESH_SUFFIXES, LensMesh, lens_mesh, write_mesh


@pytest.fixture(scope="module")
def doublet() -> Lens:
    return lens_of(
        {"radius_mm": 40.0, "thickness_mm": 6.0, "material": "N-BK7", "semi_diameter_mm": 9.0},
        {"radius_mm": -30.0, "thickness_mm": 2.0, "material": "N-SF6", "semi_diameter_mm": 9.0},
        {"radius_mm": -90.0, "semi_diameter_mm": 9.0},
    )


def assert_closed(mesh: trimesh.Trimesh) -> None:
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 2
    assert mesh.volume > 0.0


def largest_distance_mm(lens: Lens, mesh: trimesh.Trimesh, count: int = 20_000) -> tuple[float, float]:
    """Largest distance of random points on optical facets to a dense meridian, and its sampling error."""
    edge = mechanical_semi_diameter_mm(lens, 0)
    outline = []
    for surface, z in zip(lens.surfaces, lens.vertex_z_mm, strict=True):
        r = edge * np.sin(np.linspace(0.0, 0.5 * math.pi, 40_001))
        outline.append(np.stack([r, z + surface.sag_mm(r)], axis=-1))
        # Rings reach past the rim, by the sagitta of the edge at most; the tangent goes on there.
        slope = float(surface.slope(edge))
        if math.isfinite(slope):
            beyond = edge * np.linspace(0.0, 0.04, 2001)
            rim = z + surface.sag_mm(edge) + beyond * slope
            outline.append(np.stack([edge + beyond, rim], axis=-1))
    rng = np.random.default_rng(1)
    share = rng.dirichlet([0.6, 0.6, 0.6], count)
    optical = np.flatnonzero(np.abs(mesh.face_normals[:, 2]) > 1e-9)
    corners = mesh.triangles[rng.choice(optical, count)]
    points: NDArray[np.float64] = np.einsum("nk,nkd->nd", share, corners)
    radial = np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]], axis=-1)
    spacing = max(float(np.max(np.linalg.norm(np.diff(part, axis=0), axis=1))) for part in outline)
    distance = cKDTree(np.concatenate(outline)).query(radial)[0]
    return float(np.max(distance)), 0.5 * spacing


def test_paper_lens(paper_lens: Lens) -> None:
    result = lens_mesh(paper_lens)
    assert_closed(result.mesh)
    assert 0.05 < result.chord_error_um <= 0.1
    assert result.edge_error_um <= 10.0
    assert abs(result.volume_error) < min(result.volume_tolerance, 1e-8)
    assert result.mesh.bounds == pytest.approx(np.array([[-10.0, -10.0, 0.0], [10.0, 10.0, 9.7]]), abs=1e-4)


def test_volume_error_falls_with_the_square_of_the_chord_error(paper_lens: Lens) -> None:
    coarse, fine = lens_mesh(paper_lens, 10.0), lens_mesh(paper_lens, 1.0)
    assert abs(fine.volume_error) < 0.03 * abs(coarse.volume_error) < 1e-7


@pytest.mark.parametrize("chord_error_um", [10.0, 1.0])
def test_facets_lie_to_both_sides(paper_lens: Lens, chord_error_um: float) -> None:
    mesh = lens_mesh(paper_lens, chord_error_um).mesh
    front = mesh.triangles_center[mesh.face_normals[:, 2] < -0.5]
    at_corners = mesh.vertices[np.unique(mesh.faces[mesh.face_normals[:, 2] < -0.5])]
    sag = paper_lens.surfaces[0].sag_mm
    assert np.all(front[:, 2] > sag(np.hypot(*front[:, :2].T)))
    assert np.all(at_corners[:, 2] < sag(np.hypot(*at_corners[:, :2].T)))


def test_facets_are_where_the_stated_chord_error_says(paper_lens: Lens) -> None:
    for asked_um in (100.0, 10.0, 1.0):
        result = lens_mesh(paper_lens, asked_um)
        found, sampling = largest_distance_mm(paper_lens, result.mesh)
        assert found <= 1.002e-3 * result.chord_error_um + sampling
        assert found > 0.9e-3 * result.chord_error_um - sampling


def test_ball_lens_against_closed_form() -> None:
    lens = lens_of(
        {"radius_mm": 5.0, "thickness_mm": 10.0, "material": "N-BK7", "semi_diameter_mm": 4.9},
        {"radius_mm": -5.0, "semi_diameter_mm": 4.9},
    )
    result = lens_mesh(lens, 1.0)
    # A ball less the ring outside the cylinder: napkin-ring theorem.
    length = 2.0 * math.sqrt(25.0 - 4.9**2)
    expected = 4.0 / 3.0 * math.pi * 125.0 - math.pi * length**3 / 6.0
    assert_closed(result.mesh)
    assert result.exact_volume_mm3 == pytest.approx(expected, rel=1e-13)
    assert result.volume_mm3 == pytest.approx(expected, rel=result.volume_tolerance)


def test_hemisphere_up_to_its_upright_edge() -> None:
    lens = lens_of(
        {"radius_mm": 4.0, "thickness_mm": 5.0, "material": "N-BK7", "semi_diameter_mm": 4.0},
        {"semi_diameter_mm": 4.0},
    )
    result = lens_mesh(lens, 2.0)
    assert_closed(result.mesh)
    assert result.chord_error_um <= 2.0
    expected = math.pi * 64.0 * (2.0 / 3.0 + 0.25)
    assert result.volume_mm3 == pytest.approx(expected, rel=result.volume_tolerance)
    ball = result.mesh.vertices[result.mesh.vertices[:, 2] < 4.0 - 1e-9]
    assert np.linalg.norm(ball - [0.0, 0.0, 4.0], axis=1) == pytest.approx(4.0, abs=2e-3)


def test_flat_annulus() -> None:
    lens = lens_of(
        {"radius_mm": 8.0, "thickness_mm": 9.0, "material": "N-BK7", "semi_diameter_mm": 6.0},
        {"semi_diameter_mm": 10.0},
    )
    result = lens_mesh(lens)
    assert_closed(result.mesh)
    assert result.volume_mm3 == pytest.approx(result.exact_volume_mm3, rel=result.volume_tolerance)


def test_plane_parallel_plate_is_a_prism() -> None:
    lens = lens_of(
        {"thickness_mm": 3.0, "material": "N-BK7", "semi_diameter_mm": 5.0}, {"semi_diameter_mm": 5.0}
    )
    result = lens_mesh(lens)
    sides = result.triangles // 4
    assert result.chord_error_um < 1e-11
    # A regular polygon with the area of the circle: its corners stand out by two thirds of its sagitta.
    sagitta = 5.0 * (1.0 - math.cos(math.pi / sides))
    assert result.edge_error_um == pytest.approx(2e3 / 3.0 * sagitta, rel=0.01)
    assert 3.0 < result.edge_error_um <= 10.0
    assert result.volume_mm3 == pytest.approx(75.0 * math.pi, rel=1e-14)


def test_asphere_with_an_inflection() -> None:
    lens = lens_of(
        {
            "radius_mm": 15.0,
            "conic": -0.5,
            "asphere": [-3e-4, 5e-7],
            "thickness_mm": 5.0,
            "material": "N-BK7",
            "semi_diameter_mm": 9.0,
        },
        {"radius_mm": -60.0, "semi_diameter_mm": 9.0},
    )
    slope = lens.surfaces[0].slope(np.linspace(0.0, 9.0, 200))
    assert np.any(np.diff(slope) < 0.0)
    result = lens_mesh(lens, 10.0)
    found, sampling = largest_distance_mm(lens, result.mesh)
    assert_closed(result.mesh)
    assert found <= 1.002e-3 * result.chord_error_um + sampling


@settings(max_examples=40, deadline=None)
@given(
    radii=st.tuples(*[st.floats(6.0, 300.0) | st.floats(-300.0, -6.0)] * 2),
    conics=st.tuples(*[st.floats(-4.0, 2.0)] * 2),
    thickness=st.floats(0.5, 12.0),
    edge=st.floats(1.0, 8.0),
    chord_error_um=st.floats(3.0, 200.0),
)
def test_random_conics(
    radii: tuple[float, float],
    conics: tuple[float, float],
    thickness: float,
    edge: float,
    chord_error_um: float,
) -> None:
    first, second = (
        {"radius_mm": r, "conic": k, "semi_diameter_mm": edge} for r, k in zip(radii, conics, strict=True)
    )
    try:
        lens = lens_of(first | {"thickness_mm": thickness, "material": "N-BK7"}, second)
    except ValidationError:
        reject()
    result = lens_mesh(lens, chord_error_um)
    assert_closed(result.mesh)
    assert result.chord_error_um <= chord_error_um
    assert abs(result.volume_error) <= result.volume_tolerance
    found, sampling = largest_distance_mm(lens, result.mesh, 4000)
    assert found <= 1.002e-3 * result.chord_error_um + sampling


@pytest.mark.parametrize("suffix", sorted({*MESH_SUFFIXES} - {".3mf"}))
def test_files_read_back(paper_lens: Lens, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"lens{suffix}"
    written = write_mesh(paper_lens, path, 10.0)
    read = trimesh.load(path, force="mesh")
    scale = 1e-3 if suffix == ".glb" else 1.0
    assert_closed(read)
    assert len(read.faces) == written.triangles
    assert read.volume == pytest.approx(written.volume_mm3 * scale**3, rel=1e-6)
    assert read.bounds == pytest.approx(written.mesh.bounds * scale, rel=1e-6, abs=1e-6 * scale)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_stl_is_binary_and_outward(paper_lens: Lens, tmp_path: Path) -> None:
    write_mesh(paper_lens, tmp_path / "lens.STL", 10.0)
    data = (tmp_path / "lens.STL").read_bytes()
    count = int.from_bytes(data[80:84], "little")
    assert len(data) == 84 + 50 * count
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets = np.frombuffer(data[84:], record)
    outward = facets["corners"].mean(axis=1) - [0.0, 0.0, 5.0]
    assert np.all(np.einsum("nd,nd->n", facets["normal"], outward) > 0.0)


def test_two_elements_are_two_bodies(doublet: Lens, tmp_path: Path) -> None:
    written = write_mesh(doublet, tmp_path / "lens.glb", 10.0)
    single = [lens_mesh(doublet, 10.0, element=i) for i in (0, 1)]
    assert written.triangles == sum(p.triangles for p in single)
    assert written.exact_volume_mm3 == pytest.approx(sum(p.exact_volume_mm3 for p in single))
    assert written.volume_mm3 == pytest.approx(written.mesh.volume)
    scene = trimesh.load(tmp_path / "lens.glb")
    assert isinstance(scene, trimesh.Scene)
    volumes = sorted(g.volume * 1e9 for g in scene.geometry.values())
    assert volumes == pytest.approx(sorted(p.volume_mm3 for p in single), rel=1e-5)
    write_mesh(doublet, tmp_path / "lens.obj", 10.0)
    assert trimesh.load(tmp_path / "lens.obj", force="mesh").volume == pytest.approx(written.volume_mm3)


def test_element_that_does_not_exist(doublet: Lens) -> None:
    for element in (2, -1):
        with pytest.raises(InputError, match=rf"element = {element}: .*allowed: 0 to 1"):
            lens_mesh(doublet, element=element)


@pytest.mark.parametrize("chord_error_um", [0.0, -1.0, math.nan, math.inf])
def test_chord_error_must_be_above_0(paper_lens: Lens, chord_error_um: float) -> None:
    with pytest.raises(InputError, match=r"chord_error_um = .*above 0"):
        lens_mesh(paper_lens, chord_error_um)


def test_too_many_triangles_are_refused_with_their_number(paper_lens: Lens) -> None:
    coarse = lens_mesh(paper_lens, 10.0)
    with pytest.raises(InputError, match=r"triangles.*2e\+07") as error:
        lens_mesh(paper_lens, 1e-5)
    named = re.search(r"need ([0-9.e+]+) triangles", str(error.value))
    assert named is not None
    assert float(named[1]) == pytest.approx(coarse.triangles * 1e6, rel=0.1)


def test_chord_error_too_coarse_for_a_thin_meniscus() -> None:
    lens = lens_of(
        {"radius_mm": 10.0, "thickness_mm": 0.02, "material": "N-BK7", "semi_diameter_mm": 8.0},
        {"radius_mm": 9.8, "semi_diameter_mm": 8.0},
    )
    # One chord will do for the front, from vertex to edge, but not for the steeper back.
    one_chord_um = 1e4 * (1.0 - math.cos(0.5 * math.asin(0.8)))
    with pytest.raises(InputError, match=r"element 1 .*cross"):
        lens_mesh(lens, 1.5 * one_chord_um)
    assert_closed(lens_mesh(lens, 10.0).mesh)


def test_nothing_is_written_where_the_lens_does_not_close(tmp_path: Path, paper_lens: Lens) -> None:
    thin = paper_lens.with_surface(0, thickness_mm=4.5)
    path = tmp_path / "lens.stl"
    with pytest.raises(InputError, match=r"edge thickness.* -0\.\d+ mm"):
        write_mesh(thin, path)
    assert not list(tmp_path.iterdir())


def test_unknown_suffix_names_the_allowed_ones(tmp_path: Path, paper_lens: Lens) -> None:
    with pytest.raises(InputError, match=r"\.step'.*\.stl, \.ply, \.obj, \.glb, \.3mf"):
        write_mesh(paper_lens, tmp_path / "lens.step")
    assert not list(tmp_path.iterdir())


def test_an_old_file_stays_where_the_new_one_cannot_be_made(tmp_path: Path, paper_lens: Lens) -> None:
    path = tmp_path / "lens.ply"
    path.write_text("old")
    with pytest.raises(InputError):
        write_mesh(paper_lens, path, 1e-6)
    assert path.read_text() == "old"


def test_result_is_frozen(paper_lens: Lens) -> None:
    result: LensMesh = lens_mesh(paper_lens, 100.0)
    with pytest.raises(AttributeError):
        result.chord_error_um = 0.0  # type: ignore[misc]


def test_trimesh_is_imported_only_when_meshing() -> None:
    code = "import sys, lensdesign.manufacture.mesh.mesh; raise SystemExit('trimesh' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
