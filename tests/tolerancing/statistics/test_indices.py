"""Variance-based indices against closed forms, through the lens and without."""

import numpy as np
import pytest

from lensdesign import InputError
from tolerancing.statistics import indices as module
from tolerancing.statistics.indices import IndicesError, most_trials, variance_indices
from tolerancing.statistics.scorer import StudyScorer
from tolerancing.study.evaluate import context_of
from tolerancing.study.files import load_study


@pytest.fixture
def loaded(write_study, ray_study):
    return load_study(write_study(ray_study))


def scored_by(function, monkeypatch):
    """The study's merit replaced by a function of its deltas, shape (n, 2)."""
    monkeypatch.setattr(module, "StudyScorer", lambda context, study, report: lambda values: function(values))


def test_indices_of_a_product_are_those_of_its_closed_form(loaded, monkeypatch):
    """f = a + b + c a b of independent deviates of unit variance: 1, 1 and c^2 of 2 + c^2."""
    spread = [p.distribution.standard_deviation for p in loaded.study.perturbations]

    def function(values):
        a, b = (values / spread).T
        return (a + b + 0.8 * a * b)[:, None]

    scored_by(function, monkeypatch)
    found, whole = variance_indices(loaded, 2048), 2.64
    assert found.trials == most_trials(loaded.study, 2048) == 2048 * 4
    assert found.first[:, 0] == pytest.approx([1.0 / whole] * 2, abs=0.03)
    assert found.total[:, 0] == pytest.approx([1.64 / whole] * 2, abs=0.03)
    assert found.products[0] == pytest.approx(0.64 / whole, abs=0.05)
    assert np.all((found.total_half_width > 0.0) & (found.total_half_width < 0.1))
    assert found.standard_deviation[0] == pytest.approx(np.sqrt(whole), rel=0.05)


def test_a_merit_that_does_not_vary_has_none(loaded, monkeypatch):
    scored_by(lambda values: np.full((len(values), 1), 3.0), monkeypatch)
    found = variance_indices(loaded, 16)
    assert np.all(np.isnan(found.first))
    assert np.all(np.isnan(found.total))
    (own,) = found.as_dict().values()
    assert own["indices"][0]["first"] is None


def test_rays_of_the_lens_give_the_indices_of_a_plain_estimate(loaded):
    """First order by the variance of means in strata of plain trials (McKay 1995)."""
    found = variance_indices(loaded, 512)
    shapes = [p.distribution for p in loaded.study.perturbations]
    drawn = np.random.default_rng(3).random((6000, len(shapes)))
    values = np.column_stack([s.quantile(drawn[:, k]) for k, s in enumerate(shapes)])
    scores = StudyScorer(context_of(loaded.lens, loaded.study), loaded.study)(values)[:, 0]
    for k in range(len(shapes)):
        means = [part.mean() for part in np.array_split(scores[np.argsort(drawn[:, k])], 30)]
        own = np.var(means) / np.var(scores) - 30 / 6000
        assert found.first[k, 0] == pytest.approx(own, abs=0.06)


def test_what_has_no_indices_is_refused(loaded, write_study, ray_study):
    with pytest.raises(InputError, match=r"base = 100.*power of two"):
        variance_indices(loaded, 100)
    first, _ = loaded.study.perturbations
    alone = loaded.study.model_copy(update={"perturbations": (first,)})
    with pytest.raises(InputError, match="one perturbation"):
        variance_indices(type(loaded)(**{**vars(loaded), "study": alone}), 16)
    text = ray_study.replace("[[perturbation]]", '[[perturbation]]\ngroup = "both"')
    grouped = load_study(write_study(text))
    with pytest.raises(InputError, match="scatter together"):
        variance_indices(grouped, 16)


def test_a_trial_without_a_score_leaves_no_indices(loaded, monkeypatch):
    scored_by(lambda values: np.where(np.arange(len(values)) == 3, np.nan, 1.0)[:, None], monkeypatch)
    with pytest.raises(IndicesError, match="1 of 64 trials"):
        variance_indices(loaded, 16)
