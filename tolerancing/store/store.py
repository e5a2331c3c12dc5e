"""The store of a study: one SQLite file that holds its files, trials, steps and pictures.

A store appears under its name only when its tables and its study are in it, and every batch goes in as one
transaction, so whatever interrupts a run leaves a store that opens and holds whole batches. Rows are only
ever added: one that is there stays as it is, whoever computes it again.
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
from tolerancing.store.file import check_is_store, connect, put_log_away, reported, start_writing, undamaged
from tolerancing.store.schema import (
    MeritRecord,
    StudyRecord,
    high_fidelity_rows,
    insert,
    number_columns,
    picture_rows,
    step_rows,
    trial_rows,
)
from tolerancing.store.trust import without_leave
from tolerancing.study.files import LoadedStudy, load_from_files
from tolerancing.study.results import HighFidelityResults, Picture, Results, StepResults, TrialResults
from tolerancing.study.study import MOST_TRIALS, Study

__all__ = ["Store", "StudyRecord", "create_store", "open_store"]

ROWS_AT_ONCE = 20_000
"""Rows that are turned into arrays, or written by an export, at a time."""


def open_store(path: str | os.PathLike[str], *, trust: bool = False) -> Store:
    """Open a store that is there.

    Parameters
    ----------
    path
        The store.
    trust
        Whether merits in Python that it holds may be run, by whoever scores its lenses again. Else those of
        which no copy of one's own lies beside the store refuse to score; all that is stored can be read.

    Raises
    ------
    InputError
        If there is none, or the file is something else, or of another version; it is not touched.
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
    """An open store; use it as a context manager.

    Parameters
    ----------
    path
        A file that :func:`create_store` made; go through :func:`open_store`, which makes sure.
    trust
        As of :func:`open_store`.
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
            held, planned = self.trial_count(), self.record().planned_trials
        except (sqlite3.Error, TransferLensError):
            return f"Store({str(self.path)!r}, closed)"
        return f"Store({str(self.path)!r}, {held} of {planned} trials)"

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
        """Let go of the file."""
        self._connection.close()
        if self._folder is not None:
            self._folder.cleanup()

    @cached_property
    def loaded(self) -> LoadedStudy:
        """The study and the lens from the store's own files, the merits' levels as they were decided."""
        sizes = self._rows("SELECT name, length(content) FROM file")
        with undamaged(self.path):
            check_file_sizes(sizes)
        rows = self._rows("SELECT name, content FROM file")
        self._folder = TemporaryDirectory(prefix="tolerancing-")
        with undamaged(self.path):
            check_kinds({"name": "text", "content": "bytes"}, rows)
            files = dict(rows)
            try:
                loaded = load_from_files(self.record().name, files, Path(self._folder.name))
            except DesignError as error:
                raise ValueError(str(error)) from error
        levels = {merit.label: merit.level for merit in self.merits()}
        loaded = replace(loaded, study=loaded.study.with_levels(levels))
        return loaded if self._trust else without_leave(loaded, self.path)

    @property
    def study(self) -> Study:
        """The study whose results these are."""
        return self.loaded.study

    def check(self) -> None:
        """Refuse a database whose tables are no store's.

        Raises
        ------
        InputError
            If one is missing, or is something else than a run makes.
        """
        with reported(self.path, "open"), undamaged(self.path):
            check_tables(self._connection)

    def record(self) -> StudyRecord:
        """The study's particulars."""
        rows = self._rows("SELECT * FROM study")
        with undamaged(self.path):
            (row,) = rows
            record = record_of(StudyRecord, row)
            if not 1 <= record.planned_trials <= MOST_TRIALS:
                raise ValueError(f"planned_trials = {record.planned_trials}: must be from 1 to {MOST_TRIALS}")
            return record

    def merits(self) -> list[MeritRecord]:
        """What the store knows of each merit."""
        with undamaged(self.path):
            rows = self._rows("SELECT * FROM merit ORDER BY rowid")
            merits = [record_of(MeritRecord, row) for row in rows]
            check_scores("nominal", np.array([merit.nominal for merit in merits], float))
            return merits

    def nominal(self) -> dict[str, float]:
        """Scores of the nominal lens, by merit."""
        return {m.label: np.nan if m.nominal is None else m.nominal for m in self.merits()}

    def start_writing(self) -> None:
        """Get ready for a run.

        Raises
        ------
        InputError
            If the store cannot be written.
        """
        with reported(self.path, "write"):
            start_writing(self._connection)
        with self._transaction():  # tells now, not after the first results, that nothing can be written
            self._connection.execute("UPDATE study SET planned_trials = planned_trials")

    def finish_writing(self) -> None:
        """Make the store one file again, unless others still use it."""
        with reported(self.path, "write"):
            put_log_away(self._connection)

    def plan(self, trials: int) -> None:
        """Note how many trials there are to be in the end; never fewer than there are."""
        held = int(self._rows("SELECT coalesce(max(trial), -1) + 1 FROM trial")[0][0])
        if self.record().planned_trials == max(trials, held):
            return
        with self._transaction():
            self._connection.execute("UPDATE study SET planned_trials = ?", (max(trials, held),))

    def add(self, *batches: Results) -> None:
        """Store some batches, all or none; rows that are there stay as they are.

        Raises
        ------
        InputError
            If the file cannot be written; it then holds what it held before.
        """
        with self._transaction():
            for results in batches:
                if isinstance(results, TrialResults):
                    insert(self._connection, "trial", trial_rows(results))
                elif isinstance(results, HighFidelityResults):
                    insert(self._connection, "dear", high_fidelity_rows(results))
                else:
                    insert(self._connection, "step", step_rows(results))
                    insert(self._connection, "picture", picture_rows(results))

    def trial_count(self, below: int = MOST_TRIALS) -> int:
        """Number of trials that the store holds, of those with lower numbers."""
        return int(self._rows("SELECT count(*) FROM trial WHERE trial < ?", below)[0][0])

    def lacking(self, trials: range) -> tuple[int, ...]:
        """Those of some trials that the store does not hold."""
        query = f"SELECT trial FROM trial WHERE trial BETWEEN {trials[0]} AND {trials[-1]}"
        held = {row[0] for row in self._rows(query)}
        return tuple(trial for trial in trials if trial not in held)

    def lacks_high_fidelity(self, trial: int) -> bool:
        """Whether a trial has no dear scores."""
        return not self._rows(f"SELECT 1 FROM dear WHERE trial = {trial}")

    def lacks_step(self, series: str, step: int) -> bool:
        """Whether a step of a series is not there."""
        return not self._rows("SELECT 1 FROM step WHERE series = ? AND step = ? LIMIT 1", series, step)

    def finished_steps(self) -> set[tuple[str, int]]:
        """Series and steps that the store holds."""
        return set(self._rows("SELECT DISTINCT series, step FROM step"))

    def trials(self, only: int | None = None) -> TrialResults:
        """All trials in order, or the one of a number; none if it is not there."""
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
        with undamaged(self.path):
            rows = rows.reshape(len(rows), width)
            numbers = rows[:, 0].astype(np.int64)
            check_trials(numbers)
            check_scores("trial", rows[:, 1 + perturbations :])
            check_kinds({"trial": "integer", "message": "text"}, messages)
            told = dict(messages)
        values, scores, extras = np.split(
            rows[:, 1 : 1 + len(columns)], [perturbations, perturbations + merits], axis=1
        )
        return TrialResults(
            trials=numbers,
            values=values,
            scores=scores,
            extras=extras,
            messages=tuple(told.get(trial, "") for trial in numbers.tolist()),
            passed=rows[:, -2] != 0.0,
            seconds=rows[:, -1],
        )

    def scores(self, label: str, trials: int) -> NDArray[np.float64]:
        """Scores of the first trials by one merit, shape (trials,); NaN where there is none."""
        (column,) = [m.column for m in self.study.merits if m.label == label]
        rows = self._array(f'SELECT trial, "{column}" FROM trial WHERE trial < {trials}').reshape(-1, 2)
        scores, numbers = np.full(trials, np.nan), rows[:, 0].astype(np.int64)
        with undamaged(self.path):
            check_trials(numbers)
            check_scores("trial", rows[:, 1])
        scores[numbers] = rows[:, 1]
        return scores

    def dear(self) -> HighFidelityResults:
        """All dear scores, by trials in order."""
        merits = self.study.high_fidelity_merits
        names = "".join(f', "{merit.column}"' for merit in merits)
        rows = self._rows(f"SELECT trial, chosen, message, seconds{names} FROM dear ORDER BY trial")
        with undamaged(self.path):
            check_kinds({"trial": "integer", "chosen": "text", "message": "text", "seconds": "number"}, rows)
            check_trials(np.array([row[0] for row in rows], np.int64))
            scores = np.array([row[4:] for row in rows], float).reshape(len(rows), len(merits))
            seconds = np.array([row[3] for row in rows], float)
            check_scores("dear", scores)
        return HighFidelityResults(
            trials=tuple(row[0] for row in rows),
            chosen=tuple(row[1] for row in rows),
            scores=scores,
            messages=tuple(row[2] for row in rows),
            seconds=seconds,
        )

    def steps(self) -> list[StepResults]:
        """All steps, series by series in order, with their pictures."""
        pictures = self._pictures()
        found: dict[tuple[str, int], StepResults] = {}
        rows = self._rows("SELECT * FROM step ORDER BY series, step, rowid")
        with undamaged(self.path):
            check_kinds(STEP_COLUMNS, rows)
            check_scores("step", np.array([row[4] for row in rows], float))
        for series, step, coordinates, merit, score, message, seconds in rows:
            key = (series, step)
            if key not in found:
                with undamaged(self.path):
                    where = json.loads(coordinates)
                    check_coordinates(where)
                found[key] = StepResults(
                    series, step, where, {}, message, tuple(pictures.get(key, ())), seconds
                )
            found[key].scores[merit] = np.nan if score is None else score
        return list(found.values())

    def _pictures(self) -> dict[tuple[str, int], list[Picture]]:
        pictures: dict[tuple[str, int], list[Picture]] = {}
        for series, step, width, refocused, orientation, half_width, points, data in self._rows(
            "SELECT * FROM picture ORDER BY line_width_um, refocused"
        ):
            with undamaged(self.path):
                intensity = np.frombuffer(data, dtype="<f4").reshape(points, points)
                check_picture(width, half_width, orientation, intensity)
            picture = Picture(width, orientation, bool(refocused), half_width, intensity)
            pictures.setdefault((series, step), []).append(picture)
        return pictures

    def blocks(self, query: str) -> Generator[list[Any], None, None]:
        """Rows of a query, some at a time, all from one moment."""
        with self._snapshot(), reported(self.path, "read"), undamaged(self.path):
            cursor = self._connection.execute(query)
            while rows := cursor.fetchmany(ROWS_AT_ONCE):
                yield rows

    def _array(self, query: str, count: int | None = None) -> NDArray[np.float64]:
        """Rows of numbers, NaN where there is none; in no more memory than they take, if counted before."""
        with undamaged(self.path):
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
        with reported(self.path, "read"), undamaged(self.path):
            return self._connection.execute(query, values).fetchall()

    @contextmanager
    def _snapshot(self) -> Iterator[None]:
        """Let several queries see one and the same moment."""
        if self._connection.in_transaction:
            yield
            return
        with reported(self.path, "read"), undamaged(self.path):
            self._connection.execute("BEGIN")
        try:
            yield
        finally:  # nothing was written: a rollback ends it as well, and reads nothing more
            if self._connection.in_transaction:
                with reported(self.path, "read"):
                    self._connection.execute("ROLLBACK")

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with reported(self.path, "write"):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise
