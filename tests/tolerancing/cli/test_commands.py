"""The command, end to end; in a process of its own where it is interrupted."""

import json
import os
import re
import signal
import sqlite3
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from stopping import heeding
from stored_rows import rows
from typer.testing import CliRunner

from tolerancing import open_store, single_trial
from tolerancing.budgets import study_budget
from tolerancing.study.files import load_study
from wavesim import SystemState, read_state

HEAVY = ("scipy", "pandas", "matplotlib", "jinja2", "numba")


def test_what_tolerances_cost_and_the_cheapest_that_do(command, write_study, ray_study, tmp_path):
    study, store, out = write_study(ray_study), tmp_path / "a.db", tmp_path / "b.toml"
    priced = json.loads(command("cost", study, "--process", "1=moulded_plastic", "--json").stdout)
    lines = {line["perturbation"]: line for line in priced["lines"]}
    assert lines["shop_radius_mm"]["process"] == "moulded_plastic"
    assert priced["total"] == pytest.approx(1.0 + sum(line["cost"] for line in lines.values()))
    assert "relative cost" in command("cost", study).stdout
    command("run", study, "--store", store, "--workers", "1")
    ran = command(
        "budget", store, "--yield", "0.6", "-o", out, "--verify", "40", "--costs", "relative", "--json"
    )
    assert ran.returncode == 0, ran.stderr
    found, now = json.loads(ran.stdout), json.loads(command("cost", out, "--json").stdout)
    assert found["cost"] == pytest.approx(now["total"], rel=1e-3)
    assert found["cost_before"] == pytest.approx(
        json.loads(command("cost", study, "--json").stdout)["total"], rel=1e-12
    )
    assert found["cost"] <= found["uniform_cost"]
    both = command("budget", store, "--yield", "0.6", "-o", out, "--costs", "relative", "--weight", "a=1")
    assert (both.returncode, both.stdout) == (2, "")
    assert "give only one of them" in both.stderr
    assert (
        "--process '2=moulded_glass': must be NAME"
        in command("cost", study, "--process", "2=moulded_glass").stderr
    )


def test_the_cheapest_budget_goes_to_the_drawing(command, write_study, ray_study, tmp_path):
    """As it was written: the sheet states the tolerances that the budget found, the mount's apart."""
    from lensdesign.cli.commands import app

    study, store, out = write_study(ray_study), tmp_path / "a.db", tmp_path / "b.toml"
    command("run", study, "--store", store, "--workers", "1")
    ran = command("budget", store, "--yield", "0.6", "-o", out, "--verify", "40", "--costs", "relative")
    assert ran.returncode == 0, ran.stderr
    before, radius = (
        next(p for p in load_study(file).study.perturbations if p.parameter.startswith("radius"))
        for file in (study, out)
    )
    assert radius.tolerance != pytest.approx(before.tolerance, rel=1e-3)
    sheet = tmp_path / "sheet.svg"
    made = ["drawing", tmp_path / "design.toml", "--tolerances", out, "-o", sheet]
    made.append("--accept-yield-loss")  # two perturbations are not all that a sheet allows
    shown = CliRunner().invoke(app, [str(argument) for argument in made])
    assert shown.exit_code == 0, shown.output
    assert "not on the sheet: lens decenter" in shown.output
    radii = re.findall(r">(R [^<]*±[^<]*)<", sheet.read_text(encoding="utf-8"))
    assert any(f"±{radius.tolerance:.4g}" in words for words in radii)


def test_indices_and_their_chart(command, write_study, ray_study, tmp_path):
    study, chart = write_study(ray_study), tmp_path / "indices.svg"
    ran = command("variance", study, "--base", "16", "-o", chart)
    assert ran.returncode == 0, ran.stderr
    assert "products of perturbations" in ran.stdout
    assert "<svg" in chart.read_text()
    found = json.loads(command("variance", study, "--base", "16", "--json").stdout)
    assert found["trials"] == 64
    (own,) = found["merits"].values()
    assert [row["total"] for row in own["indices"]] == sorted(
        (r["total"] for r in own["indices"]), reverse=True
    )
    refused = command("variance", study, "-o", tmp_path / "indices.gif")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "suffix must be one of" in refused.stderr


def test_the_yield_of_a_lens_that_seldom_fails(command, write_study, ray_study, tmp_path):
    store = tmp_path / "a.db"
    assert command("run", write_study(ray_study), "--store", store, "--workers", "1").returncode == 0
    ran = command("rare-failures", store, "--trials", "60", "--json")
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert 0.0 <= found["yield"]["low"] <= found["yield"]["share"] <= found["yield"]["high"] <= 1.0
    assert found["trials"] == 60
    assert "plain trials" in command("rare-failures", store, "--trials", "60").stdout
    assert command("rare-failures", store, "--trials", "7").returncode == 2


