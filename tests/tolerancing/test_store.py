"""The store: whole or not there, whole batches or none, and nothing else touched."""

import sqlite3

import numpy as np
import pytest

import tolerancing.store as module
from lensdesign import InputError
from tolerancing.results import Picture, StepResults, TrialResults
from tolerancing.store import create_store, open_store
from tolerancing.study import load_study


@pytest.fixture
def loaded(write_study, full_study):
    return load_study(write_study(full_study))


@pytest.fixture
def path(loaded, tmp_path):
    path = tmp_path / "a.store"
    create_store(path, loaded, {"largest_spread_deg": 4.8, "strehl": 1.0}, 40)
    return path


def some_trials(first, count, message=""):
    rng = np.random.default_rng(first)
    scores = rng.normal(size=(count, 2))
    if message:
        scores[0] = np.nan
    messages = (message, *[""] * (count - 1))
    passed = np.arange(count) % 2 == 1
    return TrialResults(
        tuple(range(first, first + count)), rng.normal(size=(count, 2)), scores, messages, passed
    )


def test_trials_come_back_as_they_went_in(path):
    later, earlier = some_trials(4, 3, "rays lost"), some_trials(0, 4)
    with open_store(path) as store:
        store.add(later)
        store.add(earlier)
    with open_store(path) as store:
        back = store.trials()
        assert back.trials == tuple(range(7))
        assert np.array_equal(back.values, np.vstack([earlier.values, later.values]))
        assert np.array_equal(back.scores, np.vstack([earlier.scores, later.scores]), equal_nan=True)
        assert back.messages[4] == "rays lost"
        assert back.status == ["ok"] * 4 + ["failed", "ok", "ok"]
        assert back.passed.tolist() == [False, True, False, True, False, True, False]
        assert store.finished_trials() == set(range(7))
        assert store.nominal() == {"largest_spread_deg": 4.8, "strehl": 1.0}


def test_columns_are_readable_by_other_programs(path):
    with open_store(path) as store:
        store.add(some_trials(0, 2))
    with sqlite3.connect(path) as connection:
        names = [row[1] for row in connection.execute("PRAGMA table_info(trial)")]
    perturbations = ["lens_decenter_y_mm", "shop_radius_mm"]
    assert names == [
        "trial", "status", "message", *perturbations, "largest_spread_deg", "strehl", "passed",
    ]  # fmt: skip


def test_steps_and_pictures_come_back(path):
    image = np.arange(9, dtype=np.float32).reshape(3, 3)
    step = StepResults(
        "decenter",
        2,
        0.04,
        {"strehl": 0.5, "contrast": np.nan},
        "lost",
        (Picture(1.0, "y", True, 5.0, image),),
    )
    with open_store(path) as store:
        store.add(step)
        (back,) = store.steps()
        assert store.finished_steps() == {("decenter", 2)}
    assert (back.sweep, back.step, back.value, back.message) == ("decenter", 2, 0.04, "lost")
    assert list(back.scores) == ["strehl", "contrast"]
    assert back.scores["strehl"] == 0.5
    assert np.isnan(back.scores["contrast"])
    (picture,) = back.pictures
    assert (picture.line_width_um, picture.orientation, picture.refocused) == (1.0, "y", True)
    assert np.array_equal(picture.intensity, image)


def test_no_store_appears_when_making_one_fails(loaded, tmp_path, monkeypatch):
    target = tmp_path / "new" / "b.store"
    monkeypatch.setattr(module, "SCHEMA", module.SCHEMA + "CREATE TABLE study (again INTEGER);")
    with pytest.raises(InputError, match="cannot write the store"):
        create_store(target, loaded, {}, 40)
    assert list(target.parent.iterdir()) == []


def test_full_disk_leaves_whole_batches(path):
    with open_store(path) as store:
        store.add(some_trials(0, 5))
        pages = store._connection.execute("PRAGMA page_count").fetchone()[0]
        store._connection.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(InputError, match=r"cannot write the store .*full"):
            store.add(some_trials(5, 3000))
        assert store.finished_trials() == set(range(5))
    with open_store(path) as store:
        assert store.finished_trials() == set(range(5))
        store.add(some_trials(5, 3000))
        assert len(store.finished_trials()) == 3005
    with sqlite3.connect(path) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_a_batch_broken_off_halfway_leaves_nothing(path, monkeypatch):
    def half(connection, table, rows):
        original(connection, table, rows[: len(rows) // 2])
        raise KeyboardInterrupt

    original = module._insert
    monkeypatch.setattr(module, "_insert", half)
    with open_store(path) as store, pytest.raises(KeyboardInterrupt):
        store.add(some_trials(0, 10))
    monkeypatch.undo()
    with open_store(path) as store:
        assert store.finished_trials() == set()


@pytest.mark.parametrize("content", [b"", b"hello", b"SQLite format 3\0" + bytes(84)])
def test_other_files_are_refused_and_left_alone(tmp_path, content):
    path = tmp_path / "other"
    path.write_bytes(content)
    with pytest.raises(InputError, match="no store of a tolerance study"):
        open_store(path)
    assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


def test_other_databases_are_refused(tmp_path):
    path = tmp_path / "other.db"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE study (a)")
    with pytest.raises(InputError, match="no store of a tolerance study"):
        open_store(path)


def test_newer_stores_are_refused(path):
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA user_version = 99")
    before = path.read_bytes()
    with pytest.raises(InputError, match="version 99; this toolkit reads version 1"):
        open_store(path)
    assert path.read_bytes() == before


def test_damaged_store_is_an_error_with_its_name(path):
    path.write_bytes(path.read_bytes()[:200] + b"\xff" * 5000)
    with pytest.raises(InputError, match=r"a\.store"), open_store(path) as store:
        store.trials()


def test_missing_store_is_not_made(tmp_path):
    with pytest.raises(InputError, match=r"cannot read .*none"):
        open_store(tmp_path / "none")
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    "damage",
    [
        "DELETE FROM study",
        "UPDATE study SET study_toml = 'x'",
        "UPDATE trial SET strehl = 'high'",
        "ALTER TABLE trial ADD COLUMN more",
        "UPDATE picture SET points = 7",
    ],
)
def test_a_store_that_makes_no_sense_is_damaged(path, damage):
    picture = Picture(1.0, "y", True, 5.0, np.zeros((3, 3), np.float32))
    with open_store(path) as store:
        store.add(some_trials(0, 5))
        store.add(StepResults("decenter", 0, 0.0, {"strehl": 1.0}, "", (picture,)))
    with sqlite3.connect(path) as connection:
        connection.execute(damage)
    message = r"the store .*a\.store is damaged: .*--fresh"
    with open_store(path) as store, pytest.raises(InputError, match=message):
        store.trials(), store.steps()
