"""Toroids: closed forms, rays of another program, and all that a surface without symmetry goes through."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensdesign import (
    InputError,
    Lens,
    Surface,
    check_design,
    load_design,
    read_zmx,
    save_design,
    trace,
    write_seq,
    write_step,
    write_zmx,
)
from lensdesign.lens.solid import closed_elements
from lensdesign.manufacture.mesh.mesh import lens_mesh

GOLDEN = Path(__file__).parents[3] / "golden" / "rays_of_optiland.json"
X, Y = (part.ravel() for part in np.meshgrid(np.linspace(-5.0, 5.0, 11), np.linspace(-4.0, 4.0, 9)))


def toroid(radius: float | None, radius_x: float | None, **keys: Any) -> Surface:
    return Surface.model_validate({"shape": "toroid", "radius_mm": radius, "radius_x_mm": radius_x, **keys})


@pytest.fixture
def lens(paper_lens: Lens) -> Lens:
    """The paper's lens with a toroid as its back."""
    return paper_lens.with_surface(1, shape_type="toroid", radius_x_mm=-14.0, asphere=(1e-6, 1e-8))


@pytest.mark.parametrize("name", ["odd asphere", "Qbfs", "toroid"])
def test_rays_equal_those_of_another_program(paper_lens: Lens, name: str) -> None:
    golden = json.loads(GOLDEN.read_text())
    wanted = golden["backs"][name]
    semi_mm = paper_lens.surfaces[1].semi_diameter_mm
    back = Surface.model_validate({**wanted["keys"], "semi_diameter_mm": semi_mm})
    lens = paper_lens.replaced(surfaces=(paper_lens.surfaces[0], back))
    plane_z = lens.exit_vertex_z_mm + golden["plane_distance_mm"]
    origins, directions = np.array(golden["origins_mm"]), np.array(golden["directions"])
    rays = trace(lens, origins, directions, golden["wavelength_um"], plane_z_mm=plane_z)
    np.testing.assert_allclose(rays.position, wanted["positions_mm"], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(rays.direction, wanted["directions"], rtol=0.0, atol=1e-13)


def test_with_circles_along_both_axes_it_lies_on_a_torus() -> None:
    for radius, radius_x in ((15.0, 40.0), (15.0, -40.0), (-30.0, 12.0)):
        z = toroid(radius, radius_x).shape.sag(X, Y)
        tube = np.hypot(X, z - radius_x) - abs(radius_x - radius)
        np.testing.assert_allclose(tube**2 + Y**2, radius**2, rtol=1e-13)


def test_equal_radii_make_a_sphere() -> None:
    same, sphere = toroid(12.0, 12.0).shape, Surface(radius_mm=12.0).shape
    for function in ("sag_and_slopes", "second_derivatives"):
        for found, wanted in zip(getattr(same, function)(X, Y), getattr(sphere, function)(X, Y), strict=True):
            np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-14)


def test_without_curvature_along_x_it_is_a_cylinder() -> None:
    shape, curve = toroid(10.0, None, conic=-0.5, asphere=(1e-5,)), Surface(radius_mm=10.0, conic=-0.5)
    np.testing.assert_allclose(shape.shape.sag(X, Y), curve.sag_mm(Y) + 1e-5 * Y**4, rtol=1e-14, atol=1e-16)
    assert shape.shape.edge_radius_mm == curve.shape.edge_radius_mm


def test_it_ends_where_the_circle_or_the_curve_ends() -> None:
    assert toroid(10.0, 7.0).shape.edge_radius_mm == pytest.approx(7.0)
    assert toroid(6.0, 50.0).shape.edge_radius_mm == pytest.approx(6.0)
    # A curve that approaches the axis of rotation leaves smaller and smaller circles.
    steep, y = toroid(None, 5.0, asphere=(0.02,)), np.linspace(0.0, 250.0**0.25, 100_001)
    nearest = math.sqrt(np.min((5.0 - 0.02 * y**4) ** 2 + y**2))
    assert steep.shape.edge_radius_mm == pytest.approx(nearest, rel=1e-6)
    with pytest.raises(ValueError, match=r"semi_diameter_mm = 7\.5.* toroid.* 7 mm"):
        toroid(10.0, 7.0, semi_diameter_mm=7.5)


