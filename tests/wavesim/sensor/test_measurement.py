"""Amplitudes and weights of recorded intensities."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign.errors import InputError
from wavesim.scene.system_state import SystemState
from wavesim.sensor.measurement import (
    Measurement,
    amplitude_bias,
    intensity_deviation,
    noise_misfit,
    placed_planes,
    recorded_intensity,
    weights_of,
)


def test_amplitudes_of_an_estimated_intensity() -> None:
    """Bright pixels: half the intensity's deviation over the amplitude. Dark ones: what noise leaves."""
    rng = np.random.default_rng(6)
    for intensity, deviation in ((400.0, 3.0), (0.0, 2.0)):
        drawn = intensity + deviation * rng.standard_normal(200_000)
        made = recorded_intensity(0.5, drawn, np.full(drawn.shape, deviation**2))
        error = np.sqrt(np.mean((made.amplitude - np.sqrt(intensity)) ** 2))
        at_truth = recorded_intensity(0.5, np.array([intensity]), np.array([deviation**2]))
        assert at_truth.sigma is not None
        assert at_truth.sigma[0] == pytest.approx(error, rel=0.03)
    saturated = recorded_intensity(0.5, np.array([4.0, 9.0]), np.array([1.0, np.inf]))
    assert saturated.sigma is not None
    assert saturated.known is not None
    np.testing.assert_array_equal(saturated.known, [True, False])
    np.testing.assert_allclose(saturated.amplitude, [2.0, 3.0])
    assert saturated.sigma[0] == pytest.approx(0.25)


@given(intensity=st.floats(-10.0, 1e6), deviation=st.floats(1e-3, 1e3))
def test_the_deviation_of_an_intensity_follows_from_its_amplitude(intensity: float, deviation: float) -> None:
    made = recorded_intensity(0.5, np.array([intensity]), np.array([deviation**2]))
    np.testing.assert_allclose(intensity_deviation(made), deviation, rtol=1e-6)


def test_weights_are_relative_to_the_brightest_pixel_and_none_exceeds_1() -> None:
    planes = [
        # The brightest is clipped, the faintest known far better than the brightest that is not.
        Measurement(0.0, np.array([9.0, 4.0, 2.0, 0.5]), np.array([np.inf, 0.5, 1.0, 0.01])),
        Measurement(1.0, np.array([3.0, 1.0]), np.array([2.0, np.inf])),
        Measurement(2.0, np.ones(2)),
    ]
    first, second, third = weights_of(planes)
    assert first is not None
    assert second is not None
    assert third is None
    np.testing.assert_allclose(first, [0.0, 1.0, 0.25, 1.0])
    np.testing.assert_allclose(second, [0.0625, 0.0])


def test_the_misfit_of_noise_is_what_noise_leaves() -> None:
    rng = np.random.default_rng(0)
    amplitude = rng.uniform(1.0, 2.0, (200, 200))
    sigma = np.full(amplitude.shape, 0.05)
    noisy = amplitude + sigma * rng.standard_normal(amplitude.shape)
    left = np.linalg.norm(noisy - amplitude) / np.linalg.norm(noisy)
    assert noise_misfit([Measurement(0.0, noisy, sigma)]) == pytest.approx(left, rel=0.02)
    assert noise_misfit([Measurement(0.0, noisy)]) is None


def test_planes_are_placed_with_the_light_of_a_linear_camera_and_the_true_exposure() -> None:
    amplitude = np.sqrt(np.array([[100.0, 400.0], [0.0, 900.0]]))
    plane = Measurement(1.0, amplitude, np.ones((2, 2)), fraction_per_intensity=np.full((2, 2), 1e-3))
    state = SystemState(plane_exposure_errors=(0.0, 0.25), nonlinearity=0.1, plane_backgrounds=(0.0, 0.5))
    placed = placed_planes([plane, plane], state)[1]
    expected = np.array([[100.0 * 1.01, 400.0 * 1.04], [0.0, 900.0 * 1.09]]) / 1.25
    assert placed.amplitude**2 == pytest.approx(expected)
    assert placed.sigma == pytest.approx(np.sqrt(np.array([[1.01, 1.04], [1.0, 1.09]]) / 1.25))
    assert placed.background == pytest.approx(np.full((2, 2), 0.5 * expected.mean()))
    with pytest.raises(InputError, match="nonlinearity"):
        placed_planes([replace(plane, fraction_per_intensity=None)], state)


def test_an_intensity_without_a_usable_variance_is_refused() -> None:
    for variance in (np.zeros(3), np.ones(4), np.full(3, np.nan)):
        with pytest.raises(InputError, match="variance"):
            recorded_intensity(0.0, np.ones(3), variance)


@pytest.mark.parametrize("level", [0.0, 0.3, 2.0, 14.9, 15.1, 60.0])
def test_the_bias_of_an_amplitude_is_that_of_the_root_of_noisy_intensities(level: float) -> None:
    """Against the integral over normal noise; level: intensity over its standard deviation."""
    deviation = 3.0
    noise = np.linspace(-9.0, 9.0, 200_001)
    density = np.exp(-0.5 * noise**2)
    mean = np.sum(density * np.sqrt(np.maximum(level + noise, 0.0))) / np.sum(density)
    expected = np.sqrt(deviation) * (mean - np.sqrt(level))
    plane = recorded_intensity(0.0, np.array([[level * deviation]]), np.array([[deviation**2]]))
    found = amplitude_bias(plane, np.sqrt([[level * deviation]]))
    assert found[0, 0] == pytest.approx(expected, rel=1e-2, abs=1e-5)


@pytest.mark.filterwarnings("error")
def test_unknown_pixels_have_no_bias() -> None:
    plane = recorded_intensity(0.0, np.array([[4.0, 4.0, 0.0]]), np.array([[1.0, np.inf, np.inf]]))
    assert amplitude_bias(plane, np.full((1, 3), 2.0))[0, 1:] == pytest.approx(0.0)
