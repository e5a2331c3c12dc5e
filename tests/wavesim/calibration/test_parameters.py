"""Parameters of benches, and what they change."""

from __future__ import annotations

from dataclasses import replace
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose
from wavesim.calibration.parameters import (
    Unknowns,
    bench_parameters,
    chosen_parameters,
    field_stop_parameters,
    mounting_parameters,
)
from wavesim.fields.field import Field, Grid
from wavesim.scene.scene import Scene, placed_light, placed_scene
from wavesim.scene.system_state import AS_DESIGNED, SystemState
from wavesim.sensor.measurement import Measurement, placed_planes

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
EVERY = *bench_parameters(LENS, 3, 0.03, 0.532, light_order=3), *field_stop_parameters(0.03)


@given(st.lists(st.floats(-1.0, 1.0), min_size=len(EVERY), max_size=len(EVERY)), st.randoms())
@settings(max_examples=20, deadline=None)
def test_values_go_in_and_come_out_in_any_order(sizes: list[float], order: Random) -> None:
    given = {p: max(size * p.typical, p.lower_bound) for p, size in zip(EVERY, sizes, strict=True)}
    given = {p: max(value, 0.0) if p.name.endswith("_background") else value for p, value in given.items()}
    shuffled = order.sample(EVERY, len(EVERY))
    start = SystemState(Pose(pivot_z_mm=3.0))
    state = Unknowns(start).changed(shuffled, [given[p] for p in shuffled]).state
    for parameter, value in given.items():
        assert parameter.value(state) == pytest.approx(value, abs=1e-15), parameter.name
    assert state.pose.pivot_z_mm == 3.0


def test_names_are_unique_and_a_bench_as_designed_has_no_values() -> None:
    assert len({p.name for p in EVERY}) == len(EVERY)
    assert Unknowns().changed(EVERY, [0.0] * len(EVERY)).state == AS_DESIGNED


def test_a_prior_does_not_make_another_parameter() -> None:
    (decenter,) = chosen_parameters("decenter_x_mm", EVERY)
    assert replace(decenter, typical=1.0) == decenter
    assert Unknowns(values={decenter: 0.2}).of([replace(decenter, typical=1.0)]).tolist() == [0.2]


def test_planes_count_from_one_in_names() -> None:
    planes = mounting_parameters(LENS, 2)[-2:]
    assert [p.name for p in planes] == ["plane_distance_1_mm", "plane_distance_2_mm"]
    assert [p.set(AS_DESIGNED, 0.1).plane_distance_errors_mm for p in planes] == [(0.1,), (0.0, 0.1)]


@pytest.mark.parametrize("text", ["", "decentre_x_mm", "tilt_x_deg,tilt_x_deg", "plane_distance_3_mm"])
def test_unknown_parameters_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="parameter"):
        chosen_parameters(text, mounting_parameters(LENS, 2))


def test_lens_object_and_planes_stand_where_the_mounting_says() -> None:
    grid = Grid((8, 8), 1e-3, LENS.object_z_mm)
    scene = Scene(LENS, grid, Grid((8, 8), 3.2e-3, LENS.exit_vertex_z_mm + 0.1), 0.532)
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
