"""The SQLite file of a store, with a write-ahead log in the same folder while it is written.

SQLite merges a log that was left behind into any database of the same name. A store may therefore replace
another one only if the log of the other is gone and no other process has it open.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lensdesign.common.input_files import check_input
from lensdesign.errors import InputError
from tolerancing.store.schema import APPLICATION_ID, HIGH_FIDELITY

BUSY_TIMEOUT_SECONDS = 60.0
"""Longest wait while another process writes."""

REPLACE_TIMEOUT_SECONDS = 2.0
"""Longest wait until no other process has a store open that is to be replaced."""


def check_is_store(path: Path) -> None:
    """Check that a file is a store of the present version, or of one that is still read.

    Raises
    ------
    InputError
        If the file does not exist, is no store, or has another version. The file is not changed.
    """
    check_input(path)
    try:
        with path.open("rb") as file:
            header = file.read(100)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    # A SQLite header holds the application id and the user version at fixed offsets.
    if header[:16] != b"SQLite format 3\0" or int.from_bytes(header[68:72]) != APPLICATION_ID:
        raise InputError(f"{path} is no store of a tolerance study; give another file name")
    schema = int.from_bytes(header[60:64])
    if schema not in HIGH_FIDELITY:
        allowed = " and ".join(map(str, HIGH_FIDELITY))
        raise InputError(
            f"{path} is a store of version {schema}; this toolkit reads versions {allowed}: "
            "use the toolkit that wrote it"
        )


def connect(path: Path) -> sqlite3.Connection:
    """Open the database of a store, for writing if that is permitted.

    A database that cannot be written and has no log is opened as immutable. SQLite then needs no files of its
    own, and can read from a folder or medium without write access.
    """
    file = Path(os.path.realpath(path))
    options = "mode=rw"
    if not (os.access(file, os.W_OK) and os.access(file.parent, os.W_OK)):
        options = "mode=ro" if _log_holds_rows(file) else "mode=ro&immutable=1"
    with translated_errors(path, "open"):
        connection = sqlite3.connect(
            f"{file.as_uri()}?{options}", uri=True, isolation_level=None, timeout=BUSY_TIMEOUT_SECONDS
        )
        connection.execute("PRAGMA trusted_schema = OFF")  # The file may come from someone else.
        return connection


def start_writing(connection: sqlite3.Connection) -> None:
    """Switch to a write-ahead log, so that a commit survives if the process is killed."""
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = NORMAL")


def merge_log(connection: sqlite3.Connection) -> None:
    """Merge the log into the database, so that the store is one file. Other open processes do it later."""
    connection.execute("PRAGMA busy_timeout = 1000")
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")


@contextmanager
def exclusive_access(path: Path) -> Iterator[None]:
    """Lock a store against other processes, and remove its log. Without a store, only remove left-over logs.

    Raises
    ------
    InputError
        If another process has the store open.
    """
    file = Path(os.path.realpath(path))
    if not file.exists():
        remove_logs(file)
        yield
        return
    with translated_errors(path, "replace"):
        connection = sqlite3.connect(
            f"{file.as_uri()}?mode=rw", uri=True, isolation_level=None, timeout=REPLACE_TIMEOUT_SECONDS
        )
    try:
        _lock(connection, path)
        remove_logs(file)
        yield
    finally:
        connection.close()


def _lock(connection: sqlite3.Connection, path: Path) -> None:
    """Lock the database exclusively. Only then can SQLite merge the log and return to a rollback journal."""
    try:
        connection.execute("PRAGMA journal_mode = DELETE")
        connection.execute("BEGIN EXCLUSIVE")
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
            raise InputError(
                f"cannot replace the store {path}: another process has it open; end it first"
            ) from error
        raise InputError(f"cannot replace the store {path}: {reason(error, path)}") from error
    except sqlite3.DatabaseError:
        return  # The file is damaged, and will be replaced.


def _log_holds_rows(file: Path) -> bool:
    try:
        return file.with_name(f"{file.name}-wal").stat().st_size > 0
    except OSError:
        return False


def remove_logs(file: Path) -> None:
    """Remove SQLite's log files beside a database that no longer exists or is locked by this process.

    Raises
    ------
    InputError
        If a log file cannot be removed.
    """
    for ending in ("-wal", "-shm", "-journal"):
        log = file.with_name(f"{file.name}{ending}")
        try:
            log.unlink(missing_ok=True)
        except NotADirectoryError:
            return
        except OSError as error:
            raise InputError(f"cannot remove {log}: {error.strerror or error}") from error


@contextmanager
def translated_errors(path: Path, action: str) -> Iterator[None]:
    """Convert errors of SQLite into an InputError that names the store and the action."""
    try:
        yield
    except sqlite3.Error as error:
        raise InputError(f"cannot {action} the store {path}: {reason(error, path)}") from error


def reason(error: sqlite3.Error, path: Path) -> str:
    """Return the message of SQLite about a store, with advice for the common errors."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    stored = "the finished results are in the store" if path.exists() else "nothing is stored yet"
    kept = f"{stored}; repeat the command to continue"
    advice = {
        sqlite3.SQLITE_FULL: f"; free some disk space: {kept}",
        sqlite3.SQLITE_IOERR: f"; {kept}",
        sqlite3.SQLITE_READONLY: "; the file or its folder cannot be written",
        sqlite3.SQLITE_CANTOPEN: "; if a run was interrupted here, its folder must be writable",
        sqlite3.SQLITE_BUSY: f"; another process has been writing for {BUSY_TIMEOUT_SECONDS:g} s",
    }
    return f"{error}{advice.get(code, '')}"


@contextmanager
def damage_as_error(path: Path) -> Iterator[None]:
    """Convert errors about invalid values in a store into an InputError that calls the store damaged."""
    try:
        yield
    except (InputError, sqlite3.OperationalError):
        raise
    except (sqlite3.DatabaseError, ValueError, TypeError) as error:
        raise InputError(
            f"the store {path} is damaged: {error}; use an intact copy, or run its study again with --fresh"
        ) from error
