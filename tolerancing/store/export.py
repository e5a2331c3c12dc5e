"""Export of a store's trials and steps as CSV or Parquet tables, written block by block."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
from typing import Any

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.text import safe_cell
from lensdesign.errors import InputError
from tolerancing.store.checks import Columns, check_kinds
from tolerancing.store.file import damage_as_error
from tolerancing.store.schema import number_columns
from tolerancing.store.store import Store

Rows = Sequence[Sequence[Any]]
Write = Callable[[Rows], None]


def write_trials(store: Store, path: str | os.PathLike[str]) -> None:
    """Write all trials of a store as a table, with their deviations and scores.

    Parameters
    ----------
    store
        Open store; its run need not be finished.
    path
        Name of a ``.csv`` or ``.parquet`` file. A missing score is an empty cell, or null. In CSV, a text
        that a spreadsheet would read as a formula starts with an apostrophe.

    Raises
    ------
    InputError
        If the name has another ending, the file cannot be written, ``pyarrow`` is not installed for Parquet,
        or the store has invalid cells. An existing file then stays unchanged.

    Examples
    --------
    >>> from tolerancing import load_study, open_store, run_study, write_trials
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     write_trials(store, "trials.csv")
    >>> import pandas
    >>> int(pandas.read_csv("trials.csv").passed.sum())
    26
    """
    study = store.study
    columns: Columns = {"trial": "integer", "status": "text", "message": "text"}
    columns |= dict.fromkeys(number_columns(study), "number")
    columns |= {"passed": "flag", "seconds": "number", "finished": "number"}
    own = [f'trial."{name}"' for name in columns]
    if study.high_fidelity_merits:
        high: Columns = {"chosen": "text"} | {m.column: "number" for m in study.high_fidelity_merits}
        own += [f'refined."{name}"' for name in (*high, "message", "seconds")]
        columns |= high | {"high_fidelity_message": "text", "high_fidelity_seconds": "number"}
    query = (
        f"SELECT {', '.join(own)} FROM trial LEFT JOIN {store.high_fidelity_table} AS refined "
        "ON refined.trial = trial.trial ORDER BY trial.trial"
    )
    with closing(store.blocks(query)) as blocks:
        _write(store, Path(path), columns, blocks)


def write_steps(store: Store, path: str | os.PathLike[str]) -> None:
    """Write all steps of a store as a table: sweeps, grids, slice counts and sensitivities.

    Each step has one row for each merit. Each varied quantity has a column, which is empty in rows of series
    that do not vary it.

    Parameters
    ----------
    store
        Open store; its run need not be finished.
    path
        Name of a ``.csv`` or ``.parquet`` file; see :func:`write_trials`.

    Raises
    ------
    InputError
        If the name has another ending, the file cannot be written, ``pyarrow`` is not installed for Parquet,
        or the store has invalid cells. An existing file then stays unchanged.

    Examples
    --------
    >>> from tolerancing import load_study, open_store, run_study, write_steps
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     write_steps(store, "steps.csv")
    >>> import pandas
    >>> pandas.read_csv("steps.csv").perturbation.nunique()
    12
    """
    steps = store.steps()
    varied: Columns = {}
    for step in steps:
        for name, value in step.coordinates.items():
            kind = "text" if isinstance(value, str) else "number"
            varied[name] = kind if varied.get(name, kind) == kind else "text"
    columns: Columns = {"series": "text", "step": "integer", **varied}
    columns |= {"merit": "text", "score": "number", "message": "text", "seconds": "number"}

    def cells(coordinates: Any) -> list[Any]:
        values = [(coordinates.get(name), kind) for name, kind in varied.items()]
        return [str(v) if kind == "text" and v is not None else v for v, kind in values]

    rows = [
        (
            step.series,
            step.step,
            *cells(step.coordinates),
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
            with damage_as_error(store.path):
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
            values = [list(column) for column in zip(*rows, strict=True)]
            for k in flags:
                values[k] = [bool(value) for value in values[k]]
            arrays = [pa.array(column, kind) for column, kind in zip(values, schema.types, strict=True)]
            file.write_table(pa.table(arrays, schema=schema))

        yield write
