"""Searches for a few parameters."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign.errors import SamplingError
from wavesim.calibration.trust_region import GaussNewton, curvature_directions

SEEDS = st.integers(0, 2**31)


def valley(seed: int, n: int = 3, stiffness: float = 30.0) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of a linear model whose directions differ in stiffness, and where its residual vanishes."""
    rng = np.random.default_rng(seed)
    turned, _ = np.linalg.qr(rng.standard_normal((n, n)))
    across, _ = np.linalg.qr(rng.standard_normal((40, n)))
    jacobian = (across * np.geomspace(1.0, stiffness, n)) @ turned
    return jacobian.T, rng.uniform(-0.5, 0.5, n)


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_stiff_directions_make_the_curvature_diagonal(seed: int) -> None:
    jacobian, _ = valley(seed)
    search_range = np.array([1.0, 0.1, 10.0])
    directions, curvatures = curvature_directions(jacobian, search_range)
    found = directions.T @ jacobian @ jacobian.T @ directions
    assert found == pytest.approx(np.diag(np.diag(found)), abs=1e-9 * curvatures.max())
    assert np.linalg.norm(directions / search_range[:, None], axis=0) == pytest.approx(np.ones(3))
    assert curvatures.max() / curvatures.min() <= 1e3 * (1.0 + 1e-9)


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_gauss_newton_solves_a_linear_model(seed: int) -> None:
    jacobian, truth = valley(seed)
    found = GaussNewton(lambda p: ((truth - p) @ jacobian, jacobian), np.zeros(3), np.ones(3)).run(1e-12, 60)
    assert found.point == pytest.approx(truth, abs=1e-4)
    assert found.stopped_because == "converged"


def test_gauss_newton_stays_within_its_reach() -> None:
    jacobian, _ = valley(3)
    outside = np.array([0.2, 2.0, -0.1])
    found = GaussNewton(lambda p: ((outside - p) @ jacobian, jacobian), np.zeros(3), np.ones(3)).run(1e-9, 60)
    assert np.all(np.abs(found.point) <= 1.0 + 1e-5)
    # The lowest point of the box is known to be where no feasible small step helps.
    curvature = jacobian @ jacobian.T
    down = curvature @ (outside - found.point)
    inner = np.abs(found.point) < 0.999
    assert np.abs(down[inner]) == pytest.approx(np.zeros(inner.sum()), abs=1e-2 * np.abs(down).max())


def test_gauss_newton_goes_around_points_where_the_model_fails() -> None:
    jacobian, truth = valley(5)
    asked = []

    def model(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append(point)
        if len(asked) in (2, 3):
            raise SamplingError("no light")
        return (truth - point) @ jacobian, jacobian

    assert GaussNewton(model, np.zeros(3), np.ones(3)).run(1e-12, 60).point == pytest.approx(truth, abs=1e-4)
