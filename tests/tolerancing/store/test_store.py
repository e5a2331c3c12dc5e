"""The store: whole or not there, whole batches or none, and nothing else touched."""

import json
import os
import sqlite3
import subprocess
import sys

import numpy as np
import pytest
from places import GOLDEN

import tolerancing.store.creation as creation
import tolerancing.store.file as file
import tolerancing.store.store as module
from lensdesign import InputError
from tolerancing.run.run import run_study
from tolerancing.store.export import write_trials
from tolerancing.store.store import create_store, open_store
from tolerancing.study.files import load_study
from tolerancing.study.results import HighFidelityResults, Picture, StepResults, TrialResults

DEAR = """
[[merit]]
name = "fine_contrast"
kind = "line_pair_contrast"
line_width_um = 1.0
at_least = 0.3
predicted_by = "strehl"
"""


@pytest.fixture
def loaded(write_study, full_study):
    return load_study(write_study(full_study + DEAR))


@pytest.fixture
def path(loaded, tmp_path):
    path = tmp_path / "a.store"
    create_store(loaded, path, {"largest_spread_deg": 4.8, "strehl": 1.0}, 40)
    return path


@pytest.fixture
def earlier(tmp_path):
    """A store that version 2 of the tables has written: two of four trials have high-fidelity scores."""
    path = tmp_path / "earlier.store"
    connection = sqlite3.connect(path)
    connection.executescript((GOLDEN / "store_version_2.sql").read_text(encoding="utf-8"))
    connection.close()
    return path


def some_trials(first, count, message=""):
    rng = np.random.default_rng(first)
    scores = rng.normal(size=(count, 2))
    if message:
        scores[0] = np.nan
    return TrialResults(
        trials=tuple(range(first, first + count)),
        values=rng.normal(size=(count, 2)),
        scores=scores,
        extras=rng.normal(size=(count, 1)),
        messages=(message, *[""] * (count - 1)),
        passed=np.arange(count) % 2 == 1,
        seconds=rng.random(count),
    )


def a_step(series="decenter", step=2, picture=None, **scores):
    pictures = () if picture is None else (picture,)
    coordinates = {"perturbation": "shop_radius_mm", "deviation": 0.04}
    return StepResults(series, step, coordinates, scores, "lost", pictures, 0.5)


def test_trials_come_back_as_they_went_in(path):
    later, earlier = some_trials(4, 3, "rays lost"), some_trials(0, 4)
    with open_store(path) as store:
        store.add(later)
        store.add(earlier)
    with open_store(path) as store:
        back = store.trials()
        assert back.trials.tolist() == list(range(7))
        for name in ("values", "scores", "extras"):
            both = np.vstack([getattr(earlier, name), getattr(later, name)])
            assert np.array_equal(getattr(back, name), both, equal_nan=True)
        assert np.array_equal(back.seconds, np.hstack([earlier.seconds, later.seconds]))
        assert back.messages[4] == "rays lost"
        assert back.status == ["ok"] * 4 + ["failed", "ok", "ok"]
        assert back.passed.tolist() == [False, True, False, True, False, True, False]
        assert store.trials().trials.tolist() == list(range(7))
        assert store.missing(range(2, 10)) == (7, 8, 9)
        assert np.array_equal(store.scores("strehl", 9)[:7], back.scores[:, 1], equal_nan=True)
        assert np.isnan(store.scores("strehl", 9)[7:]).all()
        assert store.nominal() == pytest.approx(
            {"largest_spread_deg": 4.8, "strehl": 1.0, "fine_contrast": np.nan}, nan_ok=True
        )


def test_blocks_join_without_a_seam(path, monkeypatch):
    with open_store(path) as store:
        store.add(some_trials(0, 50, "lost"))
        whole = store.trials()
        monkeypatch.setattr(module, "ROWS_AT_ONCE", 7)
        parts = store.trials()
    assert parts.messages == whole.messages
    assert np.array_equal(parts.scores, whole.scores, equal_nan=True)
    assert np.array_equal(parts.passed, whole.passed)


