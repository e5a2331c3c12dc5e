"""Spread, footprint, spot, throughput and arrival angles: the paper's figures, closed forms, brute force."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from random_lenses import numbers
from scipy.optimize import minimize

from lensdesign import DesignError, InputError, Lens, ObjectSpace, Pose, Sensor, Surface, SurfacePerturbation
from lensdesign.analysis.arrival_angles import arrival_angles
from lensdesign.analysis.check import edge_thickness_mm
from lensdesign.analysis.exit_beam import (
    footprint,
    largest_spread_angle,
    observation_distance_mm,
    rms_spot_diameter,
    throughput,
)
from lensdesign.raytrace.bundles import launch
from lensdesign.raytrace.rays import RayTrace, trace

DISTANCE, STOP, FIELD, GAP = 10.0, 3.0, 2.0, 4.0
NOMINAL = Pose()


def window(field: float = FIELD, stop: float = STOP, back: float | None = None) -> Lens:
    """A lens of air: rays go straight, so all is known in closed form."""
    return Lens(
        wavelengths_um=(0.5,),
        object=ObjectSpace(field_diameter_mm=field, numerical_aperture=0.2, working_distance_mm=DISTANCE),
        sensor=Sensor(pixel_pitch_um=3.2, pixels=(5000, 4000), plane_distances_mm=(3.0,)),
        surfaces=(
            Surface(thickness_mm=GAP, material=1.0, semi_diameter_mm=stop),
            Surface(semi_diameter_mm=back),
        ),
    )


def random_bundle(lens: Lens, rays: int, pose: Pose = NOMINAL, plane_mm: float | None = None) -> RayTrace:
    """Rays from random object points through random stop points."""
    rng = np.random.default_rng(1)
    parts = []
    for _ in range(50):
        field, pupil = (np.sqrt(rng.random((n, 1))) * _directions(rng, n) for n in (rays // 500, 10))
        parts.append(launch(lens, lens.half_field_mm * field, pupil, 0.532, pose))
    origins, directions = (np.concatenate(a) for a in zip(*parts, strict=True))
    plane = None if plane_mm is None else lens.exit_vertex_z_mm + plane_mm
    return trace(lens, origins, directions, 0.532, pose, plane)


def _directions(rng: np.random.Generator, count: int) -> np.ndarray:
    angle = 2.0 * np.pi * rng.random(count)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def angles_deg(rays: RayTrace) -> np.ndarray:
    """Angles to the axis of the rays that passed."""
    return np.rad2deg(np.arcsin(np.hypot(*rays.direction[rays.ok, :2].T)))


# Spread.


def test_spread_of_the_paper_lens(paper_lens: Lens) -> None:
    found = largest_spread_angle(paper_lens, 0.532)
    assert found.spread_deg == pytest.approx(4.810, abs=1e-3)
    assert found.field_mm == pytest.approx((0.0, 1.5), abs=1e-9)
    assert found.throughput == 1.0
    assert max(found.per_field_deg) == pytest.approx(found.spread_deg, abs=1e-9)


@pytest.mark.parametrize(("height", "expected"), [(0.0, 0.498), (0.5, 1.870), (1.0, 3.327), (1.2, 3.903)])
def test_spread_at_single_heights(paper_lens: Lens, height: float, expected: float) -> None:
    assert largest_spread_angle(paper_lens, 0.532, [height]).spread_deg == pytest.approx(expected, abs=5e-4)


@pytest.mark.parametrize("height", [0.0, 0.7, 1.5])
def test_spread_stands_to_a_millionth_of_a_degree(paper_lens: Lens, height: float) -> None:
    found = largest_spread_angle(paper_lens, 0.532, [height])

    def less(polar: np.ndarray) -> float:
        point = [[polar[0] * math.sin(polar[1]), polar[0] * math.cos(polar[1])]]
        rays = trace(paper_lens, *launch(paper_lens, [0.0, height], point, 0.532), 0.532)
        return -float(angles_deg(rays)[0])

    starts = [(r, a) for r in (0.4, 0.8, 1.0) for a in (0.3, 1.2, 2.8)]
    box = [(0.0, 1.0), (0.0, math.pi)]
    options = {"xatol": 1e-9, "fatol": 1e-12}
    best = max(-minimize(less, s, bounds=box, method="Nelder-Mead", options=options).fun for s in starts)
    assert found.spread_deg == pytest.approx(best, abs=1e-6)


def test_the_worst_ray_is_a_ray(paper_lens: Lens) -> None:
    pose, changes = Pose(decenter_x_mm=0.1, tilt_x_deg=0.4), {1: SurfacePerturbation(tilt_y_deg=0.2)}
    found = largest_spread_angle(paper_lens, 0.532, pose=pose, surface_perturbations=changes)
    origins, directions = launch(paper_lens, found.field_mm, found.pupil, 0.532, pose, changes)
    rays = trace(paper_lens, origins, directions, 0.532, pose, surface_perturbations=changes)
    assert angles_deg(rays)[0] == pytest.approx(found.spread_deg, abs=1e-9)


@pytest.mark.parametrize("pose", [Pose(), Pose(decenter_x_mm=0.2, tilt_y_deg=-0.5)])
def test_no_ray_of_a_dense_bundle_is_worse(paper_lens: Lens, pose: Pose) -> None:
    found = largest_spread_angle(paper_lens, 0.532, pose=pose)
    brute = angles_deg(random_bundle(paper_lens, 200_000, pose)).max()
    assert brute <= found.spread_deg
    assert brute == pytest.approx(found.spread_deg, rel=1e-2)


def test_a_perturbed_lens_is_searched_all_around(paper_lens: Lens) -> None:
    nominal = largest_spread_angle(paper_lens, 0.532).spread_deg
    nearly = largest_spread_angle(paper_lens, 0.532, pose=Pose(decenter_x_mm=1e-12)).spread_deg
    assert nearly == pytest.approx(nominal, abs=1e-6)
    around = [
        largest_spread_angle(paper_lens, 0.532, pose=pose).spread_deg
        for pose in (Pose(decenter_x_mm=0.1), Pose(decenter_y_mm=0.1), Pose(decenter_y_mm=-0.1))
    ]
    assert np.ptp(around) < 1e-6
    assert around[0] > nominal + 0.01


@settings(max_examples=8)
@given(field=numbers(0.5, 4.0), stop=numbers(0.5, 4.0))
def test_spread_and_footprint_without_glass(field: float, stop: float) -> None:
    lens = window(field, stop)
    slope = (stop + 0.5 * field) / DISTANCE
    assert largest_spread_angle(lens).spread_deg == pytest.approx(math.degrees(math.atan(slope)), abs=1e-8)
    assert footprint(lens, plane_distance_mm=3.0).radius_mm == pytest.approx(stop + slope * 7.0, abs=1e-8)


def test_clipped_rays_do_not_count() -> None:
    lens = window(back=3.5)
    found = largest_spread_angle(lens)
    # The steepest ray that passes runs from the field's edge to the back surface's.
    assert found.spread_deg == pytest.approx(math.degrees(math.atan(4.5 / 14.0)), abs=1e-5)
    assert found.throughput < 1.0


def test_a_lens_without_light_is_refused(paper_lens: Lens) -> None:
    blocked = paper_lens.with_surface(1, semi_diameter_mm=0.01).with_surface(0, semi_diameter_mm=0.5)
    far = blocked.replaced(object=paper_lens.object.model_copy(update={"field_diameter_mm": 300.0}))
    assert math.isnan(largest_spread_angle(far, 0.532).per_field_deg[-1])
    with pytest.raises(DesignError, match=r"no ray.*0\.532 µm"):
        largest_spread_angle(far, 0.532, [150.0])


@pytest.mark.parametrize("heights", [[-0.1], [1.6], [], [math.nan]])
def test_heights_outside_the_field_are_refused(paper_lens: Lens, heights: list[float]) -> None:
    with pytest.raises(InputError, match=r"field_heights_mm = .*0 to 1\.5 mm"):
        largest_spread_angle(paper_lens, 0.532, heights)


def test_arrays_of_trials_are_refused(paper_lens: Lens) -> None:
    with pytest.raises(InputError, match="not arrays of trials"):
        largest_spread_angle(paper_lens, 0.532, pose=Pose(decenter_x_mm=np.zeros(2)))


# Footprint, spot, throughput.


def test_footprint_of_the_paper_lens(paper_lens: Lens) -> None:
    near, far = (footprint(paper_lens, 0.532, d) for d in (2.0, 22.0))
    assert near.inside
    assert far.inside
    assert near.sensor_half_side_mm == pytest.approx(11.2)
    assert far.margin_mm == pytest.approx(11.2 - far.radius_mm)
    for found in (near, far):
        rays = random_bundle(paper_lens, 200_000, plane_mm=found.plane_distance_mm)
        radius = np.hypot(*rays.position[:, :2].T).max()
        assert radius <= found.radius_mm
        assert radius == pytest.approx(found.radius_mm, rel=5e-3)
    assert not footprint(paper_lens, 0.532, 25.0).inside


@pytest.mark.parametrize(("height", "expected"), [(0.0, 14.27), (1.0, 14.25), (1.5, 14.22)])
def test_spots_of_the_paper_lens(paper_lens: Lens, height: float, expected: float) -> None:
    assert rms_spot_diameter(paper_lens, 0.532, height).rms_diameter_mm == pytest.approx(expected, abs=5e-3)


def test_spot_without_glass() -> None:
    spot = rms_spot_diameter(window(), field_mm=1.0, plane_distance_mm=3.0)
    scale = (DISTANCE + GAP + 3.0) / DISTANCE
    assert spot.rms_diameter_mm == pytest.approx(2.0 * scale * STOP / math.sqrt(2.0), rel=1e-12)
    assert spot.centroid_mm == pytest.approx((0.0, 1.0 - scale), abs=1e-12)
    assert spot.throughput == pytest.approx(1.0)


def test_throughput_is_the_share_of_the_stop_that_passes() -> None:
    assert throughput(window(back=20.0)).throughput == 1.0
    found = throughput(window(back=3.0))
    inner = 3.0 / (1.0 + GAP / DISTANCE) / STOP  # stop height of the ray that just passes, on axis
    assert found.per_field[0] == pytest.approx(inner**2, abs=0.02)
    assert found.per_field[-1] < found.per_field[0]
    assert found.throughput == min(found.per_field)


def test_a_rim_that_is_only_just_clipped_shows() -> None:
    edge = STOP + (STOP + 0.5 * FIELD) / DISTANCE * GAP
    assert throughput(window(back=edge + 1e-6)).throughput == 1.0
    found = throughput(window(back=edge - 1e-4))
    assert 0.99 < found.throughput < 1.0
    assert found.per_field[0] == 1.0


def test_spots_are_looked_at_within_the_sensor_planes(paper_lens: Lens) -> None:
    def distance(*planes: float) -> float:
        sensor = paper_lens.sensor.replaced(plane_distances_mm=planes)
        return observation_distance_mm(paper_lens.replaced(sensor=sensor))

    assert observation_distance_mm(paper_lens) == 3.0
    assert distance(0.5, 1.1) == 0.5
    assert distance(5.0, 9.0) == 5.0
    assert distance(3.0) == 3.0


def test_edge_thickness(paper_lens: Lens) -> None:
    front = 42.3 - math.sqrt(42.3**2 - 100.0)
    back = -float(100.0 / 12.0 / (1.0 + math.sqrt(1.0 - (1 - 0.89862) * 100.0 / 144.0)))
    assert edge_thickness_mm(paper_lens) == pytest.approx(9.7 + back - front, abs=1e-12)
    assert edge_thickness_mm(window().with_surface(0, material=1.5)) == pytest.approx(GAP)
    assert edge_thickness_mm(window()) is None  # of air
    assert edge_thickness_mm(window().replaced(surfaces=(Surface(semi_diameter_mm=1.0),))) is None


def test_edge_of_a_surface_that_ends_before_it(paper_lens: Lens) -> None:
    lens = paper_lens.with_surface(0, radius_mm=9.0)  # a hemisphere of 9 mm on a lens of 10 mm
    clear = 9.0 - math.sqrt(81.0 - 8.26**2)
    back = float(paper_lens.surfaces[1].sag_mm(10.0))
    assert edge_thickness_mm(lens) == pytest.approx(9.7 + back - clear)


# Arrival angles.


def test_arrival_angles_without_glass() -> None:
    lens, target = window(), np.array([1.0, 4.5])
    found = arrival_angles(lens, (1.0, 4.5), plane_distance_mm=3.0)
    travel = DISTANCE + GAP + 3.0
    slopes = (target - found.object_points_mm) / travel
    passes = np.linalg.norm(found.object_points_mm + slopes * DISTANCE, axis=1) <= STOP
    assert np.array_equal(found.ok, passes)
    assert 0.5 < found.fraction < 1.0
    expected = np.rad2deg(np.arctan(slopes))
    assert np.allclose(found.angles_deg[found.ok], expected[found.ok], atol=1e-7)
    largest = np.degrees(np.arctan(np.linalg.norm(slopes[passes], axis=1).max()))
    assert found.largest_deg == pytest.approx(largest, abs=1e-7)


@pytest.fixture(scope="module")
def landed(paper_lens: Lens) -> RayTrace:
    """A bundle dense enough to have rays close to any point."""
    return random_bundle(paper_lens, 2_000_000, plane_mm=3.0)


@pytest.mark.parametrize("height", [0.0, 3.0, 7.0, 9.0])
def test_arrival_angles_of_the_paper_lens(paper_lens: Lens, landed: RayTrace, height: float) -> None:
    """Fig. 2d: no more than 4.8 deg at these points; and against rays that happen to land close by."""
    found = arrival_angles(paper_lens, (0.0, height))
    assert found.largest_deg <= largest_spread_angle(paper_lens, 0.532).spread_deg
    near = np.linalg.norm(landed.position[:, :2] - [0.0, height], axis=1) < 0.05
    cosines = landed.direction[near, :2]
    assert len(cosines) > 20
    assert found.largest_deg > np.rad2deg(np.arcsin(np.hypot(*cosines.T))).max() - 0.05
    distance = np.linalg.norm(found.cosines[found.ok] - cosines[:, None], axis=2)
    assert distance.min(axis=1).max() < 0.008
    assert found.fraction == pytest.approx(1.0 if height < 9.0 else 0.89, abs=0.01)


def test_folds_give_every_ray() -> None:
    """Behind a caustic several rays of one object point reach one sensor point."""
    lens = window(field=0.01, stop=2.0).with_surface(1, radius_mm=-5.0, semi_diameter_mm=4.0)
    lens = lens.with_surface(0, material=1.5)
    heights = np.linspace(-1.0, 1.0, 4001)
    fan = np.column_stack([np.zeros(4001), heights])
    rays = trace(lens, *launch(lens, [0.0, 0.0], fan, 0.5), 0.5, plane_z_mm=GAP + 30.0)
    assert rays.ok.all()
    y = rays.position[:, 1] - 0.2
    crossings = np.count_nonzero(y[1:] * y[:-1] < 0.0)
    assert crossings == 2
    found = arrival_angles(lens, (0.0, 0.2), plane_distance_mm=30.0, wavelength_um=0.5, object_rings=1)
    centre = np.all(np.abs(found.object_points_mm) < 1e-12, axis=1)
    assert np.count_nonzero(centre & found.ok) == crossings
    assert np.all(np.abs(found.cosines[centre, 0]) < 1e-9)


def test_a_point_in_the_dark(paper_lens: Lens) -> None:
    found = arrival_angles(paper_lens, (0.0, 14.0))
    assert not found.ok.any()
    assert found.fraction == 0.0
    assert math.isnan(found.largest_deg)
    assert len(found.ok) == 817
    with pytest.raises(InputError, match=r"sensor_point_mm = .*finite"):
        arrival_angles(paper_lens, (0.0, math.inf))


def test_a_lens_is_looked_at_anew_where_its_glass_has_changed(tmp_path: Path) -> None:
    """What is found of a lens is kept; its catalogue's file may change all the same."""
    path, found = tmp_path / "own.agf", []
    slab = Surface(thickness_mm=GAP, material="own.agf:G", semi_diameter_mm=STOP)
    for time, index in enumerate((1.0, 1.5)):
        path.write_text(f"NM G 1 0 {index} 60\nCD {index**2} 0 0 0 0 0\nLD 0.3 2.0\n")
        os.utime(path, ns=(time, time))
        lens = window().replaced(glass_catalogs=(path,), surfaces=(slab, Surface()))
        found.append(footprint(lens, plane_distance_mm=3.0).radius_mm)
    sine = math.sin(math.atan(4.0 / DISTANCE))
    in_glass, behind = (math.tan(math.asin(sine / n)) for n in (1.5, 1.0))
    assert found[0] == pytest.approx(STOP + 7.0 * behind, abs=1e-6)
    assert found[1] == pytest.approx(STOP + GAP * in_glass + 3.0 * behind, abs=1e-6)
