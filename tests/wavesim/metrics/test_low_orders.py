"""Low orders of a phase: found, and taken out of comparisons."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from wavesim.fields.field import Field, Grid
from wavesim.metrics.contrast import object_correlation
from wavesim.metrics.low_orders import LOW_ORDERS, low_order_factor, smooth_phase_waves, with_low_orders_of
from wavesim.scene.light_errors import LightErrors

WAVES = {(1, 0): 0.4, (0, 1): -0.3, (2, 0): 0.1, (1, 1): 0.05, (0, 2): -0.08}
GRID = Grid((60, 60), 1e-3, 0.0)
EVEN = Field(GRID, np.ones(GRID.shape, np.complex64), 0.5)


def exponent() -> np.ndarray:
    return 2j * np.pi * np.array([WAVES.get(orders, 0.0) for orders in LOW_ORDERS])


def test_low_orders_of_a_phase_are_found() -> None:
    found = smooth_phase_waves(EVEN.with_values(low_order_factor(exponent(), GRID.shape)))
    assert found == pytest.approx(WAVES, abs=1e-3)


def test_a_phase_is_found_without_unwrapping() -> None:
    """Over several waves, on an object of its own amplitude, which is dark beyond a disc."""
    grid = Grid((60, 80), 1e-3, 0.0)
    amplitude = 0.2 + gaussian_filter(np.random.default_rng(3).random(grid.shape), 2.0, mode="wrap")
    phase = {(1, 0): 2.5, (0, 1): -1.2, (2, 0): 0.4, (1, 1): -0.3, (0, 2): 0.1}
    inside = np.hypot(grid.x_mm[None, :], grid.y_mm[:, None]) < 0.028
    even = Field(grid, (inside * amplitude).astype(complex), 0.532)
    found = smooth_phase_waves(LightErrors(phase_waves=phase).on(even))
    assert found == pytest.approx(phase, abs=1e-6)


def test_a_comparison_without_them_shows_the_same_object() -> None:
    random = np.random.default_rng(0)
    values = np.exp(1j * random.uniform(0.0, 1.5, GRID.shape)) * random.uniform(0.5, 1.0, GRID.shape)
    true = EVEN.with_values(values.astype(np.complex64))
    found = true.with_values((0.7 * values * low_order_factor(exponent(), GRID.shape)).astype(np.complex64))
    inside = np.ones(GRID.shape, bool)
    fitted = true.with_values(with_low_orders_of(true, found, inside))
    assert object_correlation(found, true, EVEN) < 0.5
    assert object_correlation(found, fitted, EVEN) > 0.9999
