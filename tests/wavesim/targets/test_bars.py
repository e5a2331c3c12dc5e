"""Bars: area, period and symmetry of rectangles and of samples, contrast, and the finest lines resolved."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign.common.arrays import Array
from wavesim.fields.coverage import rectangle_coverage
from wavesim.fields.field import Grid, Orientation
from wavesim.targets.bars import (
    bar_and_gap_centres,
    bar_centres,
    bar_contrasts,
    bar_coverage,
    bar_levels,
    bar_profile,
    bar_rectangles,
    resolved_lines,
)

GRID = Grid((200, 240), 1e-3, -1.0, (0.3, -0.2))


def covered(grid: Grid, width_um: float, orientation: Orientation, bars: int) -> Array:
    width = 1e-3 * width_um
    length = (2 * bars - 1) * width
    return rectangle_coverage(grid, bar_rectangles(width, bars, orientation, grid.centre_mm, length))


@pytest.mark.parametrize("bars", [2, 3, 5])
def test_bars_have_their_area_period_and_symmetry(bars: int) -> None:
    width = 5.3
    along_x = covered(GRID, width, "x", bars)
    assert along_x.sum() * GRID.cell == pytest.approx(bars * (2 * bars - 1) * (1e-3 * width) ** 2)
    np.testing.assert_allclose(along_x, along_x[::-1, ::-1], atol=1e-12)
    square = Grid((200, 200), 1e-3, -1.0)
    along_x, along_y = covered(square, width, "x", bars), covered(square, width, "y", bars)
    np.testing.assert_allclose(along_x, along_y.T, atol=1e-12)
    profile = along_x.sum(axis=0)
    cycles = np.exp(-1j * math.pi * square.x_mm / (1e-3 * width))
    # Summed over the bars, the order of their own period is bars * 2 width / pi but for the cells' own sinc.
    length = (2 * bars - 1) * 1e-3 * width
    expected = bars * 2e-3 * width / math.pi * length * np.sinc(0.5 * 1.0 / width)
    assert abs(profile @ cycles) * square.cell == pytest.approx(expected, rel=1e-2)


@given(st.floats(0.3, 9.0), st.integers(1, 6))
def test_bars_on_a_line_are_those_in_the_plane(width_um: float, bars: int) -> None:
    width = 1e-3 * width_um
    in_plane = rectangle_coverage(GRID, bar_rectangles(width, bars, "x", GRID.centre_mm, 0.1))
    on_line = bar_coverage(GRID.x_mm - GRID.centre_mm[0], GRID.pitch_mm, width, bars)
    np.testing.assert_allclose(on_line, in_plane[100], atol=1e-11)


def test_gaps_lie_between_bars() -> None:
    centres = bar_and_gap_centres(0.7, 4)
    np.testing.assert_allclose(centres[:4], bar_centres(0.7, 4))
    np.testing.assert_allclose(np.sort(centres), 0.7 * np.arange(-3, 4))


@pytest.mark.parametrize("orientation", ["x", "y"])
def test_levels_and_profile_are_those_of_bars_and_gaps(orientation: Orientation) -> None:
    intensity = 0.25 + 0.5 * covered(GRID, 8.0, orientation, 3)
    shown = (intensity, GRID, 8e-3, 3, orientation, GRID.centre_mm)
    bars, gaps = bar_levels(*shown)
    np.testing.assert_allclose(bars, 0.75)
    np.testing.assert_allclose(gaps, 0.25)
    assert bar_contrasts(bars, gaps) == pytest.approx((0.5, 0.5))
    across, profile = bar_profile(*shown)
    assert abs(across).max() == pytest.approx(36.0, abs=1.0)
    np.testing.assert_allclose(profile[abs(across) < 3.0], 0.75)
    np.testing.assert_allclose(profile[abs(across - 8.0) < 3.0], 0.25)


def test_without_light_there_is_no_contrast() -> None:
    assert np.all(np.isnan(bar_contrasts(np.zeros(3), np.zeros(2))))


def test_lines_beyond_the_first_failure_do_not_count() -> None:
    assert resolved_lines([4.0, 3.0, 2.0, 1.0], lambda width: width != 2.0) == [4.0, 3.0]
    assert resolved_lines([4.0], lambda _: False) == []
