"""Position of an object on a dark ground, from misfits that chance makes uneven."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lensdesign import load_design, scaled
from wavesim.calibration.joint.object_position import (
    MisfitAt,
    better_position,
    is_dark_at_rim,
    position_deviations,
)
from wavesim.targets.patch import PatchSettings, lit, object_patch


def test_an_object_is_on_a_dark_ground_if_the_rim_of_the_stop_shows_none_of_it() -> None:
    patch = object_patch(scaled(load_design("designs/paper_singlet.toml"), 1 / 48), 0.03)
    light = lit(patch, PatchSettings())
    ny, nx = patch.grid.shape
    letter = np.zeros((ny, nx))
    letter[ny // 3 : -ny // 3, nx // 2 - 3 : nx // 2 + 3] = 0.7
    assert is_dark_at_rim(letter, light)
    assert not is_dark_at_rim(1.0 - letter, light)
    assert not is_dark_at_rim(letter + 0.3, light)


def bowl(x0: float, y0: float, uneven: float = 0.0) -> MisfitAt:
    """Return misfits with their minimum at a displacement; odd samples are worse by a fraction."""

    def misfit_at(x: int, y: int) -> float:
        is_odd = (round(x - x0) + round(y - y0)) % 2
        return math.hypot(1.0, 0.02 * (x - x0), 0.02 * (y - y0)) * (1.0 + uneven * is_odd)

    return misfit_at


@pytest.mark.parametrize("place", [(3.0, 0.0), (0.0, -5.0), (-5.0, 5.0), (2.0, 1.0), (8.0, 8.0)])
def test_the_lowest_misfit_is_found_across_higher_ones(place: tuple[float, float]) -> None:
    misfit_at = bowl(*place, uneven=0.01)
    found = better_position(misfit_at)
    assert math.dist(found, place) < 1.5  # beside it, where chance is better


def test_an_object_stays_where_nothing_is_better() -> None:
    assert better_position(bowl(0.0, 0.0)) == (0.0, 0.0)
    assert better_position(lambda x, y: 1.0 if x == y == 0.0 else 0.9995) == (0.0, 0.0)


def test_positions_with_equal_misfits_are_equally_probable() -> None:
    """From -3 to 5 samples along x and not at all along y: the deviation of an even distribution from 0."""
    ratio = 1.02

    def misfit_at(x: int, y: int) -> float:
        if x == y == 0.0:
            return 1.0
        return 1.01 if -3.0 <= x <= 5.0 and y == 0.0 else 1.03

    assert position_deviations(misfit_at, ratio) == pytest.approx((math.sqrt((27.0 + 125.0) / 24.0), 0.0))
