"""States of a system, and scenes that follow them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose, SurfacePerturbation
from wavesim.scene.patches import patch_scene
from wavesim.scene.scene import placed_scene
from wavesim.scene.system_state import AS_DESIGNED, SystemState, state_of

TWIN = scaled(load_design("designs/paper_singlet.toml"), 0.125)


def test_a_pose_alone_stands_for_a_perfect_bench() -> None:
    pose = Pose(tilt_y_deg=0.1)
    assert state_of(pose) == SystemState(pose=pose)
    assert state_of(SystemState(pose)) == state_of(pose)
    assert state_of(AS_DESIGNED) is AS_DESIGNED


def test_a_scene_follows_lens_object_and_light_and_keeps_its_exit_grid() -> None:
    scene = patch_scene(TWIN, 0.02, plane_distance_mm=0.25)
    bent = {1: SurfacePerturbation(radius_mm=0.01)}
    there = placed_scene(
        scene, SystemState(Pose(tilt_x_deg=0.1), bent, (1e-3, 2e-3, -3e-3), wavelength_um=0.54)
    )
    grid = scene.object_grid
    assert there.object_grid.centre_mm == (grid.centre_mm[0] + 1e-3, grid.centre_mm[1] + 2e-3)
    assert there.object_grid.z_mm == pytest.approx(grid.z_mm - 3e-3)
    assert (there.pose, there.surface_perturbations) == (Pose(tilt_x_deg=0.1), bent)
    assert (there.wavelength_um, there.exit_grid) == (0.54, scene.exit_grid)
    assert placed_scene(scene, AS_DESIGNED) == scene
    # Only surface perturbations change indices.
    assert there.system.index[0].tolist() == TWIN.indices(scene.wavelength_um).tolist()


def test_planes_beyond_the_list_are_where_the_sensor_is() -> None:
    """Errors of planes add to the shift of the sensor, along z as across."""
    there = SystemState(sensor_shift_mm=(0.0, 0.0, 0.02), plane_distance_errors_mm=(0.01,))
    found = [there.sensor_pose(number).distance_mm for number in range(3)]
    assert found == pytest.approx([0.03, 0.02, 0.02], abs=1e-15)


def test_planes_beyond_the_lists_have_the_shift_of_the_sensor_and_no_background() -> None:
    state = SystemState(
        sensor_shift_mm=(1e-3, 0.0, 0.0), plane_shifts_um=((0.0, 2.0),), plane_backgrounds=(0.1,)
    )
    assert state.sensor_pose(0).shift_mm == pytest.approx((1e-3, 2e-3))
    assert state.sensor_pose(1).shift_mm == pytest.approx((1e-3, 0.0))
    assert (state.background(0), state.background(1)) == (0.1, 0.0)
    assert state.at_plane(0).sensor_pose(1).shift_mm == state.sensor_pose(0).shift_mm


@pytest.mark.parametrize(
    "wrong",
    [
        {"object_shift_mm": (0.0, 1.0)},
        {"sensor_shift_mm": (0.0, 0.0, math.nan)},
        {"sensor_tilt_deg": (0.0, 1.0, 2.0)},
        {"plane_distance_errors_mm": (math.inf,)},
        {"plane_shifts_um": ((math.inf, 0.0),)},
        {"plane_backgrounds": (-0.1,)},
        {"plane_background_slopes": ((0.0, math.nan),)},
        {"vibration_um": -0.1},
        {"plane_exposure_errors": (0.0, -1.0)},
        {"nonlinearity": 0.5},
        {"nonlinearity": math.nan},
    ],
)
def test_what_is_no_place_is_refused(wrong: dict[str, Any]) -> None:
    (name,) = wrong
    with pytest.raises(InputError, match=name):
        SystemState(**wrong)


def test_a_background_changes_evenly_from_the_centre_to_the_edges() -> None:
    state = SystemState(plane_backgrounds=(0.0, 0.02), plane_background_slopes=((0.01, -0.004),) * 2)
    shares = state.background_on(1, (51, 101))
    assert shares is not None
    x, y = (np.arange(n) - 0.5 * (n - 1) for n in (101, 51))
    expected = 0.02 + 0.01 * x / 50.5 - 0.004 * (y / 25.5)[:, None]
    assert shares == pytest.approx(expected, abs=1e-12)
    first = state.background_on(0, (51, 101))
    assert first is not None
    assert first.min() == 0.0
    assert state.background_on(2, (51, 101)) is None
