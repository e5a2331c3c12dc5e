"""Runs: the same rows whoever made them, resumed where they stopped, failures stored."""

import os
import pickle
import sqlite3
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pytest
from stored_rows import TABLES, rows

import tolerancing.run.executors as executors
import tolerancing.run.run as module
from lensdesign import InputError
from tolerancing.merits.rays import LargestSpread
from tolerancing.run.run import RunError, run_study
from tolerancing.run.tasks import Task, chosen_trials, high_fidelity_counts
from tolerancing.store.store import open_store
from tolerancing.study.files import load_study

DEAR = """
[fidelity]
worst_share = 0.1
random_share = 0.05

[[merit]]
name = "fine_contrast"
kind = "line_pair_contrast"
line_width_um = 1.0
at_least = 0.3
predicted_by = "largest_spread_deg"
"""


@pytest.fixture
def full(write_study, full_study):
    return load_study(write_study(full_study + DEAR))


@pytest.fixture
def rays(write_study, ray_study, monkeypatch):
    """A study of rays, its 40 trials cut into chunks of 8."""
    monkeypatch.setattr(LargestSpread, "trials_per_chunk", 8)
    return load_study(write_study("sensitivity = false\n" + ray_study))


def test_one_and_two_workers_make_the_same_rows(full, tmp_path):
    one = run_study(full, tmp_path / "one", workers=1)
    two = run_study(full, tmp_path / "two", workers=2)
    assert (one.workers, two.workers) == (1, 2)
    assert (one.trials_run, one.steps_run, one.high_fidelity_run) == (40, 11, 6)
    assert (two.trials_run, two.steps_run, two.high_fidelity_run) == (40, 11, 6)
    made = rows(tmp_path / "one")
    assert [len(made[table]) for table in TABLES] == [40, 6, 25, 2, 3, 2]
    assert made == rows(tmp_path / "two")


def test_broken_run_goes_on_with_what_is_missing(rays, tmp_path):
    class Killed(BaseException):
        pass

    def kill(done, total):
        if done >= 16:
            raise Killed

    path = tmp_path / "store"
    with pytest.raises(Killed):
        run_study(rays, path, workers=1, progress=kill)
    with open_store(path) as store:
        assert store.trials().trials.tolist() == list(range(16))
    seen = []
    outcome = run_study(rays, path, workers=1, progress=lambda done, total: seen.append((done, total)))
    assert outcome.trials_run == 24
    assert seen == [(8, 24), (16, 24), (24, 24)]
    assert run_study(rays, path, workers=1).trials_run == 0
    run_study(rays, tmp_path / "whole", workers=1)
    assert rows(path) == rows(tmp_path / "whole")


def test_gaps_in_a_store_are_filled(rays, tmp_path):
    run_study(rays, tmp_path / "whole", workers=1)
    run_study(rays, tmp_path / "gaps", workers=1)
    with sqlite3.connect(tmp_path / "gaps") as connection:
        connection.execute("DELETE FROM trial WHERE trial IN (0, 3, 21)")
    connection.close()
    assert run_study(rays, tmp_path / "gaps", workers=1).trials_run == 3
    assert rows(tmp_path / "gaps") == rows(tmp_path / "whole")


def test_more_trials_extend_a_store_and_fewer_take_none_away(rays, tmp_path):
    path = tmp_path / "store"
    assert run_study(rays, path, workers=1, trials=10).trials_run == 10
    assert run_study(rays, path, workers=1).trials_run == 30
    assert run_study(rays, path, workers=1, trials=5).trials_run == 0
    with open_store(path) as store:
        assert store.record().planned_trials == 40
    run_study(rays, tmp_path / "whole", workers=1)
    assert rows(path) == rows(tmp_path / "whole")


def test_another_study_is_refused_unless_fresh(rays, write_study, ray_study, tmp_path):
    path = tmp_path / "store"
    run_study(rays, path, workers=1)
    before = path.read_bytes()
    other = load_study(write_study(ray_study.replace("seed = 7", "seed = 8")))
    with pytest.raises(InputError, match="holds another study"):
        run_study(other, path, workers=1)
    assert path.read_bytes() == before
    assert run_study(other, path, workers=1, fresh=True).trials_run == 40
    with open_store(path) as store:
        assert store.record().fingerprint == other.fingerprint


