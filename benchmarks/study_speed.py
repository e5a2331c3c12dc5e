"""Speed of tolerance studies with the store included: rays, pupils, a cluster, a million trials.

Each run is a process of its own; its speed is that of its loop, from the first tenth of its trials to the
last one, so that starting Python does not count.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.timing import DESIGNS, Row, print_table

ROUNDS = 3
RAY_TRIALS, PUPIL_TRIALS, LINE_TRIALS, WAVE_TRIALS = 60_000, 600, 1000, 200
MOST_TRIALS = 1_000_000
SLEEPS, TRIALS_PER_TASK = 40, 16
SHARE_LEFT_OUT = 0.1
MOST_MEGABYTES = 500.0

HEAD = """
design = "paper_singlet.toml"
trials = 1000
seed = 20240601
sensitivity = false

[sampling]
rings = 5
arms = 21

[[perturbation]]
target = "lens"
parameter = "decenter_x_mm"
distribution = "normal"
sigma = 0.008

[[perturbation]]
target = "lens"
parameter = "decenter_y_mm"
distribution = "normal"
sigma = 0.008

[[perturbation]]
target = "lens"
parameter = "tilt_x_deg"
distribution = "normal"
sigma = 0.03

[[perturbation]]
target = "surface 1"
parameter = "thickness_mm"
distribution = "uniform"
half_width = 0.015

[[perturbation]]
target = "surface 2"
parameter = "radius_mm"
distribution = "truncated_normal"
sigma = 0.004
limit = 0.008
"""

RAYS = HEAD + "".join(
    f'\n[[merit]]\nkind = "{kind}"\n{limit}\nfield_points_mm = [[0.0, 0.0], [0.0, 1.0]]\n'
    for kind, limit in (
        ("largest_spread_deg", "at_most = 4.9"),
        ("footprint_radius_mm", "at_most = 12.0"),
        ("throughput", "at_least = 0.99"),
    )
)
PUPILS = (
    HEAD
    + """
[[merit]]
kind = "strehl"
at_least = 0.5
field_points_mm = [[0.0, 0.0], [0.0, 0.7], [0.0, 1.4]]
"""
)
WAVES = (
    HEAD
    + """
[[merit]]
kind = "line_pair_contrast"
level = "wave"
patch_um = 34.0
line_width_um = 0.775
orientation = "y"
at_least = 0.5
"""
)
# What happens on the meridional line stays on it.
LINE = WAVES.replace("decenter_x_mm", "despace_mm").replace("patch_um", "line = true\npatch_um")
SLEEPING = (
    HEAD
    + """
[[merit]]
kind = "python"
function = "sleeping.py:score"
at_most = 1.0
"""
)
TEXTS = {"rays": RAYS, "pupils": PUPILS, "line": LINE, "waves": WAVES, "sleeping": SLEEPING}
SLEEPING_SOURCE = f"""
import time

def score(trial):
    time.sleep(1.0 / {TRIALS_PER_TASK})
    return trial.deltas["lens_decenter_x_mm"]
