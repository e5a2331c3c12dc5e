"""Residuals that are smaller than the stated noise, and the parameter that explains it."""

from __future__ import annotations

import numpy as np
import pytest

from wavesim.metrics.noise_parameters import noise_check
from wavesim.metrics.plane_residuals import PlaneResidual
from wavesim.sensor.measurement import recorded_intensity

SHAPE = (200, 150)
READ_NOISE = 2.0


def plane(
    stated_read_noise: float = READ_NOISE, gain: float = 1.0, smoothed: float = 1.0, seed: int = 0
) -> PlaneResidual:
    """Residuals of a perfect model, dark in one half; noise stated otherwise than it is."""
    random = np.random.default_rng(seed)
    electrons = np.where(np.arange(SHAPE[1]) < 75, 0.0, 900.0) * np.ones(SHAPE)
    seen = electrons + smoothed * np.sqrt(electrons + READ_NOISE**2) * random.standard_normal(SHAPE)
    stated = seen / gain
    variance = np.maximum(stated, 0.0) + stated_read_noise**2
    recorded = recorded_intensity(1.0, stated, variance)
    held = np.arange(0, recorded.amplitude.size, 20)
    assert recorded.sigma is not None
    sigma = recorded.sigma.ravel()[held]
    error = np.sqrt(electrons / gain) - recorded.amplitude
    return PlaneResidual(1.0, recorded.amplitude, recorded.sigma, error, held, sigma)


def test_noise_as_stated_is_not_too_small() -> None:
    found = noise_check([plane(), plane(seed=1)])
    assert found is not None
    assert found.ratio == pytest.approx(1.0, abs=0.05)
    assert not found.is_too_small
    assert found.explanation == ""


def test_noise_stated_too_small_is_not_this_finding() -> None:
    found = noise_check([plane(stated_read_noise=0.5)])
    assert found is not None
    assert not found.is_too_small


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (plane(stated_read_noise=8.0), "read noise 0.2"),
        (plane(gain=30.0), "A gain (electrons per count)"),
        (plane(smoothed=0.2), "Pictures that were smoothed"),
    ],
)
def test_noise_that_is_too_small_names_the_parameter(wrong: PlaneResidual, words: str) -> None:
    found = noise_check([wrong])
    assert found is not None
    assert found.is_too_small
    assert words in found.explanation


def test_the_gain_that_would_explain_it_is_stated() -> None:
    found = noise_check([plane(gain=30.0)])
    assert found is not None
    assert found.bright_ratio is not None
    assert found.bright_ratio**-2 == pytest.approx(30.0, rel=0.2)


def several_exposures(gain: float, seed: int) -> PlaneResidual:
    """Residuals of a perfect model; a few pixels are only known from an exposure a thousand times shorter."""
    random = np.random.default_rng(seed)
    electrons = np.full(SHAPE, 1e5)
    exposures = np.full(SHAPE, 1e3)
    bright = np.unravel_index(np.arange(0, electrons.size, 2000), SHAPE)
    electrons[bright], exposures[bright] = 1e8, 1.0
    seen = random.poisson(electrons * exposures * 1e-3) / gain
    recorded = recorded_intensity(1.0, seen / exposures, seen / exposures**2)
    assert recorded.sigma is not None
    held = np.arange(0, electrons.size, 20)
    error = np.sqrt(1e-3 * electrons / gain) - recorded.amplitude
    return PlaneResidual(1.0, recorded.amplitude, recorded.sigma, error, held, recorded.sigma.ravel()[held])


@pytest.mark.parametrize("seed", range(20))
def test_a_few_bright_pixels_do_not_decide_alone(seed: int) -> None:
    """Fifteen held-out pixels have nearly all of the noise of the others together."""
    found = noise_check([several_exposures(1.0, seed)])
    assert found is not None
    assert not found.is_too_small


def test_a_wrong_gain_shows_in_several_exposures() -> None:
    found = noise_check([several_exposures(30.0, 0)])
    assert found is not None
    assert found.is_too_small


def test_few_pixels_say_nothing() -> None:
    some = plane()
    assert noise_check([some._replace(held=some.held[:20], held_sigma=some.held_sigma[:20])]) is None
