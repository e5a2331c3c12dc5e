"""Rows of a store from what workers hand over. SQLite keeps NaN as NULL."""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from tolerancing.study.results import DearResults, StepResults, TrialResults

Rows = list[tuple[Any, ...]]


def trial_rows(results: TrialResults) -> Rows:
    """Rows of the table of trials."""
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


def dear_rows(results: DearResults) -> Rows:
    """Rows of the table of dear scores."""
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
    """Rows of the table of steps, one for each merit."""
    key = (results.series, results.step, json.dumps(dict(results.coordinates)))
    return [(*key, m, score, results.message, results.seconds) for m, score in results.scores.items()]


def picture_rows(results: StepResults) -> Rows:
    """Rows of the table of pictures."""
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
    """Insert rows but for those that are there; results are reproducible, so these are the same."""
    if rows:
        marks = ", ".join("?" * len(rows[0]))
        connection.executemany(f"INSERT OR IGNORE INTO {table} VALUES ({marks})", rows)
