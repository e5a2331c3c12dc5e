"""Commands that take more than a minute on the paper's lens: processor time and peak memory.

Each is run as a user types it, in a folder of its own with the designs, after those that make its input.

    python -m benchmarks.long_commands [NAME ...]
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import tempfile
from pathlib import Path
from typing import NamedTuple

from benchmarks.timing import DESIGNS, Row, Spent, print_table, spent_by

LENS = "designs/paper_singlet.toml"
FIELD = "--object-pitch-um 0.3875 --engine hierarchical"
PATCH = "--patch-mm 0.1 --kind amplitude"


class Command(NamedTuple):
    """A command, and the name of the one whose results it needs; empty if it needs none."""

    text: str
    after: str = ""


def _frames(folder: str) -> str:
    return " ".join(f"{folder}/frame_{plane}_{exposure}.tif" for plane in (1, 2) for exposure in (1, 2, 3))


COMMANDS = {
    "as-built search": Command("lensdesign optimize designs/as_built_spec.toml -o as_built.toml"),
    "frames of the whole field": Command(
        f"wavesim image {LENS} --object usaf --chart-at-mm 0,1.3 --exposures 1,30,1000 {FIELD} -o field"
    ),
    "object of the whole field": Command(
        f"wavesim reconstruct {_frames('field')} --design {LENS} --kind amplitude --iterations 15 {FIELD} "
        "-o field_object",
        "frames of the whole field",
    ),
    "frames of a patch": Command(
        f"wavesim image {LENS} --object usaf --patch-mm 0.1 --exposures 1,30,1000 --engine hierarchical "
        "-o patch"
    ),
    "object of a patch": Command(
        f"wavesim reconstruct {_frames('patch')} --design {LENS} {PATCH} -o patch_object",
        "frames of a patch",
    ),
    "calibration with a patch": Command(
        f"wavesim calibrate {_frames('patch')} --design {LENS} {PATCH} -o bench", "frames of a patch"
    ),
    "calibration without verdict and deviations": Command(
        f"wavesim calibrate {_frames('patch')} --design {LENS} {PATCH} --verdict none --no-deviations "
        "-o quick_bench",
        "frames of a patch",
    ),
    "object with the calibration": Command(
        f"wavesim reconstruct {_frames('patch')} --design {LENS} {PATCH} "
        "--calibration bench/calibration.json -o calibrated_object",
        "calibration with a patch",
    ),
    "study of Fig. 7": Command("tolerancing run designs/paper_figure_7.toml --store figure_7.db"),
    "starting study": Command(f"tolerancing start {LENS} --nominal-mounting -o start.toml"),
    "trials of reconstructions": Command("tolerancing run start.toml --store start.db", "starting study"),
    "budget of reconstructions": Command(
        "tolerancing budget start.db --yield 0.9 -o budget.toml", "trials of reconstructions"
    ),
    "study of reconstructions": Command(
        "tolerancing run designs/paper_reconstruction_study.toml --store reconstructions.db"
    ),
    "the paper, quick": Command("python -m paper --quick -o paper_output"),
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.long_commands")
    parser.add_argument("names", nargs="*", metavar="NAME", help="names of commands; all if left out")
    names = parser.parse_args().names
    unknown = [name for name in names if name not in COMMANDS]
    if unknown:
        parser.error(f"{unknown[0]}: must be one of {', '.join(COMMANDS)}")
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(DESIGNS, Path(folder) / "designs")
        done: dict[str, Spent] = {}
        for name in [name for name in COMMANDS if not names or name in names]:
            measured = _measured(name, Path(folder), done)
            rows = [
                Row("processor time", measured.seconds, "s"),
                Row("memory", measured.gigabytes, "GB"),
                Row("exit status", measured.status),
            ]
            print_table(name, rows)
            print(COMMANDS[name].text, flush=True)


def _measured(name: str, folder: Path, done: dict[str, Spent]) -> Spent:
    """Return what a command takes, which runs once, after those that make its input."""
    if name not in done:
        if COMMANDS[name].after:
            _measured(COMMANDS[name].after, folder, done)
        done[name] = spent_by(shlex.split(COMMANDS[name].text), DESIGNS.parent, folder)
    return done[name]


if __name__ == "__main__":
    main()
