"""One trial again: the same numbers as stored, and its picture."""

import numpy as np
import pytest
from tests_studies import DESIGN, FULL_STUDY

from lensdesign.errors import InputError
from tolerancing.analysis.trial import single_trial, trial_figure, write_trial_figure
from tolerancing.run.run import run_study
from tolerancing.store.store import open_store
from tolerancing.study.files import load_study


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    folder = tmp_path_factory.mktemp("single")
    (folder / "design.toml").write_text(DESIGN)
    (folder / "study.toml").write_text(FULL_STUDY)
    run_study(load_study(folder / "study.toml"), folder / "a.db", workers=1, trials=6)
    # What the store says must not depend on the files that it was made from.
    (folder / "design.toml").unlink()
    (folder / "study.toml").unlink()
    with open_store(folder / "a.db") as opened:
        yield opened


@pytest.mark.parametrize("number", [0, 5])
def test_a_trial_comes_out_again_to_the_last_bit(store, number):
    trial = single_trial(store, number)
    assert trial.same is True
    assert np.array_equal(trial.again.values[0], store.trials().values[number])
    data = trial.as_dict()
    assert data["scores"] == data["stored_scores"]
    assert data["deviations"]["lens_decenter_y_mm"] == trial.again.values[0, 0]
    assert set(data["extras"]) == {"strehl_uncompensated"}


def test_a_planned_trial_that_is_not_there_yet_is_drawn_all_the_same(store):
    store.plan(8)
    trial = single_trial(store, 7)
    assert trial.stored is None
    assert trial.same is None
    assert np.all(np.isfinite(trial.again.scores))


@pytest.mark.parametrize("number", [-1, 8, 10**9])
def test_trials_that_are_not_planned_are_refused(store, number):
    store.plan(8)
    with pytest.raises(InputError, match=f"trial = {number}: the study has trials 0 to 7"):
        single_trial(store, number)


def test_the_picture_shows_each_field_point(store, tmp_path):
    trial = single_trial(store, 2)
    figure = trial_figure(trial)
    titles = [axis.get_title() for axis in figure.axes if axis.get_title()]
    assert len(titles) == 3
    assert f"Strehl {trial.again.scores[0, 1]:.3f}" in titles[1]
    write_trial_figure(trial, tmp_path / "trial.png")
    assert (tmp_path / "trial.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="suffix must be one of"):
        write_trial_figure(trial, tmp_path / "trial.jpeg")
    assert not (tmp_path / "trial.jpeg").exists()
