"""Tables of a store and their rows. SQLite stores NaN as NULL."""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tolerancing.merits.base import Merit
from tolerancing.study.results import HighFidelityResults, StepResults, TrialResults
from tolerancing.study.study import Study

Rows = list[tuple[Any, ...]]

APPLICATION_ID = 0x544C5354
"""Application id in the header of a SQLite file that is a store ("TLST")."""

SCHEMA_VERSION = 3

HIGH_FIDELITY = {2: "dear", SCHEMA_VERSION: "high_fidelity"}
"""Table of high-fidelity scores by the version of a store; stores of other versions are refused."""

SCHEMA = """
CREATE TABLE study (
    schema_version INTEGER NOT NULL,
    toolkit_version TEXT NOT NULL,
    name TEXT NOT NULL,
    fingerprint TEXT NOT NULL,
    seed TEXT NOT NULL,
    planned_trials INTEGER NOT NULL,
    created TEXT NOT NULL
);
CREATE TABLE file (name TEXT PRIMARY KEY, content BLOB NOT NULL);
CREATE TABLE merit (
    label TEXT PRIMARY KEY,
    "column" TEXT NOT NULL,
    level TEXT NOT NULL,
    engine TEXT NOT NULL,
    at_least REAL,
    at_most REAL,
    nominal REAL
);
CREATE TABLE step (
    series TEXT NOT NULL,
    step INTEGER NOT NULL,
    coordinates TEXT NOT NULL,
    merit TEXT NOT NULL,
    score REAL,
    message TEXT NOT NULL,
    seconds REAL NOT NULL,
    PRIMARY KEY (series, step, merit)
);
CREATE TABLE picture (
    series TEXT NOT NULL,
    step INTEGER NOT NULL,
    line_width_um REAL NOT NULL,
    refocused INTEGER NOT NULL,
    orientation TEXT NOT NULL,
    half_width_um REAL NOT NULL,
    points INTEGER NOT NULL,
    intensity_float32 BLOB NOT NULL,
    PRIMARY KEY (series, step, line_width_um, refocused)
);
"""


@dataclass(frozen=True)
class StudyRecord:
    """Row of the table ``study``.

    Attributes
    ----------
    schema_version
        Version of the store's tables.
    toolkit_version
        Version of the toolkit that created the store.
    name
        Name of the study file among the store's files.
    fingerprint
        Hash of everything that scores depend on.
    seed
        Seed of the study, as text.
    planned_trials
        Planned number of trials.
    created
        Date and time at which the store was created (UTC).
    """

    schema_version: int
    toolkit_version: str
    name: str
    fingerprint: str
    seed: str
    planned_trials: int
    created: str


@dataclass(frozen=True)
class MeritRecord:
    """Row of the table ``merit``.

    Attributes
    ----------
    label, column
        Name of the merit, and of the column of its scores.
    level, engine
        Level and computation of the scores, as the run decided where the study says ``auto``.
    at_least, at_most
        Limit of the merit; one of the two is None.
    nominal
        Score of the nominal lens; None if it has none.
    """

    label: str
    column: str
    level: str
    engine: str
    at_least: float | None
    at_most: float | None
    nominal: float | None


def engine_of(merit: Merit) -> str:
    """Return the name of the computation behind a merit's scores, from the merit itself or its level."""
    # Name of the computation that gives the scores, by the level of a merit.
    engines = {"ray": "rays", "pupil": "point characteristic", "wave": "eikonal patch"}
    return str(getattr(merit, "engine", None) or engines.get(merit.used_level, merit.used_level))


def merit_record(merit: Merit, nominal: float | None) -> MeritRecord:
    """Return the record of a merit whose level is decided."""
    limits = (merit.at_least, merit.at_most)
    return MeritRecord(merit.label, merit.column, merit.used_level, engine_of(merit), *limits, nominal)


def number_columns(study: Study) -> tuple[str, ...]:
    """Return the columns of a trial's numbers: perturbations, merits, and the study's extra columns."""
    return (
        *(p.column for p in study.perturbations),
        *(m.column for m in study.merits),
        *study.extra_columns,
    )


