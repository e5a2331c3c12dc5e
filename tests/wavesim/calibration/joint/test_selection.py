"""Parameters that frames do not need return to their nominal values."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from wavesim.calibration.joint.selection import Selection, count_not_needed, eliminated_in_turn


def select_parameters(estimates: np.ndarray, covariance: np.ndarray, pixels: int) -> Selection:
    """The parameters that are needed."""
    selections = eliminated_in_turn(estimates, covariance)
    return selections[count_not_needed(selections, covariance, pixels)]


def test_parameters_are_eliminated_one_by_one_and_the_others_fit_best_without_them() -> None:
    rng = np.random.default_rng(1)
    root = rng.standard_normal((6, 6))
    covariance, estimates = root @ root.T + 0.1 * np.eye(6), 5.0 * rng.standard_normal(6)
    precision = np.linalg.inv(covariance)
    selections = eliminated_in_turn(estimates, covariance)
    assert [int(one.needed.sum()) for one in selections] == [6, 5, 4, 3, 2, 1, 0]
    assert selections[0].values == pytest.approx(estimates)
    misfits = [(one.values - estimates) @ precision @ (one.values - estimates) for one in selections]
    assert np.all(np.diff(misfits) > 0.0)
    for before, one in itertools.pairwise(selections):
        assert not one.values[~one.needed].any()
        assert np.all(before.needed[one.needed])
        gradient = precision @ (one.values - estimates)
        assert gradient[one.needed] == pytest.approx(0.0, abs=1e-9 * np.abs(precision @ estimates).max())


def test_what_noise_makes_is_not_needed() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((12, 12))
    covariance = root @ root.T + np.eye(12)
    estimates = rng.multivariate_normal(np.zeros(12), covariance)
    found = select_parameters(estimates, covariance, 40_000)
    assert not found.needed.any()
    assert not found.values.any()


def test_what_differs_is_kept_and_the_others_are_not() -> None:
    estimates, covariance = np.array([20.0, 0.5, -1.0]), np.eye(3)
    found = select_parameters(estimates, covariance, 40_000)
    assert found.needed.tolist() == [True, False, False]
    assert found.values == pytest.approx([20.0, 0.0, 0.0])


def test_of_two_that_are_not_told_apart_one_takes_on_what_both_do() -> None:
    """Only the sum of two is measured well: it must not be lost with one of them."""
    covariance = np.linalg.inv(np.array([[100.0, 100.0], [100.0, 100.0]]) + 0.01 * np.eye(2))
    found = select_parameters(np.array([1.0, 1.0]), covariance, 1000)
    assert found.needed.sum() == 1
    assert found.values.sum() == pytest.approx(2.0, rel=1e-3)
