"""Intervals of yields."""

import math

import numpy as np
import pytest
from scipy.stats import binomtest

from tolerancing.analysis.control_variates import Seconds, choose_trials, combined_yield
from tolerancing.analysis.yields import yield_of


@pytest.mark.parametrize("good", range(19))
def test_an_interval_is_that_of_wilson(good):
    found = yield_of(np.arange(18) < good)
    wilson = binomtest(good, 18).proportion_ci(0.95, method="wilson")
    assert (found.passed, found.total, found.share) == (good, 18, good / 18)
    assert (found.low, found.high) == (pytest.approx(wilson.low), pytest.approx(wilson.high))


def test_nothing_has_no_yield():
    assert yield_of(np.zeros(0, bool)) is None


@pytest.mark.parametrize("good", [0, 7, 24, 25])
def test_the_count_of_random_trials_is_judged_as_by_clopper_and_pearson(good):
    """Beside it stands the interval of all 400 trials, of which 25 were drawn."""
    chosen = choose_trials(np.linspace(-1.0, 1.0, 400), 0, worst=0, random=25)
    low, high = combined_yield(
        np.linspace(-1.0, 1.0, 400), chosen, np.arange(25) < good, Seconds(1.0, 50.0)
    ).by_counts
    share, drawn = good / 25, binomtest(good, 25).proportion_ci(0.95)
    every = binomtest(good * 16, 400).proportion_ci(0.95, method="wilson")
    left = 1.0 - 25 / 400
    assert low == pytest.approx(share - math.hypot(share - every.low, math.sqrt(left) * (share - drawn.low)))
    assert high == pytest.approx(
        min(share + math.hypot(every.high - share, math.sqrt(left) * (drawn.high - share)), 1.0)
    )
