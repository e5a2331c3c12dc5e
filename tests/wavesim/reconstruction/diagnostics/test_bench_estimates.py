"""How large errors are, as pictures and phases tell."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.diagnostics.bench_estimates import (
    background,
    centroid,
    shift_pixels,
    smooth_phase_waves,
)
from wavesim.scene.light_errors import LightErrors

PICTURE = gaussian_filter(np.random.default_rng(3).random((60, 80)), 2.0, mode="wrap")


@pytest.mark.parametrize("x_y", [(0.0, 0.0), (3.0, -2.0), (-0.4, 1.3)])
def test_a_shift_is_found_to_a_tenth_of_a_pixel(x_y: tuple[float, float]) -> None:
    measured = shift(PICTURE, x_y[::-1], order=5, mode="grid-wrap")
    assert shift_pixels(measured, PICTURE) == pytest.approx(x_y, abs=0.1)


def test_the_centre_of_two_pixels_is_between_them() -> None:
    picture = np.zeros((5, 9))
    picture[1, 2] = picture[2, 6] = 3.0
    assert centroid(picture) == (4.0, 1.5)


def test_a_background_is_read_where_it_is_dark() -> None:
    modelled = np.zeros((10, 10))
    modelled[:5] = 2.0
    share, level = background(modelled + 0.1, modelled)
    assert level == pytest.approx(0.1)
    assert share == pytest.approx(0.1 / 1.1)
    assert background(modelled[:5], modelled[:5]) == (0.0, 0.0)


def test_a_phase_is_found_without_unwrapping() -> None:
    """Over several waves, on an object of its own amplitude, which is dark beyond a disc."""
    grid = Grid((60, 80), 1e-3, 0.0)
    phase = {(1, 0): 2.5, (0, 1): -1.2, (2, 0): 0.4, (1, 1): -0.3, (0, 2): 0.1}
    inside = np.hypot(grid.x_mm[None, :], grid.y_mm[:, None]) < 0.028
    even = Field(grid, (inside * (0.2 + PICTURE)).astype(complex), 0.532)
    found = smooth_phase_waves(LightErrors(phase_waves=phase).on(even))
    assert found == pytest.approx(phase, abs=1e-6)
