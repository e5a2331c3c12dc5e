"""Covariance of estimates against the scatter of estimates from many draws of noise."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lensdesign import load_design
from wavesim.calibration.joint.covariance import (
    background_of_clipping,
    covariance_of_estimates,
    residual_variance,
)
from wavesim.calibration.parameters import bench_parameters, chosen_parameters
from wavesim.metrics.goodness_of_fit import MODEL_ERROR

PARAMETERS, PIXELS = 3, 400

BENCH = bench_parameters(load_design("designs/paper_singlet.toml"), 2, 1.0, 0.5)
NO_PARAMETERS = chosen_parameters("surface_1_index", BENCH) * PARAMETERS
"""Parameters that are no backgrounds."""


class Linear:
    """Residuals with the variances of a few very noisy pixels, and of many precise ones."""

    def __init__(self, variances: NDArray[Any] | None) -> None:
        self.variances, self.misfit = variances, 1e-6

    def residual_variances(self, model_error: float) -> NDArray[Any] | None:
        return self.variances


class Equations:
    """Normal equations."""

    def __init__(self, columns: NDArray[Any], typical: NDArray[Any], variance: float, linear: Linear) -> None:
        self.columns, self.linear, self.variance = columns, linear, variance
        self.prior_precision = variance / typical**2


def test_more_pixels_do_not_reduce_the_variance_below_that_of_model_errors() -> None:
    few, many = (residual_variance(0.1, pixels) for pixels in (100, 10**9))
    assert few - many == pytest.approx(1e-4, rel=1e-3)
    assert many == pytest.approx(MODEL_ERROR**2 / 60, rel=1e-3)


def test_the_covariance_is_that_of_estimates_whatever_the_variances_of_the_pixels() -> None:
    rng = np.random.default_rng(3)
    columns, typical = rng.standard_normal((PARAMETERS, PIXELS)), np.array([1.0, 0.1, 0.02])
    variances = np.where(np.arange(PIXELS) % 20 == 0, 1.0, 0.01)
    equations: Any = Equations(columns, typical, 0.05, Linear(variances))
    normal = columns @ columns.T + np.diag(equations.prior_precision)
    draws = 20_000
    true = typical * rng.standard_normal((draws, PARAMETERS))
    residuals = true @ columns + np.sqrt(variances) * rng.standard_normal((draws, PIXELS))
    errors = np.linalg.solve(normal, columns @ residuals.T).T - true
    found = covariance_of_estimates(equations, NO_PARAMETERS, (), columns)
    assert found == pytest.approx(np.cov(errors.T), rel=0.1, abs=0.02 * np.abs(found).max())


def test_residuals_beyond_the_noise_widen_the_covariance() -> None:
    columns, typical = (
        np.random.default_rng(4).standard_normal((PARAMETERS, PIXELS)),
        np.full(PARAMETERS, 1e3),
    )
    linear = Linear(np.full(PIXELS, 0.01))
    equations: Any = Equations(columns, typical, 0.01, linear)
    alone = covariance_of_estimates(equations, NO_PARAMETERS, (), columns)
    linear.misfit = np.sqrt(0.01 * PIXELS + 20.0 * 60 * 0.01)
    assert covariance_of_estimates(equations, NO_PARAMETERS, (), columns) == pytest.approx(
        21.0 * alone, rel=1e-3
    )


def test_without_standard_deviations_the_residuals_are_the_evidence() -> None:
    columns, typical = np.random.default_rng(5).standard_normal((PARAMETERS, PIXELS)), np.ones(PARAMETERS)
    equations: Any = Equations(columns, typical, 0.03, Linear(None))
    expected = 0.03 * np.linalg.inv(columns @ columns.T + 0.03 * np.eye(PARAMETERS))
    assert covariance_of_estimates(equations, NO_PARAMETERS, (), columns) == pytest.approx(expected)


def test_clipped_noise_adds_to_backgrounds_of_planes_with_noise_alone() -> None:
    parameters = chosen_parameters("plane_1_background,plane_2_background,decenter_x_mm", BENCH)
    amplitude = np.array([0.0, 1.0, 1.0])
    planes: list[Any] = [
        SimpleNamespace(amplitude=amplitude, sigma=np.full(3, 0.1)),
        SimpleNamespace(amplitude=amplitude, sigma=None),
    ]
    background, unknown, nothing = background_of_clipping(parameters, planes)
    assert nothing == unknown == 0.0 < background
    planes[0].sigma = np.full(3, 0.2)
    assert background_of_clipping(parameters, planes)[0] == pytest.approx(4.0 * background)
