"""The store of a study: one SQLite file that holds texts, trials, sweeps and pictures.

A store appears under its name only when its schema and study are in it, and every batch goes in as one
transaction, so whatever interrupts a run leaves a store that opens and holds whole batches.
"""

from __future__ import annotations

import sqlite3
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from lensdesign.errors import InputError, atomic_path
from tolerancing.results import Picture, Results, StepResults, TrialResults
from tolerancing.study import LoadedStudy, Study, study_from_tables

APPLICATION_ID = 0x544C5354
"""Marks a SQLite file as one of ours ("TLST")."""

SCHEMA_VERSION = 1

SCHEMA = """
CREATE TABLE study (
    schema_version INTEGER NOT NULL,
    toolkit_version TEXT NOT NULL,
    study_toml TEXT NOT NULL,
    design_toml TEXT NOT NULL,
    fingerprint TEXT NOT NULL,
    seed TEXT NOT NULL,
    planned_trials INTEGER NOT NULL,
    created TEXT NOT NULL
);
CREATE TABLE nominal (merit TEXT PRIMARY KEY, score REAL);
CREATE TABLE sweep (
    sweep TEXT NOT NULL,
    step INTEGER NOT NULL,
    value REAL NOT NULL,
    merit TEXT NOT NULL,
    score REAL,
    message TEXT NOT NULL,
    PRIMARY KEY (sweep, step, merit)
);
CREATE TABLE picture (
    sweep TEXT NOT NULL,
    step INTEGER NOT NULL,
    line_width_um REAL NOT NULL,
    refocused INTEGER NOT NULL,
    orientation TEXT NOT NULL,
    half_width_um REAL NOT NULL,
    points INTEGER NOT NULL,
    intensity_float32 BLOB NOT NULL,
    PRIMARY KEY (sweep, step, line_width_um, refocused)
);
"""


@dataclass(frozen=True)
class StudyRecord:
    """The store's one row about its study."""

    schema_version: int
    toolkit_version: str
    study_toml: str
    design_toml: str
    fingerprint: str
    seed: str
    planned_trials: int
    created: str


def toolkit_version() -> str:
    """Version of the installed toolkit."""
    return version("transferlens")


