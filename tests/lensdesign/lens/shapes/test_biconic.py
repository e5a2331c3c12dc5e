"""Biconics: closed forms, and all that a surface goes through, where no symmetry helps."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference_trace import trace_numpy

from lensdesign import (
    Edge,
    InputError,
    Lens,
    Pose,
    Surface,
    SurfacePerturbation,
    check_design,
    load_design,
    read_zmx,
    save_design,
    trace,
    write_seq,
    write_step,
    write_zmx,
)
from lensdesign.analysis.sag_tables import sag_table
from lensdesign.errors import DesignError
from lensdesign.lens.solid import closed_elements
from lensdesign.manufacture.mesh.mesh import lens_mesh
from lensdesign.plots.layout import layout_figure
from lensdesign.plots.scene import scene_parts
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.gradients import Variable, gradient_traces

X, Y = (part.ravel() for part in np.meshgrid(np.linspace(-4.0, 4.0, 9), np.linspace(-4.0, 4.0, 9)))


def biconic(radius: float | None, conic: float, radius_x: float | None, conic_x: float) -> Surface:
    return Surface.model_validate(
        {"shape": "biconic", "radius_mm": radius, "conic": conic, "radius_x_mm": radius_x, "conic_x": conic_x}
    )


@pytest.fixture
def lens(paper_lens: Lens) -> Lens:
    """The paper's lens with a back that bends light more along y."""
    return paper_lens.with_surface(1, shape_type="biconic", radius_x_mm=-14.0, conic_x=-1.2)


def test_alike_along_x_and_y_it_is_a_conic() -> None:
    for radius, conic in ((12.0, -0.7), (-30.0, 0.4), (None, 0.0)):
        same, plain = (
            biconic(radius, conic, radius, conic).shape,
            Surface(radius_mm=radius, conic=conic).shape,
        )
        for mine, wanted in zip(same.sag_and_slopes(X, Y), plain.sag_and_slopes(X, Y), strict=True):
            np.testing.assert_allclose(mine, wanted, rtol=1e-14, atol=1e-15)


def test_two_paraboloids_make_an_elliptic_one() -> None:
    shape = biconic(20.0, -1.0, 50.0, -1.0).shape
    np.testing.assert_allclose(shape.sag(X, Y), X**2 / 100.0 + Y**2 / 40.0, rtol=1e-15)


def test_without_curvature_along_x_it_is_a_cylinder() -> None:
    shape = biconic(10.0, 0.0, None, 0.0).shape
    np.testing.assert_allclose(shape.sag(X, Y), 10.0 - np.sqrt(100.0 - Y**2), rtol=1e-12)
    assert shape.edge_radius_mm == 10.0


def test_rays_meet_a_cylinder_where_its_closed_form_says() -> None:
    lens = Lens.model_validate(
        {
            "wavelengths_um": [0.532],
            "object": {"field_diameter_mm": 1.0, "numerical_aperture": 0.1, "working_distance_mm": 10.0},
            "sensor": {"pixel_pitch_um": 3.2, "pixels": [1000, 1000], "plane_distances_mm": [3.0]},
            "surface": [
                {
                    "shape": "biconic",
                    "radius_mm": 10.0,
                    "thickness_mm": 5.0,
                    "material": 1.5,
                    "semi_diameter_mm": 6.0,
                    "stop": True,
                },
                {},
            ],
        }
    )
    y = np.linspace(-5.0, 5.0, 11)
    origins = np.column_stack([np.full(11, 3.0), y, np.full(11, -10.0)])
    rays = trace(lens, origins, np.tile([0.0, 0.0, 1.0], (11, 1)), 0.532, record_hits=True)
    assert rays.hits is not None
    np.testing.assert_allclose(rays.hits[:, 0, 2], 10.0 - np.sqrt(100.0 - y**2), atol=1e-13)
    # Snell's law in the plane across the cylinder; nothing happens along it.
    angle = np.arcsin(y / 10.0) - np.arcsin(y / 15.0)
    np.testing.assert_allclose(
        np.diff(rays.hits[:, :, 1], axis=1)[:, 0] / np.diff(rays.hits[:, :, 2])[:, 0],
        -np.tan(angle),
        atol=1e-12,
    )
    np.testing.assert_allclose(rays.position[:, 0], 3.0, atol=1e-13)


