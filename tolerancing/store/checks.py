"""What a store's tables and cells may be: SQLite itself lets anybody make a table of anything."""

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
"""Names of columns and what they hold: one of :data:`KINDS`."""

KINDS: dict[str, tuple[type, ...]] = {
    "integer": (int,),
    "number": (int, float),
    "flag": (int,),
    "text": (str,),
    "bytes": (bytes,),
}
"""What cells may be, by the kind of their column; empty ones may stand in all that allow them."""

STEP_COLUMNS: Columns = {
    "series": "text",
    "step": "integer",
    "coordinates": "text",
    "merit": "text",
    "score": "number",
    "message": "text",
    "seconds": "number",
}

MOST_FILES = 10_000
"""Most files that a store may hold: a study of hundreds of perturbations names hundreds."""

STUDY_TABLES = ("trial", "dear")
"""Tables whose columns a study's perturbations and merits tell."""

_OWN_COLUMN = re.compile(r'("[^"]*"|\w+) (REAL|(REAL|TEXT|INTEGER) NOT NULL)')
_KIND_OF_FIELD = {"int": "integer", "str": "text", "float | None": "number"}


def check_tables(connection: sqlite3.Connection) -> None:
    """Refuse a store whose tables are none that a run makes: a view may never end, a trigger change rows.

    Views, tables and indices of other names are left to whoever made them.

    Raises
    ------
    ValueError
        What is wrong.
    """
    rows = connection.execute("SELECT type, name, sql FROM sqlite_master")
    found = {name: (kind, sql) for kind, name, sql in rows}
    triggers = [name for name, (kind, _) in found.items() if kind == "trigger"]
    if triggers:
        raise ValueError(f"{triggers[0]!r} is a trigger, and no run makes one")
    made = (_squeezed(text) for text in SCHEMA.split(";"))
    fixed = {text.split()[2]: text for text in made if text}
    for name in (*fixed, *STUDY_TABLES):
        kind, sql = found.get(name, ("missing", ""))
        text = _squeezed(str(sql))
        if kind != "table" or (text != fixed[name] if name in fixed else not _is_plain(name, text)):
            raise ValueError(f"{name!r} is {'missing' if kind == 'missing' else 'no table that a run makes'}")


def _squeezed(text: str) -> str:
    return " ".join(text.split())


def _is_plain(name: str, sql: str) -> bool:
    """Whether a table has nothing but columns of numbers and text, none of them worked out."""
    start = f"CREATE TABLE {name} (trial INTEGER PRIMARY KEY, "
    columns = sql.removeprefix(start).removesuffix(")").split(", ")
    return sql.startswith(start) and all(_OWN_COLUMN.fullmatch(column) for column in columns)


def check_kinds(columns: Mapping[str, str], rows: Sequence[Sequence[Any]]) -> None:
    """Refuse text among numbers and the like: SQLite keeps in a column whatever it was given.

    Raises
    ------
    ValueError
        Which column holds what, and what is allowed.
    """
    for (name, kind), part in zip(columns.items(), zip(*rows, strict=True), strict=False):
        allowed = (*KINDS[kind], type(None))
        for value in part:
            if not isinstance(value, allowed):
                raise ValueError(f"{name} = {value!r:.60}: must be {kind}")


def check_file_sizes(sizes: Sequence[tuple[Any, Any]]) -> None:
    """Refuse files, by their names and sizes in bytes, of which there are more than any study names."""
    if len(sizes) > MOST_FILES:
        raise ValueError(f"{len(sizes)} files; a study has at most {MOST_FILES}")
    for name, size in sizes:
        if not isinstance(size, int) or size > TABLE_BYTES:
            raise ValueError(f"file {name!r:.60}: {size} bytes; at most {TABLE_BYTES} are read")


def record_of(kind: type[Record], row: Sequence[Any]) -> Record:
    """A row as a dataclass whose fields are numbers and text."""
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]
    check_kinds({f.name: _KIND_OF_FIELD[str(f.type)] for f in fields}, [row])
    return kind(*row)


def check_scores(what: str, scores: Array) -> None:
    """Refuse scores that no run stores: finite ones beyond what can be counted with."""
    beyond = np.abs(scores[np.isfinite(scores)]) > LARGEST_SCORE
    if beyond.any():
        raise ValueError(f"{what}: a score beyond +-{LARGEST_SCORE:g}")


def check_trials(numbers: NDArray[np.int64]) -> None:
    """Refuse numbers of trials that no run draws."""
    if len(numbers) and not 0 <= numbers.min() <= numbers.max() < MOST_TRIALS:
        raise ValueError(f"trial: must be from 0 to {MOST_TRIALS - 1}")


def check_picture(width_um: Any, half_width_um: Any, orientation: Any, intensity: Array) -> None:
    """Refuse a picture of line pairs that cannot be one."""
    sizes = isinstance(width_um, float) and isinstance(half_width_um, float)
    if not (sizes and orientation in ("x", "y") and np.isfinite([width_um, half_width_um]).all()):
        raise ValueError("picture: must have finite widths and lie along x or y")
    if not np.isfinite(intensity).all():
        raise ValueError("picture: must be of finite numbers")


def check_coordinates(coordinates: Any) -> None:
    """Refuse coordinates of a step that are no names with numbers or text."""
    if not isinstance(coordinates, dict) or not all(
        isinstance(value, str) or (isinstance(value, int | float) and math.isfinite(value))
        for value in coordinates.values()
    ):
        raise ValueError(f"coordinates = {coordinates!r:.60}: must be names with finite numbers or text")
