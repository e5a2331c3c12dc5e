"""Hot and dead pixels found in frames, and none where all are well."""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy.ndimage

from lensdesign.lens.lens import Sensor
from wavesim.sensor.camera_noise import Electronics
from wavesim.sensor.frames import Frame
from wavesim.sensor.pixels.bad_pixels import find_bad_pixels
from wavesim.sensor.pixels.non_uniformity import ALIKE, PixelErrors
from wavesim.sensor.sensor import Camera

SHAPE = (120, 160)


@cache
def light(seed: int) -> np.ndarray:
    """Speckle about two pixels wide, as pixels average it, bright in the middle: rough as light gets."""
    random = np.random.default_rng(seed)
    fine = 3 * SHAPE[0], 3 * SHAPE[1]
    field = random.standard_normal(fine) + 1j * random.standard_normal(fine)
    intensity = np.abs(scipy.ndimage.gaussian_filter(field, 3.0)) ** 2
    means = intensity.reshape(SHAPE[0], 3, SHAPE[1], 3).mean(axis=(1, 3))
    y, x = np.ogrid[: SHAPE[0], : SHAPE[1]]
    return np.asarray(means * np.exp(-((x - 80) ** 2 + (y - 60) ** 2) / 1500.0))


def planes(errors: PixelErrors, exposures: tuple[float, ...], count: int = 2) -> list[tuple[Frame, ...]]:
    sensor = Sensor(pixel_pitch_um=3.0, pixels=SHAPE[::-1], plane_distances_mm=(1.0,))
    camera = Camera(sensor, Electronics(), exposures, pixel_errors=errors)
    return [camera.frames(light(n), 1.0 + n, 0.5, n) for n in range(count)]


def test_nothing_is_found_where_all_is_well() -> None:
    for errors in (ALIKE, PixelErrors(prnu=0.01, dsnu_electrons=2.0)):
        for times in ((1.0,), (1.0, 30.0)):
            assert not any(mask.any() for mask in find_bad_pixels(planes(errors, times)))
    assert not find_bad_pixels(planes(ALIKE, (1.0,), 1))[0].any()


def test_hot_pixels_are_found_and_dead_ones_where_there_is_light() -> None:
    errors = PixelErrors(hot_share=2e-3, dead_share=2e-3, seed=3)
    pattern = errors.pattern(SHAPE, 1e4)
    assert pattern is not None
    hot, dead = pattern.dark_electrons > 0.0, pattern.gain == 0.0
    ring = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], bool)
    bright = scipy.ndimage.minimum_filter(light(0), footprint=ring) > 0.3 * light(0).max()
    for times in ((1.0,), (1.0, 30.0)):
        for mask in find_bad_pixels(planes(errors, times)):
            assert not np.any(mask & ~(hot | dead))
            assert np.count_nonzero(mask & hot) > 0.7 * np.count_nonzero(hot)
            assert np.all(mask[dead & bright])


def test_where_much_contradicts_it_is_no_matter_of_pixels() -> None:
    """Two pictures in the place of two exposures."""
    (short, _), (_, long) = planes(ALIKE, (1.0, 2.0))
    assert not find_bad_pixels([[short, long]])[0].any()
