"""Measurements for each unknown, counted on frames."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.reconstruction.oversampling import measured_oversampling, pixels_in_light
from wavesim.sensor.measurement import Measurement, recorded_intensity

OF_LENS = {"support_mm": 0.02, "numerical_aperture": 0.5, "wavelength_um": 0.532}


def noisy_plane(light: np.ndarray, seed: int = 0) -> Measurement:
    """Return a plane with Poisson noise, and read noise of 2 electrons."""
    random = np.random.default_rng(seed)
    counts = random.poisson(light) + 2.0 * random.standard_normal(light.shape)
    return recorded_intensity(0.0, counts, np.maximum(counts, 0.0) + 4.0)


def test_pixels_of_noise_alone_do_not_count() -> None:
    assert pixels_in_light(noisy_plane(np.zeros((600, 600)))) < 0.003 * 600**2


def test_pixels_in_the_light_count() -> None:
    """Also across the blocks of rows in which a plane is processed."""
    light = np.zeros((600, 300))
    light[200:500, 100:200] = 100.0
    counted = pixels_in_light(noisy_plane(light))
    # Pixels beside the light have three lit ones among their nine.
    assert 300 * 100 <= counted <= 302 * 102 + 0.003 * light.size


def test_saturated_pixels_do_not_count() -> None:
    plane = noisy_plane(np.full((50, 50), 100.0))
    assert plane.sigma is not None
    plane.sigma[:10] = np.inf
    assert pixels_in_light(plane) == 40 * 50


def test_the_ratio_is_that_of_pixels_to_unknowns_up_to_four_for_each_degree_of_freedom() -> None:
    degrees = (np.pi * 0.02 * 0.5 / (2 * 0.532e-3)) ** 2
    few, many = noisy_plane(np.full((30, 30), 100.0)), noisy_plane(np.full((90, 90), 100.0))
    found = measured_oversampling([few, many], (1.0, 2.0), kind="complex", **OF_LENS)
    assert found.unknowns == pytest.approx(2 * degrees)
    assert found.measurements_of_planes == pytest.approx((900.0, 4 * degrees))
    assert found.ratio == pytest.approx((900.0 + 4 * degrees) / (2 * degrees))
    amplitude = measured_oversampling([few], (1.0,), kind="amplitude", **OF_LENS)
    assert amplitude.ratio == pytest.approx(900.0 / degrees)


def test_planes_need_standard_deviations() -> None:
    with pytest.raises(InputError, match="sigma"):
        pixels_in_light(Measurement(0.0, np.ones((4, 4))))