def test_run_show_and_report(command, write_study, full_study, tmp_path):
    store, out = tmp_path / "a.store", tmp_path / "out"
    ran = command(
        "run", write_study(full_study), "--store", store, "--workers", "1", "--trials", "12", "--json"
    )
    assert ran.returncode == 0, ran.stderr
    data = json.loads(ran.stdout)
    assert data["run"]["trials_run"] == 12
    assert data["run"]["steps_run"] == 3 + 8
    assert data["complete"] is True
    assert data["trials"] == data["planned_trials"] == 12
    good = data["yield"]
    assert good["total"] == 12
    assert 0.0 <= good["low"] <= good["share"] <= good["high"] <= 1.0
    assert set(data["merits"]) == {"largest_spread_deg", "strehl"}
    assert data["merits"]["strehl"]["nominal"] == pytest.approx(1.0, abs=1e-9)
    assert (data["predicted_yield"] is None) == bool(data["predicted_reason"])

    shown = command("show", store, "--json")
    assert json.loads(shown.stdout) == {k: v for k, v in data.items() if k != "run"}
    table = command("show", store)
    assert "12 of 12 trials" in table.stdout
    assert "all limits" in table.stdout

    reported = command("report", store, "-o", out)
    assert reported.returncode == 0, reported.stderr
    assert str(out / "report.html") in reported.stdout
    assert (out / "report.pdf").read_bytes().startswith(b"%PDF")
    assert (out / "trials.csv").read_text().count("\n") == 13


def test_a_yield_without_a_prediction_has_a_reason(command, write_study, ray_study, tmp_path):
    shifted = '[[merit]]\nkind = "image_shift_um"\nat_most = 50.0\n'
    study = "sensitivity = false\n" + ray_study.replace("pupil_samples = 64", "pupil_samples = 16") + shifted
    words = ("run", write_study(study), "--store", tmp_path / "a.store", "--workers", "1", "--trials", "2")
    data = json.loads(command(*words, "--json").stdout)
    assert data["predicted_yield"] is None
    assert "tolerancing predict" in data["predicted_reason"]
    assert data["predicted_reason"] in command("show", tmp_path / "a.store").stdout.replace("\n", " ")


def test_run_ends_by_saying_what_was_done_and_where_it_lies(command, write_study, ray_study, tmp_path):
    store = tmp_path / "a.store"
    ran = command("run", write_study(ray_study), "--store", store, "--workers", "1")
    assert ran.stdout.splitlines()[-1].startswith("40 trials, 8 steps in ")
    assert ran.stdout.splitlines()[-1].endswith(str(store))
    assert ran.stderr.startswith("40 trials, 8 steps: about ")
    again = command("run", write_study(ray_study), "--store", store, "--workers", "1")
    assert again.stdout.splitlines()[-1] == f"the store is already complete: {store}"
    assert again.stderr == ""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sigma = -1.0", "perturbation 1: sigma = -1.0: must be greater than 0"),
        ("sgma = 1.0", "perturbation 1: sgma: unknown key; allowed: "),
    ],
)
def test_faulty_study_is_one_message_and_status_2(command, write_study, ray_study, tmp_path, text, message):
    path = write_study(ray_study.replace("sigma = 0.02", text))
    ran = command("run", path, "--store", tmp_path / "a.store")
    assert ran.returncode == 2
    assert ran.stdout == ""
    assert ran.stderr.startswith(f"error: {path}: {message}")
    assert len(ran.stderr.splitlines()) == 1
    assert not (tmp_path / "a.store").exists()


def test_a_merit_that_raises_for_the_nominal_lens_is_one_message_and_status_2(
    command, write_study, ray_study, tmp_path
):
    (tmp_path / "mine.py").write_text("def ratio(trial):\n    raise LookupError('no ratio')\n")
    merit = '[[merit]]\nkind = "python"\nname = "ratio"\nfunction = "mine.py:ratio"\nat_least = 1.0\n'
    ran = command("run", write_study(ray_study + merit), "--store", tmp_path / "a.store", "--trust")
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr == (
        "error: merit 'ratio' cannot score the nominal lens: LookupError: no ratio "
        "(mine.py, line 2); no trial was run: correct the merit or the design\n"
    )
    assert not (tmp_path / "a.store").exists()


