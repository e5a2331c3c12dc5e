"""Folders of results, whose files change together at the end."""

from __future__ import annotations

import csv
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lensdesign.common.text import safe_cell
from lensdesign.errors import UNFINISHED, InputError, atomic_path


@contextmanager
def new_results(folder: Path) -> Iterator[Path]:
    """Give an empty folder to write to, and rename its files into `folder` at the end.

    A failure leaves `folder` as it was; other files in it stay.

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
        place = folder / f".new.{os.urandom(4).hex()}"
        UNFINISHED.add(place)
        place.mkdir(0o700)
    except (FileExistsError, NotADirectoryError) as error:
        raise InputError(f"cannot make the folder {folder}: a file stands in its place") from error
    except OSError as error:
        raise InputError(f"cannot write to the folder {folder}: {error.strerror or error}") from error
    try:
        yield place
        for path in sorted(place.iterdir()):
            os.replace(path, folder / path.name)
    except OSError as error:
        raise InputError(f"cannot write to the folder {folder}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(place, ignore_errors=True)
        UNFINISHED.discard(place)
        if made and not any(folder.iterdir()):
            folder.rmdir()


def refuse_no_folder(folder: Path) -> None:
    """Refuse, before anything is computed, a place where no folder can stand.

    Raises
    ------
    InputError
        If a file stands there.
    """
    for place in (folder, *folder.parents):
        if place.exists():
            if not place.is_dir():
                raise InputError(f"--output = {str(folder)!r}: {place} is no folder")
            return


def write_json(data: Mapping[str, Any], path: Path) -> None:
    """Write one JSON object."""
    path.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def write_csv(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """A table with the first row's keys as its columns; no text in it is a formula to a spreadsheet."""
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(
            {key: safe_cell(value) if isinstance(value, str) else value for key, value in row.items()}
            for row in rows
        )
