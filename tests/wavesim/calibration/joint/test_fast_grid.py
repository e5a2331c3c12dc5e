"""Room beside the pixels, where transforms would be slow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_twins import twin_scene

from wavesim.calibration.joint.fast_grid import with_fast_shape
from wavesim.fields.field import Grid
from wavesim.sensor.measurement import Measurement, noise_misfit


def test_pixels_stay_where_they_are_and_new_ones_tell_nothing() -> None:
    grid = Grid((438, 437), 3.2e-3, 0.7, (0.1, -0.2))
    scene = replace(twin_scene(60), exit_grid=grid)
    rng = np.random.default_rng(1)
    plane = Measurement(0.0, 1.0 + rng.random(grid.shape), 0.01 + 0.01 * rng.random(grid.shape))
    wider, (padded,) = with_fast_shape(scene, [plane])
    assert wider.exit_grid.shape == padded.amplitude.shape == (440, 440)
    assert wider.exit_grid.y_mm[1:-1] == pytest.approx(grid.y_mm)
    assert wider.exit_grid.x_mm[1:-2] == pytest.approx(grid.x_mm)
    assert np.array_equal(padded.amplitude[1:-1, 1:-2], plane.amplitude)
    assert padded.sigma is not None
    assert np.isfinite(padded.sigma).sum() == grid.shape[0] * grid.shape[1]
    assert noise_misfit([padded]) == pytest.approx(noise_misfit([plane]))


def test_what_is_fast_or_without_noise_stays() -> None:
    scene = replace(twin_scene(60), exit_grid=Grid((440, 440), 3.2e-3, 0.7))
    assert with_fast_shape(scene, [Measurement(0.0, np.ones((440, 440)), np.ones((440, 440)))])[0] is scene
    slow = replace(scene, exit_grid=Grid((438, 440), 3.2e-3, 0.7))
    assert with_fast_shape(slow, [Measurement(0.0, np.ones((438, 440)))])[0] is slow
