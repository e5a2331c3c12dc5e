"""How long the packages take to import, and what a command takes to answer, beside a bare interpreter."""

from __future__ import annotations

import resource
import subprocess
import sys
import sysconfig
from functools import partial
from pathlib import Path
from statistics import median

from benchmarks.timing import Row, interleaved, print_table

ROUNDS = 9
PACKAGES = ("lensdesign", "wavesim", "tolerancing")
DESIGN = str(Path(__file__).parents[1] / "designs" / "paper_singlet.toml")
USE_ALL = "import {0}; [getattr({0}, name) for name in {0}.__all__]"


def main() -> None:
    """Measure and print."""
    command = str(Path(sysconfig.get_path("scripts")) / "lensdesign")
    work = {"bare": partial(run, sys.executable, "-c", "pass")}
    for package in PACKAGES:
        work[f"import {package}"] = partial(run, sys.executable, "-c", f"import {package}")
        work[f"import {package}, every public name"] = partial(
            run, sys.executable, "-c", USE_ALL.format(package)
        )
    work["lensdesign --help"] = partial(run, command, "--help")
    times = interleaved(work, ROUNDS)
    bare = times.pop("bare")
    rows = [Row("python -c pass", bare.median, "s")]
    for name, timing in times.items():
        more = median(a - b for a, b in zip(timing.wall, bare.wall, strict=True))
        rows.append(Row(f"{name}, beyond that", more, "s", at_most=None if "every" in name else 0.5))
    check = [processor_seconds(command, "check", DESIGN) for _ in range(ROUNDS)]
    rows.append(Row("lensdesign check of the paper's lens, processor time", median(check), "s"))
    print_table(f"Start-up, median of {ROUNDS} new processes of each in turn", rows)


def run(*command: str) -> None:
    """Run a command to its end."""
    subprocess.run(command, check=True, capture_output=True)


def processor_seconds(*command: str) -> float:
    """What a command takes of the processors, the system's part included, whatever its exit status."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


if __name__ == "__main__":
    main()
