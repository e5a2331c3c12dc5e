"""Normalized errors of estimates on linear benches whose covariance is known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.calibration_errors import normalized_errors

PRIOR = np.array([2.0, 0.1, 5.0, 1.0, 0.5])


def estimated(
    random: np.random.Generator, slopes: np.ndarray, true: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Most probable values and their covariance, of data with unit noise."""
    data = slopes @ true + random.standard_normal(len(slopes))
    covariance = np.linalg.inv(slopes.T @ slopes + np.diag(PRIOR**-2.0))
    return covariance @ slopes.T @ data, covariance


@pytest.fixture
def slopes() -> np.ndarray:
    """Three well determined directions, a weak one, and one of which the data say next to nothing."""
    rotation = np.linalg.qr(np.random.default_rng(3).standard_normal((5, 5)))[0]
    return np.diag([30.0, 8.0, 4.0, 1.5, 0.01]) @ rotation / PRIOR


@pytest.mark.parametrize("share", [0.0, 1.0, 3.0])
def test_normalized_errors_have_unit_variance_for_every_true_value(slopes: np.ndarray, share: float) -> None:
    random = np.random.default_rng(0)
    found = []
    for _ in range(2000):
        true = share * PRIOR * random.standard_normal(5)
        found.append(normalized_errors(*estimated(random, slopes, true), PRIOR, true))
    assert np.shape(found) == (2000, 4)
    np.testing.assert_allclose(np.cov(np.transpose(found)), np.eye(4), atol=0.12)


def test_normalized_errors_of_single_parameters_are_too_small_where_the_truth_is_nominal(
    slopes: np.ndarray,
) -> None:
    random = np.random.default_rng(1)
    errors = []
    for _ in range(500):
        estimates, covariance = estimated(random, slopes, np.zeros(5))
        errors.append(estimates / np.sqrt(np.diag(covariance)))
    assert np.sqrt(np.mean(np.square(errors))) < 0.6


def test_wrong_covariances_show() -> None:
    random = np.random.default_rng(2)
    slopes = np.diag([30.0, 20.0, 10.0, 9.0, 8.0]) / PRIOR
    factors = []
    for factor in (0.25, 4.0):
        errors = []
        for _ in range(300):
            estimates, covariance = estimated(random, slopes, np.zeros(5))
            errors.append(normalized_errors(estimates, factor * covariance, PRIOR))
        factors.append(np.sqrt(np.mean(np.square(errors))))
    assert factors == pytest.approx([2.0, 0.5], rel=0.08)
