"""What an uncertain bench leaves open in the object."""

from __future__ import annotations

import numpy as np
import pytest

from wavesim.calibration.object_uncertainty import ObjectUncertainty
from wavesim.fields.field import Field, Grid
from wavesim.metrics.low_orders import LOW_ORDERS

GRID = Grid((50, 50), 1e-3, 0.0)
LIGHT = Field(GRID, np.ones(GRID.shape, np.complex64), 0.5)


def uncertainty(ramp_waves: float, change: float) -> ObjectUncertainty:
    """Return that of a phase object: a ramp of the light, and a random change of a relative size."""
    random = np.random.default_rng(0)
    values = np.exp(1j * random.uniform(0.0, 1.5, GRID.shape)).astype(np.complex64)
    other = change * random.standard_normal((*GRID.shape, 2)) @ (1.0, 1j) / np.sqrt(2.0)
    exponents = np.zeros((2, len(LOW_ORDERS)), complex)
    exponents[1, LOW_ORDERS.index((1, 0))] = 2j * np.pi * ramp_waves
    return ObjectUncertainty(LIGHT, values, np.stack([other, 0.0 * other]).astype(np.complex64), exponents)


def test_a_ramp_that_the_light_may_have_is_stated_and_counts_in_one_bound() -> None:
    found = uncertainty(ramp_waves=0.3, change=0.0).summary
    assert found.phase_waves["ramp x"] == pytest.approx(0.3, rel=1e-6)
    assert found.phase_waves["curvature y"] == 0.0
    assert "ramp x" in found.words
    assert "curvature" not in found.words
    assert found.correlation < 0.5
    assert found.correlation_without_low_orders == pytest.approx(1.0, abs=1e-6)


def test_the_bound_is_that_of_a_rare_size_of_a_single_error() -> None:
    """99 % of normal draws are below 2.58 deviations in size."""
    found = uncertainty(ramp_waves=0.0, change=0.1)
    values, light = found.transmission, np.ones(GRID.shape)
    strength = 1.0 - abs(np.vdot(light, values)) ** 2 / values.size / np.vdot(values, values).real
    expected = 1.0 / np.sqrt(1.0 + (2.58 * 0.1) ** 2 / strength)
    assert found.summary.correlation == pytest.approx(expected, abs=0.03)
    assert not found.summary.phase_waves
    assert not found.summary.words


def test_a_displacement_is_stated_and_counts_in_one_bound() -> None:
    """Displaced by some samples, a random object has nothing in common with itself."""
    random = np.random.default_rng(0)
    values = random.uniform(0.0, 1.0, GRID.shape).astype(np.complex64)
    displacements = np.array([[3.0, 0.0], [0.0, 2.0]])
    exponents = np.zeros((2, len(LOW_ORDERS)), complex)
    found = ObjectUncertainty(LIGHT, values, np.zeros((2, *GRID.shape)), exponents, displacements).summary
    assert found.position_um == pytest.approx({"x": 3.0, "y": 2.0})  # samples of 1 um
    assert "position of the object" in found.words
    assert "x ±3 µm, y ±2 µm" in found.words
    assert found.correlation < 0.2
    assert found.correlation_without_low_orders == pytest.approx(1.0, abs=1e-6)
    assert found.as_dict()["position_um"] == pytest.approx({"x": 3.0, "y": 2.0})
