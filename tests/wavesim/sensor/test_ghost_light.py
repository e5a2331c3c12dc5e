"""Ghosts in simulated frames: smooth light, fringes, and settings that contradict each other."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import CoverGlass, InputError, Pose, load_design, scaled
from lensdesign.analysis.ghost_maps import ghost_maps
from wavesim import Field, image
from wavesim.scene.system_state import SystemState
from wavesim.sensor.ghost_light import ghost_light

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
SETTINGS = {"patch_mm": 0.03, "planes_mm": (0.0625,), "engine": "eikonal", "error": 0.1, "noise": False}


def glazed(coating="bare", reflectance=0.3):
    glass = CoverGlass(thickness_mm=0.02, material=1.52, distance_mm=0.02)
    sensor = LENS.sensor.replaced(cover_glass=glass, reflectance=reflectance)
    return LENS.replaced(sensor=sensor).with_coating(coating)


def counts(lens, **changes):
    (frame,) = image(lens, "star", **SETTINGS, **changes).frames
    return frame.counts.astype(float) - frame.settings.offset_counts


def test_smooth_light_is_that_of_the_maps():
    lens = glazed()
    taken = image(lens, "star", **SETTINGS)
    grid = taken.target.transmission.grid
    light = Field(grid, np.asarray(taken.target.transmission.values, complex), taken.patch.wavelength_um)
    found = ghost_light(lens, light, taken.sensor, 0.0625)
    assert found.shape == taken.frames[0].counts.shape
    power = np.abs(light.values) ** 2
    y, x = np.meshgrid(grid.y_mm, grid.x_mm, indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel()])
    maps = ghost_maps(lens, points, power.ravel(), 0.0625, taken.sensor.size_mm)
    assert found.sum() == pytest.approx(sum(one.power for one in maps), rel=0.1)
    with pytest.raises(InputError, match="the object is dark"):
        ghost_light(lens, light.with_values(0.0 * light.values), taken.sensor, 0.0625)


def test_frames_contain_smooth_ghosts():
    lens = glazed()
    fine = {"bits": 16, "full_well_electrons": 1e6}
    without, smooth = counts(lens, **fine), counts(lens, ghosts="incoherent", **fine)
    # Both are scaled to the same brightest pixel, which ghosts hardly change.
    added = smooth / smooth.max() - without / without.max()
    taken = image(lens, "star", **SETTINGS)
    values = np.asarray(taken.target.transmission.values, complex)
    light = Field(taken.patch.grid, values, taken.patch.wavelength_um)
    expected = ghost_light(lens, light, taken.sensor, 0.0625).sum()
    assert added.sum() / (without.sum() / without.max()) == pytest.approx(expected, rel=0.1)
    assert added.min() > -1e-4


def test_frames_contain_fringes_of_coated_ghosts():
    bare = LENS.with_coating("bare")
    without, fringes = counts(bare), counts(bare, ghosts="coherent")
    change = fringes * (without.sum() / fringes.sum()) - without
    contrast = np.sqrt(np.mean(change**2) / np.mean(without**2))
    assert 0.005 < contrast < 0.2
    weaker = LENS.with_coating("mgf2")
    again = counts(weaker, ghosts="coherent")
    other = counts(weaker)
    rest = again * (other.sum() / again.sum()) - other
    assert np.sqrt(np.mean(rest**2)) < 0.7 * np.sqrt(np.mean(change**2))


def test_ghosts_need_surfaces_that_reflect():
    with pytest.raises(InputError, match="ideal coatings reflect no light"):
        counts(LENS, ghosts="coherent")
    with pytest.raises(InputError, match="both given"):
        counts(LENS.with_coating("bare"), ghosts="coherent", ghost=0.001)


def test_smooth_ghosts_move_with_lens_and_sensor():
    """A decentered lens moves its ghost; the pixels of a displaced sensor see the light displaced."""
    lens = LENS.with_coating("bare")
    sensor = lens.sensor.replaced(pixels=(200, 200))
    taken = image(LENS, "star", **SETTINGS)
    light = Field(taken.patch.grid, np.ones(taken.patch.grid.shape, complex), taken.patch.wavelength_um)
    x = np.arange(200) - 99.5

    def middle(state):
        found = ghost_light(lens, light, sensor, 0.0625, state=state)
        return float((found.sum(axis=0) * x).sum() / found.sum())

    nominal = middle(SystemState())
    assert abs(nominal) < 1.0
    assert abs(middle(SystemState(pose=Pose(decenter_x_mm=0.03))) - nominal) > 1.0
    moved = ghost_light(lens, light, sensor, 0.0625, state=SystemState(sensor_shift_mm=(0.064, 0.0, 0.0)))
    straight = ghost_light(lens, light, sensor, 0.0625)
    # 20 pixels of 3.2 um; maps have cells of 4 pixels.
    inner = moved[40:160, 40:140], straight[40:160, 60:160]
    assert np.abs(inner[0] - inner[1]).mean() < 0.25 * inner[1].mean()
