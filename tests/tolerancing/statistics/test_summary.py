"""Yields with their confidence intervals, statistics, rank correlations."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr

import tolerancing.statistics.correlation as correlation_module
from tolerancing.statistics.correlation import rank_correlation
from tolerancing.statistics.summary import PERCENTILES, summarize, summary_of
from tolerancing.statistics.yields import yield_of
from tolerancing.study.files import load_study
from tolerancing.study.results import TrialResults


def results_of(values, scores, messages=None):
    count = len(values)
    return TrialResults(
        trials=tuple(range(count)),
        values=values,
        scores=scores,
        extras=np.empty((count, 0)),
        messages=tuple(messages or [""] * count),
        passed=np.ones(count, bool),
        seconds=np.ones(count),
    )


@pytest.mark.parametrize(
    ("passed", "total", "low", "high"),
    [(0, 10, 0.0, 0.2775), (5, 10, 0.2366, 0.7634), (10, 10, 0.7225, 1.0), (90, 100, 0.8256, 0.9448)],
)
def test_intervals_are_wilsons(passed, total, low, high):
    good = yield_of(np.arange(total) < passed)
    assert (good.passed, good.total, good.fraction) == (passed, total, passed / total)
    assert (good.low, good.high) == (pytest.approx(low, abs=1e-4), pytest.approx(high, abs=1e-4))


@given(st.integers(1, 2000), st.floats(0.0, 1.0))
def test_interval_solves_the_score_equation(total, share):
    passed = round(share * total)
    good = yield_of(np.arange(total) < passed)
    z = 1.959963984540054
    for end in (good.low, good.high):
        if 0.0 < end < 1.0:
            assert (good.fraction - end) ** 2 == pytest.approx(z * z * end * (1.0 - end) / total, abs=1e-9)
    assert good.low <= good.fraction <= good.high


def test_nothing_has_no_yield():
    assert yield_of(np.zeros(0, bool)) is None


def test_statistics_leave_out_what_has_no_score_and_the_yield_does_not(write_study, full_study):
    study = load_study(write_study(full_study)).study
    rng = np.random.default_rng(4)
    scores = np.column_stack([rng.normal(4.83, 0.02, 50), rng.uniform(size=50)])
    scores[:5, 1] = np.nan
    results = results_of(rng.normal(size=(50, 2)), scores, ["strehl: dark"] * 5 + [""] * 45)
    summary = summary_of(None, study, {"strehl": 1.0, "largest_spread_deg": np.nan}, results, 3)
    spread, strehl = summary.merits
    assert (summary.trials, summary.failed) == (50, 5)
    assert (spread.nominal, strehl.nominal) == (None, 1.0)
    assert (strehl.scored, strehl.good.total) == (45, 50)
    assert strehl.good.passed == np.count_nonzero(scores[5:, 1] >= 0.5)
    assert strehl.mean == pytest.approx(scores[5:, 1].mean())
    assert [spread.percentiles[p] for p in PERCENTILES] == pytest.approx(
        np.percentile(scores[:, 0], PERCENTILES)
    )
    assert summary.planned_steps == sum(len(series) for series in study.series) > 3


def test_rank_correlations_are_spearmans(write_study, full_study):
    study = load_study(write_study(full_study)).study
    rng = np.random.default_rng(1)
    values = rng.normal(size=(60, 2))
    scores = np.column_stack([np.exp(values[:, 0]), -(values[:, 1] ** 2) + 0.3 * rng.normal(size=60)])
    scores[5, 1] = np.nan
    correlation = rank_correlation(study, results_of(values, scores))
    known = np.isfinite(scores[:, 1])
    for k in range(2):
        assert correlation.signed[0, k] == pytest.approx(spearmanr(scores[:, 0], values[:, k]).statistic)
        magnitude = spearmanr(scores[known, 1], np.abs(values[known, k])).statistic
        assert correlation.magnitude[1, k] == pytest.approx(magnitude)
    assert correlation.signed[0, 0] == pytest.approx(1.0)
    assert correlation.magnitude[1, 1] < -0.7 < -abs(correlation.signed[1, 1])


def test_ranks_of_many_trials_are_those_of_evenly_spaced_ones(write_study, ray_study, monkeypatch):
    study = load_study(write_study(ray_study)).study
    rng = np.random.default_rng(3)
    values = rng.normal(size=(100, 2))
    scores = values[:, :1] + rng.normal(size=(100, 1))
    monkeypatch.setattr(correlation_module, "MOST_TRIALS", 40)
    found = rank_correlation(study, results_of(values, scores))
    assert found.signed[0, 0] == pytest.approx(spearmanr(scores[::3, 0], values[::3, 0]).statistic)


def test_constant_scores_correlate_with_nothing(write_study, ray_study):
    study = load_study(write_study(ray_study)).study
    values = np.random.default_rng(2).normal(size=(20, 2))
    assert np.all(rank_correlation(study, results_of(values, np.ones((20, 1)))).strength == 0.0)


def test_a_summary_shows_itself(small_store):
    summary = summarize(small_store)
    assert repr(summary) == (
        f"Summary('a study: 6 of 6 trials', all limits: {100.0 * summary.good.fraction:.1f} % good "
        f"({100.0 * summary.good.low:.1f} to {100.0 * summary.good.high:.1f} %))"
    )
    page = ElementTree.fromstring(f"<div>{summary._repr_html_()}</div>")
    assert [row.text for row in page.iter("th")] == ["all limits", "largest_spread_deg", "strehl"]
    assert len(list(page.iter("{http://www.w3.org/2000/svg}rect"))) == 3
    empty = replace(summary, good=None, merits=())
    assert "no trials" in repr(empty)
    assert "no trials" in empty._repr_html_()
