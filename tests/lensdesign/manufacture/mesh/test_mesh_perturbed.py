"""Meshes of perturbed and measured lenses: as near to the exact perturbed surfaces as they say."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from small_lenses import lens_of

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.lens.surface_figure import surface_figure_from_grid, surface_figure_from_zernike
from lensdesign.manufacture.mesh.mesh import LensMesh, lens_mesh, write_mesh

EDGE_MM = 5.0
Array = NDArray[np.float64]


def singlet(**front: Any) -> Lens:
    return lens_of(
        {"radius_mm": 20.0, "thickness_mm": 4.0, "material": "N-BK7", "semi_diameter_mm": EDGE_MM} | front,
        {"radius_mm": -15.0, "conic": -0.7, "semi_diameter_mm": EDGE_MM},
    )


def plate() -> Lens:
    return lens_of(
        {"thickness_mm": 3.0, "material": "N-BK7", "semi_diameter_mm": EDGE_MM}, {"semi_diameter_mm": EDGE_MM}
    )


def assert_closed(mesh: trimesh.Trimesh) -> None:
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 2
    assert mesh.volume > 0.0


def distances(points: Array, lens: Lens, i: int, change: SurfacePerturbation, spherical_um: float) -> Array:
    """Distances of points to an exact perturbed surface: foot points in its own frame, exact figure."""
    turned = Rotation.from_euler("XY", [change.tilt_x_deg, change.tilt_y_deg], degrees=True)
    vertex = [change.decenter_x_mm, change.decenter_y_mm, lens.vertex_z_mm[i]]
    own = turned.inv().apply(points - np.array(vertex))

    def sag(x: Array, y: Array) -> Array:
        rho2 = (x * x + y * y) / 5.5**2
        figure = 1e-3 * spherical_um * math.sqrt(5.0) * (6.0 * rho2 * rho2 - 6.0 * rho2 + 1.0)
        return np.asarray(lens.surfaces[i].sag_mm(np.hypot(x, y)) + figure)

    x, y, h = own[:, 0], own[:, 1], 1e-5
    for _ in range(30):
        slopes = [(sag(x + h, y) - sag(x - h, y)) / (2 * h), (sag(x, y + h) - sag(x, y - h)) / (2 * h)]
        normal = np.stack([-slopes[0], -slopes[1], np.ones_like(x)], axis=-1)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        off = own - np.stack([x, y, sag(x, y)], axis=-1)
        along = off - np.sum(off * normal, axis=1)[:, None] * normal
        x, y = x + along[:, 0], y + along[:, 1]
    return np.asarray(np.linalg.norm(own - np.stack([x, y, sag(x, y)], axis=-1), axis=1))


def optical_points(result: LensMesh, back: bool, count: int = 4000) -> Array:
    """Random points on the facets of one optical surface."""
    rng = np.random.default_rng(2)
    up = result.mesh.face_normals[:, 2]
    facets = rng.choice(np.flatnonzero(up > 0.3 if back else up < -0.3), count)
    share = rng.dirichlet([0.6, 0.6, 0.6], count)
    return np.asarray(np.einsum("nk,nkd->nd", share, result.mesh.triangles[facets]))


@settings(max_examples=25)
@given(
    back=st.booleans(),
    tilt=st.tuples(*[st.floats(-1.0, 1.0)] * 2),
    decenter=st.tuples(*[st.floats(-0.2, 0.2)] * 2),
    spherical_um=st.floats(-2.0, 2.0),
    chord_error_um=st.floats(0.3, 10.0),
)
def test_facets_are_where_the_stated_chord_error_says(
    back: bool,
    tilt: tuple[float, float],
    decenter: tuple[float, float],
    spherical_um: float,
    chord_error_um: float,
) -> None:
    lens, i = singlet(), int(back)
    change = SurfacePerturbation(
        decenter_x_mm=decenter[0],
        decenter_y_mm=decenter[1],
        tilt_x_deg=tilt[0],
        tilt_y_deg=tilt[1],
        figure=surface_figure_from_zernike({12: spherical_um}, 5.5),
    )
    result = lens_mesh(lens, chord_error_um, surface_perturbations={i: change})
    assert_closed(result.mesh)
    assert result.chord_error_um <= chord_error_um
    found = float(np.max(distances(optical_points(result, back), lens, i, change, spherical_um)))
    # Points at random miss the very worst of few facets.
    assert 0.6e-3 * result.chord_error_um < found <= 1.05e-3 * result.chord_error_um + 1e-8
    other = SurfacePerturbation()
    assert (
        np.max(distances(optical_points(result, not back), lens, 1 - i, other, 0.0)) <= 1e-3 * chord_error_um
    )
    assert abs(result.volume_error) < 0.02 * result.volume_tolerance


def test_next_to_no_tilt_is_the_nominal_body(paper_lens: Lens) -> None:
    nominal = lens_mesh(paper_lens, 1.0)
    general = lens_mesh(paper_lens, 1.0, surface_perturbations={1: SurfacePerturbation(tilt_x_deg=1e-9)})
    assert general.triangles == nominal.triangles
    assert general.exact_volume_mm3 == pytest.approx(nominal.exact_volume_mm3, rel=1e-10)
    assert general.chord_error_um == pytest.approx(nominal.chord_error_um, rel=0.02)
    assert abs(general.volume_error) < 1e-7


def test_symmetric_deltas_are_another_lens() -> None:
    changes = {
        0: SurfacePerturbation(radius_mm=1.0, thickness_mm=0.3),
        1: SurfacePerturbation(conic=0.2, radius_mm=-0.5),
    }
    result = lens_mesh(singlet(), 1.0, surface_perturbations=changes)
    other = singlet(radius_mm=21.0, thickness_mm=4.3).with_surface(1, radius_mm=-15.5, conic=-0.5)
    assert result.mesh.vertices == pytest.approx(lens_mesh(other, 1.0).mesh.vertices, abs=1e-12)


def test_despace_adds_a_cylinder() -> None:
    nominal = lens_mesh(singlet(), 10.0)
    result = lens_mesh(singlet(), 10.0, surface_perturbations={1: SurfacePerturbation(despace_mm=0.25)})
    added = result.exact_volume_mm3 - nominal.exact_volume_mm3
    assert added == pytest.approx(0.25 * math.pi * EDGE_MM**2, rel=1e-10)


def test_a_tilted_plane_keeps_the_volume_of_a_plate() -> None:
    result = lens_mesh(plate(), surface_perturbations={1: SurfacePerturbation(tilt_x_deg=2.0)})
    assert_closed(result.mesh)
    assert result.chord_error_um < 1e-9
    assert result.exact_volume_mm3 == pytest.approx(3.0 * math.pi * EDGE_MM**2, rel=1e-12)
    assert result.volume_mm3 == pytest.approx(result.exact_volume_mm3, rel=1e-12)
    # Right-handed about x: what lies at +y goes towards +z.
    rise = math.tan(math.radians(2.0))
    back = result.mesh.vertices[result.mesh.vertices[:, 2] > 2.0]
    assert back[:, 2] == pytest.approx(3.0 + rise * back[:, 1], abs=1e-12)


def test_zernike_figures_against_closed_forms() -> None:
    def volume(index: int) -> float:
        figure = surface_figure_from_zernike({index: 2.0}, EDGE_MM)
        change = {0: SurfacePerturbation(figure=figure)}
        return lens_mesh(plate(), 1.0, surface_perturbations=change).exact_volume_mm3

    disc = math.pi * EDGE_MM**2
    assert volume(0) == pytest.approx((3.0 - 2e-3) * disc, rel=1e-9)
    assert volume(4) == pytest.approx(3.0 * disc, rel=1e-9)


def test_pose_moves_the_whole() -> None:
    pose = Pose(decenter_x_mm=1.0, despace_mm=-2.0, tilt_y_deg=30.0, pivot_z_mm=2.0)
    still, moved = lens_mesh(singlet(), 10.0), lens_mesh(singlet(), 10.0, pose=pose)
    turned = Rotation.from_euler("y", 30.0, degrees=True)
    expected = turned.apply(still.mesh.vertices - [0.0, 0.0, 2.0]) + np.array([1.0, 0.0, 0.0])
    assert moved.mesh.vertices == pytest.approx(expected, abs=1e-12)
    assert moved.mesh.volume == pytest.approx(still.volume_mm3, rel=1e-12)


def test_measured_figures(tmp_path: Any) -> None:
    figure = {"zernike_um": {"7": 1.5}, "semi_diameter_mm": 5.0}
    lens = singlet(figure=figure)
    change = {0: SurfacePerturbation(figure=surface_figure_from_zernike({7: 1.5}, 5.0))}
    notes: list[str] = []
    measured = write_mesh(lens, tmp_path / "lens.ply", 1.0, warn=notes.append, measured=True)
    assert not notes
    assert measured.mesh.vertices == pytest.approx(
        lens_mesh(singlet(), 1.0, surface_perturbations=change).mesh.vertices, abs=1e-12
    )
    nominal = write_mesh(lens, tmp_path / "lens.ply", 1.0, warn=notes.append)
    (note,) = notes
    assert note.startswith("surface 1: ")
    assert nominal.mesh.vertices == pytest.approx(lens_mesh(singlet(), 1.0).mesh.vertices, abs=1e-12)


def test_figure_finer_than_the_facets_is_seen() -> None:
    rng = np.random.default_rng(0)
    figure = surface_figure_from_grid(2e-4 * rng.normal(size=(121, 121)), 0.1, 5.5)
    result = lens_mesh(plate(), 0.3, surface_perturbations={0: SurfacePerturbation(figure=figure)})
    points = optical_points(result, back=False, count=20_000)
    found = np.max(np.abs(points[:, 2] - figure.sag(points[:, 0], points[:, 1])))
    assert 0.5e-4 < found <= 1.05e-3 * result.chord_error_um
    assert result.chord_error_um <= 0.3


def test_figure_that_needs_too_many_triangles_is_named() -> None:
    rng = np.random.default_rng(0)
    figure = surface_figure_from_grid(1e-2 * rng.normal(size=(401, 401)), 0.03, 5.5)
    with pytest.raises(InputError, match=r"surface 2 .*triangles.* 0\.03") as error:
        lens_mesh(plate(), 1e-3, surface_perturbations={1: SurfacePerturbation(figure=figure)})
    needed = re.search(r"need ([0-9.e+]+) triangles", str(error.value))
    assert needed is not None
    assert float(needed[1]) > 2e7


@pytest.mark.parametrize(
    ("front", "change", "message"),
    [
        ({}, SurfacePerturbation(tilt_x_deg=np.zeros(3)), "hold 3 trials"),
        ({"thickness_mm": 1.7}, SurfacePerturbation(tilt_x_deg=-9.0), "does not close"),
        ({"thickness_mm": 1.7}, SurfacePerturbation(thickness_mm=-0.5), "does not close|cross"),
        ({"radius_mm": 5.01, "thickness_mm": 9.0}, SurfacePerturbation(decenter_y_mm=0.1), "inside its rim"),
        (
            {"radius_mm": 4.0, "semi_diameter_mm": 4.0, "thickness_mm": 9.0},
            SurfacePerturbation(tilt_y_deg=0.1),
            "inside its rim",
        ),
    ],
)
def test_what_makes_no_body_is_refused(
    front: dict[str, Any], change: SurfacePerturbation, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        lens_mesh(singlet(**front), 10.0, surface_perturbations={0: change})


def test_pose_of_many_trials_is_refused() -> None:
    with pytest.raises(InputError, match="pose holds 2 trials"):
        lens_mesh(singlet(), 10.0, pose=Pose(tilt_x_deg=np.array([0.0, 1.0])))


def test_a_tilted_surface_with_a_flat_ring_closes() -> None:
    lens = singlet(radius_mm=4.5, semi_diameter_mm=4.0, thickness_mm=6.0)
    change = SurfacePerturbation(tilt_y_deg=0.1)
    result = lens_mesh(lens, 1.0, surface_perturbations={0: change})
    assert_closed(result.mesh)
    points = optical_points(result, False)
    optical = points[np.hypot(*points[:, :2].T) < 3.99]
    assert np.max(distances(optical, lens, 0, change, 0.0)) <= 1e-3
    assert abs(result.volume_error) < 0.05 * result.volume_tolerance


def test_figure_on_a_surface_with_a_flat_annulus() -> None:
    lens = singlet(radius_mm=4.5, semi_diameter_mm=4.0, thickness_mm=6.0)
    figure = surface_figure_from_zernike({5: 1.0}, 4.0)
    result = lens_mesh(lens, 1.0, surface_perturbations={0: SurfacePerturbation(figure=figure)})
    assert_closed(result.mesh)
    assert result.chord_error_um <= 1.0
    assert abs(result.volume_error) < 0.05 * result.volume_tolerance


def test_a_perturbed_shape_is_meshed_as_if_the_design_said_so() -> None:
    lens = singlet(asphere=(1e-5,))
    change = SurfacePerturbation(radius_mm=0.5, shape={"asphere_4": 2e-5})
    found = lens_mesh(lens, surface_perturbations={0: change}, chord_error_um=20.0)
    expected = lens_mesh(singlet(radius_mm=20.5, asphere=(3e-5,)), chord_error_um=20.0)
    assert found.exact_volume_mm3 == pytest.approx(expected.exact_volume_mm3, rel=1e-12)
    assert found.mesh.vertices == pytest.approx(expected.mesh.vertices, abs=1e-12)
