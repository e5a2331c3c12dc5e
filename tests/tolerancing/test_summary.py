"""Yields with their confidence intervals, statistics, rank correlations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr

from tolerancing.correlation import rank_correlation
from tolerancing.results import TrialResults
from tolerancing.study import load_study
from tolerancing.summary import yield_of


@pytest.mark.parametrize(
    ("passed", "total", "low", "high"),
    [
        (0, 10, 0.0, 0.2775),
        (5, 10, 0.2366, 0.7634),
        (10, 10, 0.7225, 1.0),
        (90, 100, 0.8256, 0.9448),
    ],
)
def test_intervals_are_wilsons(passed, total, low, high):
    good = yield_of(np.arange(total) < passed)
    assert (good.passed, good.total, good.share) == (passed, total, passed / total)
    assert (good.low, good.high) == (pytest.approx(low, abs=1e-4), pytest.approx(high, abs=1e-4))


@given(st.integers(1, 2000), st.floats(0.0, 1.0))
def test_interval_solves_the_score_equation(total, share):
    passed = round(share * total)
    good = yield_of(np.arange(total) < passed)
    z = 1.959963984540054
    for end in (good.low, good.high):
        if 0.0 < end < 1.0:
            assert (good.share - end) ** 2 == pytest.approx(z * z * end * (1.0 - end) / total, abs=1e-9)
    assert good.low <= good.share <= good.high


def test_nothing_has_no_yield():
    assert yield_of(np.zeros(0, bool)) is None


def test_rank_correlations_are_spearmans(write_study, full_study):
    study = load_study(write_study(full_study)).study
    rng = np.random.default_rng(1)
    values = rng.normal(size=(60, 2))
    scores = np.column_stack([np.exp(values[:, 0]), -(values[:, 1] ** 2) + 0.3 * rng.normal(size=60)])
    scores[5, 1] = np.nan
    results = TrialResults(tuple(range(60)), values, scores, ("",) * 60, np.ones(60, bool))
    correlation = rank_correlation(study, results)
    known = np.isfinite(scores[:, 1])
    for k in range(2):
        assert correlation.signed[0, k] == pytest.approx(spearmanr(scores[:, 0], values[:, k]).statistic)
        magnitude = spearmanr(scores[known, 1], np.abs(values[known, k])).statistic
        assert correlation.magnitude[1, k] == pytest.approx(magnitude)
    assert correlation.signed[0, 0] == pytest.approx(1.0)
    assert correlation.magnitude[1, 1] < -0.7 < -abs(correlation.signed[1, 1])


def test_constant_scores_correlate_with_nothing(write_study, ray_study):
    study = load_study(write_study(ray_study)).study
    values = np.random.default_rng(2).normal(size=(20, 2))
    results = TrialResults(tuple(range(20)), values, np.ones((20, 1)), ("",) * 20, np.ones(20, bool))
    assert np.all(rank_correlation(study, results).strength == 0.0)
