"""How large errors are, as pictures tell."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from wavesim.reconstruction.diagnostics.bench_estimates import background, centroid, shift_pixels

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