def test_empty_store_has_arrays_of_the_right_width(path):
    with open_store(path) as store:
        empty, dear = store.trials(), store.high_fidelity()
        assert (len(empty), empty.values.shape, empty.scores.shape) == (0, (0, 2), (0, 2))
        assert (len(dear), dear.scores.shape, store.steps()) == (0, (0, 1), [])
        assert list(store.trials().trials) == list(store.high_fidelity().trials) == []


def test_rows_that_are_there_never_change(path):
    with open_store(path) as store:
        store.add(some_trials(0, 4))
        before = store.trials()
        store.add(some_trials(2, 4))
        after = store.trials()
    assert after.trials.tolist() == list(range(6))
    assert np.array_equal(after.scores[:4], before.scores)
    assert np.array_equal(after.values[4:], some_trials(2, 4).values[2:])


def test_infinite_scores_stay_infinite(path):
    one = some_trials(0, 3)
    one.scores[:, 1] = [np.inf, -np.inf, np.nan]
    with open_store(path) as store:
        store.add(one)
        assert np.array_equal(store.trials().scores, one.scores, equal_nan=True)


def test_columns_are_readable_by_other_programs(path):
    with open_store(path) as store:
        store.add(some_trials(0, 2))
    with sqlite3.connect(path) as connection:
        names = [row[1] for row in connection.execute("PRAGMA table_info(trial)")]
        merits = connection.execute("SELECT label, level, engine, at_least, at_most FROM merit").fetchall()
    perturbations = ["lens_decenter_y_mm", "shop_radius_mm"]
    assert names == [
        "trial", "status", "message", *perturbations, "largest_spread_deg", "strehl",
        "strehl_uncompensated", "passed", "seconds", "finished",
    ]  # fmt: skip
    assert merits == [
        ("largest_spread_deg", "ray", "rays", None, 4.83),
        ("strehl", "pupil", "point characteristic", 0.5, None),
        ("fine_contrast", "pupil", "point characteristic", 0.3, None),
    ]


def test_the_record_of_a_trial_tells_all_that_is_known_of_it(path):
    dear = HighFidelityResults((1,), ("worst",), np.array([[0.25]]), ("",), np.array([3.0]))
    with open_store(path) as store:
        store.add(some_trials(0, 2), dear)
        assert store.high_fidelity().trials == (1,)
        assert not store.lacks_high_fidelity(1)
        assert store.lacks_high_fidelity(0)
        back = store.high_fidelity()
        version = store.record().toolkit_version
    assert (back.trials, back.chosen, back.scores.tolist(), back.seconds.tolist()) == (
        (1,), ("worst",), [[0.25]], [3.0],
    )  # fmt: skip
    with sqlite3.connect(path) as connection:
        connection.row_factory = sqlite3.Row
        first, second = connection.execute("SELECT * FROM trial_record ORDER BY trial")
    assert (second["seed"], second["toolkit_version"], second["chosen"]) == ("7", version, "worst")
    assert (second["fine_contrast"], second["fine_contrast_engine"]) == (0.25, "point characteristic")
    assert second["largest_spread_deg_engine"] == "rays"
    assert second["lens_decenter_y_mm"] == some_trials(0, 2).values[1, 0]
    assert second["finished_utc"].startswith("20")
    assert first["chosen"] is first["fine_contrast"] is None


def test_steps_and_pictures_come_back(path):
    image = np.arange(9, dtype=np.float32).reshape(3, 3)
    step = a_step(picture=Picture(1.0, "y", True, 5.0, image), strehl=0.5, contrast=np.nan)
    with open_store(path) as store:
        assert store.lacks_step("decenter", 2)
        store.add(step)
        store.add(a_step(strehl=0.7))
        (back,) = store.steps()
        assert store.finished_steps() == {("decenter", 2)}
        assert not store.lacks_step("decenter", 2)
    assert (back.series, back.step, back.message, back.seconds) == ("decenter", 2, "lost", 0.5)
    assert back.coordinates == {"perturbation": "shop_radius_mm", "deviation": 0.04}
    assert list(back.scores) == ["strehl", "contrast"]
    assert back.scores["strehl"] == 0.5
    assert np.isnan(back.scores["contrast"])
    (picture,) = back.pictures
    assert (picture.line_width_um, picture.orientation, picture.refocused) == (1.0, "y", True)
    assert np.array_equal(picture.intensity, image)


