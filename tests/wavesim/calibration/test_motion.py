"""Motions of fields that go with those of the lens."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lensdesign import load_design
from lensdesign.lens.poses import Pose
from wavesim.calibration.motion import motion
from wavesim.calibration.parameters import Parameter, mounting_parameters
from wavesim.fields.field import Field, Grid
from wavesim.scene.system_state import SystemState


def plane_wave(grid: Grid, direction: np.ndarray) -> np.ndarray:
    k = 2e3 * np.pi / 0.532
    x, y = grid.x_mm[None, :], grid.y_mm[:, None]
    return np.exp(1j * k * (direction[0] * x + direction[1] * y + direction[2] * grid.z_mm))


def periodic_direction(grid: Grid, across: int, down: int) -> np.ndarray:
    """Of a wave that has whole periods on the grid, so that its transform is one sample."""
    width = grid.shape[0] * grid.pitch_mm
    x, y = 0.532e-3 * across / width, 0.532e-3 * down / width
    return np.array([x, y, math.sqrt(1.0 - x * x - y * y)])


POSE = mounting_parameters(load_design("designs/paper_singlet.toml"), 1)[:4]


@pytest.mark.parametrize("parameter", POSE, ids=lambda parameter: parameter.name)
def test_a_plane_wave_moves_as_its_sources_do(parameter: Parameter) -> None:
    """The field at a point is what it was where that point came from."""
    grid = Grid((64, 64), 0.6e-3, 0.4)
    direction = periodic_direction(grid, 9, -5)
    mounting = SystemState(Pose(pivot_z_mm=0.15, decenter_x_mm=0.004))
    found = motion(Field(grid, plane_wave(grid, direction), 0.532), mounting, parameter)

    def moved(amount: float) -> np.ndarray:
        there = parameter.set(mounting, parameter.value(mounting) + amount)
        rotation, shift = there.pose.transform()
        start_rotation, start_shift = mounting.pose.transform()
        r = np.stack(np.broadcast_arrays(grid.x_mm[None, :], grid.y_mm[:, None], grid.z_mm), axis=-1)
        own = (r - shift[0]) @ rotation[0]  # to the lens's frame as moved
        before = own @ start_rotation[0].T + start_shift[0]  # and to where that point was
        return np.exp(2e3j * np.pi / 0.532 * (before @ direction))

    step = 1e-6
    numeric = (moved(step) - moved(-step)) / (2.0 * step)
    assert np.linalg.norm(found - numeric) < 1e-6 * np.linalg.norm(numeric)
