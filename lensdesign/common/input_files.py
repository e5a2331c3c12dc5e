"""The one way in which files of users are read: regular ones, up to a size that is stated, and no others."""

from __future__ import annotations

import math
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from lensdesign.errors import InputError

TOML_BYTES = 2**20
"""Most bytes of a design, specification, study or drawing sheet."""

LENS_FILE_BYTES = 20 * 2**20
"""Most bytes of another program's lens file: one of a thousand surfaces takes less than one of these."""

CATALOG_BYTES = 64 * 2**20
"""Most bytes of a glass catalogue; those of the makers have less than one of these."""

TABLE_BYTES = 256 * 2**20
"""Most bytes of a table of numbers: a measured figure of 4000 x 4000 points has less."""

MESH_BYTES = 2**30
"""Most bytes of a mesh, which are 20 million triangles of a binary STL file."""


_files_from: ContextVar[Path | None] = ContextVar("files_from", default=None)


@contextmanager
def files_from(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Let designs, specifications and studies name files anywhere in a folder; ``"/"`` is everywhere.

    Else they may name those in their own folders: one that somebody else has written could have any file of
    the reader's read, and kept in a store that goes back to him.
    """
    token = _files_from.set(Path(folder).resolve())
    try:
        yield
    finally:
        _files_from.reset(token)


def allowed_folder() -> Path | None:
    """The folder of :func:`files_from`; None where none was given."""
    return _files_from.get()


def validate_inside(file: Path, source: Path, key: str, fault: type[InputError] = InputError) -> None:
    """Refuse a file that lies neither in the folder of the file that names it, nor in that of `files_from`.

    Parameters
    ----------
    file
        What is named, from here.
    source, key
        The file that names it, and where in it.
    fault
        What to raise.

    Raises
    ------
    InputError
        Of the kind `fault`; it names the file.
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
    """Content of a regular file.

    Folders, devices and pipes are refused before they are opened, since reading them might never end; larger
    files before they are read.

    Parameters
    ----------
    path
        The file; a symbolic link counts as what it points to.
    most_bytes
        Size up to which it is read.
    fault
        What to raise.
    named
        What messages call the file, before its path: "glass catalogue".

    Raises
    ------
    InputError
        Of the kind `fault`, if there is no such file, it is too large, or cannot be read.
    """
    size = check_input(path, most_bytes, fault, named)
    said = _cannot_read(path, named)
    try:
        with Path(path).open("rb") as file:
            data = file.read(size + 1)
            if len(data) > size:  # it has grown, or is one of the system's, which give no size
                data += file.read(most_bytes)
    except OSError as error:
        raise fault(f"{said}: {error.strerror or error}") from error
    if len(data) > most_bytes:
        raise fault(f"{said}: more than {most_bytes} bytes")
    return data


def check_input(
    path: str | os.PathLike[str],
    most_bytes: float = math.inf,
    fault: type[InputError] = InputError,
    named: str = "",
) -> int:
    """Refuse what :func:`read_input` refuses before it opens a file, and return its size.

    For those who read it in another way.
    """
    said = _cannot_read(path, named)
    try:
        status = os.stat(path)
    except OSError as error:
        raise fault(f"{said}: {error.strerror or error}") from error
    except ValueError as error:  # a NUL character in the path
        raise fault(f"cannot read {str(path)!r}: {error}") from error
    if stat.S_ISDIR(status.st_mode):
        raise fault(f"{said}: Is a directory")
    if not stat.S_ISREG(status.st_mode):
        raise fault(f"{said}: no regular file, but a device, pipe or socket")
    if status.st_size > most_bytes:
        raise fault(f"{said}: {status.st_size} bytes; at most {most_bytes} are read")
    return status.st_size


def _cannot_read(path: str | os.PathLike[str], named: str) -> str:
    return f"cannot read {named} {path}" if named else f"cannot read {path}"
