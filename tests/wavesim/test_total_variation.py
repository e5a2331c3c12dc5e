"""The proximal map of the total variation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wavesim.total_variation import prox_tv


@settings(max_examples=20)
@given(st.integers(0, 1000), st.floats(0.01, 2.0))
def test_proximal_map_of_the_total_variation(seed: int, weight: float) -> None:
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((12, 9)) + 1j * rng.standard_normal((12, 9))

    def variation(v: np.ndarray) -> float:
        dy, dx = np.diff(v, axis=0, append=v[-1:]), np.diff(v, axis=1, append=v[:, -1:])
        return float(np.sum(np.sqrt(np.abs(dy) ** 2 + np.abs(dx) ** 2)))

    def cost(v: np.ndarray) -> float:
        return 0.5 * float(np.sum(np.abs(v - values) ** 2)) + weight * variation(v)

    found = prox_tv(values, weight, 400)
    assert found.mean() == pytest.approx(values.mean(), abs=1e-9)
    best = cost(found)
    assert best <= cost(values)
    for _ in range(5):
        other = found + 0.05 * (rng.standard_normal((12, 9)) + 1j * rng.standard_normal((12, 9)))
        assert best <= cost(other) + 1e-6


def test_proximal_map_of_a_step_is_known() -> None:
    """Two levels, n samples each: both move towards each other by weight / n."""
    values = np.concatenate([np.zeros(10), np.ones(10)]).astype(complex)
    found = prox_tv(values, 0.5, 3000)
    np.testing.assert_allclose(found, np.concatenate([np.full(10, 0.05), np.full(10, 0.95)]), atol=1e-3)


def test_real_values_stay_real_and_are_as_complex_ones() -> None:
    values = np.random.default_rng(5).standard_normal((11, 14)).astype(np.float32)
    found = prox_tv(values, 0.3)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, prox_tv(values.astype(np.complex64), 0.3).real, atol=1e-6)


def test_no_weight_leaves_the_values() -> None:
    values = np.random.default_rng(6).standard_normal(7)
    assert prox_tv(values, 0.0) is values
