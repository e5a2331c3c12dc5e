"""Mountings, and the motions of fields that go with them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from wavesim.calibration.mounting import Mounting, motion, parameter_names, plane_of, refuse_parameters
from wavesim.camera.recorded import Recorded
from wavesim.fields.field import Field, Grid
from wavesim.scene.scene import Scene

numbers = st.floats(-1.0, 1.0)


@given(st.lists(numbers, min_size=7, max_size=7))
def test_values_go_in_and_come_out_by_name(values: list[float]) -> None:
    names = parameter_names(2)
    mounting = Mounting(pivot_z_mm=3.0).with_values(names, values)
    assert mounting.values_of(names).tolist() == values
    assert mounting.pivot_z_mm == 3.0
    assert mounting.values_of(names[::-1]).tolist() == values[::-1]


def test_plane_parameters_count_from_one() -> None:
    assert parameter_names(2)[-2:] == ("plane_distance_1_mm", "plane_distance_2_mm")
    assert [plane_of(name) for name in ("tilt_x_deg", "plane_distance_1_mm", "plane_distance_12_mm")] == [
        None,
        0,
        11,
    ]
    assert Mounting().values_of(["plane_distance_3_mm"]).tolist() == [0.0]


@pytest.mark.parametrize("names", [(), ("decentre_x_mm",), ("tilt_x_deg",) * 2, ("plane_distance_3_mm",)])
def test_unknown_parameters_are_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="parameter"):
        refuse_parameters(names, 2)


def test_lens_object_and_planes_stand_where_the_mounting_says() -> None:
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    grid = Grid((8, 8), 1e-3, lens.object_z_mm)
    scene = Scene(lens, grid, Grid((8, 8), 3.2e-3, lens.exit_vertex_z_mm + 0.1), 0.532)
    mounting = Mounting(
        decenter_x_mm=0.01, tilt_y_deg=1.0, working_distance_mm=0.02, plane_distances_mm=(0.03,)
    )
    placed = mounting.scene(scene)
    assert placed.object_grid.z_mm == pytest.approx(grid.z_mm - 0.02)
    assert placed.pose.decenter_x_mm == 0.01
    assert placed.pose.tilt_y_deg == 1.0
    assert placed.exit_grid == scene.exit_grid
    light = mounting.illumination(Field(grid, np.ones(grid.shape, np.complex64), 0.532))
    assert light.grid == placed.object_grid
    planes = [Recorded(0.0, np.ones((8, 8))), Recorded(1.0, np.ones((8, 8)))]
    assert [plane.distance_mm for plane in mounting.recorded(planes)] == [0.03, 1.0]


def plane_wave(grid: Grid, direction: np.ndarray) -> np.ndarray:
    k = 2e3 * np.pi / 0.532
    x, y = grid.x_mm[None, :], grid.y_mm[:, None]
    return np.exp(1j * k * (direction[0] * x + direction[1] * y + direction[2] * grid.z_mm))


def periodic_direction(grid: Grid, across: int, down: int) -> np.ndarray:
    """Of a wave that has whole periods on the grid, so that its transform is one sample."""
    width = grid.shape[0] * grid.pitch_mm
    x, y = 0.532e-3 * across / width, 0.532e-3 * down / width
    return np.array([x, y, math.sqrt(1.0 - x * x - y * y)])


@pytest.mark.parametrize("parameter", ["decenter_x_mm", "decenter_y_mm", "tilt_x_deg", "tilt_y_deg"])
def test_a_plane_wave_moves_as_its_sources_do(parameter: str) -> None:
    """The field at a point is what it was where that point came from."""
    grid = Grid((64, 64), 0.6e-3, 0.4)
    direction = periodic_direction(grid, 9, -5)
    mounting = Mounting(pivot_z_mm=0.15, decenter_x_mm=0.004)
    found = motion(Field(grid, plane_wave(grid, direction), 0.532), mounting, parameter)

    def moved(amount: float) -> np.ndarray:
        rotation, shift = mounting.with_values(
            [parameter], mounting.values_of([parameter]) + amount
        ).pose.transform()
        start_rotation, start_shift = mounting.pose.transform()
        r = np.stack(np.broadcast_arrays(grid.x_mm[None, :], grid.y_mm[:, None], grid.z_mm), axis=-1)
        own = (r - shift[0]) @ rotation[0]  # to the lens's frame as moved
        before = own @ start_rotation[0].T + start_shift[0]  # and to where that point was
        return np.exp(2e3j * np.pi / 0.532 * (before @ direction))

    step = 1e-6
    numeric = (moved(step) - moved(-step)) / (2.0 * step)
    assert np.linalg.norm(found - numeric) < 1e-6 * np.linalg.norm(numeric)
