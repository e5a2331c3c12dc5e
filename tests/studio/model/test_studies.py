"""A study from the page: its trials, and what a trial's lens is off by."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from lensdesign import Lens
from studio.model.built import manufacturing_quality
from studio.model.studies import run_trials, study_progress, trial_what_if
from tolerancing import open_store, summarize
from wavesim import PupilSampler, refocus, rms_waves


def test_a_trial_is_seen_as_it_was_scored(paper_lens: Lens, tmp_path: Path) -> None:
    made = manufacturing_quality("high_precision", paper_lens)
    coarse = made.study.sampling.model_copy(update={"pupil_samples": 48})
    plain = {"sampling": coarse, "sensitivity": False, "compensators": ()}
    made = replace(made, study=made.study.model_copy(update=plain))
    assert study_progress(tmp_path) is None
    assert run_trials(paper_lens, made, 4, tmp_path, lambda _: None) == 4
    found = study_progress(tmp_path)
    assert found is not None
    assert list(found.trials.trials) == [0, 1, 2, 3]
    with open_store(tmp_path / "study.db") as store:
        own = summarize(store)
    assert found.summary.good == own.good == found.yields[-1]
    assert [one.good for one in found.summary.merits] == [one.good for one in own.merits]
    state = trial_what_if(tmp_path, 2).state(paper_lens)
    distance_mm = made.study.sampling.plane_distance_mm
    samplers = [PupilSampler(paper_lens, (0.0, h), plane_distance_mm=distance_mm) for h in (0.0, 1.05, 1.5)]
    worst = max(rms_waves(refocus(sampler.pupil(state)).pupil) for sampler in samplers)
    column = [merit.kind for merit in made.study.merits].index("rms_waves")
    assert worst == pytest.approx(found.trials.scores[2, column], rel=0.02)  # coarser pupils in the study
