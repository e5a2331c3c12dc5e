"""Sensitivities that a store's steps give."""

import json

import numpy as np
import pytest

from lensdesign.errors import InputError
from tolerancing.statistics.scorer import StudyScorer
from tolerancing.statistics.sensitivities import StudySensitivity, sensitivity, study_sensitivities
from tolerancing.study.evaluate import context_of, nominal_scores, score_step
from tolerancing.study.files import load_study


@pytest.fixture
def loaded(write_study, full_study):
    return load_study(write_study(full_study))


def test_sensitivities_are_those_of_the_steps(loaded):
    study, context = loaded.study, context_of(loaded.lens, loaded.study)
    number = len(study.series) - 1
    steps = [score_step(context, study, number, step) for step in range(8)]
    nominal = nominal_scores(context, study)
    found = study_sensitivities(study, nominal, steps)
    scorer = StudyScorer(context, study)
    (far,) = scorer(np.array([[0.04, 0.0]]))
    assert found.change[0, -1] == pytest.approx(far - list(nominal.values()), abs=1e-14)
    small = 1e-4
    ends = scorer(np.array([[0.0, small], [0.0, -small]]))
    assert found.derivative[1, 0] == pytest.approx((ends[0, 0] - ends[1, 0]) / (2.0 * small), rel=0.03)
    with pytest.raises(InputError, match="holds 7 of 8 steps"):
        study_sensitivities(study, nominal, steps[:-1])
    with pytest.raises(InputError, match="sensitivity = false"):
        study_sensitivities(study.model_copy(update={"sensitivity": False}), nominal, steps)


@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_what_a_lost_step_leaves_unknown_is_null(small_store, lost):
    steps = small_store.steps()
    for step in steps:
        step.scores["strehl"] = lost
    nominal = small_store.nominal() | {"strehl": lost}
    found = study_sensitivities(small_store.study, nominal, steps)
    told = StudySensitivity(small_store.study, found, ())
    assert all(row["derivative"] is None for row in told.as_dict()["strehl"])
    json.dumps(told.as_dict(), allow_nan=False)


def test_a_store_tells_its_sensitivities(small_store):
    told = sensitivity(small_store)
    assert np.array_equal(
        told.found.change,
        study_sensitivities(told.study, small_store.nominal(), small_store.steps()).change,
    )
    rows = told.as_dict()["strehl"]
    assert [row["perturbation"] for row in rows] == ["lens_decenter_y_mm", "shop_radius_mm"]
    assert told.compared[1].mean == pytest.approx(small_store.trials().scores[:, 1].mean())
