"""The proximal map of the total variation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wavesim.reconstruction import total_variation
from wavesim.reconstruction.total_variation import prox_tv


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


def in_numpy(values: np.ndarray, weight: float, iterations: int) -> np.ndarray:
    """Chambolle's projection, word for word."""
    flow = np.zeros((2, *values.shape), values.dtype)

    def divergence() -> np.ndarray:
        return sum(np.diff(part, axis=axis, prepend=0.0) for axis, part in enumerate(flow))

    for _ in range(iterations):
        ends = divergence() - values / weight
        slope = np.stack(
            [np.diff(ends, axis=0, append=ends[-1:]), np.diff(ends, axis=1, append=ends[:, -1:])]
        )
        flow = (flow + 0.124 * slope) / (1.0 + 0.124 * np.sqrt(np.sum(np.abs(slope) ** 2, axis=0)))
    return values - weight * divergence()


@pytest.mark.parametrize("shape", [(12, 9), (1, 7), (7, 1), (2, 2), (3, 50), (131, 20)])
@pytest.mark.parametrize("iterations", [1, 12])
@pytest.mark.parametrize("threads", [1, 3])
def test_threads_do_what_all_rows_together_do(
    monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int], iterations: int, threads: int
) -> None:
    monkeypatch.setattr(total_variation, "THREADS", threads)
    monkeypatch.setattr(total_variation, "SAMPLES_PER_THREAD", 1)
    rng = np.random.default_rng(8)
    values = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    before = values.copy()
    np.testing.assert_allclose(
        prox_tv(values, 0.4, iterations), in_numpy(values, 0.4, iterations), atol=1e-13
    )
    np.testing.assert_array_equal(values, before)
