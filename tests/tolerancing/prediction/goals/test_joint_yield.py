"""The smooth joint yield of several limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from lensdesign.common.arrays import Array
from tolerancing.prediction.goals.joint_yield import failing_fraction


@dataclass(frozen=True, eq=False)
class Linear:
    """Loads that are linear in two variables."""

    at: Array
    slopes: Array
    softness: float | None = None
    sign: float = 1.0
    point: tuple[float, float] = (0.0, 0.0)

    @property
    def loads(self) -> Array:
        return self.at + self.slopes @ np.array(self.point)

    def weighted(self, weights: Array) -> Array:
        return weights @ self.slopes


def limits(point: tuple[float, float]) -> list[Linear]:
    draws = np.random.default_rng(1)
    parts = [(0.97, 0.01, None, 1.0), (0.9, 0.2, 0.06, 1.0), (1.05, 0.04, None, -1.0)]
    return [
        Linear(mean + sigma * draws.normal(size=4000), draws.normal(size=(4000, 2)), softness, sign, point)
        for mean, sigma, softness, sign in parts
    ]


def test_derivatives_are_those_of_differences() -> None:
    found, by = failing_fraction(limits((0.0, 0.0)), 2)
    step = 1e-7
    for k, axis in enumerate(np.eye(2)):
        high, low = (failing_fraction(limits(tuple(sign * step * axis)), 0)[0] for sign in (1.0, -1.0))
        assert by[k] == pytest.approx((high - low) / (2.0 * step), rel=1e-4)
    assert 0.1 < found < 0.9


def test_it_is_the_fraction_that_misses_any_limit() -> None:
    own = limits((0.0, 0.0))
    misses = [one.sign * (one.loads - 1.0) > 0.0 for one in own]
    assert failing_fraction(own, 0)[0] == pytest.approx(np.mean(np.any(misses, axis=0)), abs=0.02)
    assert failing_fraction(own[:1], 0)[0] == pytest.approx(np.mean(misses[0]), abs=0.005)
