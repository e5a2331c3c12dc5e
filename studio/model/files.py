"""Files of this machine for the picker of the page: folders, and the files that were used last."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from lensdesign.errors import InputError
from studio.model.document import cache_folder

MAX_RECENT, MAX_ENTRIES = 8, 2000
"""Largest numbers of recent files, and of entries of a folder that are shown."""


def typed_path(text: str) -> Path:
    """Return the path that a user has typed; ``~`` and ``~name`` are folders of users.

    Raises
    ------
    InputError
        If no path has this form: a user that does not exist, a name of more than 255 bytes, or a NUL.
    """
    name = text.strip()
    longest = 255  # bytes of a name
    if "\0" in name or any(len(os.fsencode(part)) > longest for part in Path(name).parts):
        raise InputError(f"{name:.80}: a name of more than {longest} bytes, or with a NUL; give another path")
    try:
        return Path(name).expanduser()
    except RuntimeError as error:
        raise InputError(f"{name:.80}: {error}; give another path") from None


def listing(path: str, suffixes: Sequence[str] = ()) -> dict[str, Any]:
    """Return the contents of a folder for the picker.

    Parameters
    ----------
    path
        The folder, or a file in it; empty: the working folder.
    suffixes
        Suffixes of the files that are listed; empty: all files.

    Returns
    -------
    dict
        ``folder`` and ``parent`` as absolute paths (an empty parent at the root), ``entries`` as pairs of a
        name and whether it is a folder, and ``error``, a message if the folder cannot be read.
    """
    try:
        folder = Path(os.path.abspath(typed_path(path)))
    except InputError as refusal:
        return {"folder": "", "parent": "", "entries": [], "error": str(refusal)}
    while not folder.is_dir() and folder != folder.parent:
        folder = folder.parent
    found: list[tuple[str, bool]] = []
    error = ""
    try:
        for entry in os.scandir(folder):
            if entry.name.startswith("."):
                continue
            with suppress(OSError):
                is_folder = entry.is_dir()
                if is_folder or not suffixes or Path(entry.name).suffix.lower() in suffixes:
                    found.append((entry.name, is_folder))
    except OSError as refusal:
        error = f"cannot read {folder}: {refusal.strerror or refusal}"
    found.sort(key=lambda one: (not one[1], one[0].casefold()))
    parent = "" if folder == folder.parent else str(folder.parent)
    return {
        "folder": str(folder),
        "parent": parent,
        "entries": [list(one) for one in found[:MAX_ENTRIES]],
        "error": error,
    }


def recent(kind: str) -> list[str]:
    """Return the paths of one kind that were used last and still exist, the newest first."""
    return [path for path in _read().get(kind, []) if isinstance(path, str) and os.path.exists(path)]


def remember(kind: str, path: Path) -> None:
    """Put a path before the other recent ones of its kind, if the cache folder can be written."""
    whole = os.path.abspath(path)
    kept = _read()
    others = [one for one in kept.get(kind, []) if isinstance(one, str) and one != whole]
    kept[kind] = [whole, *others][:MAX_RECENT]
    with suppress(OSError):
        file = _file()
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        temporary = file.with_suffix(f".{os.getpid()}")
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            json.dump(kept, stream)
        os.replace(temporary, file)


def _file() -> Path:
    return cache_folder() / "recent.json"


def _read() -> dict[str, list[Any]]:
    try:
        found = json.loads(_file().read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    if not isinstance(found, dict):
        return {}
    return {kind: paths for kind, paths in found.items() if isinstance(paths, list)}
