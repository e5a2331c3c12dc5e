"""Control variates: coverage of the intervals, bias, and how much narrower they get."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from benchmarks.control_variates import best_narrowing
from lensdesign.errors import InputError
from tolerancing.statistics.control_variates import (
    Seconds,
    TrialChoice,
    choose_trials,
    combined_mean,
    combined_yield,
)
from tolerancing.statistics.yields import yield_of

SECONDS = Seconds(low_fidelity=1.0, high_fidelity=50.0)
REPEATS = 300
# Intervals of 95 % cover less often than this in one of a thousand sets of repeats.
FEWEST_HITS = int(stats.binom.ppf(1e-3, REPEATS, 0.95))


def linear(rng, n, rho=0.95):
    cheap = rng.normal(size=n)
    return cheap, rho * cheap + math.sqrt(1.0 - rho * rho) * rng.normal(size=n)


def curved(rng, n):
    cheap = rng.normal(size=n)
    return cheap, np.tanh(cheap) + 0.1 * cheap**2 + 0.15 * rng.normal(size=n)


def skewed(rng, n):
    loss = rng.exponential(size=n)
    return -loss, -loss - 0.2 * loss**2 + 0.3 * (rng.exponential(size=n) - 1.0)


POPULATIONS = {"linear": linear, "curved": curved, "skewed": skewed}


@pytest.fixture(scope="module", params=POPULATIONS)
def population(request):
    """A draw function, and many dear scores that it draws."""
    draw = POPULATIONS[request.param]
    return draw, draw(np.random.default_rng(99), 2_000_000)[1]


def test_mean_has_no_bias_and_its_interval_covers(population):
    draw, dear = population
    rng, truth, hits, estimates, errors = np.random.default_rng(1), dear.mean(), 0, [], []
    for seed in range(REPEATS):
        c, d = draw(rng, 2000)
        chosen = choose_trials(c, seed, worst=40, random=60)
        e = combined_mean(c, chosen, d[chosen.all], SECONDS)
        hits += e.low <= truth <= e.high
        estimates.append(e.estimate)
        errors.append(e.standard_error)
    assert hits >= FEWEST_HITS
    scatter = np.std(estimates)
    assert abs(np.mean(estimates) - truth) < 4.0 * scatter / math.sqrt(REPEATS)
    assert np.mean(errors) == pytest.approx(scatter, rel=0.2)


@pytest.mark.parametrize("truth", [0.5, 0.9, 0.98])
def test_yield_has_no_bias_and_its_interval_covers(population, truth):
    draw, dear = population
    rng, limit = np.random.default_rng(2), np.quantile(dear, 1.0 - truth)
    hits, estimates = 0, []
    for seed in range(REPEATS):
        c, d = draw(rng, 2000)
        margin = c - limit - 0.05
        chosen = choose_trials(margin, seed, worst=60, random=60)
        e = combined_yield(margin, chosen, d[chosen.all] >= limit, SECONDS)
        hits += e.low <= truth <= e.high
        estimates.append(e.estimate)
    assert hits >= FEWEST_HITS
    assert abs(np.mean(estimates) - truth) < 4.0 * np.std(estimates) / math.sqrt(REPEATS)


@pytest.mark.parametrize("ratio", [20.0, 100.0, 1000.0])
def test_narrowing_is_that_of_theory(ratio):
    """At the best share of cheap trials, and three-fold where the formula says so."""
    rho = 0.995
    rng, dear = np.random.default_rng(3), 150
    cheap = round(dear * rho * math.sqrt(ratio / (1.0 - rho * rho)))
    seen = []
    for seed in range(40):
        c, d = linear(rng, cheap, rho)
        chosen = choose_trials(c, seed, worst=0, random=dear)
        seen.append(combined_mean(c, chosen, d[chosen.all], Seconds(1.0, ratio)))
    narrowing = np.mean([e.narrower_than_same_time for e in seen])
    assert narrowing == pytest.approx(best_narrowing(rho, ratio), rel=0.03)
    assert narrowing > 3.0
    assert np.mean([e.correlation for e in seen]) == pytest.approx(rho, abs=0.002)


@pytest.mark.parametrize(
    ("ratio", "rho", "narrowing"), [(20.0, 0.9939, 3.0), (100.0, 0.9718, 3.0), (20.0, 0.9293, math.sqrt(3.0))]
)
def test_best_narrowing_at_the_correlations_told(ratio, rho, narrowing):
    assert best_narrowing(rho, ratio) >= narrowing > best_narrowing(rho - 0.002, ratio)
    assert best_narrowing(0.0, ratio) == 1.0


def test_worst_trials_narrow_the_interval_of_a_high_yield_threefold():
    truth, rng = 0.98, np.random.default_rng(4)
    limit = np.quantile(skewed(rng, 2_000_000)[1], 1.0 - truth)
    seen = []
    for seed in range(60):
        c, d = skewed(rng, 5000)
        chosen = choose_trials(c - limit, seed, worst=150, random=100)
        seen.append(combined_yield(c - limit, chosen, d[chosen.all] >= limit, SECONDS))
    assert np.mean([e.narrower_than_high_fidelity for e in seen]) > 3.0
    assert np.mean([e.narrower_than_same_time for e in seen]) > 3.0


def test_dear_scores_of_all_trials_need_no_model():
    rng = np.random.default_rng(5)
    c, d = curved(rng, 200)
    chosen = choose_trials(c, 0, worst=50, random=150)
    mean = combined_mean(c, chosen, d[chosen.all], SECONDS)
    assert mean.estimate == pytest.approx(d.mean(), abs=1e-12)
    assert mean.standard_error == pytest.approx(d.std(ddof=1) / math.sqrt(200), rel=1e-9)
    good = combined_yield(c, chosen, d[chosen.all] >= 0.0, SECONDS)
    plain = yield_of(d >= 0.0)
    assert good.estimate == pytest.approx(plain.fraction)
    assert good.by_counts == (pytest.approx(plain.low), pytest.approx(plain.high))
    # The curve's own share stands in the variance where it is the larger; here they agree closely.
    assert (good.low, good.high) == (pytest.approx(plain.low, abs=1e-3), pytest.approx(plain.high, abs=1e-3))


def test_an_exact_cheap_model_leaves_the_scatter_of_its_trials():
    c = np.random.default_rng(6).normal(size=3000)
    chosen = choose_trials(c, 0, worst=10, random=20)
    e = combined_mean(c, chosen, 3.0 * c[chosen.all] - 1.0, SECONDS)
    assert e.estimate == pytest.approx(3.0 * c.mean() - 1.0, abs=1e-9)
    assert e.correlation == pytest.approx(1.0)


@given(
    seed=st.integers(0, 1000),
    limit=st.floats(-4.0, 4.0),
    worst=st.integers(0, 40),
    random=st.integers(4, 60),
    none=st.integers(0, 20),
)
def test_interval_of_a_yield_has_a_width_and_stays_within_0_and_1(seed, limit, worst, random, none):
    rng = np.random.default_rng(seed)
    c, d = linear(rng, 100)
    c[:none] = np.nan
    chosen = choose_trials(c - limit, seed, worst, random)
    e = combined_yield(c - limit, chosen, d[chosen.all] >= limit, SECONDS)
    assert 0.0 <= e.low <= e.estimate <= e.high <= 1.0
    assert 0.0 <= e.by_counts[0] < e.by_counts[1] <= 1.0
    # Not narrower than the trials themselves would be, had the dear model scored them all.
    assert e.high - e.low > 0.036


def test_a_cheap_model_that_knows_nothing_does_little_harm():
    rng = np.random.default_rng(7)
    narrowing, hits = [], 0
    for seed in range(REPEATS):
        c, good = rng.normal(size=1000), rng.random(1000) < 0.7
        chosen = choose_trials(c, seed, worst=0, random=100)
        e = combined_yield(c, chosen, good[chosen.all], SECONDS)
        narrowing.append(e.narrower_than_high_fidelity)
        hits += e.low <= 0.7 <= e.high
    assert hits >= FEWEST_HITS
    assert np.mean(narrowing) > 0.93


def test_failures_that_the_cheap_model_knows_nothing_of_are_covered_by_counts():
    rng, truth, hits, trusting = np.random.default_rng(10), 0.98 * stats.norm.cdf(2.0), 0, 0
    for seed in range(REPEATS):
        c = rng.normal(size=2000)
        good = (c + 0.1 * rng.normal(size=2000) > -2.0) & (rng.random(2000) < 0.98)
        chosen = choose_trials(c + 2.0, seed, worst=60, random=60)
        e = combined_yield(c + 2.0, chosen, good[chosen.all], SECONDS)
        hits += e.by_counts[0] <= truth <= e.by_counts[1]
        trusting += e.low <= truth <= e.high
    assert hits >= FEWEST_HITS > trusting


def test_trials_without_a_score():
    c, d = linear(np.random.default_rng(8), 500)
    c[[3, 7]] = np.nan
    chosen = choose_trials(c, 0, worst=20, random=50)
    assert set(chosen.worst[:2]) == {3, 7}
    dear = d[chosen.all]
    dear[[0, 1, 30]] = np.nan
    e = combined_mean(c, chosen, dear, SECONDS)
    assert (e.left_out, e.high_fidelity_trials) == (3, 67)
    assert e.low < e.estimate < e.high


def test_choice_follows_from_the_seed_and_takes_the_worst():
    margin = np.random.default_rng(9).normal(size=300)
    first, again, other = (choose_trials(margin, seed, 30, 40) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.all, again.all)
    assert not np.array_equal(first.random, other.random)
    np.testing.assert_array_equal(first.worst, np.argsort(margin)[:30])
    assert not set(first.worst) & set(first.random)
    assert len(set(first.all)) == 70


@pytest.mark.parametrize(("worst", "random"), [(-1, 4), (2, -1), (6, 5)])
def test_choice_refuses_more_trials_than_there_are(worst, random):
    with pytest.raises(InputError, match="at most 10"):
        choose_trials(np.arange(10.0), 0, worst, random)


def test_estimates_refuse_what_does_not_match():
    c = np.arange(20.0)
    chosen = choose_trials(c, 0, 4, 6)
    with pytest.raises(InputError, match="9 for 10 chosen"):
        combined_mean(c, chosen, np.zeros(9), SECONDS)
    with pytest.raises(InputError, match="different"):
        combined_yield(c, TrialChoice(np.array([1, 2]), np.array([2, 5])), np.ones(4, bool), SECONDS)
    few = choose_trials(c, 0, 4, 3)
    with pytest.raises(InputError, match="at least 4"):
        combined_mean(c, few, c[few.all], SECONDS)
    with pytest.raises(InputError, match="at least 4"):
        combined_yield(c, few, c[few.all] > 0.0, SECONDS)
