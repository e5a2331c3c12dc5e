"""Draws: streams of their own, strata, low discrepancy, and trials that depend on their number alone."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from lensdesign import InputError
from tolerancing.perturbations.draws import (
    DRAWS,
    MOST_SOBOL_COLUMNS,
    MOST_TRIAL,
    REPLICATES,
    probabilities,
    replicates,
    shape_generator,
)


def stream(seed: int, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


@given(
    seed=st.integers(0, 2**70) | st.sampled_from([2**32 - 1, 2**32, 2**128 - 1, 2**128, 2**200]),
    trials=st.lists(st.integers(0, MOST_TRIAL), max_size=5),
    columns=st.integers(1, 7),
)
def test_random_draws_are_those_of_seed_sequences(seed, trials, columns):
    drawn = probabilities("random", seed, trials, columns, 10)
    assert drawn.shape == (len(trials), columns)
    for trial, row in zip(trials, drawn, strict=True):
        assert row.tolist() == stream(seed, trial).random(columns).tolist()


@settings(max_examples=30)
@given(
    method=st.sampled_from(DRAWS),
    seed=st.integers(0, 2**40),
    planned=st.integers(1, 40),
    cuts=st.lists(st.integers(0, 100), max_size=5),
    order=st.randoms(use_true_random=False),
)
def test_any_split_of_the_trials_gives_the_same_values(method, seed, planned, cuts, order):
    together = probabilities(method, seed, range(100), 3, planned)
    edges = [0, *sorted(cuts), 100]
    parts = [range(a, b) for a, b in pairwise(edges)]
    assert np.array_equal(
        np.vstack([probabilities(method, seed, part, 3, planned) for part in parts]), together
    )
    shuffled = list(range(100))
    order.shuffle(shuffled)
    assert np.array_equal(probabilities(method, seed, shuffled, 3, planned), together[shuffled])


def test_sobol_blocks_join_into_one_sequence(monkeypatch):
    together = probabilities("sobol", 5, range(900), 2, 900)
    monkeypatch.setattr("tolerancing.perturbations.draws.SOBOL_BLOCK_VALUES", 64)
    assert np.array_equal(probabilities("sobol", 5, range(900), 2, 900), together)
    assert np.array_equal(probabilities("sobol", 5, range(900), 2, 1), together)


@pytest.mark.parametrize("method", DRAWS)
def test_every_column_is_uniform_and_within_the_ends(method):
    drawn = probabilities(method, 2, range(4000), 5, 1000)
    assert drawn.min() > 0.0
    assert drawn.max() < 1.0
    for column in drawn.T:
        assert stats.kstest(column, "uniform").pvalue > 0.001
    off_diagonal = np.corrcoef(drawn.T) - np.eye(5)
    assert np.abs(off_diagonal).max() < 4.0 / math.sqrt(4000)


@pytest.mark.parametrize("method", DRAWS)
def test_seeds_differ(method):
    assert not np.any(probabilities(method, 1, range(8), 2, 8) == probabilities(method, 2, range(8), 2, 8))


@given(
    seed=st.integers(0, 2**40), size=st.integers(1, 8), missing=st.integers(0, 15), columns=st.integers(1, 5)
)
def test_each_replicate_is_a_latin_hypercube_with_one_trial_in_each_stratum(seed, size, missing, columns):
    """Whether or not all replicates get as many of the trials; further trials fill further hypercubes."""
    planned, trials = size * REPLICATES - missing, np.arange(3 * size * REPLICATES)
    drawn = probabilities("latin_hypercube", seed, trials, columns, planned)
    for replicate in range(REPLICATES):
        for block in np.split(drawn[replicates("latin_hypercube", trials) == replicate], 3):
            strata = np.sort(np.floor(block * size).astype(int), axis=0)
            assert np.array_equal(strata, np.tile(np.arange(size)[:, None], columns))


@pytest.mark.parametrize("method", ["latin_hypercube", "sobol"])
def test_replicates_are_randomised_each_by_itself(method):
    """The first trial of each, over 200 seeds."""
    first = [probabilities(method, seed, range(REPLICATES), 1, REPLICATES)[:, 0] for seed in range(200)]
    off_diagonal = np.corrcoef(np.transpose(first)) - np.eye(REPLICATES)
    assert np.abs(off_diagonal).max() < 5.0 / math.sqrt(200)


def test_random_trials_are_no_replicates():
    assert replicates("random", range(40)) is None


def test_ends_that_a_hypercube_may_hold_are_moved_within():
    class Ends:
        def __init__(self, d, rng):
            self.columns = d

        def random(self, n):
            return np.tile([[0.0], [1.0]], (n // 2, self.columns))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scipy.stats.qmc.LatinHypercube", Ends)
        drawn = probabilities("latin_hypercube", 987654321, range(4 * REPLICATES), 3, 4 * REPLICATES)
    assert 0.0 < drawn.min() < 1e-15
    assert 1.0 - 1e-15 < drawn.max() < 1.0


def test_designed_draws_estimate_a_mean_better():
    """Mean of a smooth function of 4 columns: 32 seeds, 1024 trials each."""

    def error(method: str) -> float:
        means = [
            np.mean(np.exp(probabilities(method, seed, range(1024), 4, 1024).sum(axis=1)))
            for seed in range(32)
        ]
        return float(np.sqrt(np.mean(np.square(np.array(means) - (math.e - 1.0) ** 4))))

    random, hypercube, sobol = (error(method) for method in ("random", "latin_hypercube", "sobol"))
    assert hypercube < 0.5 * random
    assert sobol < 0.1 * random


def test_sobol_points_have_low_discrepancy():
    trials = range(5, 512 * REPLICATES, REPLICATES)
    sobol, random = (
        stats.qmc.discrepancy(probabilities(m, 3, trials, 3, 512 * REPLICATES)) for m in ("sobol", "random")
    )
    assert sobol < 0.1 * random


def test_figures_have_streams_of_their_own():
    firsts = {
        "trial": stream(9, 4).random(),
        **{f"figure {t} {c}": shape_generator(9, t, c).random() for t in (0, 1, 4) for c in (0, 1, 4)},
        **{f"hypercube {k}": stream(9, 4, k, 0).random() for k in (0, 1, 2)},
        **{f"sobol {k}": stream(9, 0, k, 1).random() for k in (0, 1, 2)},
    }
    assert len(set(firsts.values())) == len(firsts)
    assert shape_generator(9, 4, 1).random() == firsts["figure 4 1"]
    assert shape_generator(9, 4, 1).random() == stream(9, 4, 2).random()


@pytest.mark.parametrize(
    ("method", "trials", "columns", "message"),
    [
        ("halton", [0], 1, r"draws = 'halton': .*allowed: random, latin_hypercube, sobol"),
        ("random", [-1], 1, r"allowed: 0 to"),
        ("random", [MOST_TRIAL + 1], 1, r"allowed: 0 to 4294967295"),
        ("sobol", [0], MOST_SOBOL_COLUMNS + 1, r"21202 columns; allowed: up to 21201"),
    ],
)
def test_what_cannot_be_drawn_is_refused(method, trials, columns, message):
    with pytest.raises(InputError, match=message):
        probabilities(method, 0, trials, columns, 10)