def test_one_trial_is_shown_again(command, write_study, full_study, tmp_path):
    store, picture = tmp_path / "a.store", tmp_path / "trial.svg"
    command("run", write_study(full_study), "--store", store, "--workers", "1", "--trials", "4")
    shown = command("show", store, "--trial", "2", "-o", picture)
    assert shown.returncode == 0, shown.stderr
    assert "the same as stored" in shown.stdout
    assert "strehl_uncompensated" in shown.stdout
    assert picture.read_text().startswith("<?xml")
    data = json.loads(command("show", store, "--trial", "2", "--json").stdout)
    assert data["same_as_stored"] is True
    path = tmp_path / "state.json"
    assert command("show", store, "--trial", "2", "--state", path).returncode == 0
    with open_store(store) as opened:
        trial = single_trial(opened, 2)
    assert read_state(path, trial.context.lens) == trial.state != SystemState()
    for arguments, message in (
        (("--trial", "9"), "error: trial = 9: the study has trials 0 to 3"),
        (("-o", picture), "error: --output, --state and --high-fidelity need --trial"),
        (("--trial", "1", "-o", tmp_path / "a.gif"), "error: cannot write "),
        (("--trial", "9", "--state", tmp_path), "error: cannot write "),
    ):
        refused = command("show", store, *arguments)
        assert (refused.returncode, refused.stdout) == (2, "")
        assert refused.stderr.startswith(message)


def test_a_study_is_started_run_ranked_inverted_and_budgeted(command, paper_design, tmp_path, monkeypatch):
    study, store, out = tmp_path / "study.toml", tmp_path / "a.db", tmp_path / "budget.toml"
    started = command("start", paper_design, "-o", study, "--grade", "high_precision", "--nominal-mounting")
    assert started.returncode == 0, started.stderr
    again = command("start", paper_design, "-o", study)
    assert (again.returncode, again.stderr) == (
        2,
        f"error: {study} exists already; give another name, or --force to replace it\n",
    )
    assert command("start", paper_design, "-o", tmp_path / "b", "--grade", "poor").returncode == 2
    # Rays alone, few trials and a third of the perturbations are enough here.
    first, *perturbations = study.read_text().partition("[[merit]]")[0].split("[[perturbation]]")
    head = "[[perturbation]]".join([first, *perturbations[1::3]])
    head = head.replace("trials = 100\n", "trials = 2\n")
    study.write_text(head + '[[merit]]\nkind = "largest_spread_deg"\nat_most = 4.83\n')
    ran = command("run", study, "--store", store, "--workers", "1", "--trials", "100")
    assert ran.returncode == 0, ran.stderr
    ranked = command("sensitivity", store)
    assert ranked.returncode == 0, ranked.stderr
    assert "root sum square" in ranked.stdout
    rows = json.loads(command("sensitivity", store, "--json").stdout)["merits"]["largest_spread_deg"]
    harm = [max(row["change_at_minus_tolerance"], row["change_at_plus_tolerance"]) for row in rows]
    assert harm == sorted(harm, reverse=True)
    inverted = command("inverse", study, "--json")
    assert inverted.returncode == 0, inverted.stderr
    limits = json.loads(inverted.stdout)["limits"]["largest_spread_deg"]
    assert limits["lens_decenter_y_mm"]["above"] > 0.0
    found = command("budget", store, "--yield", "0.6", "-o", out, "--verify", "40")
    assert found.returncode == 0, found.stderr
    assert "40 fresh trials (seed 202406" in found.stdout
    assert "all tolerances scaled by one factor" in found.stdout
    assert found.stderr.startswith("at most 320 trials of the lens, about ")
    assert command("run", out, "--store", tmp_path / "c.db", "--trials", "4").returncode == 0

    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(study_budget, "score_batch", interrupted)
    early = tmp_path / "early.toml"
    broken_off = command("budget", store, "--yield", "0.6", "-o", early, "--verify", "40")
    assert broken_off.returncode == 130
    assert broken_off.stderr.endswith(f"interrupted; {early} holds the best tolerances found so far\n")
    assert "not verified by trials" in broken_off.stdout
    assert all(p.distribution.limit > 0.0 for p in load_study(early).study.perturbations[:2])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("sensitivity", "STORE", "--merit", "speed"), "--merit 'speed': there is no such merit; allow"),
        (("inverse", "STUDY", "--change", "-1.0"), "change = -1: must be above 0"),
        (
            ("budget", "STORE", "--yield", "0.9", "-o", "OUT", "--weight", "a=x"),
            "--weight 'a=x': must be COLUMN",
        ),
        (("budget", "STORE", "--yield", "1.5", "-o", "OUT"), "required yield = 1.5"),
        (("export", "STORE", "OUT"), "cannot write"),
    ],
)
def test_faulty_questions_are_one_message_and_status_2(
    command, write_study, ray_study, tmp_path, arguments, message
):
    study, store = write_study(ray_study), tmp_path / "a.store"
    command("run", study, "--store", store, "--workers", "1", "--trials", "40")
    places = {"STORE": store, "STUDY": study, "OUT": tmp_path / "out.txt"}
    ran = command(*(places.get(a, a) for a in arguments))
    assert ran.returncode == 2
    assert ran.stderr.startswith("error: ")
    assert message in ran.stderr
    assert not (tmp_path / "out.txt").exists()


