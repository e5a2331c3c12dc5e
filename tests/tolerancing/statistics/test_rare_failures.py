"""Yields of lenses that seldom fail, against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr
from scipy.stats import chi2

from lensdesign import InputError
from tolerancing.run.run import run_study
from tolerancing.statistics.rare_failures import (
    UNIFORM_FRACTION,
    draw_trials,
    failure_probabilities,
    rare_yield,
    weighted_failures,
)
from tolerancing.statistics.response import fit_response
from tolerancing.statistics.yields import wilson
from tolerancing.store.store import open_store
from tolerancing.study.evaluate import context_of, score_trials
from tolerancing.study.files import load_study

COLUMNS, LIMIT = 4, float(chi2.isf(2e-3, 4))
"""Two in a thousand trials have a larger sum of squares: failures on a sphere, in no one direction."""


@pytest.mark.parametrize("blur", [0.3, 3.0])
def test_estimates_have_no_bias_and_their_intervals_hold_the_truth(blur):
    """The proposal knows the score up to an error of so much; 200 estimates of 300 trials each."""
    rng, found, errors = np.random.default_rng(5), [], []
    for _ in range(200):
        squares = np.sum(rng.standard_normal((20_000, COLUMNS)) ** 2, axis=1)
        drawn, weights = draw_trials(ndtr((squares - LIMIT) / blur), 300, rng)
        fraction, error, plain = weighted_failures(squares[drawn] > LIMIT, weights, len(squares))
        found.append((fraction, *wilson(1.0 - fraction, plain)))
        errors.append(error)
    fractions, low, high = np.transpose(found)
    assert np.mean(fractions) == pytest.approx(2e-3, rel=0.05)
    assert np.std(fractions) == pytest.approx(np.mean(errors), rel=0.25)
    assert np.std(fractions) < 0.25 * np.sqrt(2e-3 / 300)
    assert np.mean((low <= 1.0 - 2e-3) & (high >= 1.0 - 2e-3)) >= 0.92


@given(st.lists(st.floats(0.0, 1.0), min_size=2, max_size=50), st.integers(0, 2**32))
def test_weights_undo_the_choice(probabilities, seed):
    drawn, weights = draw_trials(np.array(probabilities), 40, np.random.default_rng(seed))
    assert np.all(weights <= 1.0 / UNIFORM_FRACTION * (1.0 + 1e-12))
    assert len(drawn) == len(weights) == 40


def test_no_failure_leaves_the_interval_of_evenly_drawn_trials():
    fraction, error, plain = weighted_failures(np.zeros(200, bool), np.ones(200), 1000)
    assert (fraction, error, plain) == (0.0, 0.0, UNIFORM_FRACTION * 200)


@pytest.fixture(scope="module")
def rare_store(tmp_path_factory):
    """A study of rays whose limit few trials miss."""
    from tests_studies import DESIGN, RAY_STUDY

    folder = tmp_path_factory.mktemp("rare")
    (folder / "design.toml").write_text(DESIGN)
    text = RAY_STUDY.replace("trials = 40", "trials = 200")
    (folder / "study.toml").write_text(text)
    run_study(load_study(folder / "study.toml"), folder / "a.db", workers=1)
    with open_store(folder / "a.db") as store:
        yield store


def test_a_stored_study_gives_the_yield_of_a_far_longer_plain_run(rare_store, tmp_path):
    """The limit moved to the largest score of all trials but one, 4000 plain trials beside."""
    scores = rare_store.trials().scores[:, 0]
    study = rare_store.study
    (merit,) = study.merits
    limit = float(np.quantile(scores, 0.985))
    moved = study.model_copy(
        update={"all_merits": (merit.model_copy(update={"at_most": limit, "at_least": None}),)}
    )
    rare_store.__dict__["loaded"] = type(rare_store.loaded)(**{**vars(rare_store.loaded), "study": moved})
    counted = []
    found = rare_yield(rare_store, 200, progress=counted.append)
    other = moved.model_copy(update={"seed": study.seed + 1})
    plain = score_trials(context_of(rare_store.loaded.lens, other), other, range(4000)).passed.mean()
    assert sum(counted) == 200
    error = np.hypot(found.standard_error, np.sqrt(plain * (1.0 - plain) / 4000))
    assert abs(found.fraction - plain) < 4.0 * error
    assert found.low < found.fraction < found.high
    assert found.plain_trials > 400
    assert found.failed > 20


def test_too_few_trials_are_refused(rare_store):
    with pytest.raises(InputError, match=r"trials = 10.*at least 50"):
        rare_yield(rare_store, 10)


def test_chances_are_those_of_the_models_error():
    """A score that is linear but for noise of a known size."""

    class AtMost:
        label = "score"

        @staticmethod
        def margin(scores):
            return 1.0 - scores

    class OneMerit:
        merits = (AtMost,)

    rng = np.random.default_rng(8)
    values = rng.standard_normal((3000, 2))
    scores = (values @ [0.3, 0.4] + rng.normal(0.0, 0.1, 3000))[:, None]
    modelled = np.array([[0.0, 0.0], [2.0, 1.0], [0.9, 1.5]])
    probabilities = failure_probabilities(OneMerit, fit_response(values, scores), values, scores, modelled)
    assert probabilities == pytest.approx(ndtr((modelled @ [0.3, 0.4] - 1.0) / 0.1), abs=0.05)
