"""STEP files of the glass: seconds, bytes, and how near to the lens they are when read back.

Three lenses: the paper's, a cemented doublet of spheres, and a singlet with a strong even asphere. A file
that departs from its lens is refused by the exporter, which ends this with an error. Targets are for the
paper's.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

from benchmarks.timing import DESIGNS, Row, interleaved, print_table
from lensdesign import Lens, load_design
from lensdesign.manufacture.step.writing import StepReport, write_step

DESIGN = DESIGNS / "paper_singlet.toml"
ROUNDS = 5

FIRST = """
import sys, time
from lensdesign import load_design
lens = load_design(sys.argv[1])
start = time.perf_counter()
from lensdesign.manufacture.step.writing import write_step
write_step(lens, sys.argv[2])
print(time.perf_counter() - start)
"""
"""The first file that a process writes: OCP is read in from disk."""


def lenses() -> dict[str, Lens]:
    """The lenses by name."""
    paper = load_design(DESIGN)
    front, back = paper.surfaces
    doublet = (
        front.replaced(radius_mm=40.0, semi_diameter_mm=9.0, thickness_mm=6.0),
        back.replaced(radius_mm=-30.0, conic=0.0, semi_diameter_mm=9.0, thickness_mm=2.0, material="N-SF6"),
        back.replaced(radius_mm=-90.0, conic=0.0, semi_diameter_mm=9.0),
    )
    asphere = front.replaced(radius_mm=15.0, conic=-0.5, asphere=(-3e-4, 5e-7), semi_diameter_mm=9.0)
    return {
        "paper's lens": paper,
        "doublet": paper.replaced(surfaces=doublet),
        "asphere": paper.replaced(surfaces=(asphere, back)),
    }


def whole_command(path: Path) -> None:
    """`lensdesign export`, start-up and all."""
    command = "from lensdesign.cli import main; main()"
    subprocess.run(
        [sys.executable, "-c", command, "export", DESIGN, path], check=True, stdout=subprocess.DEVNULL
    )


def first_call(path: Path) -> float:
    """Seconds of a process's first file."""
    ran = subprocess.run([sys.executable, "-c", FIRST, DESIGN, path], check=True, capture_output=True)
    return float(ran.stdout)


def rows_of(name: str, found: StepReport, seconds: float, target: bool) -> list[Row]:
    """What is measured of one lens."""
    off = abs(found.volume_mm3 / found.exact_volume_mm3 - 1.0)
    return [
        Row(f"{name}: library call", seconds, "s", at_most=2.0 if target else None),
        Row(f"{name}: size", found.bytes / 1e3, "kB", at_most=100.0 if target else None),
        Row(f"{name}: distance from the true surfaces", found.largest_error_mm, "mm"),
        Row(f"{name}: relative error of the volume", off),
    ]


def main() -> None:
    """Write, read back, time and print."""
    if find_spec("OCP") is None:
        print("left out: OCP is missing; pip install 'transferlens[cad]'")
        return
    chosen = lenses()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "lens.step"
        found = {name: write_step(lens, path) for name, lens in chosen.items()}
        work = {name: lambda lens=lens: write_step(lens, path) for name, lens in chosen.items()}
        timings = interleaved(work, ROUNDS)
        firsts = sorted(first_call(path) for _ in range(ROUNDS))
        commands = []
        for _ in range(ROUNDS):
            start = time.perf_counter()
            whole_command(path)
            commands.append(time.perf_counter() - start)
    rows = [
        row
        for number, (name, timing) in enumerate(timings.items())
        for row in rows_of(name, found[name], timing.median, number == 0)
    ]
    rows += [
        Row("paper's lens: first call of a process", firsts[ROUNDS // 2], "s", at_most=2.0),
        Row("paper's lens: whole command", sorted(commands)[ROUNDS // 2], "s"),
    ]
    print_table("STEP files, written, read back and measured", rows)


if __name__ == "__main__":
    main()
