"""Placements, and scenes that follow them."""

from __future__ import annotations

import math
from typing import Any

import pytest

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose, SurfacePerturbation
from wavesim.scene.patches import patch_scene
from wavesim.scene.placement import NOMINAL, Placement, placed
from wavesim.scene.scene import placed_scene

TWIN = scaled(load_design("designs/paper_singlet.toml"), 0.125)


def test_a_pose_alone_stands_for_a_perfect_bench() -> None:
    pose = Pose(tilt_y_deg=0.1)
    assert placed(pose) == Placement(pose=pose)
    assert placed(Placement(pose)) == placed(pose)
    assert placed(NOMINAL) is NOMINAL


def test_a_scene_follows_lens_object_and_light_and_keeps_its_exit_grid() -> None:
    scene = patch_scene(TWIN, 0.02, plane_distance_mm=0.25)
    bent = {1: SurfacePerturbation(radius_mm=0.01)}
    there = placed_scene(
        scene, Placement(Pose(tilt_x_deg=0.1), bent, (1e-3, 2e-3, -3e-3), wavelength_um=0.54)
    )
    grid = scene.object_grid
    assert there.object_grid.centre_mm == (grid.centre_mm[0] + 1e-3, grid.centre_mm[1] + 2e-3)
    assert there.object_grid.z_mm == pytest.approx(grid.z_mm - 3e-3)
    assert (there.pose, there.surface_perturbations) == (Pose(tilt_x_deg=0.1), bent)
    assert (there.wavelength_um, there.exit_grid) == (0.54, scene.exit_grid)
    assert placed_scene(scene, NOMINAL) == scene
    # Only surface perturbations change indices.
    assert there.system.index[0].tolist() == TWIN.indices(scene.wavelength_um).tolist()


def test_planes_beyond_the_list_are_where_the_sensor_is() -> None:
    there = Placement(sensor_shift_mm=(0.0, 0.0, 0.02), plane_distances_mm=(0.01,))
    assert [there.plane_distance_mm(number) for number in range(3)] == [0.01, 0.02, 0.02]


@pytest.mark.parametrize(
    "wrong",
    [
        {"object_shift_mm": (0.0, 1.0)},
        {"sensor_shift_mm": (0.0, 0.0, math.nan)},
        {"sensor_tilt_deg": (0.0, 1.0, 2.0)},
        {"plane_distances_mm": (math.inf,)},
    ],
)
def test_what_is_no_place_is_refused(wrong: dict[str, Any]) -> None:
    (name,) = wrong
    with pytest.raises(InputError, match=name):
        Placement(**wrong)
