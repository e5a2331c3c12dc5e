"""Reading of user files: only regular files, and only up to a stated size."""

from __future__ import annotations

import json
import math
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from lensdesign.errors import InputError

TOML_BYTES = 2**20
"""Largest size of a design, specification, study or drawing sheet."""

LENS_FILE_BYTES = 20 * 2**20
"""Largest size of another program's lens file; a file of a thousand surfaces has less than 1 MB."""

CATALOG_BYTES = 64 * 2**20
"""Largest size of a glass catalogue; those of makers have less than 1 MB."""

TABLE_BYTES = 256 * 2**20
"""Largest size of a table of numbers; a measured figure of 4000 x 4000 points is smaller."""

MESH_BYTES = 2**30
"""Largest size of a mesh: 20 million triangles of a binary STL file."""


_files_from: ContextVar[Path | None] = ContextVar("files_from", default=None)


@contextmanager
def files_from(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Allow designs, specifications and studies to name files anywhere in a folder; ``"/"`` means everywhere.

    Otherwise they may only name files in their own folders. A study from another person could otherwise read
    private files and store their content.
    """
    token = _files_from.set(Path(folder).resolve())
    try:
        yield
    finally:
        _files_from.reset(token)


def allowed_folder() -> Path | None:
    """Return the folder of :func:`files_from`; None if none was given."""
    return _files_from.get()


def validate_inside(file: Path, source: Path, key: str, fault: type[InputError] = InputError) -> None:
    """Refuse a file that is neither in the folder of the file that names it nor in that of `files_from`.

    Parameters
    ----------
    file
        The named file, relative to the working folder.
    source, key
        The file that names it, and the key.
    fault
        Class of the exception to raise.

    Raises
    ------
    InputError
        If the file is outside these folders. The exception has the class `fault`.
    """
    folder = source.parent.resolve()
    if not file.resolve().is_relative_to(allowed_folder() or folder):
        raise fault(
            f"{source}: {key}: {file.resolve()} lies outside {folder}; copy it there, or, if you know who "
            "named it, allow it by --outside-files before the command's name (in Python: "
            'with files_from("/"))'
        )


def read_input(
    path: str | os.PathLike[str],
    most_bytes: int,
    fault: type[InputError] = InputError,
    named: str = "",
) -> bytes:
    """Return the content of a regular file.

    Folders, devices and pipes are refused before they are opened, since reading them might never end. Larger
    files are refused before they are read.

    Parameters
    ----------
    path
        The file; symbolic links are followed.
    most_bytes
        Largest size that is read.
    fault
        Class of the exception to raise.
    named
        Description of the file in messages, before its path, such as "glass catalogue".

    Raises
    ------
    InputError
        If the file does not exist, is too large, or cannot be read. The exception has the class `fault`.
    """
    size = check_input(path, most_bytes, fault, named)
    prefix = _cannot_read(path, named)
    try:
        with Path(path).open("rb") as file:
            data = file.read(size + 1)
            if len(data) > size:  # the file has grown, or the system states no size for it
                data += file.read(most_bytes)
    except OSError as error:
        raise fault(f"{prefix}: {error.strerror or error}") from error
    if len(data) > most_bytes:
        raise fault(f"{prefix}: more than {most_bytes} bytes")
    return data


def read_json(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the object of a JSON file.

    Raises
    ------
    InputError
        If the file cannot be read, or contains no object.
    """
    content = read_input(path, TABLE_BYTES)
    try:
        data = json.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"cannot read {path}: not a JSON file: {error}") from None
    if not isinstance(data, dict):
        raise InputError(f"cannot read {path}: must contain a JSON object")
    return data


def check_input(
    path: str | os.PathLike[str],
    most_bytes: float = math.inf,
    fault: type[InputError] = InputError,
    named: str = "",
) -> int:
    """Check a file as :func:`read_input` does before it opens it, and return its size in bytes."""
    prefix = _cannot_read(path, named)
    try:
        status = os.stat(path)
    except OSError as error:
        raise fault(f"{prefix}: {error.strerror or error}") from error
    except ValueError as error:  # a NUL character in the path
        raise fault(f"cannot read {str(path)!r}: {error}") from error
    if stat.S_ISDIR(status.st_mode):
        raise fault(f"{prefix}: Is a directory")
    if not stat.S_ISREG(status.st_mode):
        raise fault(f"{prefix}: not a regular file, but a device, pipe or socket")
    if status.st_size > most_bytes:
        raise fault(f"{prefix}: {status.st_size} bytes; at most {most_bytes} are read")
    return status.st_size


def _cannot_read(path: str | os.PathLike[str], named: str) -> str:
    return f"cannot read {named} {path}" if named else f"cannot read {path}"
