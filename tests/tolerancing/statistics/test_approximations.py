"""Cheap merits that stand in for dear ones: named, with their measured difference."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tolerancing.cli.commands import app
from tolerancing.run.run import run_study
from tolerancing.statistics.approximations import approximations, approximations_of
from tolerancing.store.store import open_store
from tolerancing.study.files import load_study

DEAR = """
[fidelity]
random_share = 0.5

[[merit]]
name = "refined"
kind = "strehl"
refocus = false
at_least = 0.5
predicted_by = "strehl"
"""


@pytest.fixture
def store_path(write_study, full_study, tmp_path):
    run_study(load_study(write_study(full_study + DEAR)), tmp_path / "a.db", workers=1, trials=6)
    return tmp_path / "a.db"


def test_the_difference_is_that_of_the_trials_with_both_scores(store_path):
    with open_store(store_path) as store:
        (found,) = approximations(store)
        trials, dear = store.trials(), store.high_fidelity()
        study = store.study
    column = [m.label for m in study.merits].index("strehl")
    differences = [
        abs(score - trials.scores[trial, column])
        for trial, (score,) in zip(dear.trials, dear.scores, strict=True)
    ]
    differences = [one for one in differences if np.isfinite(one)]
    assert len(differences) == found.trials >= 3
    assert found.largest == max(differences) > 0.0
    assert found.root_mean_square == pytest.approx(np.sqrt(np.mean(np.square(differences))))
    assert found.sentence.startswith("refined is approximated by strehl")
    (unknown,) = approximations_of(study, trials, None)
    assert "has not been measured" in unknown.sentence


def test_sensitivities_say_what_they_approximate(store_path):
    run = CliRunner().invoke(app, ["sensitivity", str(store_path)])
    assert run.exit_code == 0
    assert "refined is approximated by strehl" in run.output
    result = json.loads(CliRunner().invoke(app, ["sensitivity", str(store_path), "--json"]).output)
    assert result["approximated"][0]["high_fidelity"] == "refined"


def test_a_study_without_dear_merits_approximates_nothing(small_store):
    assert approximations(small_store) == ()
