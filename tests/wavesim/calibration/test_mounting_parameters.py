"""Mountings."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose
from wavesim.calibration.mounting_parameters import (
    parameter_names,
    plane_of,
    validate_parameters,
    values_of,
    with_values,
)
from wavesim.fields.field import Field, Grid
from wavesim.scene.scene import Scene, placed_light, placed_scene
from wavesim.scene.system_state import AS_DESIGNED, SystemState
from wavesim.sensor.measurement import Measurement, placed_planes

numbers = st.floats(-1.0, 1.0)


@given(st.lists(numbers, min_size=7, max_size=7))
def test_values_go_in_and_come_out_by_name(values: list[float]) -> None:
    names = parameter_names(2)
    mounting = with_values(SystemState(Pose(pivot_z_mm=3.0)), names, values)
    assert values_of(mounting, names).tolist() == values
    assert mounting.pose.pivot_z_mm == 3.0
    assert values_of(mounting, names[::-1]).tolist() == values[::-1]


def test_plane_parameters_count_from_one() -> None:
    assert parameter_names(2)[-2:] == ("plane_distance_1_mm", "plane_distance_2_mm")
    assert [plane_of(name) for name in ("tilt_x_deg", "plane_distance_1_mm", "plane_distance_12_mm")] == [
        None,
        0,
        11,
    ]
    assert values_of(AS_DESIGNED, ["plane_distance_3_mm"]).tolist() == [0.0]


@pytest.mark.parametrize("names", [(), ("decentre_x_mm",), ("tilt_x_deg",) * 2, ("plane_distance_3_mm",)])
def test_unknown_parameters_are_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="parameter"):
        validate_parameters(names, 2)


def test_lens_object_and_planes_stand_where_the_mounting_says() -> None:
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    grid = Grid((8, 8), 1e-3, lens.object_z_mm)
    scene = Scene(lens, grid, Grid((8, 8), 3.2e-3, lens.exit_vertex_z_mm + 0.1), 0.532)
    mounting = SystemState(
        Pose(decenter_x_mm=0.01, tilt_y_deg=1.0),
        object_shift_mm=(0.0, 0.0, -0.02),
        plane_distance_errors_mm=(0.03,),
    )
    placed = placed_scene(scene, mounting)
    assert placed.object_grid.z_mm == pytest.approx(grid.z_mm - 0.02)
    assert placed.pose.decenter_x_mm == 0.01
    assert placed.pose.tilt_y_deg == 1.0
    assert placed.exit_grid == scene.exit_grid
    light = placed_light(Field(grid, np.ones(grid.shape, np.complex64), 0.532), mounting)
    assert light.grid == placed.object_grid
    planes = [Measurement(0.0, np.ones((8, 8))), Measurement(1.0, np.ones((8, 8)))]
    assert [plane.distance_mm for plane in placed_planes(planes, mounting)] == [0.03, 1.0]
