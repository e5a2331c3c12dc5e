"""Pixels that are not alike: spreads as stated, one pattern for all frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lensdesign.errors import InputError
from lensdesign.lens.lens import Sensor
from wavesim.sensor.camera_noise import Electronics
from wavesim.sensor.merged_exposures import estimate_intensity
from wavesim.sensor.pixels.non_uniformity import ALIKE, PixelErrors
from wavesim.sensor.sensor import Camera

SHAPE = (200, 300)


def test_pixels_that_are_alike_have_no_pattern() -> None:
    assert ALIKE.pattern(SHAPE, 1e4) is None


def test_spreads_and_shares_are_those_stated() -> None:
    pattern = PixelErrors(0.02, 3.0, hot_share=0.01, dead_share=0.02, seed=4).pattern(SHAPE, 1e4)
    assert pattern is not None
    dead, hot = pattern.gain == 0.0, pattern.dark_electrons >= 1e3
    assert float(dead.mean()) == pytest.approx(0.02, rel=0.2)
    assert float(hot.mean()) == pytest.approx(0.01, rel=0.2)
    usual = ~(dead | hot)
    assert float(pattern.gain[usual].std()) == pytest.approx(0.02, rel=0.02)
    assert float(pattern.dark_electrons[usual].std()) == pytest.approx(3.0, rel=0.02)


def test_all_frames_show_one_pattern() -> None:
    """Without noise, gain and dark signal follow from two frames of even light."""
    errors = PixelErrors(prnu=0.03, dsnu_electrons=20.0, seed=1)
    pattern = errors.pattern(SHAPE, 1e4)
    assert pattern is not None
    sensor = Sensor(pixel_pitch_um=3.0, pixels=SHAPE[::-1], plane_distances_mm=(1.0,))
    camera = Camera(sensor, Electronics(bits=16), (0.5, 1.0), pixel_errors=errors)
    frames = camera.frames(np.ones(SHAPE), 1.0, 0.5, None)
    short, long = (estimate_intensity(frame)[0] * frame.settings.exposure for frame in frames)
    step = frames[0].settings.gain_electrons_per_count
    np.testing.assert_allclose(long - short, 4000.0 * pattern.gain, atol=2.0 * step)
    np.testing.assert_allclose(2.0 * short - long, pattern.dark_electrons, atol=3.0 * step)


def test_longer_exposures_than_stated_are_brighter_by_as_much() -> None:
    sensor = Sensor(pixel_pitch_um=3.0, pixels=SHAPE[::-1], plane_distances_mm=(1.0,))
    camera = Camera(sensor, Electronics(), (0.5, 1.0))
    stated = camera.frames(np.ones(SHAPE), 1.0, 0.5, None)
    true = replace(camera, exposure_errors=(0.0, 0.1)).frames(np.ones(SHAPE), 1.0, 0.5, None)
    ratios = [
        float((estimate_intensity(b)[0] / estimate_intensity(a)[0]).mean())
        for a, b in zip(stated, true, strict=True)
    ]
    assert [a.settings for a in stated] == [b.settings for b in true]
    assert ratios == pytest.approx([1.0, 1.1], abs=1e-3)


@pytest.mark.parametrize("nonlinearity", [0.08, -0.08])
def test_stating_the_nonlinearity_gives_the_light(nonlinearity: float) -> None:
    sensor = Sensor(pixel_pitch_um=3.0, pixels=SHAPE[::-1], plane_distances_mm=(1.0,))
    light = np.tile(np.linspace(0.0, 1.0, SHAPE[1]), (SHAPE[0], 1))
    camera = Camera(sensor, Electronics(bits=16), pixel_errors=PixelErrors(nonlinearity=nonlinearity))
    (frame,) = camera.frames(light, 1.0, 0.5, None)
    recorded = estimate_intensity(frame)[0]
    # The brightest pixel fills 80 % of the full well.
    assert recorded[0, -1] == pytest.approx(1.0 - 0.8 * nonlinearity, abs=0.01)
    stated = replace(frame, settings=frame.settings.replaced(nonlinearity=nonlinearity))
    np.testing.assert_allclose(estimate_intensity(stated)[0], light, atol=1e-4)


def test_what_cannot_be_is_refused() -> None:
    for wrong in ({"prnu": 1.0}, {"dsnu_electrons": -1.0}, {"hot_share": 0.6, "dead_share": 0.5}):
        with pytest.raises(InputError, match="must be"):
            PixelErrors(**wrong)