def test_there_is_no_sag_beyond_the_axis_of_rotation() -> None:
    shape = toroid(2.0, 3.0, conic=-1.0).shape
    assert shape.edge_radius_mm < 5.0
    assert np.all(np.isnan(shape.sag([1.0, 0.0, 2.0], [5.0, 4.5, 6.0])))


def test_its_principal_sections_are_a_circle_and_its_curve() -> None:
    shape = toroid(12.0, 30.0, conic=-0.5).shape
    assert [shape.section(angle).kind for angle in (0.0, 0.5 * math.pi, 0.3)] == ["sphere", "conic", "toroid"]


def test_it_bends_light_along_x_by_its_radius_of_rotation(lens: Lens, paper_lens: Lens) -> None:
    turned = paper_lens.with_surface(1, shape_type="toroid", radius_x_mm=-12.0)
    origins = np.array([[0.0, 0.0, -13.5]])
    small = math.sin(1e-4)
    along = [
        trace(one, origins, np.array([[x, y, math.cos(1e-4)]]), 0.532, plane_z_mm=30.0).direction[0]
        for one in (turned, lens)
        for x, y in ((small, 0.0), (0.0, small))
    ]
    assert along[0][0] == pytest.approx(along[1][1], abs=1e-9)
    assert along[2][0] != pytest.approx(along[3][1], rel=0.05)
    assert check_design(lens).max_spread_deg > check_design(paper_lens).max_spread_deg + 1.0


def test_the_body_closes_and_its_mesh_holds_the_chord_error(lens: Lens) -> None:
    (element,) = closed_elements(lens)
    angle = 2.0 * math.pi * np.arange(720) / 720
    r, weight = np.polynomial.legendre.leggauss(200)
    r, weight = 5.0 * (r + 1.0), 5.0 * weight
    x, y = np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))
    thickness = 9.7 + lens.surfaces[1].shape.sag(x, y) - lens.surfaces[0].shape.sag(x, y)
    volume = 2.0 * math.pi * np.sum(weight * r * thickness.mean(axis=1))
    assert element.volume_mm3 == pytest.approx(volume, rel=1e-9)
    mesh = lens_mesh(lens, chord_error_um=2.0)
    assert mesh.mesh.is_watertight
    assert mesh.chord_error_um <= 2.0


def test_a_step_file_has_it_as_a_spline(lens: Lens, tmp_path: Path) -> None:
    pytest.importorskip("OCP")
    (body,) = write_step(lens, tmp_path / "lens.step").bodies
    assert max(body.surface_errors_mm) < 1e-7
    assert body.volume_mm3 == pytest.approx(closed_elements(lens)[0].volume_mm3, rel=1e-9)


def test_files_hold_what_they_have_a_place_for(lens: Lens, tmp_path: Path) -> None:
    save_design(lens, tmp_path / "lens.toml")
    assert load_design(tmp_path / "lens.toml") == lens
    write_zmx(lens, tmp_path / "lens.zmx")
    text = (tmp_path / "lens.zmx").read_text(encoding="utf-16")
    assert "TYPE TOROIDAL" in text
    assert "PARM 1 -14.0" in text
    assert "PARM 3 1e-06" in text
    assert read_zmx(tmp_path / "lens.zmx").lens == lens
    with pytest.raises(InputError, match=r"surface 2.*\.seq.*toroid"):
        write_seq(lens, tmp_path / "lens.seq")


@pytest.mark.parametrize(
    ("number", "loss"), [(0, "extrapolation"), (2, r"toroid term in y\^2"), (13, "Zernike terms")]
)
def test_terms_without_a_counterpart_are_named(lens: Lens, tmp_path: Path, number: int, loss: str) -> None:
    path = tmp_path / "lens.zmx"
    write_zmx(lens, path)
    text = path.read_text(encoding="utf-16").replace("PARM 2 0.0", "")
    text = text.replace("PARM 1 -14.0", f"PARM 1 -14.0\n  PARM {number} 1.0")
    path.write_text(text, encoding="utf-16")
    with pytest.raises(InputError, match=loss):
        read_zmx(path)
