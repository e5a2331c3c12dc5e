"""A field whose samples are kept, against pixels that make them anew."""

from __future__ import annotations

import numpy as np
import pytest

from wavesim.fields.field import Grid
from wavesim.fields.tilted_propagator import TiltedPropagator, propagator_to
from wavesim.reconstruction.linear.cached_samples import CachedSamples
from wavesim.reconstruction.recording.pixel_means import PixelMeans

GRID = Grid((48, 40), 3.2e-3, 1.0)
TILTS = (0.0, 0.0), (2.0, -1.0)


def spectrum(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal(GRID.shape) + 1j * rng.standard_normal(GRID.shape)


@pytest.fixture(params=TILTS, ids=["upright", "tilted"])
def kept(request: pytest.FixtureRequest) -> CachedSamples:
    way = propagator_to(GRID, 0.532, 0.4, complex, (1e-3, -2e-3), request.param)
    assert isinstance(way, TiltedPropagator) == any(request.param)
    return CachedSamples(PixelMeans(GRID, 0.9), spectrum(1), way)


def test_intensities_and_products_are_those_of_the_pixels(kept: CachedSamples) -> None:
    rows, others = (kept.pixels.carried(spectrum(seed), kept.way) for seed in (1, 2))
    assert kept.intensity() == pytest.approx(kept.pixels.intensity(rows))
    assert kept.products(spectrum(2)) == pytest.approx(kept.pixels.products(rows, others))


def test_the_way_back_is_that_of_the_pixels_and_can_be_gone_again(kept: CachedSamples) -> None:
    change = np.random.default_rng(3).random(GRID.shape)
    expected = spectrum(4)
    kept.pixels.add_back(kept.pixels.carried(spectrum(1), kept.way), change, kept.way, expected)
    for _ in range(2):
        total = spectrum(4)
        kept.add_back(change, total)
        assert total == pytest.approx(expected)
