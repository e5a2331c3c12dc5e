"""Making a store: whole under its name, or not at all, and never in the place of one that is in use."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing, nullcontext, suppress
from datetime import UTC, datetime
from pathlib import Path

from lensdesign.common.clusters import toolkit_version
from lensdesign.errors import InputError, atomic_path
from tolerancing.store.file import nobody_else, remove_logs, reported, start_writing
from tolerancing.store.schema import (
    APPLICATION_ID,
    SCHEMA,
    SCHEMA_VERSION,
    MeritRecord,
    StudyRecord,
    insert,
    merit_record,
    study_tables,
)
from tolerancing.study.files import LoadedStudy
from tolerancing.study.study import Study


class _Taken(Exception):
    """A store has appeared meanwhile."""


def create_store(
    loaded: LoadedStudy,
    path: Path,
    nominal: Mapping[str, float],
    planned_trials: int,
    *,
    levels: Mapping[str, str] | None = None,
    replace: bool = True,
) -> bool:
    """Make a store without trials.

    Parameters
    ----------
    loaded
        The study.
    path
        Where to make it.
    nominal
        Scores of the nominal lens, by merit.
    planned_trials
        How many trials there are to be.
    levels
        The merits' levels by their labels, where the study leaves them open.
    replace
        Whether it takes the place of a store that stands there.

    Returns
    -------
    bool
        False if there is a store already, and it was not to be replaced.

    Raises
    ------
    InputError
        If the file cannot be written, or another process has the store open; whatever stood there stays.
    """
    record = StudyRecord(
        schema_version=SCHEMA_VERSION,
        toolkit_version=toolkit_version(),
        name=loaded.name,
        fingerprint=loaded.fingerprint,
        seed=str(loaded.study.seed),
        planned_trials=planned_trials,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    study = loaded.study.with_levels(levels or {})
    merits = [merit_record(m, nominal.get(m.label)) for m in study.all_merits]
    try:
        with nobody_else(path) if replace else nullcontext(), atomic_path(path) as temporary:
            with reported(path, "write"):
                _fill(temporary, record, study, merits, loaded.files)
            if not replace:
                _claim(path, temporary)
    except _Taken:
        return False
    return True


def remove_empty_store(path: Path) -> None:
    """Remove a store that holds no results and that nobody else has open; any other stays."""
    with suppress(InputError, OSError, sqlite3.Error), nobody_else(path):
        place = Path(os.path.realpath(path))
        with closing(sqlite3.connect(f"{place.as_uri()}?mode=ro&immutable=1", uri=True)) as connection:
            held = any(
                connection.execute(f"SELECT 1 FROM {table} LIMIT 1").fetchone()
                for table in ("trial", "dear", "step", "picture")
            )
        if not held:
            place.unlink()


def _fill(
    temporary: Path,
    record: StudyRecord,
    study: Study,
    merits: Sequence[MeritRecord],
    files: Mapping[str, bytes],
) -> None:
    """Write all but the trials, and leave one file."""
    connection = sqlite3.connect(temporary, isolation_level=None)
    try:
        # As one transaction: a disk takes its time over each.
        connection.executescript(f"BEGIN;{SCHEMA}{study_tables(study)}")
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        insert(connection, "study", [tuple(vars(record).values())])
        insert(connection, "file", sorted(files.items()))
        insert(connection, "merit", [tuple(vars(merit).values()) for merit in merits])
        connection.execute("COMMIT")
        start_writing(connection)
    finally:
        connection.close()
        remove_logs(temporary)


def _claim(path: Path, temporary: Path) -> None:
    """Give a new store its name, unless another process was first; a link does not take another's place."""
    place = Path(os.path.realpath(path))
    if not place.exists():
        remove_logs(place)
    try:
        os.link(temporary, place)
    except FileExistsError:
        raise _Taken from None
    except OSError:  # a file system without links
        if place.exists():
            raise _Taken from None
