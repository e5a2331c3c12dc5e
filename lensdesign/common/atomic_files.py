"""Atomic writing of files: a file appears complete or not at all."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lensdesign.errors import InputError

UNFINISHED: set[Path] = set()
"""Temporary files and folders that are being written; a process that ends immediately removes them."""

MARK = r"(?P<process>[0-9]{1,10})-[0-9a-f]{8}"
"""Regular expression of the marks of :func:`new_mark`."""


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Provide a temporary path in the folder of `path`, and rename it to `path` at the end.

    If writing fails, an existing file at `path` stays unchanged. A symbolic link is kept, and its target is
    replaced.

    Parameters
    ----------
    path
        Path of the finished file. Its folder is created if needed.

    Yields
    ------
    Path
        A temporary path in the same folder, with the same suffix.

    Raises
    ------
    InputError
        If the folder or the file cannot be written.
    """
    temporary, target = _temporary_for(Path(path))
    try:
        yield temporary
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, target)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):  # the disk may have become read-only; the first error is reported
            temporary.unlink(missing_ok=True)
        UNFINISHED.discard(temporary)


def resolved_output(target: Path) -> Path:
    """Return the path of a file to write with all symbolic links resolved.

    Raises
    ------
    InputError
        If the path is a folder or something else that is not a regular file, or a link that refers to itself.
    OSError, ValueError
        If the system does not accept the name.
    """
    if target.is_dir():
        raise InputError(f"cannot write {target}: it is a folder; give a file name")
    if target.exists() and not target.is_file():
        raise InputError(
            f"cannot write {target}: it is not a regular file and would be lost; give another name"
        )
    resolved = Path(os.path.realpath(target))
    if resolved.is_symlink():
        raise InputError(f"cannot write {target}: a symbolic link that refers to itself")
    return resolved


def _temporary_for(target: Path) -> tuple[Path, Path]:
    """Return an empty temporary file in the folder of the target, and the target without symbolic links."""
    try:
        resolved = resolved_output(target)
        resolved.parent.mkdir(parents=True, exist_ok=True)
        # Only the start of the name is used, so that the temporary name does not become too long.
        start, end = f".{resolved.stem[:32]}.", resolved.suffix
        _remove_abandoned(resolved.parent, start, end)
        temporary = resolved.parent / f"{start}{new_mark()}{end}"
        UNFINISHED.add(temporary)
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
    except (FileExistsError, NotADirectoryError) as error:
        raise InputError(f"cannot write {target}: there is a file where a folder is needed") from error
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror or error}") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"cannot write {str(target)!r}: {error}") from error  # a NUL character in the name
    return temporary, resolved


def new_mark() -> str:
    """Return a mark for the name of a temporary file or folder: process number and random digits."""
    return f"{os.getpid()}-{os.urandom(4).hex()}"


def is_abandoned(path: Path, process: str | None) -> bool:
    """Return whether a temporary file or folder is no longer written because its process was killed.

    Parameters
    ----------
    path
        The file or folder.
    process
        Number of the process from its name; None if the name has none.
    """
    if path in UNFINISHED:
        return False
    if process is None:
        return True
    age_seconds = time.time() - path.stat().st_mtime
    if int(process) == os.getpid():  # processes of other containers may have the same number
        return age_seconds > 60.0
    try:
        os.kill(int(process), 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):  # a process of another user
        pass
    # Age from which a temporary file is abandoned, even if a process with the number in its name exists.
    abandoned_seconds = 6 * 3600.0
    # Process numbers are reused, so the age decides.
    return age_seconds > abandoned_seconds


def _remove_abandoned(folder: Path, start: str, end: str) -> None:
    """Remove temporary files of one name that killed processes have left."""
    name = re.compile(rf"{re.escape(start)}{MARK}{re.escape(end)}")
    with suppress(OSError):
        for path in folder.iterdir():
            found = name.fullmatch(path.name)
            if found and path.is_file() and is_abandoned(path, found["process"]):
                path.unlink()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
