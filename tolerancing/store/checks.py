"""Checks of a store's tables and cells. SQLite itself accepts any table and any value in a column."""

from __future__ import annotations

import dataclasses
import math
import re
import sqlite3
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.input_files import TABLE_BYTES
from tolerancing.merits.base import LARGEST_SCORE
from tolerancing.store.schema import SCHEMA
from tolerancing.study.study import MOST_TRIALS

Record = TypeVar("Record")
Columns = dict[str, str]
"""Names of columns, and the kind of their cells (a key of :data:`KINDS`)."""

KINDS: dict[str, tuple[type, ...]] = {
    "integer": (int,),
    "number": (int, float),
    "flag": (int,),
    "text": (str,),
    "bytes": (bytes,),
}
"""Allowed types of cells by the kind of their column; NULL is allowed as well."""

STEP_COLUMNS: Columns = {
    "series": "text",
    "step": "integer",
    "coordinates": "text",
    "merit": "text",
    "score": "number",
    "message": "text",
    "seconds": "number",
}


_OWN_COLUMN = re.compile(r'("[^"]*"|\w+) (REAL|(REAL|TEXT|INTEGER) NOT NULL)')


def check_tables(connection: sqlite3.Connection, high_fidelity: str) -> None:
    """Check that the tables of a store are those that a run creates.

    A view in place of a table may never end, and a trigger may change rows. Views, tables and indices of
    other names are ignored.

    Parameters
    ----------
    connection
        Connection to the store.
    high_fidelity
        Name of its table of high-fidelity scores.

    Raises
    ------
    ValueError
        If a table is missing or different, or the store has a trigger.
    """
    rows = connection.execute("SELECT type, name, sql FROM sqlite_master")
    found = {name: (kind, sql) for kind, name, sql in rows}
    triggers = [name for name, (kind, _) in found.items() if kind == "trigger"]
    if triggers:
        raise ValueError(f"it has the trigger {triggers[0]!r}, which no run creates")
    made = (_squeezed(text) for text in SCHEMA.split(";"))
    fixed = {text.split()[2]: text for text in made if text}
    for name in (*fixed, "trial", high_fidelity):  # The columns of these two depend on the study.
        kind, sql = found.get(name, ("missing", ""))
        text = _squeezed(str(sql))
        if kind != "table" or (text != fixed[name] if name in fixed else not _is_plain(name, text)):
            raise ValueError(
                f"{name!r} is {'missing' if kind == 'missing' else 'not a table that a run creates'}"
            )


def _squeezed(text: str) -> str:
    return " ".join(text.split())


def _is_plain(name: str, sql: str) -> bool:
    """Return whether all columns of a table hold numbers or text, and none is computed."""
    start = f"CREATE TABLE {name} (trial INTEGER PRIMARY KEY, "
    columns = sql.removeprefix(start).removesuffix(")").split(", ")
    return sql.startswith(start) and all(_OWN_COLUMN.fullmatch(column) for column in columns)


def check_kinds(columns: Mapping[str, str], rows: Sequence[Sequence[Any]]) -> None:
    """Check the types of cells: SQLite accepts any value in a column.

    Raises
    ------
    ValueError
        If a cell has a type that its column does not allow.
    """
    for (name, kind), values in zip(columns.items(), zip(*rows, strict=True), strict=False):
        allowed = (*KINDS[kind], type(None))
        for value in values:
            if not isinstance(value, allowed):
                raise ValueError(f"{name} = {value!r:.60}: must be {kind}")


def check_file_sizes(sizes: Sequence[tuple[Any, Any]]) -> None:
    """Check number and sizes of a store's files, given as pairs of name and size in bytes."""
    most = 10_000  # A study of hundreds of perturbations names hundreds of files.
    if len(sizes) > most:
        raise ValueError(f"{len(sizes)} files; a study has at most {most}")
    for name, size in sizes:
        if not isinstance(size, int) or size > TABLE_BYTES:
            raise ValueError(f"file {name!r:.60}: {size} bytes; at most {TABLE_BYTES} are read")


def record_of(kind: type[Record], row: Sequence[Any]) -> Record:
    """Return a row as a dataclass whose fields are numbers and text."""
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]
    kind_of_field = {"int": "integer", "str": "text", "float | None": "number"}
    check_kinds({f.name: kind_of_field[str(f.type)] for f in fields}, [row])
    return kind(*row)


def check_scores(what: str, scores: Array) -> None:
    """Check that finite scores are within the limit that a run stores."""
    beyond = np.abs(scores[np.isfinite(scores)]) > LARGEST_SCORE
    if beyond.any():
        raise ValueError(f"{what}: a score beyond +-{LARGEST_SCORE:g}")


def check_trials(numbers: NDArray[np.int64]) -> None:
    """Check that numbers of trials are within the range that a run draws."""
    if len(numbers) and not 0 <= numbers.min() <= numbers.max() < MOST_TRIALS:
        raise ValueError(f"trial: must be from 0 to {MOST_TRIALS - 1}")


def check_picture(width_um: Any, half_width_um: Any, orientation: Any, intensity: Array) -> None:
    """Check the widths, the orientation and the intensity of a picture of line pairs."""
    sizes = isinstance(width_um, float) and isinstance(half_width_um, float)
    if not (sizes and orientation in ("x", "y") and np.isfinite([width_um, half_width_um]).all()):
        raise ValueError("picture: must have finite widths and lie along x or y")
    if not np.isfinite(intensity).all():
        raise ValueError("picture: must be of finite numbers")


def check_coordinates(coordinates: Any) -> None:
    """Check that the coordinates of a step are names with finite numbers or text."""
    if not isinstance(coordinates, dict) or not all(
        isinstance(value, str) or (isinstance(value, int | float) and math.isfinite(value))
        for value in coordinates.values()
    ):
        raise ValueError(f"coordinates = {coordinates!r:.60}: must be names with finite numbers or text")
