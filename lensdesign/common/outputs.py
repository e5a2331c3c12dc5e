"""Checks of what a command is to write, before its work starts."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from lensdesign.errors import InputError, resolved_output


def check_output_file(path: str | os.PathLike[str]) -> None:
    """Refuse a file that could not be written, before anything is computed for it.

    A file is tried in the nearest folder that exists, and removed again. Folders that do not exist are not
    made.

    Parameters
    ----------
    path
        Where the file is to stand; a symbolic link counts as what it points to.

    Raises
    ------
    InputError
        If it is a folder or another thing that is no regular file, or if nothing can be written there. The
        message names the path and the reason.
    """
    target = Path(path)
    try:
        place = resolved_output(target)
        _try_name(place)
        _try_folder(place.parent)
    except OSError as error:
        raise InputError(f"cannot write {target}: {_reason(error)}") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"cannot write {str(target)!r}: {error}") from error  # a NUL character


def check_output_folder(path: str | os.PathLike[str]) -> None:
    """Refuse a folder into which nothing could be written, before anything is computed for it.

    A file is tried in it, or in the nearest folder that exists, and removed again. Folders that do not exist
    are not made.

    Parameters
    ----------
    path
        The folder.

    Raises
    ------
    InputError
        If a file stands in its place or above it, or nothing can be written there. The message names the
        path and the reason.
    """
    target = Path(path)
    try:
        place = Path(os.path.realpath(target))
        for above in (place, *place.parents):
            if above.is_symlink() or above.exists():
                if not above.is_dir():
                    named = "it" if above == place else above
                    raise InputError(f"cannot write to the folder {target}: {named} is no folder")
                break
            _try_name(above)
        _try_folder(place)
    except OSError as error:
        raise InputError(f"cannot write to the folder {target}: {_reason(error)}") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"cannot write to the folder {str(target)!r}: {error}") from error


def _try_name(place: Path) -> None:
    """Refuse a name that no file system holds."""
    with suppress(FileNotFoundError, NotADirectoryError):
        os.lstat(place)


def _try_folder(folder: Path) -> None:
    """Write an empty file into the nearest folder that exists, and remove it."""
    for place in (folder, *folder.parents):
        if place.exists():
            if not place.is_dir():
                raise NotADirectoryError(f"{place} is no folder")
            with tempfile.TemporaryFile(dir=place, prefix=".try."):
                return
    raise FileNotFoundError(f"{folder}: no folder above it exists")


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


def output_file(path: Path | None) -> Path | None:
    """Check an option that names a file to write, as its command line is read."""
    if path is not None:
        check_output_file(path)
    return path


def output_folder(path: Path | None) -> Path | None:
    """Check an option that names a folder to write to, as its command line is read."""
    if path is not None:
        check_output_folder(path)
    return path
