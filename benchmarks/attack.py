"""Files, lenses, merits and stores that mean harm, and runs that are killed: tried, refused, wrong.

Refused is what ends in one message of ours. Wrong is everything else that is no right result: another
exception, a number that is not finite, a row lost or changed, an attempt that takes too long.
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
import signal
import sqlite3
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, redirect_stdout, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import DESIGNS
from lensdesign.errors import TransferLensError

ROOT = DESIGNS.parent
MOST_SECONDS, MOST_SECONDS_STARTING = 20.0, 60.0
"""Of one attempt within this process, and of one that starts others."""


@dataclass
class Tally:
    """What became of the attempts of one kind."""

    tried: int = 0
    refused: int = 0
    wrong: list[str] = field(default_factory=list)

    def count(
        self,
        work: Callable[[], object],
        check: Callable[[Any], bool] = lambda _: True,
        most_seconds: float = MOST_SECONDS,
    ) -> None:
        """Make one attempt."""
        self.tried += 1
        try:
            with _within(most_seconds):
                if not check(work()):
                    self.wrong.append("a wrong result")
        except TransferLensError:
            self.refused += 1
        except (Exception, SystemExit) as error:
            self.wrong.append(f"{type(error).__name__}: {error}"[:300])


@contextmanager
def _within(seconds: float) -> Iterator[None]:
    def late(_number: int, _frame: object) -> None:
        raise TimeoutError(f"more than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def mutated_toml(folder: Path, rng: np.random.Generator, count: int) -> Tally:
    """Designs, specifications and studies."""
    from malformed import malformed

    from lensdesign import load_design, load_specification
    from tolerancing import load_study

    shutil.copytree(DESIGNS, folder, dirs_exist_ok=True)
    readers = {b"[[perturbation": load_study, b"[optimize]": load_specification, b"[sensor]": load_design}
    files = [path.read_bytes() for path in sorted(DESIGNS.glob("*.toml"))]
    tally, path = Tally(), folder / "mutant.toml"
    for _ in range(count):
        data = files[rng.integers(len(files))]
        read = next((r for mark, r in readers.items() if mark in data), load_specification)
        path.write_bytes(malformed(data, rng))
        tally.count(lambda read=read: read(path))
    return tally


def mutated_lenses_and_meshes(folder: Path, rng: np.random.Generator, count: int) -> Tally:
    """Zemax and CODE V files, meshes of all formats."""
    from malformed import malformed

    from lensdesign import load_design, read_mesh, read_seq, read_zmx, write_mesh, write_seq, write_zmx

    lens = load_design(DESIGNS / "paper_singlet.toml")
    write_zmx(lens, folder / "lens.zmx")
    write_seq(lens, folder / "lens.seq")
    for suffix in ("stl", "ply", "obj", "3mf"):
        write_mesh(lens, folder / f"lens.{suffix}", 200.0)
    readers: dict[str, Callable[[Path], Any]] = {"zmx": read_zmx, "seq": read_seq}
    whole = {path: path.read_bytes() for path in sorted(folder.glob("lens.*"))}
    tally = Tally()
    for _ in range(count):
        path = list(whole)[rng.integers(len(whole))]
        mutant = folder / f"mutant{path.suffix}"
        mutant.write_bytes(malformed(whole[path], rng))
        read = readers.get(path.suffix[1:], read_mesh)
        tally.count(lambda read=read, mutant=mutant: read(mutant), _is_finite)
    return tally


def _is_finite(made: Any) -> bool:
    vertices = getattr(made, "vertices_mm", None)
    if vertices is not None:
        return bool(np.isfinite(vertices).all())
    return all(np.isfinite(made.lens.indices(w)).all() for w in made.lens.wavelengths_um)


def mutated_data(folder: Path, rng: np.random.Generator, count: int) -> Tally:
    """Pictures, frames, fields and JSON of mountings."""
    import json

    from malformed import malformed
    from PIL import Image

    from lensdesign import load_design
    from wavesim.calibration.calibration_result import read_calibration
    from wavesim.fields.field import Field, Grid
    from wavesim.fields.files import read_field, write_field
    from wavesim.sensor.frames import read_frame
    from wavesim.targets.patterns import read_grey

    grey = (rng.random((32, 40)) * 65535).astype(np.uint16)
    Image.fromarray(grey).save(folder / "whole.tif")
    Image.fromarray((grey >> 8).astype(np.uint8)).save(folder / "whole.png")
    write_field(
        Field(Grid((16, 16), 1e-3, 0.0), np.ones((16, 16), np.complex64), 0.532), folder / "whole.npz"
    )
    numbers = {"decenter_x_mm": 0.01, "tilt_x_deg": 0.1}
    (folder / "whole.json").write_text(json.dumps({"mounting": numbers, **numbers}))
    lens = load_design(DESIGNS / "paper_singlet.toml")
    readers = {
        ".tif": read_frame,
        ".png": read_grey,
        ".npz": read_field,
        ".json": lambda path: read_calibration(path, lens),
    }
    tally = Tally()
    for _ in range(count):
        suffix = list(readers)[rng.integers(len(readers))]
        mutant = folder / f"mutant{suffix}"
        mutant.write_bytes(malformed((folder / f"whole{suffix}").read_bytes(), rng))
        tally.count(lambda read=readers[suffix], mutant=mutant: read(mutant))
    return tally


POWERS = (-300, -9, -3, -1, 0, 1, 3, 9, 300)


def extreme_lenses(folder: Path, rng: np.random.Generator, count: int) -> Tally:
    """The paper's lens with some numbers of any size, checked as `lensdesign check` does."""
    import re

    from lensdesign import check_design

    text = (DESIGNS / "paper_singlet.toml").read_text()
    places = [m.span(1) for m in re.finditer(r"^\w+ = (-?[\d.]+)", text, re.MULTILINE)]
    tally, path = Tally(), folder / "extreme.toml"
    for _ in range(count):
        changed = text
        for start_at, end in sorted((places[k] for k in rng.choice(len(places), 2, False)), reverse=True):
            old = float(text[start_at:end])
            size = rng.choice([-1.0, 1.0], p=[0.1, 0.9]) * 10.0 ** rng.choice(POWERS)
            changed = f"{changed[:start_at]}{old * size:g}{changed[end:]}"
        path.write_text(changed)
        tally.count(lambda: check_design(path), lambda report: _no_nan(report.as_dict()))
    return tally


