"""Cost of one reconstruction pupil, and how a tolerance study grows with trials and processors."""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sysconfig
import tempfile
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.timing import DESIGNS, Row, interleaved, print_table
from lensdesign import Lens, Pose, load_design
from wavesim.pupil.characteristic import PupilSampler

SAMPLES = 144
COUNTS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
STUDY_TRIALS = 4000
STUDY_ROUNDS = 2
WORKERS = (1, 2)


def main() -> None:
    """Measure and print."""
    print_table("One reconstruction pupil", one_trial(load_design(DESIGNS / "paper_singlet.toml")))
    title = f"Tolerance study, {STUDY_TRIALS} trials and its sweeps, {STUDY_ROUNDS} runs of each in turn"
    print_table(title, study_speeds())


def one_trial(lens: Lens) -> list[Row]:
    """Cost of a trial, and the exponent of the cost of many in their number."""
    sampler = PupilSampler(lens, samples=SAMPLES)
    rng = np.random.default_rng(20240601)
    poses = [
        Pose(decenter_x_mm=dx, decenter_y_mm=dy, tilt_x_deg=tilt_x, tilt_y_deg=tilt_y)
        for dx, dy, tilt_x, tilt_y in rng.normal(size=(max(COUNTS), 4)) * [0.01, 0.01, 0.05, 0.05]
    ]

    def run(count: int) -> None:
        for pose in poses[:count]:
            sampler.pupil(pose)

    single = interleaved({"trial": partial(run, 1)}, 101)["trial"]
    many = interleaved({str(count): partial(run, count) for count in COUNTS}, 5)
    seconds = [many[str(count)].best for count in COUNTS]
    exponent = np.polyfit(np.log(COUNTS), np.log(seconds), 1)[0]
    return [
        Row("pupil points", int(np.count_nonzero(sampler.grid.inside))),
        Row("processor time of a trial, median", 1e3 * single.cpu_median, "ms", at_most=20.0),
        Row("wall-clock time of a trial, median", 1e3 * single.median, "ms"),
        Row(f"time of {COUNTS[-1]} trials, each", 1e3 * seconds[-1] / COUNTS[-1], "ms", at_most=20.0),
        Row(f"exponent of the time, {COUNTS[0]} to {COUNTS[-1]} trials", exponent, "", at_most=1.05),
    ]


def study_speeds() -> list[Row]:
    """Trials a second of a study with one and with two processes, which must store the same rows."""
    seconds: dict[int, list[float]] = {workers: [] for workers in WORKERS}
    with tempfile.TemporaryDirectory() as folder:
        stores = {workers: Path(folder) / f"{workers}.db" for workers in WORKERS}
        for _ in range(STUDY_ROUNDS):
            for workers, store in stores.items():
                seconds[workers].append(run_study(store, workers))
        one, two = (set(stored_rows(store)) for store in stores.values())
    best = {workers: STUDY_TRIALS / min(spent) for workers, spent in seconds.items()}
    rows = [Row(f"--workers {workers}, best", speed, "trials/s") for workers, speed in best.items()]
    return [
        *rows,
        Row(f"--workers {WORKERS[1]} / --workers {WORKERS[0]}", best[WORKERS[1]] / best[WORKERS[0]]),
        Row("stored rows of each", len(one), at_least=STUDY_TRIALS),
        Row("stored rows that differ between them", len(one ^ two), at_most=0),
    ]


def run_study(store: Path, workers: int) -> float:
    """Run all trials and sweeps into a fresh store; seconds that the run says it took."""
    command = Path(sysconfig.get_path("scripts")) / "tolerancing"
    study = DESIGNS / "paper_tolerances.toml"
    options = [f"--store={store}", f"--workers={workers}", f"--trials={STUDY_TRIALS}", "--fresh", "--json"]
    done = subprocess.run([command, "run", study, *options], check=True, stdout=subprocess.PIPE)
    return float(json.loads(done.stdout)["run"]["seconds"])


def stored_rows(path: Path) -> list[tuple[object, ...]]:
    """All trials, steps and pictures of a store, but for the time that they took."""
    rows: list[tuple[object, ...]] = []
    with closing(sqlite3.connect(path)) as connection:
        for table in ("trial", "step", "picture"):
            columns = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
            lasting = ", ".join(f'"{c}"' for c in columns if c not in ("seconds", "finished"))
            rows += [(table, *row) for row in connection.execute(f"SELECT {lasting} FROM {table}")]
    return rows


if __name__ == "__main__":
    main()
