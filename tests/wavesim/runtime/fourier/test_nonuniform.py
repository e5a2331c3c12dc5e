"""The stated error of nonuniform transforms, against FINUFFT in double precision and against sums."""

from __future__ import annotations

import finufft
import numpy as np
import pytest

from wavesim.runtime.fourier.nonuniform import (
    Precision,
    folded,
    fourier_plan,
    rounding_error,
    transform_error,
)

SINGLE = np.dtype(np.complex64)
POINTS = 2000


def points() -> np.ndarray:
    return np.random.default_rng(5).uniform(-np.pi, np.pi, (2, POINTS))


def field(modes: int) -> np.ndarray:
    parts = np.random.default_rng(modes).standard_normal((2, modes, modes))
    return np.asarray(parts[0] + 1j * parts[1])


@pytest.mark.parametrize("requested", [1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("modes", [64, 256, 1024, 2048])
def test_the_stated_error_holds_at_any_size(modes: int, requested: float) -> None:
    """An upper bound, and no more than three times too large where rounding dominates."""
    angles, values = points(), field(modes)
    exact = finufft.nufft2d2(*angles, values, eps=1e-13, isign=-1)
    plan = fourier_plan(2, (1, modes, modes), Precision(SINGLE, requested, 0.0))
    plan.setpts(*folded(angles, SINGLE))
    found = plan.execute(values.astype(SINGLE))
    error = np.linalg.norm(found - exact) / np.linalg.norm(exact)
    stated = transform_error(Precision(SINGLE, requested, 0.0), modes)
    assert error <= stated
    if rounding_error(modes) > 3.0 * requested:
        assert stated < 3.0 * error


def test_the_reference_agrees_with_sums() -> None:
    angles, values = points()[:, :200], field(64)
    waves = [np.exp(-1j * np.outer(axis, np.arange(64) - 32)) for axis in angles]
    summed = np.einsum("pk,kl,pl->p", waves[0], values, waves[1])
    np.testing.assert_allclose(finufft.nufft2d2(*angles, values, eps=1e-13, isign=-1), summed, rtol=1e-10)


def test_double_precision_has_no_such_error() -> None:
    assert transform_error(Precision(np.dtype(complex), 1e-12, 0.0), 2048) < 2e-12
