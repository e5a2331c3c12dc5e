"""Files of super-tiles' fields, which save memory and allow an interrupted run to be resumed."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator, MutableMapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError

KEY_FILE = "key.txt"


class TileStore(MutableMapping[int, NDArray]):
    """Arrays by index, each in a file of a folder; reading one maps its file into memory.

    Parameters
    ----------
    folder : Path
        Folder of the files; created if it does not exist.
    key : str
        Digest of the operator that the arrays belong to. Arrays under another key are removed.

    Raises
    ------
    InputError
        If the folder or a file cannot be written; earlier arrays stay.
    """

    def __init__(self, folder: Path, key: str) -> None:
        self.folder = folder
        try:
            if folder.exists() and _key_in(folder) != key:
                shutil.rmtree(folder)
            folder.mkdir(parents=True, exist_ok=True)
            (folder / KEY_FILE).write_text(key, encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot write to the folder {folder}: {error.strerror or error}") from error

    def __getitem__(self, number: int) -> NDArray:
        try:
            return np.asarray(np.load(self._path(number), mmap_mode="r", allow_pickle=False))
        except (OSError, ValueError, EOFError):
            raise KeyError(number) from None

    def __setitem__(self, number: int, values: NDArray) -> None:
        path = self._path(number)
        temporary = path.with_suffix(".new")
        try:
            with temporary.open("wb") as file:
                np.save(file, values, allow_pickle=False)
            os.replace(temporary, path)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            why = "the disk is full" if full else error.strerror or str(error)
            raise InputError(
                f"cannot store a part of the field ({values.nbytes / 1e6:.3g} MB) in {self.folder}: {why}. "
                f"Parts stored so far: {len(self)}. Free some disk space and run the same command again to "
                "continue"
            ) from error

    def __delitem__(self, number: int) -> None:
        try:
            self._path(number).unlink()
        except FileNotFoundError:
            raise KeyError(number) from None

    def __iter__(self) -> Iterator[int]:
        return iter(sorted(int(path.stem) for path in self.folder.glob("*.npy") if path.stem.isdigit()))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def check_free_space(self, needed_bytes: int) -> None:
        """Check, before any work, that the disk has space for all arrays that are not stored yet.

        Raises
        ------
        InputError
            If the disk is too full; the message states the needed and the free space.
        """
        kept = sum(path.stat().st_size for path in self.folder.glob("*.npy"))
        free = shutil.disk_usage(self.folder).free
        # Disk space that stays free.
        spare_bytes = 100_000_000
        if needed_bytes - kept + spare_bytes > free:
            raise InputError(
                f"the disk of {self.folder} has {free / 1e9:.3g} GB free: parts of the field need "
                f"{(needed_bytes - kept + spare_bytes) / 1e9:.3g} GB"
            )

    def drop(self) -> None:
        """Remove all stored arrays."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _path(self, number: int) -> Path:
        return self.folder / f"{number:05d}.npy"


def _key_in(folder: Path) -> str | None:
    try:
        return (folder / KEY_FILE).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
