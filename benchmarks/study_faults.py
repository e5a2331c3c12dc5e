"""A run of a study that is killed a hundred times at random moments, against one that nothing befalls."""

from __future__ import annotations

import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from benchmarks.study_speed import RAYS
from benchmarks.timing import DESIGNS, Row, print_table

KILLS, TRIALS, SEED = 100, 200_000, 20240601
STARTING_SECONDS, WRITING_SECONDS = 3.0, 0.4
LEFT_OUT = ("seconds", "finished")


def main() -> None:
    """Kill and compare; exit with status 1 if a row differs."""
    if len(sys.argv) > 1:
        _run(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(DESIGNS / "paper_singlet.toml", folder)
        # Finer chunks of dearer trials than usual, so that a run is killed within them, not between.
        (folder / "study.toml").write_text(RAYS.replace("arms = 21", "arms = 60"))
        rows = kill_often(folder, KILLS, TRIALS, random.Random(SEED))
    print_table(f"{KILLS} kills of a run of {TRIALS} trials with two workers", rows)
    if any(row.met == "NO" for row in rows):
        raise SystemExit(1)


def kill_often(folder: Path, kills: int, trials: int, rng: random.Random) -> list[Row]:
    """Kill a run and start it again, let it finish, and compare with an unbroken one."""
    store = folder / "store"
    lost, gained, logs, last = 0, 0, 0, 0
    for kill in range(1, kills + 1):
        # The study grows from kill to kill, or it would be done long before the last one.
        process = start(folder, store, trials * kill // kills)
        first = ""
        if kill % 4:  # most while it writes, the others while it starts
            assert process.stdout is not None
            first = process.stdout.readline()
        time.sleep(rng.uniform(0.0, WRITING_SECONDS if first else STARTING_SECONDS))
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        printed = [int(line) for line in (first + process.communicate()[0]).split()]
        logs += store.with_name("store-wal").exists()
        held = count(store)
        lost += max(last + (printed[-1] if printed else 0) - held, 0)
        gained += held > last
        last = held
    start(folder, store, trials).communicate()
    start(folder, folder / "unbroken", trials).communicate()
    broken, whole = stored_rows(store), stored_rows(folder / "unbroken")
    return [
        Row("kills after which the store held more than before", gained),
        Row("kills that left a log to be played in", logs),
        Row("trials lost that a run had reported as stored", lost, at_most=0),
        Row("trials in the end", len(broken), at_least=trials, at_most=trials),
        Row("rows that differ from those of an unbroken run", len(set(broken) ^ set(whole)), at_most=0),
        Row("faults that SQLite finds in the file", faults(store), at_most=0),
    ]


def start(folder: Path, store: Path, trials: int) -> subprocess.Popen[str]:
    """Begin a run in a process group of its own; it prints how many trials it has stored."""
    command = [sys.executable, "-m", "benchmarks.study_faults", folder / "study.toml", store, str(trials)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)


def _run(study: Path, store: Path, trials: int) -> None:
    from tolerancing.run.run import run_study
    from tolerancing.study.files import load_study

    loaded = load_study(study)
    run_study(loaded, store, workers=2, trials=trials, progress=lambda done, _: print(done, flush=True))


def count(store: Path) -> int:
    """Number of trials in a store."""
    if not store.exists():
        return 0
    with closing(sqlite3.connect(store)) as connection:
        return int(connection.execute("SELECT count(*) FROM trial").fetchone()[0])


def faults(store: Path) -> int:
    """Number of faults in the file."""
    with closing(sqlite3.connect(store)) as connection:
        found: Sequence[Any] = connection.execute("PRAGMA integrity_check").fetchall()
    return 0 if found == [("ok",)] else len(found)


def stored_rows(store: Path) -> list[tuple[Any, ...]]:
    """All trials of a store, but for the times that they took."""
    with closing(sqlite3.connect(store)) as connection:
        info = connection.execute("PRAGMA table_info(trial)").fetchall()
        names = ", ".join(f'"{row[1]}"' for row in info if row[1] not in LEFT_OUT)
        return connection.execute(f"SELECT {names} FROM trial ORDER BY trial").fetchall()


if __name__ == "__main__":
    main()
