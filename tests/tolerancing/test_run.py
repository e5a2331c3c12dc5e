"""Runs: the same rows whoever made them, resumed where they stopped, failures stored."""

import os
import sqlite3
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool

import pytest

import tolerancing.run as module
from lensdesign import InputError
from tolerancing.evaluate import nominal_scores
from tolerancing.ray_merits import LargestSpread
from tolerancing.run import RunError, run_study
from tolerancing.store import open_store
from tolerancing.study import load_study

TABLES = {
    "trial": "trial",
    "sweep": "sweep, step, merit",
    "picture": "sweep, step, refocused",
    "nominal": "merit",
}


def rows(path):
    """All results of a store, bit by bit."""
    with sqlite3.connect(path) as connection:
        return {
            table: connection.execute(f"SELECT * FROM {table} ORDER BY {order}").fetchall()
            for table, order in TABLES.items()
        }


@pytest.fixture
def full(write_study, full_study):
    return load_study(write_study(full_study))


@pytest.fixture
def rays(write_study, ray_study, monkeypatch):
    """A study of rays, its 40 trials cut into chunks of 8."""
    monkeypatch.setattr(LargestSpread, "trials_per_chunk", 8)
    return load_study(write_study(ray_study))


def test_one_and_two_workers_make_the_same_rows(full, tmp_path):
    one = run_study(full, tmp_path / "one", workers=1)
    two = run_study(full, tmp_path / "two", workers=2)
    assert (one.workers, two.workers) == (1, 2)
    assert (one.trials_run, one.steps_run) == (two.trials_run, two.steps_run) == (40, 3)
    made = rows(tmp_path / "one")
    assert [len(made[table]) for table in TABLES] == [40, 9, 2, 2]
    assert made == rows(tmp_path / "two")


def test_broken_run_goes_on_with_what_is_missing(rays, tmp_path):
    class Killed(BaseException):
        pass

    def kill(done, total):
        if done >= 16:
            raise Killed

    path = tmp_path / "store"
    with pytest.raises(Killed):
        run_study(rays, path, workers=1, report=kill)
    with open_store(path) as store:
        assert store.finished_trials() == set(range(16))
    seen = []
    outcome = run_study(rays, path, workers=1, report=lambda done, total: seen.append((done, total)))
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
    with pytest.raises(InputError, match=r"begun with version .*99\.0"):
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
    with pytest.raises(InputError, match="must be at least 1"):
        run_study(rays, tmp_path / "store", **{"workers": 1} | keys)
    assert not (tmp_path / "store").exists()


def test_nominal_lens_that_cannot_be_scored_stops_before_a_store_is_made(write_study, full_study, tmp_path):
    text = full_study.replace("line_widths_um = [1.0]", "line_widths_um = [50.0]")
    with pytest.raises(InputError, match="um wide"):
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
    with pytest.raises(RunError, match="a worker process died"):
        module._result(future)


class Bomb:
    """A task that ends whatever process unpickles it."""

    trials, size = (), 1

    def __reduce__(self):
        return os._exit, (1,)


def test_worker_that_dies_leaves_a_store_that_goes_on(rays, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "missing_tasks", lambda *_: [Bomb(), Bomb()])
    with pytest.raises(RunError, match="a worker process died"):
        run_study(rays, tmp_path / "store", workers=2)
    monkeypatch.undo()
    assert run_study(rays, tmp_path / "store", workers=1).trials_run == 40


def test_nominal_scores_are_those_of_an_unperturbed_lens(full):
    from tolerancing.context import Context

    scores = nominal_scores(Context(full.lens, full.study.sampling), full.study)
    assert scores["strehl"] == pytest.approx(1.0, abs=1e-9)
    assert scores["largest_spread_deg"] == pytest.approx(4.81, abs=0.01)
