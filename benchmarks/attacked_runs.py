"""Runs that are killed, on full disks, with damaged logs and checkpoints: whether what they leave is whole.

The part of `benchmarks.attack` whose attempts take processes of their own.
"""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.attack import ROOT, Tally, damage, write_study
from benchmarks.study_faults import kill_often, start, stored_rows
from benchmarks.study_speed import RAYS
from benchmarks.timing import DESIGNS

TRIALS = 4000


def killed_runs(folder: Path, rng: np.random.Generator, kills: int) -> Tally:
    """A run that is killed at random and resumed: all trials that it reported as stored are in the store."""
    _rays(folder)
    rows = kill_often(folder, kills, TRIALS, random.Random(int(rng.integers(2**31))))
    return Tally(tried=kills, wrong=[f"killed runs: {row.name}" for row in rows if row.met == "NO"])


def _rays(folder: Path) -> None:
    shutil.copy(DESIGNS / "paper_singlet.toml", folder)
    (folder / "study.toml").write_text(RAYS.replace("arms = 21", "arms = 60"))


def damaged_logs(folder: Path, rng: np.random.Generator, attempts: int) -> Tally:
    """A write-ahead log with bytes changed or its end cut off: whole batches before that, or a refusal."""
    from tolerancing import load_study, open_store, run_study

    write_study(folder)
    loaded = load_study(folder / "study.toml")
    run_study(loaded, folder / "whole.db", workers=1, trials=40)
    whole = set(stored_rows(folder / "whole.db"))
    run_study(loaded, folder / "begun.db", workers=1, trials=10)
    with open_store(folder / "whole.db") as source:
        later = [source.trials(only=k) for k in range(10, 40)]
    with open_store(folder / "begun.db") as store:  # its log as a kill would leave it
        store.start_writing()
        for row in later:
            store.add(row)
        for end in ("", "-wal"):
            shutil.copy(folder / f"begun.db{end}", folder / f"kept.db{end}")
    tally, copy = Tally(), folder / "copy.db"

    def rows() -> list[object]:
        with open_store(copy) as opened:
            opened.trials()
        return list(stored_rows(copy))

    for _ in range(attempts):
        for end in ("-shm", "-wal", ""):
            (folder / f"copy.db{end}").unlink(missing_ok=True)
        for end in ("", "-wal"):
            shutil.copy(folder / f"kept.db{end}", folder / f"copy.db{end}")
        damage(folder / "copy.db-wal", rng)
        tally.count(rows, lambda found: len(found) >= 10 and set(found) <= whole)
    return tally


def full_disks(folder: Path, rng: np.random.Generator, attempts: int) -> Tally:
    """A run whose files may not exceed some size: one message reports it; with space again it is resumed."""
    _rays(folder)
    start(folder, folder / "unbroken", TRIALS).communicate()
    whole = stored_rows(folder / "unbroken")
    size = (folder / "unbroken").stat().st_size
    command = [sys.executable, "-m", "tolerancing.cli", "run", str(folder / "study.toml"), "--workers", "1"]
    tally = Tally()
    for k in range(attempts):
        tally.tried += 1
        store, most = folder / f"{k}.db", int(size * rng.uniform(0.01, 0.9))
        words = [*command, "--trials", str(TRIALS), "--store", str(store)]

        def limit(most: int = most) -> None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

        full = subprocess.run(words, preexec_fn=limit, capture_output=True, text=True, cwd=ROOT)
        if (
            full.returncode == 2
            and "\nerror: cannot write" in f"\n{full.stderr}"
            and "Traceback" not in full.stderr
        ):
            tally.refused += 1
        else:
            tally.wrong.append(f"status {full.returncode}: {full.stderr[-200:]}")
        again = subprocess.run(words, capture_output=True, text=True, cwd=ROOT)
        if again.returncode or stored_rows(store) != whole:
            tally.wrong.append(f"not whole afterwards: {again.stderr[-200:]}")
    return tally


def killed_reconstructions(folder: Path, rng: np.random.Generator, attempts: int) -> Tally:
    """`wavesim reconstruct` killed once it has kept something, which is damaged every other time."""
    from wavesim_command import write_frames

    write_frames(folder)
    whole = _reconstruct(folder, folder / "whole")
    whole.communicate()
    tally = Tally()
    for k in range(attempts):
        tally.tried += 1
        out = folder / f"cut_{k}"
        run = _reconstruct(folder, out)
        while run.poll() is None and not (out / "checkpoint.npz").exists():
            time.sleep(0.02)
        time.sleep(rng.uniform(0.0, 0.3))
        if run.poll() is None:
            os.killpg(run.pid, signal.SIGKILL)
        run.communicate()
        if k % 2 and (out / "checkpoint.npz").exists():
            damage(out / "checkpoint.npz", rng)
        again = _reconstruct(folder, out)
        said = again.communicate()[0]
        if again.returncode or not _same(folder / "whole", out):
            tally.wrong.append(f"reconstruction {k}: {said[-200:]}")
    return tally


def _reconstruct(folder: Path, out: Path) -> subprocess.Popen[str]:
    frames = [str(folder / f"frame_{k}.tif") for k in (1, 2)]
    words = ["reconstruct", *frames, "--design", str(folder / "twin.toml"), "--patch-mm", "0.05"]
    words += ["--error", "0.3", "--engine", "eikonal", "--iterations", "7", "-o", str(out)]
    code = (
        "import math, sys; from wavesim.reconstruction import resumable as r\n"
        "r.SAVE_INTERVAL_S, r.SAVE_TIME_FRACTION = 0.0, math.inf  # too late to save anything\n"
        "from wavesim.cli.commands import main; sys.argv[0] = 'wavesim'; main()"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
        start_new_session=True,
    )


def _same(a: Path, b: Path) -> bool:
    """Whether two reconstructions are the same, to the last bit."""
    try:
        with np.load(a / "reconstruction.npz") as first, np.load(b / "reconstruction.npz") as second:
            return first.files == second.files and all(
                np.array_equal(first[name], second[name], equal_nan=True) for name in first.files
            )
    except OSError:
        return False