def _no_nan(value: Any) -> bool:
    if isinstance(value, dict):
        return all(map(_no_nan, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_no_nan, value))
    return not (isinstance(value, float) and math.isnan(value))


WAYS = (
    "import sys; sys.exit(0)",
    "import os; os._exit(0)",
    "raise BaseException('\\ud800')",
    "class Own(BaseException):\n        def __str__(self): raise Own\n    raise Own",
    "return float('nan')",
    "return float('inf')",
    "return -1.7e308",
    "return 10**400",
    "return '=HYPERLINK(1)'",
    "raise MemoryError",
    "return f(trial)",
    "print('{'); return 1.0",
    "raise ValueError('\\x1b]0;owned\\x07' + 'x' * 10**6)",
    "raise GeneratorExit",
    "import os; os.kill(os.getpid(), 11)",
)
OWN_MERIT = '\n[[merit]]\nkind = "python"\nfunction = "mine.py:f"\nat_least = 0.0\n'


def hostile_merits(folder: Path, rng: np.random.Generator, count: int) -> Tally:
    """Python that leaves, at import, for the nominal lens or in trials; then its store is read."""
    from tolerancing import load_study, open_store, run_study

    tally = Tally()
    for k in range(count):
        way, place = WAYS[k % len(WAYS)], ("trial", "nominal", "import")[int(rng.integers(3))]
        trials = rng.choice(6, 2, replace=False).tolist()
        when = f"trial.number in {trials}" if place == "trial" else "True"
        source = f"def f(trial):\n  if {when}:\n    {way}\n  return 1.0\n"
        source += "f(None)\n" if place == "import" else ""
        write_study(folder, OWN_MERIT)
        (folder / "mine.py").write_text(source)
        store = folder / f"{k}.db"

        workers = 2 if "os." in way else 1  # a merit that ends its process must not end this one

        def work(store: Path = store, workers: int = workers) -> Path:
            with redirect_stdout(sys.stderr):
                run_study(load_study(folder / "study.toml", trust=True), store, workers=workers, trials=6)
            return store

        def check(store: Path) -> bool:
            with open_store(store) as opened:
                return len(opened.trials()) == 6 and not _read_all(store, folder)

        tally.count(work, check, MOST_SECONDS_STARTING if workers > 1 else MOST_SECONDS)
    return tally


def write_study(folder: Path, more: str = "") -> None:
    from tests_studies import DECENTER, DESIGN, HEAD, SPREAD

    (folder / "design.toml").write_text(DESIGN)
    (folder / "study.toml").write_text(HEAD + DECENTER + SPREAD + more)


def _read_all(store: Path, folder: Path) -> str:
    """Return the message of all readers of a store, or an empty text; no formula may be in a table."""
    import csv

    from lensdesign.common.console import print_json
    from tolerancing import open_store, sensitivity, summarize, write_steps, write_trials

    with open_store(store) as opened, redirect_stdout(open(os.devnull, "w")):
        print_json(summarize(opened).as_dict())
        for write, name in ((write_trials, "trials.csv"), (write_steps, "steps.csv")):
            write(opened, folder / name)
            with (folder / name).open(newline="") as file:
                cells = [cell for row in csv.reader(file) for cell in row]
            if any(cell.startswith(("=", "@")) for cell in cells):
                raise ValueError("a formula in a table")
        try:
            print_json({"merits": sensitivity(opened).as_dict()})
        except TransferLensError as error:
            return str(error)
    return ""