def test_a_store_holds_its_study_and_needs_no_other_file(path, loaded, tmp_path):
    for name in ("study.toml", "design.toml"):
        (tmp_path / name).unlink()
    with open_store(path) as store:
        assert store.loaded.fingerprint == loaded.fingerprint
        assert store.loaded.files == loaded.files
        assert [p.column for p in store.study.perturbations] == ["lens_decenter_y_mm", "shop_radius_mm"]


def test_levels_are_as_they_were_decided(loaded, tmp_path):
    create_store(loaded, tmp_path / "b.store", {}, 40, levels={"fine_contrast": "pupil"})
    with open_store(tmp_path / "b.store") as store:
        assert {m.label: m.level for m in store.study.all_merits} == {
            "largest_spread_deg": "ray", "strehl": "pupil", "fine_contrast": "pupil",
        }  # fmt: skip


def test_no_store_appears_when_making_one_fails(loaded, tmp_path, monkeypatch):
    target = tmp_path / "new" / "b.store"
    monkeypatch.setattr(creation, "SCHEMA", creation.SCHEMA + "CREATE TABLE study (again INTEGER);")
    with pytest.raises(InputError, match="cannot write the store"):
        create_store(loaded, target, {}, 40)
    assert list(target.parent.iterdir()) == []


def test_full_disk_leaves_whole_batches(path):
    with open_store(path) as store:
        store.add(some_trials(0, 5))
        pages = store._connection.execute("PRAGMA page_count").fetchone()[0]
        store._connection.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(InputError, match=r"cannot write the store .*full; "):
            store.add(some_trials(5, 3000))
        assert store.trials().trials.tolist() == list(range(5))
    with open_store(path) as store:
        assert store.trials().trials.tolist() == list(range(5))
        store.add(some_trials(5, 3000))
        assert len(store.trials()) == 3005
    with sqlite3.connect(path) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_a_batch_broken_off_halfway_leaves_nothing(path, monkeypatch):
    def half(connection, table, rows):
        original(connection, table, rows[: len(rows) // 2])
        raise KeyboardInterrupt

    original = module.insert
    monkeypatch.setattr(module, "insert", half)
    with open_store(path) as store, pytest.raises(KeyboardInterrupt):
        store.add(some_trials(0, 10))
    monkeypatch.undo()
    with open_store(path) as store:
        assert store.trial_count() == 0


@pytest.mark.parametrize("content", [b"", b"hello", b"SQLite format 3\0" + bytes(84)])
def test_other_files_are_refused_and_left_alone(tmp_path, content):
    path = tmp_path / "other"
    path.write_bytes(content)
    with pytest.raises(InputError, match="no store"):
        open_store(path)
    assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


def test_other_databases_are_refused(tmp_path):
    path = tmp_path / "other.db"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE study (a)")
    with pytest.raises(InputError, match="no store"):
        open_store(path)


@pytest.mark.parametrize("version", [1, 99])
def test_stores_of_other_versions_are_refused(path, version):
    with sqlite3.connect(path) as connection:
        connection.execute(f"PRAGMA user_version = {version}")
    connection.close()
    before = path.read_bytes()
    with pytest.raises(InputError, match=f"version {version}; this toolkit reads versions 2 and 3"):
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
        "UPDATE file SET content = 'x' WHERE name = 'study.toml'",
        "DELETE FROM file",
        "UPDATE step SET coordinates = 'x'",
        "UPDATE trial SET strehl = 'high'",
        "UPDATE picture SET points = 7",
        "UPDATE picture SET half_width_um = 9e999",
        "UPDATE study SET planned_trials = 'abc'",
        "UPDATE study SET planned_trials = 9223372036854775807",
        "UPDATE study SET fingerprint = x'00'",
        "UPDATE merit SET nominal = 'zzz'",
        "UPDATE merit SET nominal = 1.7e308",
        "UPDATE trial SET strehl = 1.7e308",
        "UPDATE trial SET trial = -1 WHERE trial = 0",
        "UPDATE trial SET message = x'ff'",
        "UPDATE step SET score = -1.7e308",
        """UPDATE step SET coordinates = '{"a": [1]}'""",
    ],
)
def test_a_store_that_makes_no_sense_is_damaged(path, damage):
    picture = Picture(1.0, "y", True, 5.0, np.zeros((3, 3), np.float32))
    with open_store(path) as store:
        store.add(some_trials(0, 5))
        store.add(a_step(picture=picture, strehl=1.0))
    with sqlite3.connect(path) as connection:
        connection.execute(damage)
    connection.close()
    message = r"the store .*a\.store is damaged: .*--fresh"
    with open_store(path) as store, pytest.raises(InputError, match=message):
        store.record(), store.nominal(), store.trials(), store.steps()


ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (f"DROP TABLE study; CREATE VIEW study AS {ENDLESS} x FROM c", "'study' is not a table"),
        (f"DROP TABLE trial; CREATE VIEW trial AS {ENDLESS} x AS trial FROM c", "'trial' is not a table"),
        (
            "DROP TABLE high_fidelity; CREATE VIRTUAL TABLE high_fidelity USING fts5(trial)",
            "'high_fidelity' is not a table",
        ),
        (
            "DROP TABLE trial; CREATE TABLE trial (trial INTEGER PRIMARY KEY, a AS (zeroblob(9)) STORED)",
            "'trial' is not a table",
        ),
        ("CREATE TRIGGER t AFTER INSERT ON trial BEGIN DELETE FROM trial; END", "it has the trigger 't'"),
        ("DROP TABLE file", "'file' is missing"),
    ],
)
def test_tables_that_no_run_makes_are_refused_unread(path, change, message):
    connection = sqlite3.connect(path)
    connection.executescript(change)
    connection.close()
    with pytest.raises(InputError, match=rf"a\.store is damaged: {message}"):
        open_store(path)


