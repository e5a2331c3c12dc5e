"""One trial again: the same numbers as stored."""

import numpy as np
import pytest

from lensdesign.errors import InputError
from tolerancing.statistics.trial import single_trial


@pytest.mark.parametrize("number", [0, 5])
def test_a_trial_comes_out_again_to_the_last_bit(small_store, number):
    trial = single_trial(small_store, number)
    assert trial.same is True
    assert np.array_equal(trial.again.values[0], small_store.trials().values[number])
    data = trial.as_dict()
    assert data["scores"] == data["stored_scores"]
    assert data["deviations"]["lens_decenter_y_mm"] == trial.again.values[0, 0]
    assert set(data["extras"]) == {"strehl_uncompensated"}


def test_a_planned_trial_that_is_not_there_yet_is_drawn_all_the_same(small_store):
    small_store.plan(8)
    trial = single_trial(small_store, 7)
    assert trial.stored is None
    assert trial.same is None
    assert np.all(np.isfinite(trial.again.scores))


@pytest.mark.parametrize("number", [-1, 8, 10**9])
def test_trials_that_are_not_planned_are_refused(small_store, number):
    small_store.plan(8)
    with pytest.raises(InputError, match=f"trial = {number}: the study has trials 0 to 7"):
        single_trial(small_store, number)
