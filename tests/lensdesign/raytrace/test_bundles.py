"""Bundles: exact means over the stop, and rays that go through the stop point that names them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_lenses import lenses, poses

from lensdesign import Lens, Pose, SurfacePerturbation
from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.raytrace.bundles import launch, pupil_fan, pupil_hexapolar, pupil_rings
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.rays import trace, trace_compiled


@pytest.mark.parametrize("rings", [1, 2, 4, 7])
def test_rings_give_exact_means_of_polynomials(rings: int) -> None:
    samples = pupil_rings(rings, arms=12)
    x, y = samples.points.T
    for power in range(2 * rings):
        assert samples.weights @ (x * x + y * y) ** power == pytest.approx(1.0 / (power + 1), rel=1e-13)
    assert samples.weights @ (x**2 * y**2) == pytest.approx(1 / 24 if rings > 1 else 1 / 32)
    assert samples.weights @ x == pytest.approx(0.0, abs=1e-15)


def test_the_rim_weighs_nothing_but_is_there() -> None:
    samples = pupil_rings(3, 8, edge=True)
    on_rim = np.isclose(np.hypot(*samples.points.T), 1.0)
    assert on_rim.sum() == 8
    assert samples.weights[on_rim].sum() == 0.0
    assert samples.weights.sum() == pytest.approx(1.0)


def test_fan_and_hexapolar_fillings() -> None:
    fan = pupil_fan(5)
    assert fan.points.tolist() == [[0, -1], [0, -0.5], [0, 0], [0, 0.5], [0, 1]]
    hexapolar = pupil_hexapolar(4)
    assert len(hexapolar.points) == 1 + 3 * 4 * 5
    assert np.hypot(*hexapolar.points.T).max() == pytest.approx(1.0)
    assert hexapolar.weights.sum() == pytest.approx(1.0)


def at_stop(lens: Lens, pose: Pose, origins: Array, directions: Array) -> tuple[Array, Array]:
    """Where rays cross the stop, in its own frame over its semi-diameter, and which get there."""
    rays = trace(lens, origins, directions, 0.6, pose, record_hits=True, clip=False)
    assert rays.hits is not None
    system = compile_system(lens, 0.6, pose)
    local = rays.hits[..., lens.stop_index, :] - system.vertex[:, None, lens.stop_index]
    local = local @ system.rotation[:, lens.stop_index]
    reached = rays.ok | (rays.failed_surface > lens.stop_index)
    return local.reshape(*rays.status.shape, 3)[..., :2] / lens.stop_semi_diameter_mm, reached


def least_miss(lens: Lens, pose: Pose, origin: Array, target: Array) -> Array:
    """How near to a point of the stop any ray of a fine fan comes, trial by trial."""
    axis = np.linspace(-0.6, 0.6, 121)
    x, y = (c.ravel() for c in np.meshgrid(axis, axis))
    directions = np.stack([x, y, np.sqrt(1.0 - x * x - y * y)], axis=-1)
    crossed, reached = at_stop(lens, pose, np.broadcast_to(origin, directions.shape), directions)
    distance = np.where(reached, np.linalg.norm(crossed - target, axis=-1), np.inf)
    least: Array = distance.min(axis=-1)
    return least


@settings(max_examples=60)
@given(lens=lenses(), trials=st.sampled_from([None, 3]), data=st.data())
def test_rays_go_through_their_stop_points_wherever_rays_can(
    lens: Lens, trials: int | None, data: st.DataObject
) -> None:
    pupil = pupil_hexapolar(3).points
    field = [[0.0, 0.0], [0.3, -0.5 * lens.half_field_mm]]
    pose = data.draw(poses(trials))
    origins, directions = launch(lens, field, pupil, 0.6, pose)
    crossed, reached = at_stop(lens, pose, origins, directions)
    target = np.tile(pupil, (2, 1))
    error = np.where(reached, np.linalg.norm(crossed - target, axis=-1), 0.0)
    limit = 1e-12 if lens.stop_index == 0 else 1e-8
    for ray in np.flatnonzero(np.any(np.atleast_2d(error) > limit, axis=0))[:3]:
        assert lens.stop_index > 0
        miss = error[..., ray]
        assert np.all((miss < limit) | (least_miss(lens, pose, origins[ray], target[ray]) > 0.5 * miss))


def test_an_inner_stop_is_filled_to_its_rim(paper_lens: Lens) -> None:
    front = paper_lens.surfaces[0].model_copy(update={"stop": False, "semi_diameter_mm": 12.0})
    back = paper_lens.surfaces[1].model_copy(update={"stop": True, "semi_diameter_mm": 6.0})
    lens = paper_lens.replaced(surfaces=(front, back))
    pupil = pupil_rings(4, 12, edge=True).points
    for pose in (Pose(), Pose(decenter_x_mm=0.1, tilt_x_deg=0.5)):
        origins, directions = launch(lens, [[0.0, 0.0], [1.0, 1.0]], pupil, 0.6, pose)
        crossed, reached = at_stop(lens, pose, origins, directions)
        assert reached.all()
        assert np.abs(crossed - np.tile(pupil, (2, 1))).max() < 1e-10
        assert trace(lens, origins, directions, 0.6, pose).ok.all()


def test_bundles_come_field_by_field(paper_lens: Lens) -> None:
    origins, directions = launch(paper_lens, [[0.0, 0.0], [0.0, 1.5]], pupil_fan(3).points, 0.532)
    assert origins.shape == directions.shape == (6, 3)
    assert origins[:, 1].tolist() == [0.0, 0.0, 0.0, 1.5, 1.5, 1.5]
    assert np.all(origins[:, 2] == -13.5)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-15)
    assert np.diff(directions[:3, 1]).min() > 0.0


def test_trials_lead(paper_lens: Lens) -> None:
    pose = Pose(decenter_y_mm=np.array([0.0, 0.1]))
    origins, directions = launch(paper_lens, [0.0, 0.0], pupil_fan(3).points, 0.532, pose)
    assert directions.shape == (2, 3, 3)
    rays = trace(paper_lens, origins, directions, 0.532, pose)
    assert rays.ok.all()
    assert directions[1, 1, 1] == pytest.approx(0.1 / np.hypot(13.5, 0.1), rel=1e-6)


def test_the_stop_moves_with_its_surface(paper_lens: Lens) -> None:
    changes = {0: SurfacePerturbation(decenter_x_mm=0.2, radius_mm=0.5)}
    system = compile_system(paper_lens, 0.532, surface_perturbations=changes)
    origins, directions = launch(paper_lens, [0.0, 0.0], [[1.0, 0.0]], 0.532, surface_perturbations=changes)
    rays = trace_compiled(system, origins, directions, record_hits=True)
    assert rays.hits is not None
    assert rays.hits[0, 0, 0] == pytest.approx(8.46, abs=1e-12)


@pytest.mark.parametrize("field", [[0.0], [[0.0, np.nan]], [[0.0, 1.0, 2.0]], [[[0.0, 1.0]]]])
def test_points_of_other_shapes_are_refused(paper_lens: Lens, field: list) -> None:
    with pytest.raises(
        InputError, match=r"field_points_mm has shape .* must be finite values of shape \(n, 2\)"
    ):
        launch(paper_lens, field, [[0.0, 0.0]], 0.532)
