"""The ray kernel against golden rays, its NumPy reference, and closed forms of geometrical optics."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from places import GOLDEN
from random_lenses import lenses, numbers, poses, random_rays, surface_perturbations
from reference_trace import trace_numpy

from lensdesign import Lens, ObjectSpace, Pose, Sensor, Surface, SurfacePerturbation
from lensdesign.errors import InputError
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.rays import RAYS_PER_THREAD, RayTrace, trace, trace_compiled
from lensdesign.raytrace.status import Status

SEEDS = st.integers(0, 2**32 - 1)


def make(*surfaces: dict[str, Any]) -> Lens:
    """A lens from its surfaces; the first gets a semi-diameter if it has none."""
    edge = Surface(**surfaces[0] | {"semi_diameter_mm": None}).shape.edge_radius_mm
    first = {"semi_diameter_mm": min(50.0, 0.999 * edge)} | surfaces[0]
    return Lens(
        wavelengths_um=(0.532,),
        object=ObjectSpace(field_diameter_mm=1.0, numerical_aperture=0.1, working_distance_mm=10.0),
        sensor=Sensor(pixel_pitch_um=3.2, pixels=(1000, 1000), plane_distances_mm=(3.0,)),
        surfaces=tuple(Surface(**s) for s in (first, *surfaces[1:])),
    )


def unit(vectors: Any) -> np.ndarray:
    """Vectors of unit length."""
    array = np.atleast_2d(np.asarray(vectors, float))
    return array / np.linalg.norm(array, axis=1, keepdims=True)


# Golden rays: the paper's lens, nominal and perturbed.


def golden_cases() -> list[dict[str, Any]]:
    """Rays traced by independent code."""
    path = GOLDEN / "paper_rays.json"
    return json.loads(path.read_text())


@pytest.mark.parametrize("case", golden_cases())
def test_golden_rays(case: dict[str, Any]) -> None:
    lens = make(*[s | {"semi_diameter_mm": 11.9} for s in case["surfaces"]])
    pose = Pose(
        decenter_y_mm=case.get("decenter_y", 0.0),
        tilt_x_deg=case.get("tilt_x_deg", 0.0),
        pivot_z_mm=case.get("pivot", 0.0),
    )
    rays = trace(
        lens,
        case["origin"],
        case["start_direction"],
        case["wavelength_um"],
        pose,
        case["plane_z_mm"],
        record_hits=True,
    )
    assert rays.ok.all()
    assert np.max(np.abs(rays.position - case["end"])) < 1e-10
    assert np.max(np.abs(rays.direction - case["direction"])) < 1e-10
    assert np.max(np.abs(rays.opl - case["opl"])) < 1e-10
    rotation, shift = pose.transform()
    assert rays.hits is not None
    for surface, expected in enumerate(case["hits_in_lens_frame"]):
        own = (rays.hits[:, surface] - shift[0]) @ rotation[0]
        assert np.max(np.abs(own - expected)) < 1e-10


def test_golden_cases_cover_a_decenter_and_a_tilt() -> None:
    cases = golden_cases()
    assert len(cases) == 5
    assert any("decenter_y" in c for c in cases)
    assert any("tilt_x_deg" in c for c in cases)


# The NumPy reference.


def one_trial(system: CompiledSystem, trial: int) -> CompiledSystem:
    """A single lens out of many."""

    def own(array: np.ndarray) -> np.ndarray:
        return array[trial : trial + 1] if len(array) > 1 else array

    names = ("rotation", "vertex", "index")
    shapes = tuple(shape.trial(trial) for shape in system.shapes)
    return replace(system, trials=None, shapes=shapes, **{n: own(getattr(system, n)) for n in names})


@settings(max_examples=150)
@given(data=st.data(), trials=st.sampled_from([None, 1, 3]), seed=SEEDS, clip=st.booleans())
def test_kernel_equals_numpy(data: st.DataObject, trials: int | None, seed: int, clip: bool) -> None:
    lens = data.draw(lenses())
    pose, changes = data.draw(poses(trials)), data.draw(surface_perturbations(lens, trials))
    system = compile_system(lens, 0.55, pose, changes)
    origins, directions = random_rays(seed, 150)
    plane = data.draw(st.none() | st.just(60.0))
    rays = trace_compiled(system, origins, directions, plane, clip=clip, record_hits=True)
    for t in range(system.trials or 1):
        own: Any = (lambda a, t=t: a[t]) if system.trials else (lambda a: a)
        position, direction, opl, status, failed, hits = trace_numpy(
            one_trial(system, t), origins, directions, plane, clip
        )
        assert np.array_equal(own(rays.status), status)
        assert np.array_equal(own(rays.failed_surface), failed)
        # Rays that run far are compared on the scale of their path.
        scale = 1.0 + np.maximum(np.abs(opl), np.abs(hits).max(axis=(1, 2)))[:, None]
        off = np.concatenate(
            [
                np.abs(own(rays.position) - position) / scale,
                np.abs(own(rays.direction) - direction),
                np.abs(own(rays.opl) - opl)[:, None] / scale,
                np.abs(own(rays.hits) - hits).max(axis=1) / scale,
            ],
            axis=1,
        ).max(axis=1)
        # A ray that grazes a surface magnifies rounding.
        assert np.quantile(off, 0.97) < 1e-12
        assert np.max(off) < 1e-11


def test_random_rays_meet_every_fate() -> None:
    """So that the comparison above is not only about rays that pass."""
    steep = {"radius_mm": 6.0, "asphere": (1e-2,), "thickness_mm": 8.0, "material": 1.9}
    lens = make({**steep, "semi_diameter_mm": 3.5}, {"radius_mm": 9.0, "semi_diameter_mm": 3.0})
    origins, directions = random_rays(1, 20000, wild=0.5)
    system = compile_system(lens, 0.55)
    rays = trace_compiled(system, origins, directions, 60.0)
    assert set(np.unique(rays.status)) == {int(s) for s in Status}
    assert np.array_equal(rays.status, trace_numpy(system, origins, directions, 60.0)[3])


@pytest.mark.parametrize("terms", [1, 6, 7, 10, 11])
def test_aspheres_of_any_number_of_terms_equal_numpy_up_to_the_rim(terms: int) -> None:
    """With a departure of tenths of a millimetre at the rim, and among rays that fail."""
    asphere = tuple((-1) ** n * 0.1 / 5.0 ** (4 + 2 * n) for n in range(terms))
    first = {"radius_mm": 12.0, "thickness_mm": 6.0, "material": 1.9, "semi_diameter_mm": 5.0}
    lens = make(first | {"asphere": asphere}, {"radius_mm": 8.0, "conic": -0.6, "asphere": asphere})
    origins, directions = random_rays(7, 1000)
    system = compile_system(lens, 0.55)
    rays = trace_compiled(system, origins, directions, 60.0)
    position, direction, opl, status, failed, _ = trace_numpy(system, origins, directions, 60.0)
    assert np.array_equal(rays.status, status)
    assert np.array_equal(rays.failed_surface, failed)
    assert {Status.OK, Status.CLIPPED} <= {Status(s) for s in status}
    passed = rays.ok
    np.testing.assert_allclose(rays.position[passed], position[passed], atol=1e-12 * 60.0)
    np.testing.assert_allclose(rays.direction[passed], direction[passed], atol=1e-12)
    np.testing.assert_allclose(rays.opl[passed], opl[passed], atol=1e-12 * 60.0)


@pytest.mark.parametrize("front", [{}, {"asphere": (1e-5,)}])
@pytest.mark.parametrize("pose", [Pose(), Pose(decenter_x_mm=0.1), Pose(tilt_y_deg=1.0)])
def test_no_ray_depends_on_those_beside_it(front: dict[str, Any], pose: Pose) -> None:
    """Failed ones among them, over several blocks: bit by bit as alone, or among others that all pass."""
    first = {"radius_mm": 12.0, "thickness_mm": 6.0, "material": 1.9, "semi_diameter_mm": 5.0}
    lens = make(first | front, {"radius_mm": 8.0, "conic": -0.6, "semi_diameter_mm": 4.0})
    origins, directions = random_rays(3, 700)
    together = trace(lens, origins, directions, 0.55, pose, 60.0, record_hits=True)
    assert {Status.OK, Status.MISSED, Status.CLIPPED} <= {Status(s) for s in together.status}
    for chosen in (together.ok, ~together.ok, np.arange(700) % 31 == 7, np.arange(700) == 299):
        own = trace(lens, origins[chosen], directions[chosen], 0.55, pose, 60.0, record_hits=True)
        for name in ("position", "direction", "opl", "status", "failed_surface", "hits"):
            assert np.array_equal(getattr(own, name), getattr(together, name)[chosen])


@settings(max_examples=40)
@given(lens=lenses(), seed=SEEDS, data=st.data())
def test_trials_at_once_equal_trials_one_by_one(lens: Lens, seed: int, data: st.DataObject) -> None:
    pose = data.draw(poses(4))
    origins, directions = random_rays(seed, 40)
    rays = trace(lens, origins, directions, 0.6, pose, 40.0)
    assert rays.status.shape == (4, 40)
    for t in range(4):
        values = {n: float(getattr(pose, n)[t]) for n in Pose.__dataclass_fields__}
        alone = trace(lens, origins, directions, 0.6, Pose(**values), 40.0)
        assert np.array_equal(rays.status[t], alone.status)
        assert np.allclose(rays.position[t], alone.position, rtol=1e-13, atol=1e-12)
        assert np.allclose(rays.opl[t], alone.opl, rtol=1e-13, atol=1e-12)


# Statuses.


def fate(lens: Lens, origin: list[float], direction: list[float], **more: Any) -> tuple[Status, int]:
    """Status and surface of one ray."""
    rays = trace(lens, [origin], unit(direction), 0.532, **more)
    return Status(rays.status[0]), int(rays.failed_surface[0])


def test_missed_clipped_and_passed() -> None:
    lens = make(
        {"radius_mm": 10.0, "thickness_mm": 2.0, "material": 1.5, "semi_diameter_mm": 5.0},
        {"semi_diameter_mm": 4.0},
    )
    assert fate(lens, [0, 12, -10], [0, 0, 1]) == (Status.MISSED, 0)
    assert fate(lens, [0, 6, -10], [0, 0, 1]) == (Status.CLIPPED, 0)
    assert fate(lens, [0, 4.7, -10], [0, 0, 1]) == (Status.CLIPPED, 1)
    assert fate(lens, [0, 4.7, -10], [0, 0, 1], clip=False) == (Status.OK, -1)
    assert fate(lens, [0, 3.0, -10], [0, 0, 1], plane_z_mm=20.0) == (Status.OK, -1)
    assert fate(lens, [0, 3.0, -10], [0, 1, 0]) == (Status.MISSED, 0)
    assert fate(lens, [0, 3.0, -10], [0, 0, -1]) == (Status.MISSED, 0)
    asphere = make({"radius_mm": 10.0, "asphere": (1e-4,), "material": 1.5})
    assert fate(asphere, [0, 3.0, -10], [0, 0, -1]) == (Status.MISSED, 0)


def test_a_ray_through_the_very_rim_passes() -> None:
    lens = make({"radius_mm": 10.0, "semi_diameter_mm": 5.0, "material": 1.5})
    assert fate(lens, [0, 5.0, -10], [0, 0, 1]) == (Status.OK, -1)
    assert fate(lens, [0, 5.0 * (1 + 1e-8), -10], [0, 0, 1]) == (Status.CLIPPED, 0)


@pytest.mark.parametrize(("offset", "status"), [(-1e-6, Status.OK), (1e-6, Status.TOTAL_REFLECTION)])
def test_total_reflection_starts_at_the_critical_angle(offset: float, status: Status) -> None:
    # Towards its centre of curvature a ray enters the glass unbent; there it meets a plane.
    lens = make({"radius_mm": 10.0, "thickness_mm": 10.0, "material": 1.2}, {})
    angle = math.asin(1.0 / 1.2) + offset
    direction = np.array([0.0, math.sin(angle), math.cos(angle)])
    origin = np.array([0.0, 0.0, 10.0]) - 12.0 * direction
    failed = -1 if status == Status.OK else 1
    assert fate(lens, origin.tolist(), direction.tolist()) == (status, failed)


def test_a_failed_ray_stays_at_the_last_point_it_reached() -> None:
    lens = make({"thickness_mm": 2.0, "material": 1.5}, {"semi_diameter_mm": 1.0, "thickness_mm": 1.0}, {})
    rays = trace(lens, [[0.0, 2.0, -3.0]], [[0.0, 0.0, 1.0]], 0.532, plane_z_mm=9.0)
    assert rays.status[0] == Status.CLIPPED
    assert rays.failed_surface[0] == 1
    assert rays.position[0] == pytest.approx([0.0, 2.0, 2.0])
    assert rays.opl[0] == pytest.approx(3.0 + 1.5 * 2.0)
    assert rays.throughput == 0.0


def test_a_ray_that_turns_back_misses_the_plane() -> None:
    """Out of the side of a deep bowl, with the plane on the other side."""
    lens = make({"radius_mm": -10.0, "material": 1.5, "semi_diameter_mm": 9.99})
    rays = trace(lens, [[0.0, 9.0, -9.0]], unit([0.0, 1.0, -0.2]), 0.532, plane_z_mm=9.0)
    assert rays.status[0] == Status.MISSED
    assert rays.failed_surface[0] == 1
    assert rays.direction[0, 2] < 0.0


# Closed forms.


def test_a_ball_lens_is_hit_on_its_far_side() -> None:
    """Rays that start beyond the centre of curvature of the surface that they meet."""
    lens = make(
        {"radius_mm": 5.0, "thickness_mm": 10.0, "material": 1.5, "semi_diameter_mm": 4.0},
        {"radius_mm": -5.0},
    )
    rays = trace(lens, [[0.0, 1e-5, -20.0]], [[0.0, 0.0, 1.0]], 0.532, plane_z_mm=12.5)
    assert rays.ok[0]
    assert rays.position[0, 1] == pytest.approx(0.0, abs=1e-14)  # back focus n R / (2 (n - 1)) - R = 2.5 mm


@given(radius=numbers(2.0, 8.0), height=numbers(0.0, 1.5))
def test_a_concave_front_is_hit_near_its_vertex(radius: float, height: float) -> None:
    lens = make({"radius_mm": -radius, "material": 1.5, "semi_diameter_mm": 0.9 * radius})
    rays = trace(lens, [[0.0, height, -50.0]], [[0.0, 0.0, 1.0]], 0.532)
    assert rays.ok[0]
    assert rays.position[0, 2] == pytest.approx(math.sqrt(radius**2 - height**2) - radius, abs=1e-12)


def test_plano_hyperbolic_lens_is_stigmatic() -> None:
    n, radius = 1.6, -10.0
    lens = make(
        {"thickness_mm": 6.0, "material": n}, {"radius_mm": radius, "conic": -n * n, "semi_diameter_mm": 6.0}
    )
    heights = np.linspace(-6.0, 6.0, 25)
    origins = np.column_stack([0.3 * heights, heights, np.full(25, -4.0)]) * [0.9, 0.9, 1.0]
    rays = trace(lens, origins, np.tile([0.0, 0.0, 1.0], (25, 1)), 0.532, plane_z_mm=6.0 - radius / (n - 1.0))
    assert rays.ok.all()
    assert np.max(np.abs(rays.position[:, :2])) < 1e-12
    assert np.ptp(rays.opl) < 1e-12


@given(n=numbers(1.2, 2.5), height=numbers(0.0, 6.0), radius=numbers(8.0, 30.0))
def test_cartesian_ellipsoid_is_stigmatic(n: float, height: float, radius: float) -> None:
    lens = make({"radius_mm": radius, "conic": -1.0 / n**2, "material": n, "semi_diameter_mm": 7.0})
    focus = n * radius / (n - 1.0)
    rays = trace(lens, [[height, 0.0, -5.0]], [[0.0, 0.0, 1.0]], 0.532, plane_z_mm=focus)
    assert rays.position[0] == pytest.approx([0.0, 0.0, focus], abs=1e-11)
    assert rays.opl[0] == pytest.approx(5.0 + n * focus, rel=1e-14)


@given(n=numbers(1.1, 2.5), radius=numbers(5.0, 50.0), angle=numbers(0.01, 0.9))
def test_aplanatic_points_of_a_sphere(n: float, radius: float, angle: float) -> None:
    """Rays towards a point n R behind the centre meet, after refraction, R / n behind it."""
    lens = make({"radius_mm": radius, "material": n})
    hit = radius * np.array([math.sin(angle), 0.0, 1.0 - math.cos(angle)])
    direction = unit(np.array([0.0, 0.0, radius + n * radius]) - hit)
    assume(direction[0] @ (np.array([0, 0, radius]) - hit) > 0.0)
    rays = trace(lens, hit - 3.0 * direction, direction, 0.532, plane_z_mm=radius + radius / n, clip=False)
    assert rays.ok[0]
    assert np.abs(rays.position[0, :2]).max() < 1e-11 * radius


@given(n=numbers(1.0, 3.0), thickness=numbers(0.1, 30.0), angle=numbers(-1.4, 1.4))
def test_plane_parallel_plate_shifts_a_ray(n: float, thickness: float, angle: float) -> None:
    lens = make({"thickness_mm": thickness, "material": n, "semi_diameter_mm": 1e3}, {})
    direction = [0.0, math.sin(angle), math.cos(angle)]
    rays = trace(lens, [[0.0, 0.0, -1.0]], [direction], 0.532, plane_z_mm=thickness + 1.0)
    assert rays.direction[0] == pytest.approx(direction, abs=1e-14)
    straight = (thickness + 2.0) * math.tan(angle)
    shift = (straight - rays.position[0, 1]) * math.cos(angle)
    cos_inside = math.sqrt(n * n - math.sin(angle) ** 2)
    formula = thickness * math.sin(angle) * (1.0 - math.cos(angle) / cos_inside)
    assert shift == pytest.approx(formula, abs=1e-11)


def test_rays_stay_square_to_wavefronts(paper_lens: Lens) -> None:
    """Malus and Dupin: along a plane the path of one object point grows by the direction cosines."""
    pose = Pose(decenter_x_mm=0.2, tilt_y_deg=1.0)
    angle = np.linspace(-0.4, 0.4, 4001)
    directions = np.column_stack([0.1 + 0.0 * angle, np.sin(angle), np.zeros_like(angle)])
    directions[:, 2] = np.sqrt(1.0 - np.sum(directions**2, axis=1))
    rays = trace(paper_lens, np.tile([0.3, 0.5, -13.5], (4001, 1)), directions, 0.532, pose, 13.0)
    assert rays.ok.all()
    step, mean = np.diff(rays.position, axis=0), 0.5 * (rays.direction[1:] + rays.direction[:-1])
    assert np.max(np.abs(np.diff(rays.opl) - np.sum(step * mean, axis=1))) < 1e-9
    assert np.min(np.abs(np.diff(rays.opl))) > 1e-5


# Symmetries.


@settings(max_examples=50)
@given(lens=lenses(), seed=SEEDS, data=st.data())
def test_a_moved_lens_is_an_object_moved_the_other_way(lens: Lens, seed: int, data: st.DataObject) -> None:
    pose = data.draw(poses(None))
    rotation, shift = (a[0] for a in pose.transform())
    origins, directions = random_rays(seed, 60)
    moved = trace(lens, origins, directions, 0.6, pose)
    still = trace(lens, (origins - shift) @ rotation, directions @ rotation, 0.6)
    assert np.array_equal(moved.status, still.status)
    scale = 1.0 + np.abs(still.opl)[:, None]
    assert np.max(np.abs(moved.position - (still.position @ rotation.T + shift)) / scale) < 1e-11
    assert np.max(np.abs(moved.direction - still.direction @ rotation.T)) < 1e-11
    assert np.max(np.abs(moved.opl - still.opl) / scale[:, 0]) < 1e-11


def test_despace_is_a_change_of_both_distances(paper_lens: Lens) -> None:
    origins, directions = random_rays(3, 200, wild=0.0)
    moved = trace(paper_lens, origins, directions, 0.532, Pose(despace_mm=0.25), 20.0)
    still = trace(paper_lens, origins - [0, 0, 0.25], directions, 0.532, plane_z_mm=19.75)
    assert moved.ok.sum() > 100
    assert np.allclose(moved.position[:, :2], still.position[:, :2], atol=1e-12)
    assert np.allclose(moved.opl, still.opl, atol=1e-12)


def mirrored(lens: Lens) -> Lens:
    """The lens seen from behind; it must end in air."""
    last = lens.surfaces[-1]
    media = [None, *(s.material for s in lens.surfaces[:-1])]
    gaps = [None, *(s.thickness_mm for s in lens.surfaces[:-1])]
    surfaces = [
        Surface(
            radius_mm=None if s.radius_mm is None else -s.radius_mm,
            conic=s.conic,
            asphere=tuple(-a for a in s.asphere),
            thickness_mm=gap,
            material=medium,
            semi_diameter_mm=s.semi_diameter_mm or (4.0 if s is last else None),
        )
        for s, gap, medium in zip(lens.surfaces, gaps, media, strict=True)
    ]
    return lens.replaced(surfaces=tuple(reversed(surfaces)))


@settings(max_examples=60)
@given(lens=lenses(), seed=SEEDS)
def test_light_finds_its_way_back(lens: Lens, seed: int) -> None:
    lens = lens.with_surface(len(lens.surfaces) - 1, material=None)
    origins, directions = random_rays(seed, 100, wild=0.0)
    plane = lens.exit_vertex_z_mm + 30.0
    there = trace(lens, origins, directions, 0.6, plane_z_mm=plane)
    ok = there.ok & (there.direction[:, 2] > 0.3)
    assume(ok.sum() > 3)
    flip = np.array([1.0, 1.0, -1.0])
    starts = there.position[ok] * flip + [0.0, 0.0, lens.exit_vertex_z_mm]
    end = lens.exit_vertex_z_mm + 20.0
    back = trace(mirrored(lens), starts, -there.direction[ok] * flip, 0.6, plane_z_mm=end, clip=False)
    assert back.ok.all()
    assert np.max(np.abs(back.position[:, :2] - origins[ok, :2])) < 1e-9
    assert np.max(np.abs(back.direction * -flip - directions[ok])) < 1e-9
    assert np.max(np.abs(back.opl - there.opl[ok])) < 1e-9


@given(lens=lenses(), seed=SEEDS, angle=numbers(0.0, 6.3))
def test_a_lens_is_the_same_from_all_sides(lens: Lens, seed: int, angle: float) -> None:
    turn = np.array(
        [[math.cos(angle), -math.sin(angle), 0.0], [math.sin(angle), math.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    origins, directions = random_rays(seed, 40, wild=0.0)
    plain = trace(lens, origins, directions, 0.6)
    turned = trace(lens, origins @ turn.T, directions @ turn.T, 0.6)
    same = plain.status == turned.status
    assert same.mean() > 0.95  # a ray on the very rim may fall to either side
    assert np.allclose((plain.position @ turn.T)[same], turned.position[same], atol=1e-9)


# Calling it.


def equal(a: RayTrace, b: RayTrace) -> bool:
    """Whether two results agree bit by bit."""
    names = ("position", "direction", "opl", "status", "failed_surface")
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in names)


@pytest.mark.parametrize("trials", [None, 3, 3000])
def test_threads_change_nothing(paper_lens: Lens, trials: int | None) -> None:
    rays = 2 * RAYS_PER_THREAD + 77 if trials is None else 31
    origins, directions = random_rays(5, rays)
    tilt: Any = 0.3 if trials is None else np.linspace(0.0, 1.0, trials)
    results = [
        trace(paper_lens, origins, directions, 0.532, Pose(tilt_x_deg=tilt), 13.0, threads=threads)
        for threads in (1, 2, 5, None)
    ]
    assert all(equal(results[0], r) for r in results[1:])


def test_an_earlier_result_is_overwritten(paper_lens: Lens) -> None:
    origins, directions = random_rays(6, 500)
    first = trace(paper_lens, *random_rays(7, 500), 0.532, plane_z_mm=13.0, record_hits=True)
    again = trace(paper_lens, origins, directions, 0.532, plane_z_mm=13.0, record_hits=True, out=first)
    fresh = trace(paper_lens, origins, directions, 0.532, plane_z_mm=13.0, record_hits=True)
    assert again is first
    assert equal(again, fresh)
    assert np.array_equal(again.hits, fresh.hits)
    with pytest.raises(InputError, match="another record_hits"):
        trace(paper_lens, origins, directions, 0.532, out=first)
    with pytest.raises(InputError, match=r"out has rays of shape \(500,\): must be \(499,\)"):
        trace(paper_lens, origins[1:], directions[1:], 0.532, out=first, record_hits=True)
    apart = replace(first, opl=np.zeros((500, 2))[:, 0])
    with pytest.raises(InputError, match="not contiguous"):
        trace(paper_lens, origins, directions, 0.532, out=apart, record_hits=True)


def test_input_is_left_alone(paper_lens: Lens) -> None:
    origins, directions = random_rays(8, 100)
    kept = origins.copy(), directions.copy()
    trace(paper_lens, origins, directions, 0.532, plane_z_mm=13.0)
    assert np.array_equal(kept[0], origins)
    assert np.array_equal(kept[1], directions)


def test_rays_of_their_own_for_each_trial(paper_lens: Lens) -> None:
    bundles = [random_rays(seed, 20) for seed in range(3)]
    origins, directions = (np.stack(a) for a in zip(*bundles, strict=True))
    rays = trace(paper_lens, origins, directions, 0.532, Pose(decenter_x_mm=np.array([0.0, 0.1, 0.2])), 13.0)
    for t, (o, d) in enumerate(bundles):
        alone = trace(paper_lens, o, d, 0.532, Pose(decenter_x_mm=0.1 * t), 13.0)
        assert np.allclose(rays.position[t], alone.position, atol=1e-13)


def test_one_origin_serves_all_directions(paper_lens: Lens) -> None:
    directions = unit(np.column_stack([np.linspace(-0.2, 0.2, 9), np.zeros(9), np.ones(9)]))
    one = trace(paper_lens, [[0.0, 0.0, -13.5]], directions, 0.532)
    all_ = trace(paper_lens, np.tile([0.0, 0.0, -13.5], (9, 1)), directions, 0.532)
    assert equal(one, all_)


def test_no_rays_are_no_fault(paper_lens: Lens) -> None:
    assert trace(paper_lens, np.zeros((0, 3)), np.zeros((0, 3)), 0.532).status.shape == (0,)


@pytest.mark.parametrize(
    ("origins", "directions", "message"),
    [
        (
            [[0, 0, -9]],
            [[0, 0, 1.001]],
            "1 rays have an origin that is not finite or a direction that is not",
        ),
        ([[0, 0, -9]], [[0, 0, math.nan]], "not finite"),
        ([[0, math.nan, -9]], [[0, 0, 1]], "not finite"),
        ([[0, math.inf, -9]], [[0, 0, 1]], "not finite"),
        ([[0, 0]], [[0, 0, 1]], r"origins .*\(1, 2\).*\(rays, 3\)"),
        ([[0, 0, -9]] * 2, [[0, 0, 1]] * 3, "2 origins and 3 directions"),
        ([[[0, 0, -9]]] * 2, [[[0, 0, 1]]] * 3, "different numbers of trials"),
    ],
)
def test_bad_rays_are_refused(paper_lens: Lens, origins: Any, directions: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        trace(paper_lens, np.array(origins, float), np.array(directions, float), 0.532)


def test_other_bad_calls_are_refused(paper_lens: Lens) -> None:
    rays = random_rays(1, 4)
    with pytest.raises(InputError, match="threads = 0"):
        trace(paper_lens, *rays, 0.532, threads=0)
    with pytest.raises(InputError, match="no surface 7"):
        trace(paper_lens, *rays, 0.532, surface_perturbations={7: SurfacePerturbation()})


def test_threads_share_one_compiled_kernel_however_the_work_is_cut(paper_lens: Lens) -> None:
    from lensdesign.raytrace.kernel import trace_kernel

    origins, directions = random_rays(5, 40)
    pose = Pose(decenter_x_mm=np.array([0.0, 0.1]))
    one = trace(paper_lens, origins, directions, 0.532, pose, threads=1)
    compiled = set(trace_kernel.signatures)
    three = trace(paper_lens, origins, directions, 0.532, pose, threads=3)
    assert set(trace_kernel.signatures) == compiled
    assert np.array_equal(one.position, three.position)
    assert np.array_equal(one.status, three.status)
