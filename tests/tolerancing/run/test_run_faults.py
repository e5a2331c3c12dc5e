"""What goes wrong around a run: kills, a full disk, a second run; the rows are the same afterwards."""

import os
import random
import resource
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import stored_rows
from tests_studies import DESIGN, RAY_STUDY

from lensdesign import InputError, TransferLensError
from tolerancing.run.run import RunError, run_study
from tolerancing.store.store import open_store
from tolerancing.study.files import load_study

SCRIPT = Path(stored_rows.__file__).with_name("run_into_store.py")
TRIALS = 3000
KILLS = 4


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A study that takes long enough to be killed."""
    path = tmp_path_factory.mktemp("study") / "study.toml"
    path.with_name("design.toml").write_text(DESIGN)
    path.write_text("sensitivity = false\n" + RAY_STUDY.replace("rings = 2", "rings = 8"))
    return path


@pytest.fixture(scope="module")
def unbroken(study, tmp_path_factory):
    """All rows of a run that nothing befell."""
    store = tmp_path_factory.mktemp("unbroken") / "store"
    run_study(load_study(study), store, workers=1, trials=TRIALS)
    return stored_rows.rows(store)


def start(study, store, workers=2, trials=TRIALS, **options):
    """Begin a run in a process group of its own."""
    return subprocess.Popen(
        [sys.executable, SCRIPT, study, store, str(workers), str(trials)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **options,
    )


def kill(run):
    """End a run and its workers as a power cut would; returns the amount that it last reported as stored."""
    os.killpg(run.pid, signal.SIGKILL)
    printed = run.communicate()[0].split()
    return int(printed[-1]) if printed else 0


def check(path):
    """Let SQLite look for damage."""
    with sqlite3.connect(path) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    connection.close()


def test_runs_that_are_killed_at_any_moment_go_on_and_make_the_same_rows(study, unbroken, tmp_path):
    path, rng, kills = tmp_path / "store", random.Random(20240601), 0
    held = 0
    while kills < KILLS:
        # Fewer than all, though a fast machine ended each run before it is killed.
        run = start(study, path, trials=TRIALS * (kills + 1) // (KILLS + 1))
        if kills % 2:  # while it starts, or long after the first rows
            time.sleep(rng.uniform(0.0, 1.5))
        else:
            run.stdout.readline()
            time.sleep(rng.uniform(0.0, 0.1))
        stored = kill(run)
        kills += 1
        if path.exists():
            with open_store(path) as store:
                assert store.trial_count() >= held + stored
                held = store.trial_count()
    assert 0 < held < TRIALS
    run = start(study, path)
    run.communicate()
    assert run.returncode == 0
    assert stored_rows.rows(path) == unbroken
    check(path)


def test_two_runs_at_once_make_one_store(study, unbroken, tmp_path):
    path = tmp_path / "store"
    runs = [start(study, path, workers=1) for _ in range(2)]
    printed = [run.communicate() for run in runs]
    assert [run.returncode for run in runs] == [0, 0], printed
    assert stored_rows.rows(path) == unbroken
    check(path)


def limited(tenths):
    """Let no file grow beyond some tenths of a megabyte, as a full disk would."""

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (tenths * 2**20 // 10,) * 2)

    return limit


def test_full_disk_in_the_middle_of_a_run_stops_it_with_a_word_and_the_store_intact(
    study, unbroken, tmp_path
):
    path = tmp_path / "store"
    run = start(study, path, workers=1, preexec_fn=limited(2))
    _, error = run.communicate()
    assert run.returncode == 2
    assert error.startswith(f"error: cannot write the store {path}: ")
    assert "repeat the command" in error
    assert "Traceback" not in error
    with open_store(path) as store:
        assert 0 < store.trial_count() < TRIALS
    check(path)
    run_study(load_study(study), path, workers=1, trials=TRIALS)
    assert stored_rows.rows(path) == unbroken


def test_full_disk_before_anything_is_written_leaves_nothing(study, tmp_path):
    folder = tmp_path / "new"
    folder.mkdir()
    run = start(study, folder / "store", workers=1, preexec_fn=limited(0))
    _, error = run.communicate()
    assert run.returncode == 2
    assert error.startswith("error: cannot write")
    assert "Traceback" not in error
    assert "in the store" not in error
    assert list(folder.iterdir()) == []


def test_workers_of_a_run_that_is_killed_end_too(study, tmp_path):
    psutil = pytest.importorskip("psutil")
    run = start(study, tmp_path / "store", trials=200_000)
    run.stdout.readline()
    workers = psutil.Process(run.pid).children(recursive=True)
    assert len(workers) >= 2
    run.kill()
    run.communicate()
    assert psutil.wait_procs(workers, timeout=300.0)[1] == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_a_folder_that_cannot_be_written(study, tmp_path):
    folder = tmp_path / "locked"
    folder.mkdir()
    run_study(load_study(study), folder / "store", workers=1, trials=20)
    folder.chmod(0o555)
    try:
        with open_store(folder / "store") as store:
            assert len(store.trials()) == 20
        with pytest.raises(InputError, match="cannot write the store"):
            run_study(load_study(study), folder / "store", workers=1, trials=30)
        with pytest.raises(InputError, match="cannot write"):
            run_study(load_study(study), folder / "other", workers=1, trials=30)
    finally:
        folder.chmod(0o755)


def test_a_place_where_nothing_can_be_made(study):
    with pytest.raises(InputError, match="cannot write /proc/store"):
        run_study(load_study(study), "/proc/store", workers=1, trials=3)


LEAVING = """
import os
import sys