def test_a_store_of_an_earlier_version_is_read_and_continued(earlier, tmp_path):
    with open_store(earlier) as store:
        assert store.record().schema_version == 2
        found = store.high_fidelity()
        assert (found.trials, found.chosen) == ((1, 3), ("random", "worst"))
        assert found.scores[:, 0].tolist() == [0.9660247719084877, 0.968106245576222]
        assert len(store.trials()) == 4
        assert [store.lacks_high_fidelity(trial) for trial in (0, 1, 3)] == [True, False, False]
        write_trials(store, tmp_path / "trials.csv")
        header, *_, last = (tmp_path / "trials.csv").read_text().splitlines()
        assert dict(zip(header.split(","), last.split(","), strict=True))["chosen"] == "worst"
        assert "high_fidelity_seconds" in header
    outcome = run_study(load_stored(earlier, tmp_path), earlier, workers=1, trials=6)
    assert outcome.trials_run == 2
    with open_store(earlier) as store:
        assert len(store.trials()) == 6
        assert len(store.high_fidelity()) >= 2


def load_stored(path, folder):
    """The study of a store, from the files that it holds."""
    with open_store(path) as store:
        for name, content in store.loaded.files.items():
            (folder / name).write_bytes(content)
    return load_study(folder / "study.toml")


def test_views_of_ones_own_do_no_harm(path):
    connection = sqlite3.connect(path)
    connection.executescript("CREATE VIEW mine AS SELECT trial FROM trial; CREATE INDEX i ON trial (strehl)")
    connection.close()
    with open_store(path) as store:
        assert store.trial_count() == 0