def study_tables(study: Study) -> str:
    """Return SQL that creates the tables of trials, and the view that joins all data of each trial."""
    columns = [m.column for m in study.high_fidelity_merits]
    return (
        "CREATE TABLE trial (trial INTEGER PRIMARY KEY, status TEXT NOT NULL, message TEXT NOT NULL, "
        f"{_reals(number_columns(study))}passed INTEGER NOT NULL, seconds REAL NOT NULL, "
        "finished REAL NOT NULL);\n"
        "CREATE TABLE high_fidelity (trial INTEGER PRIMARY KEY, chosen TEXT NOT NULL, "
        f"{_reals(columns)}message TEXT NOT NULL, seconds REAL NOT NULL, finished REAL NOT NULL);\n"
        f"CREATE VIEW trial_record AS SELECT trial.*, {_high_fidelity_columns(columns)}"
        f"{''.join(_engine_column(merit) for merit in study.all_merits)}"
        "study.seed AS seed, study.toolkit_version AS toolkit_version, "
        "strftime('%Y-%m-%dT%H:%M:%SZ', trial.finished, 'unixepoch') AS finished_utc "
        "FROM trial CROSS JOIN study LEFT JOIN high_fidelity ON high_fidelity.trial = trial.trial;\n"
    )


def _reals(columns: Iterable[str]) -> str:
    return "".join(f'"{column}" REAL, ' for column in columns)


def _high_fidelity_columns(columns: list[str]) -> str:
    own = "".join(f'high_fidelity."{column}", ' for column in columns)
    return (
        f"high_fidelity.chosen AS chosen, {own}high_fidelity.message AS high_fidelity_message, "
        "high_fidelity.seconds AS high_fidelity_seconds, "
    )


def _engine_column(merit: Merit) -> str:
    query = f"SELECT engine FROM merit WHERE label = '{merit.label}'"
    return f'({query}) AS "{merit.label}_engine", '


def trial_rows(results: TrialResults) -> Rows:
    """Return the rows of the table ``trial``."""
    numbers = np.column_stack([results.values, results.scores, results.extras]).tolist()
    finished = time.time()
    return [
        (trial, status, message, *own, passed, seconds, finished)
        for trial, status, message, own, passed, seconds in zip(
            np.asarray(results.trials).tolist(),
            results.status,
            results.messages,
            numbers,
            results.passed.astype(int).tolist(),
            results.seconds.tolist(),
            strict=True,
        )
    ]


def high_fidelity_rows(results: HighFidelityResults) -> Rows:
    """Return the rows of the table ``high_fidelity``."""
    finished = time.time()
    return [
        (trial, chosen, *scores, message, seconds, finished)
        for trial, chosen, scores, message, seconds in zip(
            results.trials,
            results.chosen,
            results.scores.tolist(),
            results.messages,
            results.seconds.tolist(),
            strict=True,
        )
    ]


def step_rows(results: StepResults) -> Rows:
    """Return the rows of the table ``step``, one for each merit."""
    key = (results.series, results.step, json.dumps(dict(results.coordinates)))
    return [(*key, m, score, results.message, results.seconds) for m, score in results.scores.items()]


def picture_rows(results: StepResults) -> Rows:
    """Return the rows of the table ``picture``."""
    return [
        (
            results.series,
            results.step,
            picture.line_width_um,
            int(picture.refocused),
            picture.orientation,
            picture.half_width_um,
            len(picture.intensity),
            picture.intensity.astype("<f4").tobytes(),
        )
        for picture in results.pictures
    ]


def insert(connection: sqlite3.Connection, table: str, rows: Sequence[Sequence[Any]]) -> None:
    """Insert rows, except those that exist already. Results are reproducible, so existing rows are equal."""
    if rows:
        marks = ", ".join("?" * len(rows[0]))
        connection.executemany(f"INSERT OR IGNORE INTO {table} VALUES ({marks})", rows)
