"""Amplitudes at points from all pixels around them."""

from __future__ import annotations

import numpy as np
import pytest

from wavesim.sensor.frames import Frame, FrameSettings
from wavesim.sensor.pixels.points import point_weights, points_among, recorded_points


def frame(electrons: np.ndarray) -> Frame:
    settings = FrameSettings(
        pixel_pitch_um=2.0,
        wavelength_um=0.532,
        plane_distance_mm=2.0,
        exposure=1.0,
        bits=16,
        offset_counts=100.0,
        gain_electrons_per_count=1.0,
        read_noise_electrons=2.0,
    )
    return Frame(np.round(electrons + 100.0).astype(np.uint16), settings)


def fringes(x: np.ndarray, y: np.ndarray, period: float) -> np.ndarray:
    return 20000.0 + 9000.0 * np.cos(2.0 * np.pi * (0.8 * x + 0.6 * y) / period + 0.3)


@pytest.mark.parametrize("apart", [2, 3, 5])
def test_points_have_the_light_that_falls_there_and_not_the_mean_over_a_pixel(apart: int) -> None:
    """Fringes as fine as may be: points are 0.6 of a period apart."""
    period = apart / 0.6
    y, x = np.mgrid[:90, :80].astype(float)
    # The exact mean over the square pixel.
    means = 20000.0 + (fringes(x, y, period) - 20000.0) * np.sinc(0.8 / period) * np.sinc(0.6 / period)
    found = recorded_points([frame(means)], 0.0, apart, 1.0)
    down, across = points_among(90, apart), points_among(80, apart)
    true = fringes(x, y, period)[down, across]
    assert found.amplitude.shape == true.shape
    # 0.09 of 9000 electrons at the finest.
    assert np.max(np.abs(found.amplitude**2 - true)) < 1000.0
    wide = recorded_points([frame(20000.0 + 0.0 * x)], 0.0, apart, 1.0)
    assert np.allclose(wide.amplitude**2, 20000.0, rtol=1e-4)


@pytest.mark.parametrize("apart", [2, 4])
def test_deviations_are_those_of_the_noise(apart: int) -> None:
    rng = np.random.default_rng(1)
    found = recorded_points([frame(rng.poisson(5000.0, (200, 200)))], 0.0, apart, 1.0)
    assert found.sigma is not None
    ratio = np.std(found.amplitude) / np.mean(found.sigma)
    assert ratio == pytest.approx(1.0, abs=0.06)
    assert np.sum(point_weights(apart, 1.0)) == pytest.approx(1.0, abs=1e-6)


def test_points_near_clipped_pixels_are_not_known() -> None:
    light = np.full((40, 40), 3000.0)
    light[20, 20] = 60000.0
    bright = np.minimum(light + 6000.0, 65400.0)
    bright[20, 20] = 65435.0
    found = recorded_points([frame(bright)], 0.0, 4, 1.0)
    down, across = points_among(40, 4), points_among(40, 4)
    rows, columns = np.arange(40)[down], np.arange(40)[across]
    near = (np.abs(rows - 20)[:, None] <= 4) & (np.abs(columns - 20) <= 4)
    assert found.sigma is not None
    assert np.array_equal(np.isinf(found.sigma), near)
    assert near.any()
