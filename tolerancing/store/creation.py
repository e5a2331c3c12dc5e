"""Creation of a store. It gets its name when it is complete, and never replaces a store that is in use."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing, nullcontext, suppress
from datetime import UTC, datetime
from pathlib import Path

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.clusters import toolkit_version
from lensdesign.errors import InputError
from tolerancing.store.file import exclusive_access, remove_logs, start_writing, translated_errors
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


class _StoreExists(Exception):
    """Another process has created the store in the meantime."""


def create_store(
    loaded: LoadedStudy,
    path: Path,
    nominal: Mapping[str, float],
    planned_trials: int,
    *,
    levels: Mapping[str, str] | None = None,
    replace: bool = True,
) -> bool:
    """Create a store without trials.

    Parameters
    ----------
    loaded
        Study with its files.
    path
        Path of the new store.
    nominal
        Scores of the nominal lens, by the merit's label.
    planned_trials
        Planned number of trials.
    levels
        Level of each merit, by the merit's label. Default: the levels of the study.
    replace
        Whether an existing store is replaced.

    Returns
    -------
    bool
        False if a store exists and `replace` is false; nothing is changed then.

    Raises
    ------
    InputError
        If the file cannot be written, or another process has the store open. An existing file stays.
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
        with exclusive_access(path) if replace else nullcontext(), atomic_path(path) as temporary:
            with translated_errors(path, "write"):
                _fill(temporary, record, study, merits, loaded.files)
            if not replace:
                _claim(path, temporary)
    except _StoreExists:
        return False
    return True


def remove_empty_store(path: Path) -> None:
    """Remove a store if it holds no results and no other process has it open."""
    with suppress(InputError, OSError, sqlite3.Error), exclusive_access(path):
        file = Path(os.path.realpath(path))
        with closing(sqlite3.connect(f"{file.as_uri()}?mode=ro&immutable=1", uri=True)) as connection:
            has_results = any(
                connection.execute(f"SELECT 1 FROM {table} LIMIT 1").fetchone()
                for table in ("trial", "high_fidelity", "step", "picture")
            )
        if not has_results:
            file.unlink()


def _fill(
    temporary: Path,
    record: StudyRecord,
    study: Study,
    merits: Sequence[MeritRecord],
    files: Mapping[str, bytes],
) -> None:
    """Write tables, study and merits into a new file, without a log file."""
    connection = sqlite3.connect(temporary, isolation_level=None)
    try:
        # One transaction, because each one waits for the disk.
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
    """Give a new store its name, unless another process was first. A hard link never replaces a file."""
    file = Path(os.path.realpath(path))
    if not file.exists():
        remove_logs(file)
    try:
        os.link(temporary, file)
    except FileExistsError:
        raise _StoreExists from None
    except OSError:  # The file system has no hard links.
        if file.exists():
            raise _StoreExists from None
