"""Ghosts found in residuals of light that has one."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.metrics.ghosts import GhostPlane, ghost_in_residuals

SIGMA = 0.01


def plane(amplitude: complex, random: np.random.Generator) -> GhostPlane:
    """Light with random detail, a bent wave as its ghost, and amplitudes with noise."""
    y, x = np.mgrid[-1:1:48j, -1:1:40j]
    detail = random.normal(size=(2, 48, 40))
    field = 1.0 + 0.2 * (detail[0] + 1j * detail[1])
    ghost = np.exp(20j * (x**2 + y**2)) * (np.hypot(x, y) < 0.7)
    recorded = np.abs(field + amplitude * ghost) + SIGMA * random.normal(size=x.shape)
    sigma = np.full(x.shape, SIGMA)
    sigma[3, 4], recorded[3, 4] = np.inf, 1e6
    return GhostPlane(recorded - np.abs(field), sigma, np.abs(field), np.conj(field) * ghost)


def test_size_phase_and_deviation() -> None:
    """Of 200 noises the errors scatter as the standard deviation says."""
    true, random = 0.02 * np.exp(2j), np.random.default_rng(3)
    found = [ghost_in_residuals([plane(true, random), plane(true, random)]) for _ in range(200)]
    deviation = np.array([one.standard_deviation for one in found])
    errors = np.array([one.amplitude - true for one in found])
    assert abs(np.mean(errors)) < 3.0 * deviation[0] / np.sqrt(100.0)
    scatter = np.sqrt(0.5 * np.mean(np.abs(errors) ** 2))
    assert scatter == pytest.approx(np.mean(deviation), rel=0.15)
    assert min(one.significance for one in found) > 20.0
    assert found[0].power_fraction == pytest.approx(4e-4, rel=0.2)
    assert found[0].over_noise == pytest.approx(1.0, abs=0.05)


def test_none_where_there_is_none() -> None:
    random = np.random.default_rng(4)
    beyond = [ghost_in_residuals([plane(0.0, random)]).significance > 3.0 for _ in range(300)]
    assert np.mean(beyond) == pytest.approx(np.exp(-4.5), abs=0.02)


def test_residuals_of_something_else_widen_the_deviation() -> None:
    one = plane(0.0, np.random.default_rng(5))
    worse = one._replace(residual=10.0 * one.residual)
    assert ghost_in_residuals([worse]).standard_deviation == pytest.approx(
        10.0 * ghost_in_residuals([one]).standard_deviation, rel=0.1
    )


def test_refused() -> None:
    one = plane(0.0, np.random.default_rng(6))
    with pytest.raises(InputError, match="product must have one shape"):
        ghost_in_residuals([one._replace(sigma=one.sigma[1:])])
    with pytest.raises(InputError, match="a ghost cannot be measured"):
        ghost_in_residuals([one._replace(product=0.0 * one.product)])