"""


def main() -> None:
    """Measure and print."""
    if len(sys.argv) > 1:
        print(json.dumps(measured_run(*sys.argv[1:])))
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(DESIGNS / "paper_singlet.toml", folder)
        (folder / "sleeping.py").write_text(SLEEPING_SOURCE)
        for study, text in TEXTS.items():
            (folder / f"{study}.toml").write_text(text)
        title = f"Studies, store included, best of {ROUNDS} runs of each in turn"
        print_table(title, [*speeds(folder, "rays", RAY_TRIALS, 5000.0)])
        print_table(title, [*speeds(folder, "pupils", PUPIL_TRIALS, 50.0)])
        print_table(title, [*speeds(folder, "line", LINE_TRIALS, 50.0)])
        print_table(title, [*speeds(folder, "waves", WAVE_TRIALS, 10.0)])
        print_table(f"{SLEEPS} tasks of 1 s, two workers", cluster_rows(folder))
        print_table(f"{MOST_TRIALS} trials of rays, two workers", many_rows(folder))


def speeds(folder: Path, study: str, trials: int, at_least: float) -> list[Row]:
    """Trials a second by one worker and by two, and their ratio."""
    best = {1: 0.0, 2: 0.0}
    for _ in range(ROUNDS):
        for workers in best:
            best[workers] = max(best[workers], run(folder, study, trials * workers, workers=workers)["speed"])
    return [
        Row(f"{study}, one worker", best[1], "trials/s"),
        Row(f"{study}, two workers", best[2], "trials/s", at_least=at_least),
        Row(f"{study}, two workers / one", best[2] / best[1], at_least=1.8),
    ]


def cluster_rows(folder: Path) -> list[Row]:
    """A Dask cluster of two workers beside the local pool."""
    trials = SLEEPS * TRIALS_PER_TASK
    local = run(folder, "sleeping", trials, workers=2)["speed"] / TRIALS_PER_TASK
    with dask_cluster(folder) as address:
        cluster = run(folder, "sleeping", trials, cluster=address)["speed"] / TRIALS_PER_TASK
    return [
        Row("local pool", local, "tasks/s"),
        Row("Dask cluster", cluster, "tasks/s"),
        Row("Dask cluster / local pool", cluster / local, at_least=0.8),
    ]


def many_rows(folder: Path) -> list[Row]:
    """What a million trials take."""
    found = run(folder, "rays", MOST_TRIALS, workers=2)
    return [
        Row("all of it", found["seconds"], "s"),
        Row("in the loop", found["speed"], "trials/s"),
        Row("largest memory of the process with the store", found["megabytes"], "MB", at_most=MOST_MEGABYTES),
        Row("largest memory of a worker", found["worker_megabytes"], "MB", at_most=MOST_MEGABYTES),
        Row("store", (folder / "store").stat().st_size / 1e6, "MB"),
        *report_rows(folder),
    ]


def report_rows(folder: Path) -> list[Row]:
    """What the report of that store takes, in a process of its own."""
    code = (
        "import resource, sys; from tolerancing import open_store, write_report\n"
        "with open_store(sys.argv[1]) as store: write_report(store, sys.argv[2])\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3)"
    )
    start = time.perf_counter()
    command = [sys.executable, "-c", code, folder / "store", folder / "report"]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    return [
        Row("its report, as page, PDF and tables", time.perf_counter() - start, "s", at_most=30.0),
        Row("largest memory of the report", float(done.stdout), "MB", at_most=MOST_MEGABYTES),
    ]


def run(folder: Path, study: str, trials: int, **options: Any) -> dict[str, float]:
    """A run into a fresh store, in a process of its own."""
    (folder / "store").unlink(missing_ok=True)
    command = [sys.executable, "-m", "benchmarks.study_speed", folder / f"{study}.toml", folder / "store"]
    done = subprocess.run([*command, str(trials), json.dumps(options)], check=True, stdout=subprocess.PIPE)
    result: dict[str, float] = json.loads(done.stdout)
    return result


def measured_run(study: str, store: str, trials: str, options: str) -> dict[str, float]:
    """What a run in this process takes."""
    from tolerancing.run.run import run_study
    from tolerancing.study.files import load_study

    calls: list[tuple[float, int]] = []
    outcome = run_study(
        load_study(study, trust=True),
        store,
        trials=int(trials),
        progress=lambda done, _: calls.append((time.perf_counter(), done)),
        **json.loads(options),
    )
    calls = [entry for entry in calls if entry[1] >= SHARE_LEFT_OUT * int(trials)]
    (start, first), (end, last) = calls[0], calls[-1]
    own, workers = (
        resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    return {
        "seconds": outcome.seconds,
        "speed": (last - first) / (end - start),
        "megabytes": own / 1e3,
        "worker_megabytes": workers / 1e3,
    }


@contextmanager
def dask_cluster(folder: Path) -> Iterator[str]:
    """A scheduler and two workers on this machine; gives the address."""
    file = folder / "scheduler.json"
    processes = []

    def start(name: str, *options: str) -> None:
        command = [sys.executable, "-m", f"distributed.cli.{name}", *options, "--host", "127.0.0.1"]
        with open(os.devnull, "w") as nowhere:
            processes.append(subprocess.Popen([*command, "--no-dashboard"], stdout=nowhere, stderr=nowhere))

    try:
        start("dask_scheduler", "--port", "0", "--scheduler-file", str(file))
        while not file.exists():
            time.sleep(0.05)
        address = str(json.loads(file.read_text())["address"])
        for k in range(2):
            place = str(folder / f"worker{k}")
            start("dask_worker", address, "--nthreads", "1", "--no-nanny", "--local-directory", place)
        time.sleep(5.0)
        yield address
    finally:
        for process in processes:
            process.kill()
            process.wait()


if __name__ == "__main__":
    main()
