"""Trials with multiplied tolerances: the lenses of the study's own trials, with larger or smaller errors."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign.errors import DesignError
from tolerancing import load_study, open_store, run_study
from tolerancing.merits.context import Context
from tolerancing.study.evaluate import sample_perturbations
from tolerancing.study.scaled_trials import SCALED_TRIALS

TABLE = "[scaled_trials]\nfactors = [0.5, 2.0]\ntrials = 4\n"


def test_a_scaled_trial_is_the_trial_with_multiplied_deviations(write_study, ray_study):
    loaded = load_study(write_study(ray_study + TABLE))
    study = loaded.study
    (series,) = [one for one in study.series if one.label == SCALED_TRIALS]
    assert len(series) == 8
    context, own = Context(loaded.lens, study.sampling), sample_perturbations(study, range(4))
    centre = np.array([p.distribution.centre for p in study.perturbations])
    for step in range(len(series)):
        where = series.coordinates(step)
        expected = centre + where["tolerance_factor"] * (own.values[int(where["trial"])] - centre)
        np.testing.assert_allclose(series.batch(context, step).values[0], expected, rtol=1e-12, atol=1e-15)


def test_a_run_stores_them(write_study, ray_study, tmp_path):
    loaded = load_study(write_study("sensitivity = false\n" + ray_study + TABLE))
    outcome = run_study(loaded, tmp_path / "study.db", trials=3, workers=1)
    assert outcome.steps_run >= 8
    with open_store(tmp_path / "study.db") as store:
        found = [step for step in store.steps() if step.series == SCALED_TRIALS]
    assert sorted({step.coordinates["tolerance_factor"] for step in found}) == [0.5, 2.0]
    assert all(np.isfinite(score) for step in found for score in step.scores.values())


@pytest.mark.parametrize("factors", ["[1.0]", "[0.5, 0.5]", "[-1.0]", "[]"])
def test_impossible_factors_are_refused(write_study, ray_study, factors):
    with pytest.raises(DesignError, match="factors"):
        load_study(write_study(ray_study + f"[scaled_trials]\nfactors = {factors}\n"))
