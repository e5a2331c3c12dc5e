"""Levels: the cheapest that agrees with the dearest, decided by trials that all levels score."""

import numpy as np
import pytest

from tolerancing.study.evaluate import context_of, decide_levels, sample_perturbations
from tolerancing.study.files import load_study

CONTRAST = """
[[merit]]
name = "contrast"
kind = "line_pair_contrast"
line_width_um = 1.0
at_least = 0.5
"""


@pytest.fixture
def study_with(write_study, full_study):
    def make(keys="", sigma=0.02):
        text = full_study.replace("sigma = 0.02", f"sigma = {sigma}").replace("= 64", "= 192")
        text += CONTRAST + keys
        return load_study(write_study(text))

    return make


def test_levels_without_a_choice_are_what_they_are(study_with):
    loaded = study_with('level = "wave"')
    assert decide_levels(loaded.lens, loaded.study) == {
        "largest_spread_deg": "ray",
        "strehl": "pupil",
        "contrast": "wave",
    }


def test_auto_takes_the_pupil_where_it_agrees_with_waves(study_with):
    loaded = study_with(sigma=0.002)
    assert decide_levels(loaded.lens, loaded.study)["contrast"] == "pupil"
    context, batch = context_of(loaded.lens, loaded.study), sample_perturbations(loaded.study, range(6))
    scores = [
        loaded.study.with_levels({"contrast": level}).merits[-1].scores(context, batch)
        for level in ("pupil", "wave")
    ]
    assert np.abs(scores[0] - scores[1]).max() <= 0.03


def test_auto_takes_waves_where_the_pupil_does_not_agree(study_with):
    loaded = study_with("field_mm = [0.0, 1.2]\n\n[fidelity]\nlargest_difference = 0.001", sigma=0.05)
    context, batch = context_of(loaded.lens, loaded.study), sample_perturbations(loaded.study, range(6))
    scores = [
        loaded.study.with_levels({"contrast": level}).merits[-1].scores(context, batch)
        for level in ("pupil", "wave")
    ]
    agree = np.abs(scores[0] - scores[1]).max() <= 0.001
    assert decide_levels(loaded.lens, loaded.study)["contrast"] == ("pupil" if agree else "wave")
    assert not agree


def test_what_only_waves_can_do_needs_no_probe(study_with):
    noisy = study_with("electrons = 10000.0")
    assert decide_levels(noisy.lens, noisy.study)["contrast"] == "wave"
    wide = study_with("patch_um = 5.0")
    assert decide_levels(wide.lens, wide.study)["contrast"] == "pupil"


def test_noise_is_that_of_the_trial(study_with):
    loaded = study_with("electrons = 10.0\npatch_um = 12.0")
    merit = loaded.study.merits[-1]
    context = context_of(loaded.lens, loaded.study)
    together = merit.scores(context, sample_perturbations(loaded.study, range(3)))
    alone = [merit.scores(context, sample_perturbations(loaded.study, [trial]))[0] for trial in range(3)]
    assert together.tolist() == alone
    quiet = loaded.study.with_levels({}).merits[-1].model_copy(update={"electrons": None})
    assert np.all(quiet.scores(context, sample_perturbations(loaded.study, range(3))) != together)
