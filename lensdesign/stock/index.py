"""Index of a folder of vendors' lens files, which are interpreted only when their contents have changed.

The index is a text file with one JSON object a line. The first line identifies it and what affects the
reading: the version of the toolkit and the contents of the glass catalogues. Each further line holds one
file: the SHA-256 of its contents, its lens or the reason why it has none, and a code of the whole line. Lines
are appended while files are read, so an interrupted run loses only the files that its workers were reading.

The code (HMAC, RFC 2104) uses a key in the user's cache folder. A line that someone else has written, or that
has changed, is ignored, so that the vendor's file is read again.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.caches import has_user_code, user_cache_folder, user_code, user_key
from lensdesign.common.clusters import toolkit_version
from lensdesign.common.input_files import CATALOG_BYTES, LENS_FILE_BYTES, TABLE_BYTES, read_input
from lensdesign.common.processes import Processes, follow_parent
from lensdesign.errors import InputError, TransferLensError
from lensdesign.files.draft import LossyImportError
from lensdesign.files.formats import LENS_FORMATS
from lensdesign.stock.vendor_files import find_vendor_files, read_stock_lens, surface_tables

_FORMAT = "transferlens stock index 2"

_BATCH = 40
"""Files that a worker reads before its results are appended to the index; they take a second or less."""

Progress = Callable[[int, int, str], None]
"""Progress callback: ``progress(completed, total, description)``."""


@dataclass(frozen=True)
class IndexedFile:
    """A vendor's file in the index.

    Attributes
    ----------
    name
        Path relative to the folder, with forward slashes.
    sha256
        SHA-256 of its contents in hexadecimal digits; empty if it cannot be read.
    reason
        Why the file contains no usable lens; empty if it does.
    title
        Title of the lens.
    surfaces
        Tables of its surfaces as in a design file.
    """

    name: str
    sha256: str
    reason: str = ""
    title: str = ""
    surfaces: tuple[dict[str, Any], ...] = ()


@dataclass(frozen=True)
class StockIndex:
    """Contents of a folder of vendors' lens files.

    Attributes
    ----------
    folder
        The folder.
    path
        The file that stores the index.
    glass_catalogs
        Glass catalogues with which the files were read.
    files
        All files, ordered by name.
    read_count
        Number of files that were read now; the others had not changed.

    Examples
    --------
    >>> from lensdesign import index_stock, load_design, write_zmx
    >>> write_zmx(load_design("designs/paper_singlet.toml"), "papers/paper.zmx")
    >>> [file.title for file in index_stock("papers").lenses]
    ['Spatial information transfer lens, Table 1']
    """

    folder: Path
    path: Path
    glass_catalogs: tuple[Path, ...]
    files: tuple[IndexedFile, ...]
    read_count: int

    @property
    def lenses(self) -> tuple[IndexedFile, ...]:
        """Files with a lens."""
        return tuple(file for file in self.files if not file.reason)

    @property
    def refused(self) -> tuple[IndexedFile, ...]:
        """Files without a usable lens."""
        return tuple(file for file in self.files if file.reason)


def index_stock(
    folder: str | os.PathLike[str],
    index: str | os.PathLike[str] | None = None,
    glass_catalogs: Sequence[str | os.PathLike[str]] = (),
    workers: int | None = 1,
    progress: Progress = lambda *_: None,
) -> StockIndex:
    """Read all lens files below a folder that are new or have changed, and return the index of all.

    A file that is damaged, or that is not understood, is listed with the reason and never ends the run.

    Parameters
    ----------
    folder
        Folder with lens files of vendors (:data:`lensdesign.files.formats.LENS_FORMATS`), searched with all
        folders below it.
    index
        File that stores the index (default: a file in the user's cache folder).
    glass_catalogs
        Glass catalogues (AGF) that are searched first. With other catalogues, all files are read again.
    workers
        Number of processes; None means one for each processor. Processes import the main module when they
        start, so a script with several needs ``if __name__ == "__main__":``.
    progress
        Progress callback: ``progress(completed, total, description)``.

    Raises
    ------
    InputError
        If the folder does not exist or contains no lens file, or the index cannot be read or written.
    KeyboardInterrupt
        After an interrupt; its message says how many files the index holds. The next call continues.

    Examples
    --------
    >>> from lensdesign import index_stock, load_design, write_zmx
    >>> write_zmx(load_design("designs/feasible_singlet.toml"), "vendor/singlet.zmx")
    >>> found = index_stock("vendor")
    >>> len(found.lenses), len(found.refused), found.read_count
    (1, 0, 1)
    >>> index_stock("vendor").read_count
    0
    """
    folder = Path(folder)
    path = _default_path(folder) if index is None else Path(index)
    catalogs = tuple(Path(catalog).resolve() for catalog in glass_catalogs)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder with the lens files of vendors")
    found, faults = find_vendor_files(folder)
    if not found:
        suffixes = " or ".join(LENS_FORMATS)
        raise InputError(f"{folder}: contains no {suffixes} file, nor do the folders below it")
    header = {"index": _FORMAT, "version": toolkit_version(), "catalogs": [*map(_fingerprint, catalogs)]}
    key = user_key()
    known = _known_files(path, header, key)
    now = {file.relative_to(folder).as_posix(): _digest(file) for file in found}
    kept = {n: known[n] for n, sha256 in now.items() if sha256 and n in known and known[n].sha256 == sha256}
    missing = [name for name in now if name not in kept]
    if missing or len(kept) != len(known):
        _write_index(path, header, kept, key)
    read = dict(kept)
    try:
        for batch in _read_all(folder, missing, now, catalogs, workers):
            _append(path, batch, key)
            read |= {one.name: one for one in batch}
            progress(len(read) - len(kept), len(missing), "reading lens files")
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted; {path} holds {len(read)} of {len(now)} files; repeat the command to continue"
        ) from None
    files = [*read.values(), *(IndexedFile(name, "", reason) for name, reason in faults)]
    return StockIndex(folder, path, catalogs, tuple(sorted(files, key=lambda f: f.name)), len(missing))


def _fingerprint(catalog: Path) -> list[Any]:
    """Return what identifies the contents of a catalogue."""
    content = read_input(catalog, CATALOG_BYTES, named="glass catalogue")
    return [str(catalog), hashlib.sha256(content).hexdigest()]


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file; empty for one that cannot be read, whose reading states the reason."""
    try:
        return hashlib.sha256(read_input(path, LENS_FILE_BYTES)).hexdigest()
    except InputError:
        return ""


def _default_path(folder: Path) -> Path:
    """Return the file in the user's cache folder that stores the index of a folder."""
    name = hashlib.sha256(os.fsencode(os.path.realpath(folder))).hexdigest()[:32]
    return user_cache_folder() / "stock" / f"{name}.jsonl"


def _known_files(path: Path, header: dict[str, Any], key: bytes) -> dict[str, IndexedFile]:
    """Return the files in the index by name; none if there is no index, or one with another header."""
    if not path.exists():
        return {}
    first, *lines = read_input(path, TABLE_BYTES).decode("utf-8", "replace").splitlines() or [""]
    own = _json_object(first)
    if str(own.get("index", "")).rpartition(" ")[0] != _FORMAT.rpartition(" ")[0]:
        raise InputError(f"{path}: is no index of stock lenses; give another file as --index")
    if own != header:
        return {}
    files = [_indexed_file(line, key) for line in lines]
    return {file.name: file for file in files if file is not None}


def _json_object(line: str) -> dict[str, Any]:
    try:
        row = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return row if isinstance(row, dict) else {}


def _indexed_file(line: str, key: bytes) -> IndexedFile | None:
    """Return the file of a line; None if the user did not write it so, and the file is to be read again."""
    row = _json_object(line)
    code = row.pop("code", None)
    if not has_user_code(_content(row), code, key):
        return None
    return IndexedFile(**row | {"surfaces": tuple(row["surfaces"])})


def _content(row: dict[str, Any]) -> bytes:
    """Return what the code of a line covers."""
    return json.dumps(row, sort_keys=True).encode()


def _file_line(file: IndexedFile, key: bytes) -> str:
    row = asdict(file)
    return _line(row | {"code": user_code(_content(row), key)})


def _line(content: object) -> str:
    return json.dumps(content, ensure_ascii=True) + "\n"


def _write_index(path: Path, header: dict[str, Any], files: dict[str, IndexedFile], key: bytes) -> None:
    """Replace the index by one with the unchanged files alone."""
    try:
        with atomic_path(path) as temporary:
            lines = [_line(header), *(_file_line(one, key) for one in files.values())]
            temporary.write_text("".join(lines), encoding="utf-8")
    except InputError as error:
        raise InputError(f"{error}; give a file in another folder as --index") from error


def _append(path: Path, files: Sequence[IndexedFile], key: bytes) -> None:
    try:
        with path.open("a", encoding="utf-8") as stream:
            stream.write("".join(_file_line(one, key) for one in files))
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


def _read_all(
    folder: Path,
    names: Sequence[str],
    digests: dict[str, str],
    catalogs: tuple[Path, ...],
    workers: int | None,
) -> Iterator[list[IndexedFile]]:
    """Yield the files in batches, in the order in which they are read."""
    batches = [
        [(name, digests[name]) for name in names[i : i + _BATCH]] for i in range(0, len(names), _BATCH)
    ]
    processes = min(len(os.sched_getaffinity(0)) if workers is None else workers, len(batches))
    if processes <= 1:
        for batch in batches:
            yield _read_batch(folder, batch, catalogs)
        return
    with Processes(processes, follow_parent) as pool:
        in_flight: dict[Future[list[IndexedFile]], list[tuple[str, str]]] = {}
        waiting = iter(batches)
        try:
            while True:
                for batch in waiting:
                    in_flight[pool.submit(_read_batch, folder, batch, catalogs)] = batch
                    if len(in_flight) >= 2 * processes:
                        break
                if not in_flight:
                    return
                for done in wait(in_flight, return_when=FIRST_COMPLETED).done:
                    del in_flight[done]
                    yield done.result()
        except BrokenProcessPool as error:
            raise TransferLensError(
                f"{pool.end()} ended a process that read lens files; repeat the command to continue, with "
                "--workers 1 if it happens again"
            ) from error


def _read_batch(
    folder: Path, batch: Sequence[tuple[str, str]], catalogs: tuple[Path, ...]
) -> list[IndexedFile]:
    return [_read_file(folder, *one, catalogs) for one in batch]


def _read_file(folder: Path, name: str, sha256: str, catalogs: tuple[Path, ...]) -> IndexedFile:
    """Return a file with its lens, or with the reason why it has none."""
    path = folder / name
    try:
        title, surfaces = read_stock_lens(path, catalogs)
    except LossyImportError as error:
        reason = f"a design cannot represent: {'; '.join(error.dropped)}"
        return IndexedFile(name, sha256, reason)
    except (TransferLensError, OSError) as error:
        reason = str(error).replace(f"cannot read {path}: ", "cannot be read: ")
        reason = reason.replace(f"{path}: ", "").replace(f"{path}, ", "")
        return IndexedFile(name, sha256, " ".join(reason.split()))
    except Exception as error:  # one file among thousands must not end the run, whatever is wrong with it
        reason = f"the reader failed: {type(error).__name__}: {error}"
        return IndexedFile(name, sha256, " ".join(reason.split()))
    return IndexedFile(name, sha256, "", title, tuple(surface_tables(surfaces)))
