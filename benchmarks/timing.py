"""What all benchmarks share: interleaved timing and one way to print."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import NamedTuple

DESIGNS = Path(__file__).resolve().parents[1] / "designs"


@dataclass(frozen=True)
class Timing:
    """Seconds of several runs of one thing, by the wall clock and of all its threads' processor time."""

    wall: tuple[float, ...]
    cpu: tuple[float, ...]

    @property
    def best(self) -> float:
        """Fewest seconds by the wall clock."""
        return min(self.wall)

    @property
    def median(self) -> float:
        """Median seconds by the wall clock."""
        return median(self.wall)

    @property
    def cpu_median(self) -> float:
        """Median seconds of processor time."""
        return median(self.cpu)


def interleaved(work: Mapping[str, Callable[[], object]], rounds: int, runs: int = 1) -> dict[str, Timing]:
    """Time several things in turn, A B A B ..., so that a drift of the machine's speed hits all alike.

    Each is run once before, untimed, and then `runs` times whenever its turn comes.
    """
    wall: dict[str, list[float]] = {name: [] for name in work}
    cpu: dict[str, list[float]] = {name: [] for name in work}
    for call in work.values():
        call()
    for _ in range(rounds):
        for name, call in work.items():
            for _ in range(runs):
                wall_start, cpu_start = time.perf_counter(), time.process_time()
                call()
                wall[name].append(time.perf_counter() - wall_start)
                cpu[name].append(time.process_time() - cpu_start)
    return {name: Timing(tuple(wall[name]), tuple(cpu[name])) for name in work}


class Spent(NamedTuple):
    """Processor time in s of a command, its largest memory in GB, its exit status, and what it prints."""

    seconds: float
    gigabytes: float
    status: int
    text: str


def spent_by(words: list[str], root: Path, folder: Path) -> Spent:
    """Run a command of the version in `root` in a folder, as a user types it, and return what it takes.

    Raises
    ------
    RuntimeError
        If it ends with another status than 0 or 1.
    """
    program, *arguments = words
    start = [] if program == "python" else ["-c", f"from {program}.cli import main; main()"]
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        process = subprocess.Popen(
            [sys.executable, *start, *arguments],
            cwd=folder,
            env=os.environ | {"PYTHONPATH": str(root)},
            stdout=out,
            stderr=err,
        )
        _, ended, used = os.wait4(process.pid, 0)
        status = process.returncode = os.waitstatus_to_exitcode(ended)
        out.seek(0)
        err.seek(0)
        if status not in (0, 1):
            raise RuntimeError(f"{' '.join(words)}: exit status {status}\n{err.read()[-2000:].decode()}")
        return Spent(used.ru_utime + used.ru_stime, 1e-6 * used.ru_maxrss, status, out.read().decode())


@dataclass(frozen=True)
class Row:
    """One measured value, and where it has a target, the target and which way it works."""

    name: str
    value: float
    unit: str = ""
    at_least: float | None = None
    at_most: float | None = None

    @property
    def target(self) -> str:
        """The target in words."""
        if self.at_least is not None:
            return f">= {self.at_least:g}"
        return "" if self.at_most is None else f"<= {self.at_most:g}"

    @property
    def met(self) -> str:
        """Whether the target is met, where there is one."""
        if self.at_least is not None:
            return "yes" if self.value >= self.at_least else "NO"
        if self.at_most is not None:
            return "yes" if self.value <= self.at_most else "NO"
        return ""


def print_table(title: str, rows: list[Row]) -> None:
    """Print measured values under a title, with the number of processors and how busy they were."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    processors = len(os.sched_getaffinity(0))
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("measured", min_width=max(len(row.name) for row in rows), no_wrap=True)
    for heading, justify in (("value", "right"), ("unit", "left"), ("target", "right"), ("met", "left")):
        table.add_column(heading, justify="right" if justify == "right" else "left", no_wrap=True)
    for row in rows:
        table.add_row(row.name, f"{row.value:.4g}", row.unit, row.target, row.met)
    console = Console(width=120, highlight=False, markup=False)
    console.print(title)
    console.print(f"{processors} processors, load average {os.getloadavg()[0]:.2f}")
    console.print(table)
