"""Lengths along a step that are worth a trial."""

from __future__ import annotations

import math
from collections.abc import Callable

from hypothesis import given
from hypothesis import strategies as st

from wavesim.calibration.joint.line_search import LARGEST_EXTENSION, MOST_TRIALS, LineSearch


def trials(cost: Callable[[float], float], slope: float, first: float) -> tuple[LineSearch, list[float]]:
    line, tried = LineSearch(cost(0.0), slope, first), []
    while (length := line.next()) is not None:
        tried.append(length)
        line.add(length, cost(length))
    return line, tried


@given(least=st.floats(0.2, 4.0), depth=st.floats(0.1, 1.0), first=st.floats(0.5, 3.0))
def test_a_parabola_is_found_in_three_trials(least: float, depth: float, first: float) -> None:
    def cost(length: float) -> float:
        return 1.0 + depth * ((length / least - 1.0) ** 2 - 1.0)

    line, tried = trials(cost, -2.0 * depth / least, first)
    assert len(tried) <= 4
    assert line.best <= LARGEST_EXTENSION**2 * first
    gained = cost(0.0) - cost(line.best)
    assert gained > 0.85 * depth


@given(
    prices=st.lists(st.floats(0.0, 20.0), min_size=8, max_size=8),
    slope=st.floats(-100.0, 100.0),
    first=st.floats(0.1, 8.0),
)
def test_trials_end_whatever_they_find(prices: list[float], slope: float, first: float) -> None:
    """Each length is a new one, above 0 and finite, and the best is among them."""
    found = iter(prices)
    line, tried = trials(lambda length: next(found), slope, first)
    assert 1 <= len(tried) <= MOST_TRIALS
    assert len(set(tried)) == len(tried)
    assert all(0.0 < length < math.inf for length in tried)
    assert line.best in (0.0, *tried)


def test_a_step_that_leads_uphill_is_cut_down() -> None:
    line, tried = trials(lambda length: 1.0 - 0.2 * length + length**2, -0.2, 2.0)
    assert tried[0] == 2.0
    assert math.isclose(line.best, 0.2) or line.best < 0.3


def test_a_shorter_trial_that_is_worse_is_not_made_again() -> None:
    """The slope at the beginning is not that of what trials find: an object that has not yet followed."""
    prices = {0.0: 7.0, 1.5: 5.6}
    line, tried = trials(lambda length: prices.get(length, 6.0), -4.0, 1.5)
    assert len(tried) <= MOST_TRIALS
    assert line.best == 1.5
