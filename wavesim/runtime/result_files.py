"""Folders of results: files are written to a temporary folder, and moved one by one at the end."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from lensdesign.common.atomic_files import MARK, UNFINISHED, atomic_path, is_abandoned, new_mark
from lensdesign.common.text import safe_cell
from lensdesign.errors import InputError

UNFINISHED_FOLDER = re.compile(rf"\.new\.(?:{MARK}|[0-9a-f]{{8}})")
"""Names of folders in which results are written until they are complete."""


def remove_unfinished(folder: Path) -> None:
    """Remove unfinished results of runs that were killed.

    Folders of running processes, and folders that cannot be removed, remain.

    Parameters
    ----------
    folder
        Folder of results, which need not exist.
    """
    with suppress(OSError):
        for path in folder.iterdir():
            found = UNFINISHED_FOLDER.fullmatch(path.name)
            if found and path.is_dir() and not path.is_symlink() and is_abandoned(path, found["process"]):
                shutil.rmtree(path, ignore_errors=True)


@contextmanager
def new_results(folder: Path) -> Iterator[Path]:
    """Yield an empty folder to write to, and move its files to `folder` at the end.

    A failure before the end leaves `folder` unchanged. Each file is replaced at once. Other files in `folder`
    remain in any case.

    Parameters
    ----------
    folder
        Folder of results, which is created if it does not exist.

    Yields
    ------
    Path
        A temporary folder within `folder`.

    Raises
    ------
    InputError
        If the folder or its files cannot be written.
    """
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_unfinished(folder)
        place = folder / f".new.{new_mark()}"
        UNFINISHED.add(place)
        place.mkdir(0o700)
    except (FileExistsError, NotADirectoryError) as error:
        raise InputError(f"cannot make the folder {folder}: a file of this name exists") from error
    except OSError as error:
        raise InputError(f"cannot write to the folder {folder}: {error.strerror or error}") from error
    try:
        yield place
        written = sorted(place.iterdir())
        for path in written:
            if (folder / path.name).is_dir():
                raise InputError(f"cannot write {folder / path.name}: it is a folder")
        for path in written:
            os.replace(path, folder / path.name)
    except OSError as error:
        raise InputError(f"cannot write to the folder {folder}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(place, ignore_errors=True)
        UNFINISHED.discard(place)
        if made:
            with suppress(OSError):  # it is not empty, or cannot be changed any more
                folder.rmdir()


def write_json(data: Mapping[str, Any], path: Path) -> None:
    """Write one JSON object."""
    path.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def write_csv(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write a table with the keys of the first row as columns.

    Text that a spreadsheet would take for a formula is escaped.
    """
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(
            {key: safe_cell(value) if isinstance(value, str) else value for key, value in row.items()}
            for row in rows
        )