@pytest.mark.parametrize("perturbed", [False, True])
def test_rays_equal_the_plain_trace(lens: Lens, perturbed: bool) -> None:
    change = SurfacePerturbation(0.05, -0.1, 0.02, 0.3, -0.2, radius_mm=0.05, conic=0.01)
    pose = Pose(0.02, 0.03, -0.01, 0.2, 0.1) if perturbed else Pose()
    system = compile_system(lens, 0.532, pose, {1: change} if perturbed else None)
    rng = np.random.default_rng(3)
    target = np.column_stack([rng.uniform(-7.0, 7.0, (400, 2)), np.zeros(400)])
    origins = np.column_stack([rng.uniform(-1.5, 1.5, (400, 2)), np.full(400, -13.5)])
    directions = (target - origins) / np.linalg.norm(target - origins, axis=1, keepdims=True)
    rays = trace(
        lens, origins, directions, 0.532, pose, 30.0, surface_perturbations={1: change} if perturbed else None
    )
    position, direction, opl, status, _, _ = trace_numpy(system, origins, directions, 30.0)
    assert np.count_nonzero(rays.ok) > 300
    assert np.array_equal(rays.status, status)
    np.testing.assert_allclose(rays.position, position, atol=1e-11)
    np.testing.assert_allclose(rays.direction, direction, atol=1e-12)
    np.testing.assert_allclose(rays.opl, opl, atol=1e-11)


def test_derivatives_of_rays_equal_complex_steps_to_1e_9(lens: Lens) -> None:
    system = compile_system(lens, 0.532)
    rng = np.random.default_rng(4)
    fields, pupil = rng.uniform(-1.0, 1.0, (30, 2)), rng.uniform(-0.6, 0.6, (30, 2))
    variables = tuple(Variable(term, 1) for term in ("curvature", "conic", "curvature_x", "conic_x"))
    semi = lens.stop_semi_diameter_mm
    got = gradient_traces(system, -13.5, np.array([5.0]), 0, semi, 0.5, fields, pupil, variables)[0]
    assert got.ok.all()
    origins = np.column_stack([fields, np.full(30, -13.5)]).astype(complex)
    target = np.column_stack([semi * pupil, system.sag(0, *(semi * pupil).T)])
    rays = target - origins
    rays = rays / np.sqrt(np.sum(rays * rays, axis=-1, keepdims=True))
    for j, variable in enumerate(variables):
        moved = replace(system, shapes=(system.shapes[0], system.shapes[1].moved(variable.kind, 1e-30j)))
        position, direction, *_ = trace_numpy(moved, origins, rays, 9.7 + 5.0, clip=False)
        np.testing.assert_allclose(
            got.plane_points_by[:, 0, :, j], position[:, :2].imag / 1e-30, rtol=1e-9, atol=1e-9
        )
        np.testing.assert_allclose(
            got.cosines_by[..., j], direction[:, :2].imag / 1e-30, rtol=1e-9, atol=1e-9
        )


def test_a_check_looks_all_round(lens: Lens, paper_lens: Lens) -> None:
    """Weaker along x, its light lands farther out there; a lens of revolution knows no such thing."""
    report, plain = check_design(lens), check_design(paper_lens)
    assert report.max_spread_deg > plain.max_spread_deg + 1.0
    assert abs(report.worst_ray.field_mm[0]) > abs(report.worst_ray.field_mm[1])
    turned = lens.with_surface(1, radius_mm=-14.0, conic=-1.2, radius_x_mm=-12.0, conic_x=-0.89862)
    assert check_design(turned).max_spread_deg == pytest.approx(report.max_spread_deg, rel=1e-4)