def test_another_version_of_the_toolkit_is_refused(rays, tmp_path, monkeypatch):
    run_study(rays, tmp_path / "store", workers=1)
    monkeypatch.setattr(module, "toolkit_version", lambda: "99.0")
    with pytest.raises(InputError, match=r"version .* of the toolkit, this is version 99\.0"):
        run_study(rays, tmp_path / "store", workers=1)


@pytest.mark.parametrize("fresh", [False, True])
def test_other_files_are_never_overwritten(rays, tmp_path, fresh):
    path = tmp_path / "notes.txt"
    path.write_text("mine")
    with pytest.raises(InputError, match="no store"):
        run_study(rays, path, workers=1, fresh=fresh)
    assert path.read_text() == "mine"


def test_unwritable_place_is_an_input_error(rays, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        run_study(rays, tmp_path / "file" / "store", workers=1)


@pytest.mark.parametrize("keys", [{"workers": 0}, {"trials": 0}, {"trials": 10**20}])
def test_counts_must_be_positive(rays, tmp_path, keys):
    with pytest.raises(InputError, match="at least 1"):
        run_study(rays, tmp_path / "store", **{"workers": 1} | keys)
    assert not (tmp_path / "store").exists()


def test_nominal_lens_that_cannot_be_scored_stops_before_a_store_is_made(write_study, full_study, tmp_path):
    text = full_study.replace("line_widths_um = [1.0]", "line_widths_um = [50.0]")
    with pytest.raises(InputError, match="µm wide"):
        run_study(load_study(write_study(text)), tmp_path / "store", workers=1)
    assert not (tmp_path / "store").exists()


def test_failing_trials_are_stored_and_count_as_bad(rays, tmp_path, monkeypatch):
    original = LargestSpread.scores

    def scores(self, context, batch):
        if (batch.values[:, 0] > 0.03).any():
            raise RuntimeError("a fault")
        return original(self, context, batch)

    run_study(rays, tmp_path / "whole", workers=1)
    monkeypatch.setattr(LargestSpread, "scores", scores)
    run_study(rays, tmp_path / "faults", workers=1)
    with open_store(tmp_path / "faults") as faults, open_store(tmp_path / "whole") as whole:
        bad, good = faults.trials(), whole.trials()
    hit = good.values[:, 0] > 0.03
    assert 0 < hit.sum() < 20
    assert [s == "failed" for s in bad.status] == hit.tolist()
    assert set(bad.messages) == {"", "largest_spread_deg: RuntimeError: a fault"}
    assert not bad.passed[hit].any()
    assert bad.scores[~hit].tolist() == good.scores[~hit].tolist()


def test_dead_worker_is_told_plainly():
    future = Future()
    future.set_exception(BrokenProcessPool("gone"))
    with pytest.raises(RunError, match=r"worker.*died"):
        executors.result(future)


class Bomb:
    """A task that ends whatever process unpickles it."""

    trials, chosen, size = (), (), 1

    def __reduce__(self):
        return os._exit, (1,)


def test_worker_that_dies_leaves_a_store_that_goes_on(rays, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "missing_trials", lambda *_, **__: iter([Bomb(), Bomb()]))
    with pytest.raises(RunError, match=r"worker.*died"):
        run_study(rays, tmp_path / "store", workers=2)
    monkeypatch.undo()
    assert run_study(rays, tmp_path / "store", workers=1).trials_run == 40


def test_dear_merits_score_the_worst_and_some_others(full, tmp_path):
    path = tmp_path / "store"
    run_study(full, path, workers=1)
    with open_store(path) as store:
        dear, spread = store.high_fidelity(), store.scores("largest_spread_deg", 40)
        chosen = chosen_trials(store.study, spread)
        assert store.study.fidelity.worst_share == 0.1
    worst = {t for t, why in zip(dear.trials, dear.chosen, strict=True) if why == "worst"}
    assert worst == set(np.argsort(-spread)[:4].tolist()) == set(chosen.worst.tolist())
    assert set(dear.trials) - worst == set(chosen.random.tolist())
    assert np.isfinite(dear.scores).all()


def test_dear_merits_wait_for_all_trials_and_follow_more_trials(full, tmp_path):
    class Killed(BaseException):
        pass

    def kill(done, total):
        if done >= 40:
            raise Killed

    path = tmp_path / "store"
    with pytest.raises(Killed):
        run_study(full, path, workers=1, progress=kill)
    with open_store(path) as store:
        assert 0 < store.trial_count() < 40
        assert len(store.high_fidelity()) == 0
    assert run_study(full, path, workers=1).high_fidelity_run == 6
    outcome = run_study(full, path, workers=1, trials=80)
    assert outcome.trials_run == 40
    run_study(full, tmp_path / "whole", workers=1, trials=80)
    with open_store(path) as store, open_store(tmp_path / "whole") as whole:
        assert set(whole.high_fidelity().trials) <= set(store.high_fidelity().trials)
        assert len(whole.high_fidelity()) == 12
        assert len(store.high_fidelity()) == 6 + outcome.high_fidelity_run


@pytest.mark.parametrize(
    ("shares", "trials", "counts"),
    [
        ((0.1, 0.05), 40, (4, 2)),
        ((0.01, 0.01), 10, (1, 1)),
        ((0.0, 0.5), 10, (0, 5)),
        ((1.0, 1.0), 7, (7, 0)),
    ],
)
def test_shares_of_trials_for_the_dear_merits(full, shares, trials, counts):
    fidelity = full.study.fidelity.model_copy(update={"worst_share": shares[0], "random_share": shares[1]})
    assert high_fidelity_counts(full.study.model_copy(update={"fidelity": fidelity}), trials) == counts


def test_two_runs_on_one_store_share_the_work(rays, tmp_path):
    path, inner = tmp_path / "store", []

    def second(done, total):
        if not inner:
            inner.append(run_study(rays, path, workers=1))

    outer = run_study(rays, path, workers=1, progress=second)
    assert (outer.trials_run, inner[0].trials_run) == (8, 32)
    run_study(rays, tmp_path / "whole", workers=1)
    assert rows(path) == rows(tmp_path / "whole")


def test_few_tasks_are_in_flight_at_a_time():
    drawn, seen = [], []

    def submit(task):
        future = Future()
        future.set_result(task.trials[0])
        return future

    def tasks():
        for trial in range(100):
            drawn.append(trial)
            yield Task(trials=(trial,))

    for batch in executors.in_flight(submit, tasks(), lambda: 2):
        seen += [row for _, row in batch]
        assert len(drawn) - len(seen) <= 2 * executors.TASKS_IN_FLIGHT
    assert sorted(seen) == drawn == list(range(100))


def test_what_others_finished_is_handed_over_before_a_failure_is_told():
    good, bad = Future(), Future()
    good.set_result("row")
    bad.set_exception(BrokenProcessPool("gone"))
    futures = iter([bad, good])
    batches = executors.in_flight(lambda _: next(futures), [Task((1,)), Task((2,))], lambda: 1)
    assert next(batches) == [(Task((2,)), "row")]
    with pytest.raises(RunError, match=r"worker.*died"):
        next(batches)


def test_a_task_falls_into_its_trials():
    assert Task((3, 4), ("worst", "random")).single_trials() == [
        Task((3,), ("worst",)),
        Task((4,), ("random",)),
    ]
    assert Task((3, 4)).single_trials() == [Task((3,)), Task((4,))]
    assert Task(series=1, step=2).single_trials() == [Task(series=1, step=2)]


def test_a_study_in_memory_of_another_machine_goes_to_workers_whole(full):
    again = pickle.loads(pickle.dumps(full))
    assert again.fingerprint == full.fingerprint
    assert again.study == full.study
