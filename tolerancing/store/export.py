"""Trials and steps of a store for other programs: CSV or Parquet, written block by block."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
from typing import Any

from lensdesign.common.text import safe_cell
from lensdesign.errors import InputError, atomic_path
from tolerancing.store.checks import Columns, check_kinds
from tolerancing.store.file import undamaged
from tolerancing.store.schema import number_columns
from tolerancing.store.store import Store

Rows = Sequence[Sequence[Any]]
Write = Callable[[Rows], None]


def write_trials(store: Store, path: str | os.PathLike[str]) -> None:
    """Write all trials, with the dear scores of those that have them.

    Parameters
    ----------
    store
        An open store, finished or not.
    path
        A ``.csv`` or ``.parquet`` file. A score that is missing is an empty cell there, or null. In CSV, a
        text that a spreadsheet would take for a formula starts with an apostrophe.

    Raises
    ------
    InputError
        If the name has another ending, the file cannot be written, ``pyarrow`` is not installed for Parquet,
        or the store holds what no run writes; whatever stood there stays.
    """
    study = store.study
    columns: Columns = {"trial": "integer", "status": "text", "message": "text"}
    columns |= dict.fromkeys(number_columns(study), "number")
    columns |= {"passed": "flag", "seconds": "number", "finished": "number"}
    own = [f'trial."{name}"' for name in columns]
    if study.high_fidelity_merits:
        dear: Columns = {"chosen": "text"} | {m.column: "number" for m in study.high_fidelity_merits}
        own += [f'dear."{name}"' for name in dear] + ["dear.message", "dear.seconds"]
        columns |= dear | {"dear_message": "text", "dear_seconds": "number"}
    query = (
        f"SELECT {', '.join(own)} FROM trial LEFT JOIN dear ON dear.trial = trial.trial ORDER BY trial.trial"
    )
    with closing(store.blocks(query)) as blocks:
        _write(store, Path(path), columns, blocks)


def write_steps(store: Store, path: str | os.PathLike[str]) -> None:
    """Write all steps of sweeps, grids, slice counts and sensitivities, one row for each merit.

    What was varied has a column for each name; cells of other series are empty there.

    Parameters
    ----------
    store, path
        As of :func:`write_trials`.

    Raises
    ------
    InputError
        As of :func:`write_trials`.
    """
    steps = store.steps()
    varied: Columns = {}
    for step in steps:
        for name, value in step.coordinates.items():
            kind = "text" if isinstance(value, str) else "number"
            varied[name] = kind if varied.get(name, kind) == kind else "text"
    columns: Columns = {"series": "text", "step": "integer", **varied}
    columns |= {"merit": "text", "score": "number", "message": "text", "seconds": "number"}

    def where(coordinates: Any) -> list[Any]:
        values = [(coordinates.get(name), kind) for name, kind in varied.items()]
        return [str(v) if kind == "text" and v is not None else v for v, kind in values]

    rows = [
        (
            step.series,
            step.step,
            *where(step.coordinates),
            merit,
            None if score != score else score,
            step.message,
            step.seconds,
        )
        for step in steps
        for merit, score in step.scores.items()
    ]
    _write(store, Path(path), columns, iter([rows] if rows else []))


def _write(store: Store, path: Path, columns: Columns, blocks: Iterator[Rows]) -> None:
    writers: dict[str, Callable[[Path, Columns], AbstractContextManager[Write]]]
    writers = {".csv": _csv_writer, ".parquet": _parquet_writer}
    if path.suffix not in writers:
        raise InputError(f"cannot write {path}: allowed endings are {' and '.join(writers)}")
    if path.exists() and path.samefile(store.path):
        raise InputError(f"cannot write {path}: it is the store itself; give another file name")
    with atomic_path(path) as temporary, writers[path.suffix](temporary, columns) as write:
        for rows in blocks:
            with undamaged(store.path):
                check_kinds(columns, rows)
            write(rows)


@contextmanager
def _csv_writer(path: Path, columns: Columns) -> Iterator[Write]:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow([safe_cell(name) for name in columns])

        def write(rows: Rows) -> None:
            for row in rows:
                table.writerow([safe_cell(v) if isinstance(v, str) else v for v in row])

        yield write


@contextmanager
def _parquet_writer(path: Path, columns: Columns) -> Iterator[Write]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise InputError(
            "Parquet files need the package pyarrow: install transferlens with its extra parquet, "
            "or write a .csv file"
        ) from error
    kinds = {"integer": pa.int64(), "number": pa.float64(), "flag": pa.bool_(), "text": pa.string()}
    schema = pa.schema([(name, kinds[kind]) for name, kind in columns.items()])
    flags = [k for k, kind in enumerate(columns.values()) if kind == "flag"]
    with pq.ParquetWriter(path, schema) as file:

        def write(rows: Rows) -> None:
            parts = [list(part) for part in zip(*rows, strict=True)]
            for k in flags:
                parts[k] = [bool(value) for value in parts[k]]
            arrays = [pa.array(part, kind) for part, kind in zip(parts, schema.types, strict=True)]
            file.write_table(pa.table(arrays, schema=schema))

        yield write
