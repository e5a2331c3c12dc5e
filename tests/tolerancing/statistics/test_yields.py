"""Intervals of yields."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtri
from scipy.stats import binomtest, t

from tolerancing.perturbations.draws import REPLICATES, probabilities, replicates
from tolerancing.statistics.control_variates import Seconds, choose_trials, combined_yield
from tolerancing.statistics.yields import yield_of


@pytest.mark.parametrize("good", range(19))
def test_an_interval_is_that_of_wilson(good):
    found = yield_of(np.arange(18) < good)
    wilson = binomtest(good, 18).proportion_ci(0.95, method="wilson")
    assert (found.passed, found.total, found.fraction) == (good, 18, good / 18)
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


@pytest.mark.parametrize(("method", "share"), [("latin_hypercube", 0.95), ("sobol", 0.5)])
def test_the_interval_of_designed_draws_holds_the_truth_as_often_as_it_says(method, share):
    """A sum of normal deviates of 6 columns below its quantile; 200 studies of 320 trials each."""
    slopes, trials = np.linspace(0.3, 1.5, 6), range(320)
    limit, own, found = float(ndtri(share)) * np.linalg.norm(slopes), replicates(method, trials), []
    for seed in range(200):
        scores = ndtri(probabilities(method, seed, trials, 6, 320)) @ slopes
        found.append(yield_of(scores <= limit, own))
    held = np.mean([one.low <= share <= one.high for one in found])
    plain = binomtest(round(320 * share), 320).proportion_ci(0.95, method="wilson")
    assert 0.95 - 3.0 * math.sqrt(0.95 * 0.05 / 200) <= held <= 0.99
    assert np.mean([one.high - one.low for one in found]) < (0.75 if share == 0.5 else 1.0) * (
        plain.high - plain.low
    )


def test_the_variance_of_a_design_is_that_of_its_replicates():
    """Four replicates of ten with 5, 6, 7 and 8 good trials: a t interval by hand, made Wilson's."""
    own = np.repeat(np.arange(4), 10)
    passed = np.concatenate([np.arange(10) < good for good in (5, 6, 7, 8)])
    found = yield_of(passed, own)
    variance = np.var([0.5, 0.6, 0.7, 0.8], ddof=1) / 4
    half = float(t.ppf(0.975, 3)) * math.sqrt(variance)
    n = 0.65 * 0.35 / variance * (1.959963984540054 / float(t.ppf(0.975, 3))) ** 2
    assert found.fraction == 0.65
    for end in (found.low, found.high):
        assert (0.65 - end) ** 2 == pytest.approx(1.959963984540054**2 * end * (1.0 - end) / n, abs=1e-9)
    assert found.high - found.low == pytest.approx(2.0 * half, rel=0.2)


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.integers(0, 100))
def test_an_interval_of_replicates_holds_its_share_and_has_a_width(passed, first):
    own = replicates("sobol", range(first, first + len(passed)))
    found = yield_of(np.array(passed), own)
    assert 0.0 <= found.low <= found.fraction <= found.high <= 1.0
    assert found.high - found.low > 0.0
    if all(passed) or len(passed) == 1:
        assert found == yield_of(np.array(passed))


def test_replicates_that_agree_to_the_trial_leave_an_interval_of_a_trial():
    own = np.repeat(np.arange(REPLICATES), 10)
    found = yield_of(np.tile(np.arange(10) < 5, REPLICATES), own)
    assert 1.0 / 160 < found.high - found.low < 3.0 / 160