CELLS = (
    "'=HYPERLINK(1)'",
    "x'ff00'",
    "NULL",
    "9e999",
    "-1.7e308",
    "-1",
    "'nan'",
    "9223372036854775807",
    "''",
)
SCHEMES = (
    "DROP TABLE {0}; CREATE VIEW {0} AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) "
    "SELECT x FROM c",
    "CREATE TRIGGER t AFTER UPDATE ON {0} BEGIN DELETE FROM trial; END",
    "DROP TABLE {0}",
)


def hostile_stores(folder: Path, rng: np.random.Generator, count: int) -> Tally:
    """Cells of any kind, tables that are none, damaged pages; all that reads reads them."""
    from tolerancing import load_study, run_study

    write_study(folder)
    run_study(load_study(folder / "study.toml"), folder / "whole.db", workers=1, trials=40)
    with closing(sqlite3.connect(folder / "whole.db")) as connection:
        query = (
            "SELECT m.name, p.name FROM sqlite_master m, pragma_table_info(m.name) p WHERE m.type = 'table'"
        )
        columns = connection.execute(query).fetchall()
    tally = Tally()
    for k in range(count):
        store = folder / "hostile.db"
        shutil.copy(folder / "whole.db", store)
        if k % 3 == 0:
            damage(store, rng)
        else:
            table, column = columns[rng.integers(len(columns))]
            change = f'UPDATE OR IGNORE {table} SET "{column}" = {CELLS[rng.integers(len(CELLS))]}'
            if k % 3 == 2 and rng.random() < 0.3:
                change = SCHEMES[rng.integers(len(SCHEMES))].format(table)
            # What SQLite itself refuses changes nothing.
            with closing(sqlite3.connect(store)) as connection, suppress(sqlite3.Error):
                connection.executescript(change)
        tally.count(lambda store=store: _read_all(store, folder))
    return tally


def damage(path: Path, rng: np.random.Generator) -> None:
    """Some bytes of a file changed, or its end cut off."""
    data = bytearray(path.read_bytes())
    if rng.random() < 0.3:
        del data[int(rng.integers(len(data))) :]
    else:
        start_at = int(rng.integers(len(data)))
        for k in range(start_at, min(start_at + int(rng.integers(1, 3000)), len(data))):
            data[k] = int(rng.integers(256))
    path.write_bytes(data)


COUNTS = {
    "mutated_toml": 3000,
    "mutated_lenses_and_meshes": 1200,
    "mutated_data": 3000,
    "extreme_lenses": 300,
    "hostile_merits": 84,
    "hostile_stores": 300,
    "killed_runs": 20,
    "damaged_logs": 200,
    "full_disks": 8,
    "killed_reconstructions": 4,
}
"""Attempts of each kind, in four minutes of two busy cores."""

RUNS = ("killed_runs", "damaged_logs", "full_disks", "killed_reconstructions")


def attack(kind: str, seed: int, count: int) -> Tally:
    """All attempts of one kind."""
    for folder in ("support", ""):
        if str(ROOT / "tests" / folder) not in sys.path:  # what spoils files is shared with the tests
            sys.path.append(str(ROOT / "tests" / folder))
    if kind in RUNS:
        import benchmarks.attacked_runs as module

        work = getattr(module, kind)
    else:
        work = globals()[kind]
    with tempfile.TemporaryDirectory() as name:
        return work(Path(name), np.random.default_rng([seed, list(COUNTS).index(kind)]), count)


def main() -> None:
    """Attack, print the table; exit with status 1 if anything was wrong."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--share", type=float, default=1.0, help="Of the attempts of each kind.")
    parser.add_argument("--only", choices=list(COUNTS), nargs="*", default=list(COUNTS))
    given = parser.parse_args()
    table = Table(title=f"seed {given.seed}, share {given.share:g}", box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("attack", "tried", "refused", "wrong", "seconds"):
        table.add_column(heading, justify="left" if heading == "attack" else "right")
    wrong: list[str] = []
    for kind in given.only:
        begun = time.perf_counter()
        tally = attack(kind, given.seed, max(round(given.share * COUNTS[kind]), 1))
        cells = [tally.tried, tally.refused, len(tally.wrong), round(time.perf_counter() - begun)]
        print(kind, *cells, file=sys.stderr, flush=True)
        table.add_row(kind.replace("_", " "), *map(str, cells))
        wrong += [f"{kind}: {text}" for text in tally.wrong]
    Console(width=100).print(table)
    print("\n".join(dict.fromkeys(wrong)))
    if wrong:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
