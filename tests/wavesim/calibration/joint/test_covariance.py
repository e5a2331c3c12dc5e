"""Variance of residuals, and the background that clipped noise imitates."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from wavesim.calibration.joint.covariance import background_of_clipping, residual_variance
from wavesim.calibration.parameters import Parameter
from wavesim.metrics.goodness_of_fit import MODEL_ERROR


def test_more_pixels_do_not_reduce_the_variance_below_that_of_model_errors() -> None:
    few, many = (residual_variance(0.1, pixels) for pixels in (100, 10**9))
    assert few - many == pytest.approx(1e-4, rel=1e-3)
    assert many == pytest.approx(MODEL_ERROR**2 / 60, rel=1e-3)


def test_clipped_noise_adds_to_backgrounds_of_planes_with_noise_alone() -> None:
    parameters = [Parameter("decenter_x_mm", "mounting", 1.0)]
    parameters += [Parameter(f"plane_{n}_background", "camera", 1.0) for n in (1, 2)]
    amplitude = np.array([0.0, 1.0, 1.0])
    planes: list[Any] = [
        SimpleNamespace(amplitude=amplitude, sigma=np.full(3, 0.1)),
        SimpleNamespace(amplitude=amplitude, sigma=None),
    ]
    nothing, background, unknown = background_of_clipping(parameters, planes)
    assert nothing == unknown == 0.0 < background
    planes[0].sigma = np.full(3, 0.2)
    assert background_of_clipping(parameters, planes)[1] == pytest.approx(4.0 * background)
