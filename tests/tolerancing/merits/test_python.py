"""A user's own merit: what it is given, and what goes wrong."""

import pickle

import numpy as np
import pytest

from lensdesign import DesignError
from tolerancing.merits.context import Context, Sampling
from tolerancing.merits.registry import merit_from_table
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.study.scoring import score_batch

SOURCE = """
import math


def sum_of_strehls(trial):
    from wavesim import strehl

    return sum(strehl(trial.pupil(point)) for point in ((0.0, 0.0), (0.0, 1.0)))


def tilt(trial):
    assert trial.lens.half_field_mm == 1.5
    assert trial.rays((0.0, 0.0)).ok.shape[0] == 1
    return trial.placement.pose.tilt_x_deg + trial.deltas["lens_tilt_x_deg"]


def fussy(trial):
    tilt = trial.deltas["lens_tilt_x_deg"]
    if tilt > 0.125:
        raise RuntimeError("too steep")
    return math.nan if tilt > 0.075 else ("text" if tilt < 0.0 else tilt)


not_callable = 3
"""

TILTS = np.array([[0.0], [0.05], [0.1], [0.15], [-0.05]])


@pytest.fixture
def context(paper_lens):
    return Context(paper_lens, Sampling(rings=2, arms=6, pupil_samples=64))


@pytest.fixture
def batch():
    return PerturbationBatch((PerturbedParameter(target="lens", parameter="tilt_x_deg"),), TILTS)


def own(tmp_path, name, source=SOURCE):
    (tmp_path / "mine.py").write_text(source)
    table = {"kind": "python", "function": f"mine.py:{name}", "at_least": 0.0}
    return merit_from_table(table, "here").loaded(tmp_path)


def test_a_trial_offers_lens_rays_and_pupils(tmp_path, context, batch):
    assert own(tmp_path, "tilt").scores(context, batch) == pytest.approx(2.0 * TILTS[:, 0])
    strehls = [
        merit_from_table({"kind": "strehl", "at_least": 0.0, "field_mm": point}, "here")
        for point in ([0.0, 0.0], [0.0, 1.0])
    ]
    expected = np.sum([merit.scores(context, batch) for merit in strehls], axis=0)
    assert own(tmp_path, "sum_of_strehls").scores(context, batch).tolist() == expected.tolist()


def test_what_it_raises_and_nan_are_that_trials_failure(tmp_path, context, batch):
    scores, messages = score_batch([own(tmp_path, "fussy")], context, batch)
    assert scores[:2, 0].tolist() == [0.0, 0.05]
    assert np.all(np.isnan(scores[2:, 0]))
    assert messages == (
        "",
        "",
        "python: mine.py:fussy returned NaN",
        "python: RuntimeError: too steep (mine.py, line 20)",
        "python: mine.py:fussy returned str: must be a number",
    )


def test_scores_have_the_unit_that_is_given(tmp_path):
    (tmp_path / "mine.py").write_text(SOURCE)
    table = {"kind": "python", "function": "mine.py:tilt", "at_least": 0.0, "score_unit": "deg"}
    merit = merit_from_table(table | {"name": "tilt"}, "here")
    assert (merit.unit, merit.column, merit.limit_text) == ("deg", "tilt_deg", "at least 0 deg")


def test_it_travels_to_other_processes(tmp_path, context, batch):
    merit = pickle.loads(pickle.dumps(own(tmp_path, "tilt")))
    (tmp_path / "mine.py").unlink()
    assert merit.scores(context, batch) == pytest.approx(2.0 * TILTS[:, 0])


@pytest.mark.parametrize(
    ("name", "source", "message"),
    [
        ("none", SOURCE, "mine.py: there is no function 'none'"),
        ("not_callable", SOURCE, "mine.py: there is no function 'not_callable'"),
        ("tilt", "def tilt(:", "mine.py: cannot be run: SyntaxError"),
        ("tilt", "1 / 0", "mine.py: cannot be run: ZeroDivisionError"),
    ],
)
def test_files_without_the_function_are_refused(tmp_path, name, source, message):
    with pytest.raises(DesignError, match=message):
        own(tmp_path, name, source)