def test_a_damaged_page_is_told_by_the_store_wherever_it_is(path):
    with open_store(path) as store:
        store.add(some_trials(0, 400))
    whole, messages = path.read_bytes(), []
    for page in range(len(whole) // 4096):
        for filler in (b"\0", b"\xff"):
            start, end = 4096 * page + (100 if page == 0 else 0), 4096 * (page + 1)
            path.write_bytes(whole[:start] + filler * (end - start) + whole[end:])
            messages.append(fault_of(path))
    assert all("a.store" in message for message in messages if message)
    assert sum(1 for message in messages if message) > 10


def fault_of(path):
    """Return the message when all of a store is read, or an empty text."""
    try:
        with open_store(path) as store:
            store.record(), store.merits(), store.trials(), store.steps()
            list(store.blocks("SELECT * FROM trial"))
    except InputError as error:
        return str(error)
    return ""


def test_log_is_written_ahead_and_put_away(path):
    with open_store(path) as store:
        store.start_writing()
        assert store._connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        store.add(some_trials(0, 5))
        assert path.with_name("a.store-wal").stat().st_size > 0
        store.finish_writing()
        assert path.with_name("a.store-wal").stat().st_size == 0
    assert sorted(p.name for p in path.parent.iterdir()) == ["a.store", "design.toml", "study.toml"]


def left_behind(path, first, count):
    """Add trials in a process that ends without closing the store, leaving its log."""
    code = (
        "import os, pathlib, sys\n"
        "from test_store import some_trials\nfrom tolerancing.store.store import open_store\n"
        "store = open_store(pathlib.Path(sys.argv[1])); store.start_writing()\n"
        "store.add(some_trials(int(sys.argv[2]), int(sys.argv[3]))); os._exit(0)\n"
    )
    imported = os.environ | {"PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *sys.path])}
    subprocess.run([sys.executable, "-c", code, path, str(first), str(count)], env=imported, check=True)
    assert path.with_name(f"{path.name}-wal").stat().st_size > 0


def test_log_that_was_left_behind_is_played_in(path):
    left_behind(path, 0, 5)
    with open_store(path) as store:
        assert np.array_equal(store.trials().values, some_trials(0, 5).values)


def test_a_fresh_store_takes_nothing_from_the_log_of_the_one_before(path, loaded):
    left_behind(path, 0, 500)
    assert create_store(loaded, path, {}, 40)
    assert not path.with_name("a.store-wal").exists()
    with open_store(path) as store:
        assert store.trial_count() == 0
        store.add(some_trials(3, 2))
        assert store._connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


@pytest.mark.parametrize("damaged", [False, True])
def test_a_log_whose_store_is_gone_or_damaged_is_not_played_in(path, loaded, damaged):
    left_behind(path, 0, 500)
    if damaged:
        path.write_bytes(path.read_bytes()[:200] + b"\xff" * 5000)
    else:
        path.unlink()
    assert create_store(loaded, path, {}, 40, replace=damaged)
    with open_store(path) as store:
        assert store.trial_count() == 0
        assert store._connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_a_store_in_use_is_not_replaced(path, loaded, monkeypatch):
    monkeypatch.setattr(file, "REPLACE_TIMEOUT_SECONDS", 0.05)
    with open_store(path) as store:
        store.start_writing()
        store.add(some_trials(0, 5))
        with pytest.raises(InputError, match="another process"):
            create_store(loaded, path, {}, 40)
        store.add(some_trials(5, 5))
    with open_store(path) as store:
        assert store.trial_count() == 10


def test_of_two_that_make_a_store_the_second_finds_that_of_the_first(path, loaded, tmp_path):
    before = path.read_bytes()
    assert not create_store(loaded, path, {}, 40, replace=False)
    assert path.read_bytes() == before
    assert create_store(loaded, tmp_path / "b.store", {}, 40, replace=False)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.store", "b.store", "design.toml", "study.toml"]


def test_a_store_on_a_medium_that_cannot_be_written_is_read(path, monkeypatch):
    with open_store(path) as store:
        store.start_writing()
        store.add(some_trials(0, 5))
        store.finish_writing()
    monkeypatch.setattr(file.os, "access", lambda *_: False)
    with open_store(path) as store:
        assert len(store.trials()) == 5
        assert not path.with_name("a.store-shm").exists()
        with pytest.raises(InputError, match=r"cannot write the store .* cannot be written"):
            store.add(some_trials(5, 5))
        with pytest.raises(InputError, match="cannot write the store"):
            store.start_writing()


def test_coordinates_are_json(path):
    with open_store(path) as store:
        store.add(a_step(strehl=1.0))
    with sqlite3.connect(path) as connection:
        (text,) = connection.execute("SELECT coordinates FROM step").fetchone()
    assert json.loads(text) == {"perturbation": "shop_radius_mm", "deviation": 0.04}


def test_a_store_shows_itself(small_store):
    assert repr(small_store) == f"Store({str(small_store.path)!r}, 6 of 6 trials)"
    shown = small_store._repr_html_()
    for text in ("study.toml", "6 of 6", "largest_spread_deg", "strehl", "nominal 1,"):
        assert text in shown
    other = open_store(small_store.path)
    other.close()
    assert repr(other) == f"Store({str(small_store.path)!r}, closed)"
