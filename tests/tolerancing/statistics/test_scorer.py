"""Scores for any deltas."""

import numpy as np
import pytest

from tolerancing.perturbations.distributions import Normal, Parabolic, Triangular, Uniform
from tolerancing.statistics.scorer import StudyScorer, scatter_of
from tolerancing.study.evaluate import context_of, sample_perturbations, score_trials
from tolerancing.study.files import load_study


@pytest.fixture
def loaded(write_study, full_study):
    return load_study(write_study(full_study))


def test_it_scores_the_trials_as_a_run_does(loaded):
    context = context_of(loaded.lens, loaded.study)
    counted = []
    scorer = StudyScorer(context, loaded.study, counted.append)
    values = sample_perturbations(loaded.study, range(70)).values
    scores = scorer(values)
    assert np.array_equal(scores[:5], score_trials(context, loaded.study, range(5)).scores)
    assert counted == [64, 6]
    assert scorer(values[:0]).shape == (0, 2)


def test_scatter_is_that_of_the_distributions(loaded):
    scatter = scatter_of(loaded.study)
    assert scatter.tolerance == pytest.approx([0.04, 0.02])
    assert scatter.standard_deviation == pytest.approx([0.02, 0.0088], rel=0.01)


@pytest.mark.parametrize(
    ("shape", "kurtosis"),
    [
        (Normal(sigma=2.0), 3.0),
        (Uniform(half_width=3.0, mean=1.0), 1.8),
        (Triangular(half_width=1.0), 2.4),
        (Parabolic(half_width=1.0), 15.0 / 7.0),
    ],
)
def test_kurtosis_is_the_known_one(loaded, shape, kurtosis):
    perturbations = tuple(p.model_copy(update={"distribution": shape}) for p in loaded.study.perturbations)
    study = loaded.study.model_copy(update={"perturbations": perturbations})
    assert scatter_of(study).kurtosis == pytest.approx([kurtosis, kurtosis], rel=0.01)