def test_the_body_closes_and_its_mesh_holds_the_chord_error(lens: Lens) -> None:
    (element,) = closed_elements(lens)
    angle = 2.0 * math.pi * np.arange(720) / 720
    r, weight = np.polynomial.legendre.leggauss(200)
    r, weight = 5.0 * (r + 1.0), 5.0 * weight
    x, y = np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))
    thickness = 9.7 + lens.surfaces[1].shape.sag(x, y) - lens.surfaces[0].shape.sag(x, y)
    assert element.volume_mm3 == pytest.approx(
        2.0 * math.pi * np.sum(weight * r * thickness.mean(axis=1)), rel=1e-9
    )
    steepest = lens.surfaces[1].sag_mm(10.0) - lens.surfaces[0].sag_mm(10.0) + 9.7
    assert element.edge_thickness_mm == pytest.approx(float(steepest), rel=1e-12)
    mesh = lens_mesh(lens, chord_error_um=2.0)
    assert mesh.mesh.is_watertight
    assert mesh.chord_error_um <= 2.0
    assert mesh.volume_mm3 == pytest.approx(element.volume_mm3, rel=2e-3)
    back = mesh.mesh.vertices[np.hypot(*mesh.mesh.vertices[:, :2].T) < 9.0]
    back = back[back[:, 2] > 6.0]
    assert np.max(np.abs(back[:, 2] - 9.7 - lens.surfaces[1].shape.sag(back[:, 0], back[:, 1]))) < 2e-3


def test_a_step_file_has_it_as_a_spline(lens: Lens, tmp_path: Path) -> None:
    pytest.importorskip("OCP")
    (body,) = write_step(lens, tmp_path / "lens.step").bodies
    assert max(body.surface_errors_mm) < 1e-7
    assert body.volume_mm3 == pytest.approx(closed_elements(lens)[0].volume_mm3, rel=1e-9)
    with pytest.raises(InputError, match="bevels and flanges"):
        write_step(lens.replaced(edges=(Edge(front_bevel_mm=0.1),)), tmp_path / "lens.step")


def test_pictures_show_it(lens: Lens) -> None:
    assert layout_figure(lens).axes
    assert {"glass", "rays"} <= {part.kind for part in scene_parts(lens, 20.0)}


def test_files_of_other_programs(lens: Lens, tmp_path: Path) -> None:
    write_zmx(lens, tmp_path / "lens.zmx")
    text = (tmp_path / "lens.zmx").read_text(encoding="utf-16")
    assert "TYPE BICONICX" in text
    assert "PARM 1 -14.0" in text
    assert "PARM 2 -1.2" in text
    assert read_zmx(tmp_path / "lens.zmx").lens == lens
    with pytest.raises(InputError, match=r"surface 2.*\.seq.*biconic"):
        write_seq(lens, tmp_path / "lens.seq")


def test_a_design_file_keeps_it(lens: Lens, tmp_path: Path) -> None:
    save_design(lens, tmp_path / "lens.toml")
    assert 'shape = "biconic"' in (tmp_path / "lens.toml").read_text()
    assert load_design(tmp_path / "lens.toml") == lens


def test_what_does_not_belong_together_is_refused() -> None:
    with pytest.raises(ValueError, match=r'radius_x_mm = 5\.0.*conic.*shape = "biconic"'):
        Surface(radius_x_mm=5.0)
    with pytest.raises(ValueError, match=r"asphere = .*biconic"):
        Surface.model_validate({"shape": "biconic", "asphere": [1e-5]})
    with pytest.raises(ValueError, match=r"shape = 'paraboloid'.*conic, even asphere, .*biconic"):
        Surface.model_validate({"shape": "paraboloid"})
    with pytest.raises(ValueError, match="radius_x_mm"):
        Surface.model_validate({"shape": "biconic", "radius_x_mm": 0.0})
    with pytest.raises(ValueError, match=r"height.* 4 mm"):
        Surface.model_validate({"shape": "biconic", "radius_x_mm": 4.0, "semi_diameter_mm": 5.0})


def test_surfaces_that_cross_beside_the_y_axis_are_found(paper_lens: Lens) -> None:
    with pytest.raises(DesignError, match="cross inside the aperture"):
        paper_lens.with_surface(1, shape_type="biconic", radius_x_mm=-3.5, conic_x=-1.0, semi_diameter_mm=8.4)


def test_a_sag_table_has_the_mean_over_all_directions(lens: Lens) -> None:
    table, angle = sag_table(lens, 1, 1.0), 2.0 * math.pi * np.arange(90) / 90
    r = table.radial_height_mm[:, None]
    z = lens.surfaces[1].shape.sag(r * np.cos(angle), r * np.sin(angle))
    np.testing.assert_allclose(table.sag_mm, z.mean(axis=1), atol=1e-12)
    assert 0.1 < table.asymmetric_rms_mm < 0.5
