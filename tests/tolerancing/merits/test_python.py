"""A user's own merit: what it is given, and what goes wrong."""

import pickle
import signal

import numpy as np
import pytest

from lensdesign import DesignError, InputError, trust_user_code
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
    assert trial.lens.half_field_mm == 1.5 and trial.placement is trial.state
    assert trial.rays((0.0, 0.0)).ok.shape[0] == 1
    return trial.state.pose.tilt_x_deg + trial.deltas["lens_tilt_x_deg"]


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
    with trust_user_code():
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
    assert (merit.unit, merit.column, merit.limit_text) == ("deg", "tilt_deg", "at least 0°")


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
def test_files_without_the_function_are_refused_before_the_first_trial(tmp_path, name, source, message):
    with pytest.raises(DesignError, match=message):
        own(tmp_path, name, source).prepare()


def test_reading_runs_nothing(tmp_path, context, batch):
    """Neither a file, nor a merit without consent, nor one whose code has failed."""
    merit = own(tmp_path, "tilt", f"open({str(tmp_path / 'run')!r}, 'w')\n" + SOURCE)
    untrusted = merit_from_table(merit.model_dump(exclude_unset=True) | {"kind": "python"}, "here").loaded(
        tmp_path
    )
    for one in (untrusted, pickle.loads(pickle.dumps(untrusted))):
        with pytest.raises(InputError, match="--trust"):
            one.prepare()
        with pytest.raises(InputError, match="--trust"):
            one.scores(context, batch)
    with pytest.raises(InputError, match="a stranger's"):
        merit.without_user_code("a stranger's").prepare()
    with pytest.raises(InputError, match="a stranger's"):
        pickle.loads(pickle.dumps(merit.without_user_code("a stranger's"))).scores(context, batch)
    assert not (tmp_path / "run").exists()
    merit.prepare()
    assert (tmp_path / "run").exists()


WAYS_OUT = """
import os
import sys


class Own(BaseException):
    def __str__(self):
        raise Own


class Number:
    def __float__(self):
        sys.exit(0)


def leave(trial):
    tilt = trial.deltas["lens_tilt_x_deg"]
    if tilt == 0.0:
        sys.exit(0)
    if tilt == 0.05:
        raise GeneratorExit
    if tilt == 0.1:
        raise Own
    if tilt == 0.15:
        raise ValueError("\\ud800\\x1b[31m")
    return Number()


def huge(trial):
    sizes = {0.0: 1.7e308, 0.05: -1.7e308, 0.1: float("inf"), 0.15: 10**400, -0.05: 1e100}
    return sizes[trial.deltas["lens_tilt_x_deg"]]
"""


def test_whatever_leaves_the_program_is_that_trials_failure(tmp_path, context, batch):
    scores, messages = score_batch([own(tmp_path, "leave", WAYS_OUT)], context, batch)
    assert np.all(np.isnan(scores))
    assert messages == (
        "python: SystemExit: 0: a merit must not end the run (mine.py, line 19)",
        "python: GeneratorExit:  (mine.py, line 21)",
        "python: Own: no message (its __str__ failed) (mine.py, line 23)",
        r"python: ValueError: \ud800\x1b[31m (mine.py, line 25)",
        "python: SystemExit: 0: a merit must not end the run (mine.py, line 13)",
    )


def test_scores_too_large_to_be_counted_with_are_failures(tmp_path, context, batch):
    scores, messages = score_batch([own(tmp_path, "huge", WAYS_OUT)], context, batch)
    assert scores[-1, 0] == 1e100
    assert np.all(np.isnan(scores[:-1]))
    assert [message.partition("returned ")[2] for message in messages] == [
        "1.7e+308: must lie within +-1e+100",
        "-1.7e+308: must lie within +-1e+100",
        "inf: must lie within +-1e+100",
        "inf: must lie within +-1e+100",
        "",
    ]


@pytest.mark.parametrize("way", ["sys.exit(0)", "raise KeyError('x')", "class B(BaseException): 0\nraise B"])
def test_a_file_that_leaves_the_program_is_refused(tmp_path, way):
    with pytest.raises(DesignError, match=r"mine.py: cannot be run: "):
        own(tmp_path, "tilt", f"import os, sys\n{way}\n{SOURCE}").prepare()


def test_interrupts_pass(tmp_path, context, batch):
    merit = own(
        tmp_path, "tilt", "import signal\ndef tilt(trial):\n    signal.raise_signal(signal.SIGUSR1)\n"
    )

    def stop(number, frame):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGUSR1, stop)
    try:
        with pytest.raises(KeyboardInterrupt):
            score_batch([merit], context, batch)
    finally:
        signal.signal(signal.SIGUSR1, before)
