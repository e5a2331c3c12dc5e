"""Checks of output files and folders before a command starts to compute."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from lensdesign.common.atomic_files import resolved_output
from lensdesign.errors import InputError


def check_output_file(path: str | os.PathLike[str]) -> None:
    """Check that a file can be written, before anything is computed for it.

    A temporary file is created in the nearest existing folder and removed again. Missing folders are not
    created.

    Parameters
    ----------
    path
        Path of the output file; symbolic links are followed.

    Raises
    ------
    InputError
        If the path is a folder or something else that is not a regular file, or is not writable. The message
        names the path and the reason.
    """
    target = Path(path)
    try:
        resolved = resolved_output(target)
        _try_name(resolved)
        _check_depth(resolved)
        _try_folder(resolved.parent)
    except OSError as error:
        raise InputError(f"cannot write {target}: {_reason(error)}") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"cannot write {str(target)!r}: {error}") from error  # a NUL character


def check_output_folder(path: str | os.PathLike[str]) -> None:
    """Check that files can be written to a folder, before anything is computed for it.

    A temporary file is created in it, or in the nearest existing folder, and removed again. Missing folders
    are not created.

    Parameters
    ----------
    path
        The folder.

    Raises
    ------
    InputError
        If the path or a parent of it is a file, or the folder is not writable. The message names the path and
        the reason.
    """
    target = Path(path)
    try:
        resolved = Path(os.path.realpath(target))
        _try_name(resolved)
        _check_depth(resolved)
        for parent in (resolved, *resolved.parents):
            if parent.is_symlink() or parent.exists():
                if not parent.is_dir():
                    named = "it" if parent == resolved else parent
                    raise InputError(f"cannot write to the folder {target}: {named} is no folder")
                break
            _try_name(parent)
        _try_folder(resolved)
    except OSError as error:
        raise InputError(f"cannot write to the folder {target}: {_reason(error)}") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"cannot write to the folder {str(target)!r}: {error}") from error


def _check_depth(path: Path) -> None:
    """Raise an InputError for more missing folders in each other than anyone wants."""
    most_new_folders = 100
    if not any(parent.exists() for parent in list(path.parents)[: most_new_folders + 1]):
        raise InputError(
            f"cannot write {str(path)!r:.100}...: more than {most_new_folders} folders in each other would "
            "have to be created; give a shorter path"
        )


def _try_name(path: Path) -> None:
    """Raise an error for a name that the file system does not accept."""
    with suppress(FileNotFoundError, NotADirectoryError):
        os.lstat(path)


def _try_folder(folder: Path) -> None:
    """Create an empty file in the nearest existing folder, and remove it."""
    for parent in (folder, *folder.parents):
        if parent.exists():
            if not parent.is_dir():
                raise NotADirectoryError(f"{parent} is no folder")
            with tempfile.TemporaryFile(dir=parent, prefix=".try."):
                return
    raise FileNotFoundError(f"{folder}: no folder above it exists")


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


def output_file(path: Path | None) -> Path | None:
    """Check the output file of a command option while the command line is parsed."""
    if path is not None:
        check_output_file(path)
    return path


def output_folder(path: Path | None) -> Path | None:
    """Check the output folder of a command option while the command line is parsed."""
    if path is not None:
        check_output_folder(path)
    return path
