"""Rays through a plane plate, beside closed forms and beside a trace of its two surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lensdesign import CoverGlass, Lens, Surface, check_design, launch, trace
from lensdesign.analysis.arrival_angles import arrival_angles
from lensdesign.analysis.exit_beam import footprint, rms_spot_diameter
from lensdesign.analysis.extreme_rays import with_extreme_rays
from lensdesign.lens.glass import refractive_index
from lensdesign.raytrace import (
    PlanePlate,
    at_wavelengths,
    compile_system,
    gradient_traces,
    pupil_rings,
    ray_paths,
)
from lensdesign.raytrace.gradients import Variable

WAVELENGTHS = (0.532, 0.65)
GLASS = CoverGlass(thickness_mm=0.7, material="N-BK7", distance_mm=0.5)


def covered(lens: Lens, **changes: object) -> Lens:
    sensor = lens.sensor.replaced(cover_glass=GLASS.replaced(**changes))
    return lens.replaced(sensor=sensor, wavelengths_um=WAVELENGTHS)


def as_surfaces(lens: Lens, plane: int = 0) -> Lens:
    """Return the lens with the plate in front of one plane as two surfaces of the lens itself."""
    glass, distance = lens.sensor.cover_glass, lens.sensor.plane_distances_mm[plane]
    assert glass is not None
    last = lens.surfaces[-1].replaced(thickness_mm=distance - glass.depth_mm)
    plate = Surface(thickness_mm=glass.thickness_mm, material=glass.material), Surface()
    sensor = lens.sensor.replaced(plane_distances_mm=(glass.distance_mm,), cover_glass=None)
    return lens.replaced(surfaces=(*lens.surfaces[:-1], last, *plate), sensor=sensor)


def skew_rays(lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (50, 2))
    return launch(lens, [(0.3, 1.2), (-1.0, 0.2)], points, WAVELENGTHS[0])


@pytest.mark.parametrize("index", [1.3, 1.5, 2.0])
def test_a_paraxial_focus_moves_by_the_closed_form(index: float) -> None:
    sine = 1e-4
    shift = PlanePlate(0.7, np.array([index])).lateral_shift_mm(np.array([sine, 0.0]))[0]
    assert -shift / sine == pytest.approx(0.7 * (1.0 - 1.0 / index), rel=1e-7)


@pytest.mark.parametrize("angle_deg", [5.0, 30.0, 60.0])
def test_the_displacement_of_a_ray_is_the_textbook_formula(angle_deg: float) -> None:
    """Born and Wolf: the distance between the parallel rays is t sin(a - b) / cos(b), sin(a) = n sin(b)."""
    a, index, thickness = np.deg2rad(angle_deg), 1.52, 0.7
    b = np.arcsin(np.sin(a) / index)
    shift = PlanePlate(thickness, np.array([index])).lateral_shift_mm(np.array([0.0, np.sin(a)]))[1]
    assert -shift * np.cos(a) == pytest.approx(thickness * np.sin(a - b) / np.cos(b), rel=1e-13)


@pytest.mark.parametrize("plane", [0, 1])
def test_rays_and_paths_equal_a_trace_through_two_surfaces(paper_lens: Lens, plane: int) -> None:
    lens = covered(paper_lens)
    other = as_surfaces(lens, plane)
    found = trace(lens, *skew_rays(lens), 0.532, plane_z_mm=lens.sensor_z_mm[plane])
    expected = trace(other, *skew_rays(lens), 0.532, plane_z_mm=other.sensor_z_mm[0])
    in_air = trace(paper_lens, *skew_rays(lens), 0.532, plane_z_mm=lens.sensor_z_mm[plane])
    assert np.all(found.ok)
    np.testing.assert_allclose(found.position, expected.position, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(found.opl, expected.opl, rtol=0.0, atol=1e-11)
    np.testing.assert_array_equal(found.direction, in_air.direction)
    assert np.max(np.abs(found.position - in_air.position)) > 0.01


def test_index_1_is_no_plate(paper_lens: Lens) -> None:
    lens = covered(paper_lens, material=1.0)
    found, expected = (
        trace(one, *skew_rays(lens), 0.532, plane_z_mm=lens.sensor_z_mm[0]) for one in (lens, paper_lens)
    )
    np.testing.assert_allclose(found.position, expected.position, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(found.opl, expected.opl, rtol=1e-15)


def test_rays_that_fail_are_not_moved(paper_lens: Lens) -> None:
    lens = covered(paper_lens)
    origins, directions = launch(lens, [(0.0, 1.5)], [(0.0, 1.3), (0.0, 0.0)], 0.532)
    found, in_air = (
        trace(one, origins, directions, 0.532, plane_z_mm=lens.sensor_z_mm[0]) for one in (lens, paper_lens)
    )
    assert found.ok.tolist() == [False, True]
    np.testing.assert_array_equal(found.position[0], in_air.position[0])


def test_footprints_spots_and_arrivals_are_those_behind_two_surfaces(paper_lens: Lens) -> None:
    lens = covered(paper_lens)
    other = as_surfaces(lens)
    wide = footprint(lens, 0.532, 2.0)
    assert wide.radius_mm == pytest.approx(footprint(other, 0.532, 0.5).radius_mm, abs=1e-9)
    assert wide.radius_mm < footprint(paper_lens, 0.532, 2.0).radius_mm - 0.01
    spots = [rms_spot_diameter(one, 0.532, 1.0, z).rms_diameter_mm for one, z in ((lens, 2.0), (other, 0.5))]
    assert spots[0] == pytest.approx(spots[1], abs=1e-11)
    angles = [arrival_angles(one, (4.0, 0.0), z, 0.532, 3) for one, z in ((lens, 2.0), (other, 0.5))]
    np.testing.assert_allclose(angles[0].cosines, angles[1].cosines, rtol=0.0, atol=1e-9)


def test_the_check_changes_its_footprints_alone(paper_lens: Lens) -> None:
    report, in_air = (check_design(one, refined=False) for one in (covered(paper_lens), paper_lens))
    first, without = report.wavelengths[0], in_air.wavelengths[0]
    assert first.max_spread_deg == without.max_spread_deg
    assert first.exit_beam_diameter_mm == without.exit_beam_diameter_mm
    assert all(a < b for a, b in zip(first.footprint_radius_mm, without.footprint_radius_mm, strict=True))


def test_extreme_rays_are_those_behind_the_plate(paper_lens: Lens) -> None:
    lens = covered(paper_lens)
    stop = pupil_rings(2, 6)
    found = with_extreme_rays(lens, [(0.0, 1.0)], stop, 0.532, [2.0])
    expected = with_extreme_rays(as_surfaces(lens), [(0.0, 1.0)], stop, 0.532, [0.5])
    np.testing.assert_allclose(found.points, expected.points, rtol=0.0, atol=1e-4)


def test_derivatives_of_points_behind_the_plate_equal_differences(paper_lens: Lens) -> None:
    lens = covered(paper_lens)
    fields, pupil = np.array([[0.2, 1.0], [-0.5, 0.3]]), np.array([[0.3, 0.9], [-0.7, 0.1]])
    variables = Variable("curvature", 1), Variable("thickness", 0)
    planes = np.array(lens.sensor.plane_distances_mm)

    def traces(one: Lens, own: tuple[Variable, ...]):
        system = at_wavelengths([compile_system(one, w) for w in WAVELENGTHS])
        return gradient_traces(
            system, one.object_z_mm, planes, 0, one.stop_semi_diameter_mm, 0.5, fields, pupil, own
        )

    step = 1e-6
    radius = 1.0 / (1.0 / -12.0 + step)
    moved = lens.with_surface(1, radius_mm=radius), lens.with_surface(0, thickness_mm=9.7 + step)
    radius = 1.0 / (1.0 / -12.0 - step)
    back = lens.with_surface(1, radius_mm=radius), lens.with_surface(0, thickness_mm=9.7 - step)
    for k, found in enumerate(traces(lens, variables)):
        for v in range(2):
            ends = [traces(one[v], ())[k].plane_points for one in (moved, back)]
            expected = (ends[0] - ends[1]) / (2.0 * step)
            np.testing.assert_allclose(found.plane_points_by[..., v], expected, rtol=1e-6, atol=1e-6)
        for p, z in enumerate(lens.sensor_z_mm):
            launched = launch(lens, fields, pupil, WAVELENGTHS[k])
            rays = trace(lens, *launched, WAVELENGTHS[k], plane_z_mm=z)
            own = rays.position[[0, 3], :2]  # the pairs of the same index
            np.testing.assert_allclose(found.plane_points[:, p], own, rtol=0.0, atol=1e-10)


def test_plates_of_several_indices_are_those_one_by_one() -> None:
    indices = np.array([1.4, 1.5, 1.6])
    cosines = np.random.default_rng(1).uniform(-0.4, 0.4, (3, 5, 2))
    several = PlanePlate(0.7, indices)
    for k, index in enumerate(indices):
        single = replace(several, index=np.array([index]))
        for name in ("lateral_shift_mm", "shift_by_cosines", "added_path_mm"):
            found, expected = getattr(several, name)(cosines)[k], getattr(single, name)(cosines[k])
            np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_the_index_is_that_of_the_wavelength(paper_lens: Lens) -> None:
    for wavelength in WAVELENGTHS:
        plate = compile_system(covered(paper_lens), wavelength).cover_glass
        assert plate is not None
        assert plate.index.tolist() == [refractive_index("N-BK7", wavelength)]


def test_drawn_rays_have_corners_on_both_faces(paper_lens: Lens) -> None:
    lens = covered(paper_lens)
    fan = [(0.0, -0.9), (0.0, 0.0), (0.0, 1.3)]  # the last one fails
    found, expected = ray_paths(lens, (0.0, 1.5), fan), ray_paths(as_surfaces(lens, 1), (0.0, 1.5), fan)
    np.testing.assert_allclose(found[:2], expected[:2], rtol=0.0, atol=1e-11)
    assert np.all(found[2, 2:] == found[2, 2])