def create_store(path: Path, loaded: LoadedStudy, nominal: Mapping[str, float], planned_trials: int) -> None:
    """Make a store without trials; it replaces whatever stands at `path`.

    Raises
    ------
    InputError
        If the file cannot be written; whatever stood there stays.
    """
    record = StudyRecord(
        schema_version=SCHEMA_VERSION,
        toolkit_version=toolkit_version(),
        study_toml=loaded.study_text,
        design_toml=loaded.design_text,
        fingerprint=loaded.fingerprint,
        seed=str(loaded.study.seed),
        planned_trials=planned_trials,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    with atomic_path(path) as temporary, _reported(path, "write"):
        connection = sqlite3.connect(temporary, isolation_level=None)
        try:
            connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
            connection.executescript(f"BEGIN;{SCHEMA}{_trial_table(loaded.study)}COMMIT;")
            _insert(connection, "study", [tuple(vars(record).values())])
            _insert(connection, "nominal", list(nominal.items()))
        finally:
            connection.close()


def _trial_table(study: Study) -> str:
    columns = [p.column for p in study.perturbations] + [m.column for m in study.merits]
    return (
        "CREATE TABLE trial (trial INTEGER PRIMARY KEY, status TEXT NOT NULL, message TEXT NOT NULL, "
        + ", ".join(f'"{column}" REAL' for column in columns)
        + ", passed INTEGER NOT NULL);\n"
    )


def open_store(path: Path) -> Store:
    """Open a store that is there.

    Raises
    ------
    InputError
        If there is none, or the file is something else, or of a newer kind; it is not touched.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            header = file.read(100)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    # Identity and version stand at fixed places of a SQLite file's header.
    if header[:16] != b"SQLite format 3\0" or int.from_bytes(header[68:72]) != APPLICATION_ID:
        raise InputError(f"{path} is no store of a tolerance study; give another file name")
    schema = int.from_bytes(header[60:64])
    if schema != SCHEMA_VERSION:
        raise InputError(
            f"{path} is a store of version {schema}; this toolkit reads version {SCHEMA_VERSION}: "
            "use the toolkit that wrote it"
        )
    return Store(path)


class Store:
    """An open store; use it as a context manager.

    Parameters
    ----------
    path
        A file that :func:`create_store` made; go through :func:`open_store`, which makes sure.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with _reported(path, "open"):
            self._connection = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode=rw", uri=True, isolation_level=None, timeout=60.0
            )

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        self._connection.close()

    @cached_property
    def study(self) -> Study:
        """The study whose results these are."""
        record = self.record()
        with _undamaged(self.path):
            return study_from_tables(tomllib.loads(record.study_toml), str(self.path))

    def record(self) -> StudyRecord:
        """The study's texts and particulars."""
        rows = self._rows("SELECT * FROM study")
        with _undamaged(self.path):
            (row,) = rows
            return StudyRecord(*row)

    def nominal(self) -> dict[str, float]:
        """Scores of the nominal lens, by merit."""
        return dict(self._rows("SELECT merit, score FROM nominal"))

    def plan(self, trials: int) -> None:
        """Note how many trials there are to be in the end."""
        with self._transaction():
            self._connection.execute("UPDATE study SET planned_trials = ?", (trials,))

    def finished_trials(self) -> set[int]:
        """Numbers of the trials that the store holds."""
        return {row[0] for row in self._rows("SELECT trial FROM trial")}

    def finished_steps(self) -> set[tuple[str, int]]:
        """Sweeps and steps that the store holds."""
        return set(self._rows("SELECT DISTINCT sweep, step FROM sweep"))

    def add(self, results: Results) -> None:
        """Store one batch, whole or not at all.

        Raises
        ------
        InputError
            If the file cannot be written; it then holds what it held before.
        """
        with self._transaction():
            if isinstance(results, TrialResults):
                self._add_trials(results)
            else:
                self._add_step(results)

    def trials(self) -> TrialResults:
        """All trials, in order."""
        rows = self._rows("SELECT * FROM trial ORDER BY trial")
        split = 3 + len(self.study.perturbations)
        with _undamaged(self.path):
            numbers = np.array([row[3:-1] for row in rows], dtype=float)
            numbers = numbers.reshape(len(rows), split - 3 + len(self.study.merits))
        return TrialResults(
            trials=tuple(row[0] for row in rows),
            values=numbers[:, : split - 3],
            scores=numbers[:, split - 3 :],
            messages=tuple(row[2] for row in rows),
            passed=np.array([row[-1] for row in rows], dtype=bool),
        )

    def steps(self) -> list[StepResults]:
        """All sweep steps, sweep by sweep in order, with their pictures."""
        pictures: dict[tuple[str, int], list[Picture]] = {}
        for sweep, step, width, refocused, orientation, half_width, points, data in self._rows(
            "SELECT * FROM picture ORDER BY line_width_um, refocused"
        ):
            with _undamaged(self.path):
                intensity = np.frombuffer(data, dtype="<f4").reshape(points, points)
            picture = Picture(width, orientation, bool(refocused), half_width, intensity)
            pictures.setdefault((sweep, step), []).append(picture)
        found: dict[tuple[str, int], StepResults] = {}
        for sweep, step, value, merit, score, message in self._rows(
            "SELECT * FROM sweep ORDER BY sweep, step, rowid"
        ):
            key = (sweep, step)
            if key not in found:
                found[key] = StepResults(sweep, step, value, {}, message, tuple(pictures.get(key, ())))
            found[key].scores[merit] = np.nan if score is None else score
        return list(found.values())

    def _add_trials(self, results: TrialResults) -> None:
        rows = [
            (trial, status, message, *values.tolist(), *scores.tolist(), int(passed))
            for trial, status, message, values, scores, passed in zip(
                results.trials,
                results.status,
                results.messages,
                results.values,
                results.scores,
                results.passed,
                strict=True,
            )
        ]
        _insert(self._connection, "trial", rows)

    def _add_step(self, results: StepResults) -> None:
        key = (results.sweep, results.step)
        scores = [(*key, results.value, m, s, results.message) for m, s in results.scores.items()]
        _insert(self._connection, "sweep", scores)
        pictures = [
            (
                *key,
                picture.line_width_um,
                int(picture.refocused),
                picture.orientation,
                picture.half_width_um,
                len(picture.intensity),
                picture.intensity.astype("<f4").tobytes(),
            )
            for picture in results.pictures
        ]
        _insert(self._connection, "picture", pictures)

    def _rows(self, query: str) -> list[Any]:
        with _reported(self.path, "read"), _undamaged(self.path):
            return self._connection.execute(query).fetchall()

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with _reported(self.path, "write"):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise


def _insert(connection: sqlite3.Connection, table: str, rows: list[Any]) -> None:
    """Insert rows; results are reproducible, so one that is there already is the same."""
    if rows:
        marks = ", ".join("?" * len(rows[0]))
        connection.executemany(f"INSERT OR REPLACE INTO {table} VALUES ({marks})", rows)


@contextmanager
def _reported(path: Path, action: str) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise InputError(f"cannot {action} the store {path}: {error}") from error


@contextmanager
def _undamaged(path: Path) -> Iterator[None]:
    """What a store holds is ours: where text or numbers in it make no sense, it is damaged."""
    try:
        yield
    except (InputError, sqlite3.OperationalError):
        raise
    except (sqlite3.DatabaseError, ValueError, TypeError) as error:
        raise InputError(
            f"the store {path} is damaged: {error}; take a whole copy, or run its study anew with --fresh"
        ) from error