@pytest.mark.parametrize("arguments", [("show",), ("report", "-o", "out")])
def test_other_files_are_refused_with_status_2(command, tmp_path, arguments):
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


def test_an_interrupted_run_says_so_and_goes_on(command, write_study, ray_study, tmp_path):
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
        preexec_fn=heeding,
    )
    until = time.monotonic() + 300.0
    while time.monotonic() < until and not (path.exists() and finished(path)):
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=300)
    assert (running.returncode, out) == (130, "")
    expected, *rest = err.splitlines()
    assert expected.startswith("1000000 trials, 8 steps: about ")
    assert expected.endswith(" by 1 worker")
    # Older releases of rich end a progress line with a new one.
    assert "".join(rest).strip() == (
        f"interrupted; the finished results are stored in {path}; repeat the command to continue"
    )
    done = len(finished(path))
    again = command("run", tmp_path / "study.toml", "--store", path, "--workers", "1", "--trials", done + 40)
    assert again.returncode == 0, again.stderr
    command(
        "run", tmp_path / "study.toml", "--store", tmp_path / "b", "--workers", "1", "--trials", done + 40
    )
    assert finished(path) == finished(tmp_path / "b")


def on_two_workers(study, store):
    """A command in a process group of its own."""
    options = ["--store", str(store), "--workers", "2", "--json"]
    return subprocess.Popen(
        [sys.executable, "-m", "tolerancing.cli", "run", str(study), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=heeding,
    )


def test_workers_that_are_started_ahead_make_the_same_rows(command, write_study, full_study, tmp_path):
    study = write_study(full_study)
    out, err = on_two_workers(study, tmp_path / "two").communicate(timeout=300)
    assert json.loads(out)["run"]["workers"] == 2
    assert err.startswith("40 trials, 11 steps: about ")
    assert err.endswith(" by 2 workers\n")
    assert command("run", study, "--store", tmp_path / "one", "--workers", "1").returncode == 0
    assert rows(tmp_path / "one") == rows(tmp_path / "two")


@pytest.mark.parametrize("seconds", [0.0, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_workers_that_are_started_ahead_end_with_a_command_that_is_stopped(
    write_study, full_study, tmp_path, seconds, number
):
    psutil = pytest.importorskip("psutil")
    study = write_study(full_study.replace("trials = 40", "trials = 100000"))
    running = on_two_workers(study, tmp_path / "a")
    until, started = time.monotonic() + 300.0, psutil.Process(running.pid)
    while time.monotonic() < until and len(started.children()) < 2:  # the server, and a tracker
        time.sleep(0.01)
    time.sleep(seconds)
    os.killpg(running.pid, number)
    out, err = running.communicate(timeout=300)  # which waits for all that could still write
    assert (running.returncode, out) == (128 + number, ""), err
    said = [line for line in err.splitlines() if "about" not in line]
    assert all(line.startswith("interrupted") for line in said if line.strip()), err


def finished(path):
    """All trials of a store."""
    with sqlite3.connect(path) as connection:
        columns = [row[1] for row in connection.execute("PRAGMA table_info(trial)")]
        lasting = ", ".join(f'"{c}"' for c in columns if c not in ("seconds", "finished"))
        return connection.execute(f"SELECT {lasting} FROM trial ORDER BY trial").fetchall()


def test_a_report_is_written_again_from_the_settings_in_its_folder(
    command, monkeypatch, small_store, tmp_path
):
    written = []

    def write(store, folder, **others):
        folder.mkdir()
        written.append((store.path, others))
        return SimpleNamespace(html=folder / "report.html")

    monkeypatch.setattr("tolerancing.report.report.write_report", write)
    ran = command("report", small_store.path, "--front", tmp_path, "-o", tmp_path / "first")
    assert ran.returncode == 0, ran.stderr
    ran = command("report", "--settings", tmp_path / "first" / "settings.toml", "-o", tmp_path / "again")
    assert ran.returncode == 0, ran.stderr
    first, again = written
    assert again[0].samefile(first[0])
    assert again[1]["front"].samefile(first[1]["front"])
