"""Wavefronts of drawn lenses once compensators are taken out."""

from __future__ import annotations

import numpy as np

from tolerancing.prediction.goals.compensated import CompensatedWaves


def forms(generator: np.random.Generator, count: int, size: int) -> np.ndarray:
    roots = generator.normal(size=(count, 2 * size, size))
    return np.swapaxes(roots, 1, 2) @ roots


def test_derivatives_at_one_point_follow_values_that_all_points_determine() -> None:
    generator = np.random.default_rng(2)
    changes, limits = 4, np.array([0.3, 0.06, 0.6])
    size = changes + len(limits)
    at, by = forms(generator, 3, size), forms(generator, 3, size) - forms(generator, 3, size)
    amounts = generator.normal(size=(200, changes))

    def waves(step: float) -> CompensatedWaves:
        values = at + step * by
        return CompensatedWaves(
            values, by[None], np.sum(values[:2], axis=0), np.sum(by[:2], axis=0)[None], amounts, limits
        )

    weights = generator.uniform(size=200)
    here, step = waves(0.0), 1e-6
    bound = np.abs(here.together[:, changes:]) >= limits * (1.0 - 1e-12)
    assert np.all((np.mean(bound, axis=0) > 0.05) & (np.mean(bound, axis=0) < 0.999))
    for point in range(3):
        high, low = (weights @ waves(sign * step).squares(point) for sign in (1.0, -1.0))
        np.testing.assert_allclose(here.weighted(point, weights)[0], (high - low) / (2.0 * step), rtol=1e-4)
