"""The command, end to end, in processes of its own."""

import json
import signal
import sqlite3
import subprocess
import sys
import time

import pytest

HEAVY = ("scipy", "pandas", "matplotlib", "jinja2", "numba")


def command(*arguments):
    """Run ``tolerancing`` and return the finished process."""
    start = [sys.executable, "-m", "tolerancing.cli", *map(str, arguments)]
    return subprocess.run(start, capture_output=True, text=True, timeout=120, check=False)


def test_run_show_and_report(write_study, full_study, tmp_path):
    store, out = tmp_path / "a.store", tmp_path / "out"
    ran = command(
        "run", write_study(full_study), "--store", store, "--workers", "1", "--trials", "12", "--json"
    )
    assert ran.returncode == 0, ran.stderr
    data = json.loads(ran.stdout)
    assert data["run"]["trials_run"] == 12
    assert data["run"]["steps_run"] == 3
    assert data["complete"] is True
    assert data["trials"] == data["planned_trials"] == 12
    good = data["yield"]
    assert good["total"] == 12
    assert 0.0 <= good["low"] <= good["share"] <= good["high"] <= 1.0
    assert set(data["merits"]) == {"largest_spread_deg", "strehl"}
    assert data["merits"]["strehl"]["nominal"] == pytest.approx(1.0, abs=1e-9)

    shown = command("show", store, "--json")
    assert json.loads(shown.stdout) == {k: v for k, v in data.items() if k != "run"}
    table = command("show", store)
    assert "12 of 12 trials" in table.stdout
    assert "all limits" in table.stdout

    reported = command("report", store, "-o", out)
    assert reported.returncode == 0, reported.stderr
    assert str(out / "report.html") in reported.stdout
    assert (out / "trials.csv").read_text().count("\n") == 13


def test_run_ends_by_saying_what_was_done_and_where_it_lies(write_study, ray_study, tmp_path):
    store = tmp_path / "a.store"
    ran = command("run", write_study(ray_study), "--store", store, "--workers", "1")
    assert ran.stdout.splitlines()[-1].startswith("40 trials and 0 sweep steps in ")
    assert ran.stdout.splitlines()[-1].endswith(str(store))
    again = command("run", write_study(ray_study), "--store", store, "--workers", "1")
    assert again.stdout.splitlines()[-1] == f"nothing was missing: {store}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sigma = -1.0", "perturbation 1: sigma = -1.0: must be greater than 0"),
        ("sgma = 1.0", "perturbation 1: sgma: unknown key; allowed: "),
    ],
)
def test_faulty_study_is_one_message_and_status_2(write_study, ray_study, tmp_path, text, message):
    path = write_study(ray_study.replace("sigma = 0.02", text))
    ran = command("run", path, "--store", tmp_path / "a.store")
    assert ran.returncode == 2
    assert ran.stdout == ""
    assert ran.stderr.startswith(f"error: {path}: {message}")
    assert len(ran.stderr.splitlines()) == 1
    assert not (tmp_path / "a.store").exists()


@pytest.mark.parametrize("arguments", [("show",), ("report", "-o", "out")])
def test_other_files_are_refused_with_status_2(tmp_path, arguments):
    path = tmp_path / "notes.txt"
    path.write_text("mine")
    name, *rest = arguments
    ran = command(name, path, *rest)
    assert ran.returncode == 2
    assert ran.stderr == f"error: {path} is no store of a tolerance study; give another file name\n"
    assert path.read_text() == "mine"


def test_import_is_light():
    code = (
        "import sys, tolerancing\n"
        "from tolerancing import load_study, open_store, run_study\n"
        f"print([name for name in {HEAVY} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_an_interrupted_run_says_so_and_goes_on(write_study, ray_study, tmp_path):
    path = tmp_path / "a.store"
    start = [
        sys.executable,
        "-m",
        "tolerancing.cli",
        "run",
        str(write_study(ray_study)),
        "--store",
        str(path),
    ]
    running = subprocess.Popen(
        [*start, "--workers", "1", "--trials", "1000000"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    until = time.monotonic() + 60.0
    while time.monotonic() < until and not (path.exists() and finished(path)):
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=60)
    assert (running.returncode, out) == (130, "")
    # Older releases of rich end a progress line with a new one.
    assert (
        err.strip() == f"interrupted; what was finished is in {path}, and the same command goes on from there"
    )
    done = len(finished(path))
    again = command("run", tmp_path / "study.toml", "--store", path, "--workers", "1", "--trials", done + 40)
    assert again.returncode == 0, again.stderr
    command(
        "run", tmp_path / "study.toml", "--store", tmp_path / "b", "--workers", "1", "--trials", done + 40
    )
    assert finished(path) == finished(tmp_path / "b")


def finished(path):
    """All trials of a store."""
    with sqlite3.connect(path) as connection:
        return connection.execute("SELECT * FROM trial ORDER BY trial").fetchall()
