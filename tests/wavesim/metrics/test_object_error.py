"""The error of an object from held-out pixels, against an error that is known."""

from __future__ import annotations

import numpy as np
import pytest

from wavesim.fields.field import Field, Grid
from wavesim.metrics.contrast import object_correlation
from wavesim.metrics.object_error import correlation_with_error, held_out_error, object_strength
from wavesim.metrics.plane_residuals import PlaneResidual


def plane(error: float, noise: float, random: np.random.Generator) -> PlaneResidual:
    """Return residuals of a random field of intensity 1 with a relative error, and noise."""
    field, wrong = (random.standard_normal((200, 200, 2)) @ (1.0, 1j) / np.sqrt(2.0) for _ in range(2))
    measured = np.abs(field) + noise * random.standard_normal(field.shape)
    held = random.permutation(field.size)[:4000]
    sigma = np.full(field.shape, noise)
    return PlaneResidual(
        1.0, measured, sigma, np.abs(field + error * wrong) - measured, held, np.full(4000, noise)
    )


@pytest.mark.parametrize(("error", "noise"), [(0.1, 0.02), (0.1, 0.1), (0.3, 0.1)])
def test_the_error_of_the_field_is_bounded_closely(error: float, noise: float) -> None:
    random = np.random.default_rng(1)
    bounds = [held_out_error([plane(error, noise, random), plane(error, noise, random)]) for _ in range(20)]
    assert sum(bound is not None and bound > 0.97 * error for bound in bounds) >= 18
    assert np.mean(bounds) < 1.35 * error


def test_without_held_out_pixels_nothing_is_known() -> None:
    whole = plane(0.1, 0.1, np.random.default_rng(0))
    assert held_out_error([whole._replace(held=np.zeros(0, int), held_sigma=np.zeros(0))]) is None


def test_an_error_of_this_size_leaves_this_correlation() -> None:
    random, grid = np.random.default_rng(2), Grid((100, 100), 1e-3, 0.0)
    light = Field(grid, np.ones(grid.shape, complex), 0.5)
    true = light.with_values(random.uniform(0.2, 1.0, grid.shape).astype(complex))
    scale = 0.1 * np.sqrt(np.mean(np.abs(true.values) ** 2))
    found = light.with_values(true.values + scale * random.standard_normal(grid.shape))
    expected = correlation_with_error(0.1, object_strength(true, light))
    assert object_correlation(found, true, light) == pytest.approx(expected, abs=2e-3)
