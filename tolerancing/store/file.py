"""The file of a store: SQLite with a write-ahead log, which lies beside the file while it is written.

SQLite plays a log that was left behind into whatever database stands beside it, so one store may only take
the place of another when that one's log is gone and nobody else has it open.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lensdesign.common.input_files import check_input
from lensdesign.errors import InputError
from tolerancing.store.schema import APPLICATION_ID, SCHEMA_VERSION

LOGS = ("-wal", "-shm", "-journal")
"""What SQLite puts beside a database, by the ends of the names."""

PATIENCE_SECONDS = 60.0
"""How long to wait while another process writes."""

FRESH_PATIENCE_SECONDS = 2.0
"""How long to wait until nobody else has a store open that is to be replaced."""


def check_is_store(path: Path) -> None:
    """Refuse a file that is no store, or one of another version.

    Raises
    ------
    InputError
        If there is none, or the file is something else, or of another version; it is not touched.
    """
    check_input(path)
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


def connect(path: Path) -> sqlite3.Connection:
    """Open a store's database, to write where that is allowed.

    Where it is not, and no log lies beside it, it is taken as immutable: SQLite then needs no files of its
    own, and reads from a folder or a medium that cannot be written.
    """
    place = Path(os.path.realpath(path))
    how = "mode=rw"
    if not (os.access(place, os.W_OK) and os.access(place.parent, os.W_OK)):
        how = "mode=ro" if _log_holds_rows(place) else "mode=ro&immutable=1"
    with reported(path, "open"):
        connection = sqlite3.connect(
            f"{place.as_uri()}?{how}", uri=True, isolation_level=None, timeout=PATIENCE_SECONDS
        )
        connection.execute("PRAGMA trusted_schema = OFF")  # others may have made it
        return connection


def start_writing(connection: sqlite3.Connection) -> None:
    """Switch to a write-ahead log; a commit then survives the end of the process, whatever ends it."""
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = NORMAL")


def put_log_away(connection: sqlite3.Connection) -> None:
    """Play the log into the database, so that the store is one file; left to others if they are at it."""
    connection.execute("PRAGMA busy_timeout = 1000")
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")


@contextmanager
def nobody_else(path: Path) -> Iterator[None]:
    """Keep a store, if there is one, from being used by others, with no log beside it.

    Raises
    ------
    InputError
        If another process has it open.
    """
    place = Path(os.path.realpath(path))
    if not place.exists():
        remove_logs(place)
        yield
        return
    with reported(path, "replace"):
        connection = sqlite3.connect(
            f"{place.as_uri()}?mode=rw", uri=True, isolation_level=None, timeout=FRESH_PATIENCE_SECONDS
        )
    try:
        _lock(connection, path)
        remove_logs(place)
        yield
    finally:
        connection.close()


def _lock(connection: sqlite3.Connection, path: Path) -> None:
    """Have the database alone: only then SQLite goes back to a rollback journal, its log played in."""
    try:
        connection.execute("PRAGMA journal_mode = DELETE")
        connection.execute("BEGIN EXCLUSIVE")
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
            raise InputError(
                f"cannot replace the store {path}: another process has it open; end it first"
            ) from error
        raise InputError(f"cannot replace the store {path}: {reason(error)}") from error
    except sqlite3.DatabaseError:
        return  # it is damaged, and about to be replaced


def _log_holds_rows(place: Path) -> bool:
    try:
        return place.with_name(f"{place.name}-wal").stat().st_size > 0
    except OSError:
        return False


def remove_logs(place: Path) -> None:
    """Remove what SQLite left beside a database that is not there any more, or alone with us.

    Raises
    ------
    InputError
        If one cannot be removed.
    """
    for end in LOGS:
        log = place.with_name(f"{place.name}{end}")
        try:
            log.unlink(missing_ok=True)
        except NotADirectoryError:
            return
        except OSError as error:
            raise InputError(f"cannot remove {log}: {error.strerror or error}") from error


@contextmanager
def reported(path: Path, action: str) -> Iterator[None]:
    """Turn what SQLite and the file system say into an InputError that names the store."""
    try:
        yield
    except sqlite3.Error as error:
        raise InputError(f"cannot {action} the store {path}: {reason(error)}") from error


def reason(error: sqlite3.Error) -> str:
    """What SQLite says, and what to do about it where that is known."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    advice = {
        sqlite3.SQLITE_FULL: "; make room: it keeps what it held, and the same command goes on from there",
        sqlite3.SQLITE_IOERR: "; it keeps what it held, and the same command goes on from there",
        sqlite3.SQLITE_READONLY: "; it stands where nothing can be written",
        sqlite3.SQLITE_CANTOPEN: "; if a run was broken off here, its folder must be writable",
        sqlite3.SQLITE_BUSY: f"; another process has been writing for {PATIENCE_SECONDS:g} s",
    }
    return f"{error}{advice.get(code, '')}"


@contextmanager
def undamaged(path: Path) -> Iterator[None]:
    """What a store holds is ours: where text or numbers in it make no sense, it is damaged."""
    try:
        yield
    except (InputError, sqlite3.OperationalError):
        raise
    except (sqlite3.DatabaseError, ValueError, TypeError) as error:
        raise InputError(
            f"the store {path} is damaged: {error}; take a whole copy, or run its study anew with --fresh"
        ) from error
