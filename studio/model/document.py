"""Design file of the workbench, which is never overwritten after external changes; autosave of edits."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.caches import user_cache_folder
from lensdesign.common.toml_files import read_toml
from lensdesign.errors import InputError
from lensdesign.files.design import design_text
from studio.model.editing import Editing, Step, Tables, lens_from


@dataclass(frozen=True)
class Document:
    """State of a design file when it was last read or written.

    Attributes
    ----------
    path
        The file.
    digest
        SHA-256 of its bytes; empty if it did not exist.
    """

    path: Path
    digest: str

    def saved(self, editing: Editing, path: Path | None = None) -> Document:
        """Write the lens, and return the new state of the file.

        Parameters
        ----------
        editing
            The edited design.
        path
            Another file, which must not exist (default: the document's file).

        Raises
        ------
        InputError
            If the file changed on disk, another file exists, or the file cannot be written.
        """
        target = self.path if path is None else path
        known = self.digest if _same(target, self.path) else ""
        if (found := digest_of(target)) != known:
            raise InputError(f"{target}: {_why_not(known, found)}")
        with atomic_path(target) as temporary:
            temporary.write_text(design_text(editing.lens, target.parent), encoding="utf-8")
        return Document(target, digest_of(target))


def opened(path: Path) -> tuple[Document, Editing]:
    """Open a design file.

    Raises
    ------
    InputError
        If the file cannot be read or does not describe a lens; see :func:`lensdesign.load_design`.
    """
    digest = digest_of(path)
    tables = read_toml(path)
    return Document(path, digest), Editing(path, Step(tables, lens_from(tables, path), "opened"))


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file's bytes; empty if there is no file."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except FileNotFoundError:
        return ""
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error


def _why_not(known: str, found: str) -> str:
    """Return the reason why a file with an unexpected digest is not overwritten."""
    if not known:
        return "exists already; give another name"
    if not found:
        return "was removed from the disk; save under another name"
    return "changed on disk since it was opened; save under another name, or open it again"


def _same(one: Path, other: Path) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)


def cache_folder() -> Path:
    """Return the private folder of the workbench in the user's cache folder; it need not exist."""
    return user_cache_folder() / "studio"


class Autosave:
    """Store of unsaved edits, and of the server's address, in a private folder of the user.

    Parameters
    ----------
    path
        The design file that is edited.
    folder
        Folder of the store (default: in the user's cache folder).
    """

    def __init__(self, path: Path, folder: Path | None = None) -> None:
        self.folder = cache_folder() if folder is None else folder
        name = hashlib.sha256(os.path.realpath(path).encode()).hexdigest()[:24]
        self.file = self.folder / f"{name}.json"
        self._turn = threading.Lock()
        self._is_refused = False

    def read(self) -> dict[str, Any]:
        """Return the stored values; empty if there are none or they cannot be read."""
        try:
            found = json.loads(self.file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def keep(self, **values: Any) -> None:
        """Add values to the store, which only the user can read.

        If the folder cannot be written, one warning is printed and the page continues without a store.
        """
        with self._turn:  # both the page and the thread of the analysis store values
            try:
                self._write(self.read() | values)
            except OSError as error:
                if not self._is_refused:
                    reason = error.strerror or str(error)
                    print(f"warning: unsaved edits cannot be stored: {self.file}: {reason}", file=sys.stderr)
                self._is_refused = True

    def _write(self, values: dict[str, Any]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        temporary = self.file.with_suffix(f".{os.getpid()}")
        try:
            descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
            with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
                json.dump(values, stream)
            os.replace(temporary, self.file)
        except OSError:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise

    def restored(self, document: Document, editing: Editing) -> Editing:
        """Return the editing with the stored edits, if they belong to the present contents of the file."""
        kept = self.read()
        tables = kept.get("tables")
        if not isinstance(tables, str) or kept.get("digest") != document.digest:
            return editing
        import tomllib

        try:
            return editing.changed(tomllib.loads(tables), "edits of the last session")
        except (InputError, ValueError):
            return editing


def tables_text(tables: Tables) -> str:
    """Return tables as the text of a TOML file."""
    return tomli_w.dumps(tables)