def score(trial):
    print("a merit may print")
    if trial.number == 1:
        sys.exit(0)
    if trial.number == 2:
        os._exit(0)
    return 1.0
"""
OWN_MERIT = """
[[merit]]
kind = "python"
function = "mine.py:score"
at_least = 0.0
"""


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.usefixtures("copied_workers")
def test_a_merit_that_ends_the_program_ends_its_trial(write_study, ray_study, tmp_path, capfd, workers):
    (tmp_path / "mine.py").write_text(LEAVING)
    study = load_study(write_study("sensitivity = false\n" + ray_study + OWN_MERIT), trust=True)
    assert run_study(study, tmp_path / "a.db", workers=workers, trials=4).trials_run == 4
    with open_store(tmp_path / "a.db") as store:
        messages = store.trials().messages
    assert [bool(message) for message in messages] == [False, True, True, False]
    assert "SystemExit" in messages[1]
    assert "status 0 ended its process" in messages[2]


@pytest.mark.parametrize(
    ("workers", "statement"), [(1, "sys.exit(0)"), (1, "os._exit(0)"), (2, "os._exit(0)")]
)
@pytest.mark.parametrize("location", ["import", "nominal"])
@pytest.mark.usefixtures("copied_workers")
def test_a_merit_that_always_ends_the_program_is_reported_at_the_start(
    write_study, ray_study, tmp_path, workers, statement, location
):
    indent = "" if location == "import" else "    "
    source = f"import os, sys\ndef score(trial):\n    pass\n{indent}{statement}\n"
    (tmp_path / "mine.py").write_text(source)
    study = load_study(write_study(ray_study + OWN_MERIT), trust=True)
    with pytest.raises(TransferLensError, match="end"):
        run_study(study, tmp_path / "a.db", workers=workers, trials=4)
    assert not (tmp_path / "a.db").exists()


DYING = """
import os


def score(trial):
    if trial.number == 0:
        os.kill(os.getpid(), 11)
    return 1.0
"""


@pytest.mark.usefixtures("copied_workers")
def test_a_merit_that_a_signal_ends_fails_its_trial_alone(write_study, ray_study, tmp_path):
    (tmp_path / "mine.py").write_text(DYING)
    study = load_study(write_study("sensitivity = false\n" + ray_study + OWN_MERIT), trust=True)
    announced = []
    outcome = run_study(study, tmp_path / "a.db", workers=2, trials=3, on_estimate=announced.append)
    assert (outcome.trials_run, outcome.workers, announced) == (3, 2, [])
    with open_store(tmp_path / "a.db") as store:
        trials = store.trials()
    assert trials.messages == ("python: SIGSEGV ended its process", "", "")
    assert np.isfinite(trials.scores).tolist() == [[True, False], [True, True], [True, True]]


@pytest.mark.usefixtures("copied_workers")
def test_a_merit_that_a_signal_ends_for_the_nominal_lens_is_told_at_the_start(
    write_study, ray_study, tmp_path
):
    (tmp_path / "mine.py").write_text("import os\ndef score(trial):\n    os.kill(os.getpid(), 9)\n")
    study = load_study(write_study(ray_study + OWN_MERIT), trust=True)
    with pytest.raises(InputError, match=r"^mine\.py: SIGKILL"):
        run_study(study, tmp_path / "a.db", workers=2, trials=4)
    assert not (tmp_path / "a.db").exists()


@pytest.mark.usefixtures("copied_workers")
def test_a_death_that_no_trial_repeats_is_none_of_a_trial(write_study, ray_study, tmp_path):
    """As for want of memory: the trials at hand are scored, and the run ends with a word."""
    (tmp_path / "mine.py").write_text(
        "import os\nfrom pathlib import Path\n"
        f"def score(trial):\n    once = Path({str(tmp_path / 'once')!r})\n"
        "    if trial.number is not None and not once.exists():\n"
        "        once.touch()\n        os.kill(os.getpid(), 9)\n    return 1.0\n"
    )
    study = load_study(write_study("sensitivity = false\n" + ray_study + OWN_MERIT), trust=True)
    with pytest.raises(RunError, match="repeat the command"):
        run_study(study, tmp_path / "a.db", workers=2, trials=2)
    with open_store(tmp_path / "a.db") as store:
        assert store.trials().messages == ("", "")
