"""Searches for a few parameters."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign.errors import SamplingError
from wavesim.calibration.gauss_newton import GaussNewton, stiff_directions

SEEDS = st.integers(0, 2**31)


def valley(seed: int, n: int = 3, stiffness: float = 30.0) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of a linear model whose directions differ in stiffness, and where its residual vanishes."""
    rng = np.random.default_rng(seed)
    turned, _ = np.linalg.qr(rng.standard_normal((n, n)))
    across, _ = np.linalg.qr(rng.standard_normal((40, n)))
    slopes = (across * np.geomspace(1.0, stiffness, n)) @ turned
    return slopes.T, rng.uniform(-0.5, 0.5, n)


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_stiff_directions_make_the_curvature_diagonal(seed: int) -> None:
    slopes, _ = valley(seed)
    reach = np.array([1.0, 0.1, 10.0])
    directions, curvatures = stiff_directions(slopes, reach)
    found = directions.T @ slopes @ slopes.T @ directions
    assert found == pytest.approx(np.diag(np.diag(found)), abs=1e-9 * curvatures.max())
    assert np.linalg.norm(directions / reach[:, None], axis=0) == pytest.approx(np.ones(3))
    assert curvatures.max() / curvatures.min() <= 1e3 * (1.0 + 1e-9)


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_gauss_newton_solves_a_linear_model(seed: int) -> None:
    slopes, truth = valley(seed)
    found = GaussNewton(lambda p: ((truth - p) @ slopes, slopes), np.zeros(3), np.ones(3)).run(1e-12, 60)
    assert found.point == pytest.approx(truth, abs=1e-4)
    assert found.stopped_because == "converged"


def test_gauss_newton_stays_within_its_reach() -> None:
    slopes, _ = valley(3)
    outside = np.array([0.2, 2.0, -0.1])
    found = GaussNewton(lambda p: ((outside - p) @ slopes, slopes), np.zeros(3), np.ones(3)).run(1e-9, 60)
    assert np.all(np.abs(found.point) <= 1.0 + 1e-5)
    # The lowest point of the box is known to be where no feasible small step helps.
    curvature = slopes @ slopes.T
    down = curvature @ (outside - found.point)
    inner = np.abs(found.point) < 0.999
    assert np.abs(down[inner]) == pytest.approx(np.zeros(inner.sum()), abs=1e-2 * np.abs(down).max())


def test_gauss_newton_goes_around_points_where_the_model_fails() -> None:
    slopes, truth = valley(5)
    asked = []

    def model(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append(point)
        if len(asked) in (2, 3):
            raise SamplingError("no light")
        return (truth - point) @ slopes, slopes

    assert GaussNewton(model, np.zeros(3), np.ones(3)).run(1e-12, 60).point == pytest.approx(truth, abs=1e-4)
