"""Commands in turns with an older commit: processor time, and results of calibrations and reconstructions.

A folder holds frames, the true object and `set.json`, as for `benchmarks.bench_sets`. Each version runs the
commands as users type them, in processes of its own and with the same installed libraries:
`wavesim calibrate`, and `wavesim reconstruct --calibration` with its result. For this version, the
reconstruction is measured twice: with the object that the calibration has judged, and without it.

With `--command`, each version runs a command of any package instead, and prints its last lines:

    python -m benchmarks.against_commit COMMIT [--rounds 1] [FOLDER ...]
    python -m benchmarks.against_commit COMMIT --command "lensdesign optimize SPEC -o found.toml"
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.bench_sets import GOLDEN, design_of, true_object
from benchmarks.timing import Row, print_table, spent_by
from lensdesign import load_design
from wavesim.fields.files import write_field
from wavesim.reconstruction.calibrated_bench import JUDGED_OBJECT
from wavesim.scene.settings import PatchSettings
from wavesim.targets.patch import lit_patch

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("commit")
    parser.add_argument("folders", nargs="*", type=Path, default=[GOLDEN])
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--command")
    given = parser.parse_args()
    with _checkout(given.commit) as older:
        if given.command is not None:
            words = shlex.split(given.command)
            print_table(
                f"{given.command}, this version and {given.commit}",
                _rows_of_command(words, older, given.rounds),
            )
            return
        for folder in given.folders:
            print_table(
                f"{folder.name}, this version and {given.commit}",
                _rows(folder.resolve(), older, given.rounds),
            )


@contextmanager
def _checkout(commit: str) -> Iterator[Path]:
    """Yield a folder with the files of a commit."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "older"
        subprocess.run(["git", "worktree", "add", "--detach", "--quiet", path, commit], cwd=ROOT, check=True)
        try:
            yield path
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", path], cwd=ROOT, check=True)


def _rows_of_command(words: list[str], older: Path, rounds: int) -> list[Row]:
    seconds: dict[str, list[float]] = {"older": [], "this": []}
    for _ in range(rounds):
        for version, root in (("older", older), ("this", ROOT)):
            spent = spent_by(words, root, root)
            seconds[version].append(spent.seconds)
            print(f"{version}:", *spent.text.splitlines()[-12:], sep="\n", flush=True)
    rows = [Row(version, median(times), "s") for version, times in seconds.items()]
    return [*rows, Row("ratio", median(seconds["this"]) / median(seconds["older"]), at_most=0.5)]


def _rows(folder: Path, older: Path, rounds: int) -> list[Row]:
    seconds: dict[str, list[float]] = {}
    found: dict[str, dict[str, Any]] = {}
    for _ in range(rounds):
        for version, root in (("older", older), ("this", ROOT)):
            with tempfile.TemporaryDirectory() as place:
                for name, time_s, result in _measured(folder, root, Path(place)):
                    seconds.setdefault(f"{version}: {name}", []).append(time_s)
                    found[f"{version}: {name}"] = result
    rows = [Row(name, median(times), "s") for name, times in seconds.items()]
    for name in ("calibrate", "reconstruct"):
        ratio = median(seconds[f"this: {name}"]) / median(seconds[f"older: {name}"])
        rows.append(Row(f"ratio of {name}", ratio, at_most=0.2))
    for name, result in found.items():
        if "truth" in result:
            rows.append(Row(f"correlation, {name}", result["truth"]["object_correlation"]))
        rows.append(Row(f"explained (1: yes), {name}", float(result["verdict"]["explained"])))
    return rows


def _measured(folder: Path, root: Path, place: Path) -> Iterator[tuple[str, float, dict[str, Any]]]:
    """Yield name, processor time and result of each command of one version."""
    about, design = json.loads((folder / "set.json").read_text()), design_of(folder)
    settings = PatchSettings(patch_mm=about["patch_mm"])
    given = [*(folder / name for name in about["files"]), "--design", design]
    given += ["--patch-mm", about["patch_mm"], "--kind", about.get("kind", "amplitude"), "--json"]
    truth = place / "true.npz"
    write_field(true_object(folder, lit_patch(load_design(design), settings)[0]), truth)
    yield "calibrate", *_run(root, "calibrate", *given, "-o", place / "bench")
    command = ("reconstruct", *given, "--calibration", place / "bench" / "calibration.json")
    yield "reconstruct", *_run(root, *command, "--truth", truth, "-o", place / "object")
    if (place / "bench" / JUDGED_OBJECT).exists():
        (place / "bench" / JUDGED_OBJECT).unlink()
        yield "reconstruct anew", *_run(root, *command, "--truth", truth, "-o", place / "anew")


def _run(root: Path, *words: object) -> tuple[float, dict[str, Any]]:
    """Run `wavesim` of a version, and return its processor time and its result."""
    spent = spent_by(["wavesim", *map(str, words)], root, root)
    result: dict[str, Any] = json.loads(spent.text)
    return spent.seconds, result


if __name__ == "__main__":
    main()
