"""The store of a study: one SQLite file with its files, trials, steps and pictures.

A new store gets its name only when its tables and its study are written, and each batch of results is one
transaction. A run that is interrupted at any moment therefore leaves a store that opens and holds complete
batches. Rows are only added; a row that exists is never changed.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.notebook import html_table
from lensdesign.errors import DesignError, TransferLensError
from tolerancing.store.checks import (
    STEP_COLUMNS,
    check_coordinates,
    check_file_sizes,
    check_kinds,
    check_picture,
    check_scores,
    check_tables,
    check_trials,
    record_of,
)
from tolerancing.store.creation import create_store
from tolerancing.store.file import (
    check_is_store,
    connect,
    damage_as_error,
    merge_log,
    start_writing,
    translated_errors,
)
from tolerancing.store.schema import (
    HIGH_FIDELITY,
    SCHEMA_VERSION,
    MeritRecord,
    StudyRecord,
    high_fidelity_rows,
    insert,
    number_columns,
    picture_rows,
    step_rows,
    trial_rows,
)
from tolerancing.study.files import LoadedStudy, load_from_files
from tolerancing.study.results import HighFidelityResults, Picture, Results, StepResults, TrialResults
from tolerancing.study.study import MOST_TRIALS, Study

__all__ = ["Store", "StudyRecord", "create_store", "open_store"]

ROWS_AT_ONCE = 20_000
"""Number of rows that are converted to arrays, or written by an export, at a time."""


def open_store(path: str | os.PathLike[str], *, trust: bool = False) -> Store:
    """Open an existing store.

    Parameters
    ----------
    path
        Path of the store.
    trust
        Whether the code of Python merits in the store may be executed when lenses are scored again; see
        :func:`load_study`. Stored results can always be read.

    Returns
    -------
    Store
        The open store; use it as a context manager.

    Raises
    ------
    InputError
        If the file does not exist, is no store, has another version, or has tables that no run creates. The
        file is not changed.

    Examples
    --------
    >>> from tolerancing import load_study, open_store, run_study
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     store.trials().scores.shape
    (50, 1)
    """
    path = Path(path)
    check_is_store(path)
    store = Store(path, trust)
    try:
        store.check()
    except BaseException:
        store.close()
        raise
    return store


class Store:
    """The results of a study in an open SQLite file; use it as a context manager.

    :func:`tolerancing.run.run.run_study` creates the file, and :func:`open_store` checks and opens it.

    Parameters
    ----------
    path
        Path of the file.
    trust
        Whether the code of Python merits in the store may be executed; see :func:`open_store`.

    Attributes
    ----------
    path
        Path of the file.
    loaded
        The study with its lens, read from the store's own copies of the files.
    study
        The study; the levels of its merits are those of the run.

    Raises
    ------
    InputError
        By every method, if the file cannot be read or its contents are damaged.

    Examples
    --------
    >>> from tolerancing import load_study, open_store, run_study
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> outcome = run_study(loaded, "study.db", trials=50, workers=1)
    >>> with open_store("study.db") as store:
    ...     print(store)
    ...     len(store.trials()), len(store.steps())
    Store('study.db', 50 of 50 trials)
    (50, 48)
    """

    def __init__(self, path: Path, trust: bool = False) -> None:
        self.path = path
        self._trust = trust
        self._folder: TemporaryDirectory[str] | None = None
        self._connection = connect(path)

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        try:
            count, planned = self.trial_count(), self.record().planned_trials
        except (sqlite3.Error, TransferLensError):
            return f"Store({str(self.path)!r}, closed)"
        return f"Store({str(self.path)!r}, {count} of {planned} trials)"

    def _repr_html_(self) -> str:
        record = self.record()
        rows = [
            ("study", record.name),
            ("trials", f"{self.trial_count()} of {record.planned_trials}"),
            ("steps of series", f"{len(self.finished_steps())}"),
            ("begun", f"{record.created}, toolkit {record.toolkit_version}"),
        ]
        for merit in self.merits():
            nominal = "none" if merit.nominal is None else f"{merit.nominal:.4g}"
            rows.append((merit.column, f"nominal {nominal}, by {merit.engine}"))
        return html_table(str(self.path), rows)

    def close(self) -> None:
        """Close the file."""
        self._connection.close()
        if self._folder is not None:
            self._folder.cleanup()

    @cached_property
    def loaded(self) -> LoadedStudy:
        """The study and the lens, read from the store's own files, with the levels that the run decided."""
        sizes = self._rows("SELECT name, length(content) FROM file")
        with damage_as_error(self.path):
            check_file_sizes(sizes)
        rows = self._rows("SELECT name, content FROM file")
        self._folder = TemporaryDirectory(prefix="tolerancing-")
        with damage_as_error(self.path):
            check_kinds({"name": "text", "content": "bytes"}, rows)
            files, name = dict(rows), self.record().name
            try:
                loaded = load_from_files(name, files, Path(self._folder.name), trust=self._trust)
            except DesignError as error:
                raise ValueError(str(error)) from error
        levels = {merit.label: merit.level for merit in self.merits()}
        return replace(loaded, study=loaded.study.with_levels(levels))

    @property
    def study(self) -> Study:
        """The study whose results the store holds."""
        return self.loaded.study

    def check(self) -> None:
        """Check that the tables of the database are those of a store.

        Raises
        ------
        InputError
            If a table is missing, or differs from what a run creates.
        """
        with translated_errors(self.path, "open"), damage_as_error(self.path):
            check_tables(self._connection, self.high_fidelity_table)

    @cached_property
    def high_fidelity_table(self) -> str:
        """Name of the table of high-fidelity scores, which depends on the version of the store."""
        (version,) = self._connection.execute("PRAGMA user_version").fetchone()
        return HIGH_FIDELITY.get(version, HIGH_FIDELITY[SCHEMA_VERSION])

    def record(self) -> StudyRecord:
        """Return the record of the study and its run."""
        rows = self._rows("SELECT * FROM study")
        with damage_as_error(self.path):
            (row,) = rows
            record = record_of(StudyRecord, row)
            if not 1 <= record.planned_trials <= MOST_TRIALS:
                raise ValueError(f"planned_trials = {record.planned_trials}: must be from 1 to {MOST_TRIALS}")
            return record

    def merits(self) -> list[MeritRecord]:
        """Return the record of each merit."""
        with damage_as_error(self.path):
            rows = self._rows("SELECT * FROM merit ORDER BY rowid")
            merits = [record_of(MeritRecord, row) for row in rows]
            check_scores("nominal", np.array([merit.nominal for merit in merits], float))
            return merits

    def nominal(self) -> dict[str, float]:
        """Return the scores of the nominal lens by the merit's label; NaN where there is none."""
        return {m.label: np.nan if m.nominal is None else m.nominal for m in self.merits()}

    def start_writing(self) -> None:
        """Prepare the store for a run.

        Raises
        ------
        InputError
            If the store cannot be written.
        """
        with translated_errors(self.path, "write"):
            start_writing(self._connection)
        with self._transaction():  # Fails now, not after the first results, if the store cannot be written.
            self._connection.execute("UPDATE study SET planned_trials = planned_trials")

    def finish_writing(self) -> None:
        """Merge the write-ahead log into the store, unless other processes still use it."""
        with translated_errors(self.path, "write"):
            merge_log(self._connection)

    def plan(self, trials: int) -> None:
        """Set the planned number of trials, which is at least the number of stored trials."""
        stored = int(self._rows("SELECT coalesce(max(trial), -1) + 1 FROM trial")[0][0])
        if self.record().planned_trials == max(trials, stored):
            return
        with self._transaction():
            self._connection.execute("UPDATE study SET planned_trials = ?", (max(trials, stored),))

    def add(self, *batches: Results) -> None:
        """Add batches of results in one transaction. Rows that exist are not changed.

        Raises
        ------
        InputError
            If the file cannot be written. The store then holds what it held before.
        """
        with self._transaction():
            for results in batches:
                if isinstance(results, TrialResults):
                    insert(self._connection, "trial", trial_rows(results))
                elif isinstance(results, HighFidelityResults):
                    insert(self._connection, self.high_fidelity_table, high_fidelity_rows(results))
                else:
                    insert(self._connection, "step", step_rows(results))
                    insert(self._connection, "picture", picture_rows(results))

    def trial_count(self, below: int = MOST_TRIALS) -> int:
        """Return the number of stored trials whose number is smaller than `below`."""
        return int(self._rows("SELECT count(*) FROM trial WHERE trial < ?", below)[0][0])

    def missing(self, trials: range) -> tuple[int, ...]:
        """Return those of the given trials that the store does not hold."""
        query = f"SELECT trial FROM trial WHERE trial BETWEEN {trials[0]} AND {trials[-1]}"
        stored = {row[0] for row in self._rows(query)}
        return tuple(trial for trial in trials if trial not in stored)

    def lacks_high_fidelity(self, trial: int) -> bool:
        """Return whether the store has no high-fidelity scores of a trial."""
        return not self._rows(f"SELECT 1 FROM {self.high_fidelity_table} WHERE trial = {trial}")

    def lacks_step(self, series: str, step: int) -> bool:
        """Return whether the store does not hold a step of a series."""
        return not self._rows("SELECT 1 FROM step WHERE series = ? AND step = ? LIMIT 1", series, step)

    def finished_steps(self) -> set[tuple[str, int]]:
        """Return the stored steps as pairs of series and step number."""
        return set(self._rows("SELECT DISTINCT series, step FROM step"))

    def trials(self, only: int | None = None) -> TrialResults:
        """Return all trials in order, or the trial of one number. The result is empty if it is not stored."""
        perturbations, merits = len(self.study.perturbations), len(self.study.merits)
        columns = number_columns(self.study)
        names = "".join(f'"{column}", ' for column in columns)
        which = "" if only is None else f"AND trial = {int(only)}"
        with self._snapshot():
            count = self.trial_count() if only is None else None
            rows = self._array(
                f"SELECT trial, {names}passed, seconds FROM trial WHERE 1 {which} ORDER BY trial", count
            )
            messages = self._rows(f"SELECT trial, message FROM trial WHERE message != '' {which}")
        width = len(columns) + 3
        with damage_as_error(self.path):
            rows = rows.reshape(len(rows), width)
            numbers = rows[:, 0].astype(np.int64)
            check_trials(numbers)
            check_scores("trial", rows[:, 1 + perturbations :])
            check_kinds({"trial": "integer", "message": "text"}, messages)
            message_of = dict(messages)
        values, scores, extras = np.split(
            rows[:, 1 : 1 + len(columns)], [perturbations, perturbations + merits], axis=1
        )
        return TrialResults(
            trials=numbers,
            values=values,
            scores=scores,
            extras=extras,
            messages=tuple(message_of.get(trial, "") for trial in numbers.tolist()),
            passed=rows[:, -2] != 0.0,
            seconds=rows[:, -1],
        )

    def scores(self, label: str, trials: int) -> NDArray[np.float64]:
        """Return the scores of the first `trials` trials by one merit, as an array; NaN without a score."""
        (column,) = [m.column for m in self.study.merits if m.label == label]
        rows = self._array(f'SELECT trial, "{column}" FROM trial WHERE trial < {trials}').reshape(-1, 2)
        scores, numbers = np.full(trials, np.nan), rows[:, 0].astype(np.int64)
        with damage_as_error(self.path):
            check_trials(numbers)
            check_scores("trial", rows[:, 1])
        scores[numbers] = rows[:, 1]
        return scores

    def high_fidelity(self) -> HighFidelityResults:
        """Return all high-fidelity scores in the order of the trials."""
        merits = self.study.high_fidelity_merits
        names = "".join(f', "{merit.column}"' for merit in merits)
        rows = self._rows(
            f"SELECT trial, chosen, message, seconds{names} FROM {self.high_fidelity_table} ORDER BY trial"
        )
        with damage_as_error(self.path):
            check_kinds({"trial": "integer", "chosen": "text", "message": "text", "seconds": "number"}, rows)
            check_trials(np.array([row[0] for row in rows], np.int64))
            scores = np.array([row[4:] for row in rows], float).reshape(len(rows), len(merits))
            seconds = np.array([row[3] for row in rows], float)
            check_scores("high_fidelity", scores)
        return HighFidelityResults(
            trials=tuple(row[0] for row in rows),
            chosen=tuple(row[1] for row in rows),
            scores=scores,
            messages=tuple(row[2] for row in rows),
            seconds=seconds,
        )

    def steps(self) -> list[StepResults]:
        """Return all steps with their pictures, ordered by series and step."""
        pictures = self._pictures()
        found: dict[tuple[str, int], StepResults] = {}
        rows = self._rows("SELECT * FROM step ORDER BY series, step, rowid")
        with damage_as_error(self.path):
            check_kinds(STEP_COLUMNS, rows)
            check_scores("step", np.array([row[4] for row in rows], float))
        for series, step, coordinates, merit, score, message, seconds in rows:
            key = (series, step)
            if key not in found:
                with damage_as_error(self.path):
                    location = json.loads(coordinates)
                    check_coordinates(location)
                found[key] = StepResults(
                    series, step, location, {}, message, tuple(pictures.get(key, ())), seconds
                )
            found[key].scores[merit] = np.nan if score is None else score
        return list(found.values())

    def _pictures(self) -> dict[tuple[str, int], list[Picture]]:
        pictures: dict[tuple[str, int], list[Picture]] = {}
        for series, step, width, refocused, orientation, half_width, points, data in self._rows(
            "SELECT * FROM picture ORDER BY line_width_um, refocused"
        ):
            with damage_as_error(self.path):
                intensity = np.frombuffer(data, dtype="<f4").reshape(points, points)
                check_picture(width, half_width, orientation, intensity)
            picture = Picture(width, orientation, bool(refocused), half_width, intensity)
            pictures.setdefault((series, step), []).append(picture)
        return pictures

    def blocks(self, query: str) -> Generator[list[Any], None, None]:
        """Yield the rows of a query in blocks, all from one snapshot of the store."""
        with self._snapshot(), translated_errors(self.path, "read"), damage_as_error(self.path):
            cursor = self._connection.execute(query)
            while rows := cursor.fetchmany(ROWS_AT_ONCE):
                yield rows

    def _array(self, query: str, count: int | None = None) -> NDArray[np.float64]:
        """Return rows of numbers as an array, with NaN for NULL.

        With a known `count` of rows, the array is filled in place, which needs the least memory.
        """
        with damage_as_error(self.path):
            blocks = (np.array(rows, float) for rows in self.blocks(query))
            if count is None:
                return np.concatenate([*blocks] or [np.empty((0, 0))])
            filled, whole = 0, np.empty((0, 0))
            for block in blocks:
                whole = whole if filled else np.empty((count, block.shape[1]))
                whole[filled : filled + len(block)] = block
                filled += len(block)
            return whole

    def _rows(self, query: str, *values: Any) -> list[Any]:
        with translated_errors(self.path, "read"), damage_as_error(self.path):
            return self._connection.execute(query, values).fetchall()

    @contextmanager
    def _snapshot(self) -> Iterator[None]:
        """Run several queries on one snapshot of the store."""
        if self._connection.in_transaction:
            yield
            return
        with translated_errors(self.path, "read"), damage_as_error(self.path):
            self._connection.execute("BEGIN")
        try:
            yield
        finally:  # Nothing was written, so a rollback ends the transaction, and it reads no more pages.
            if self._connection.in_transaction:
                with translated_errors(self.path, "read"):
                    self._connection.execute("ROLLBACK")

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with translated_errors(self.path, "write"):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise
