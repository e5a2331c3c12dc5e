"""Allocation of large arrays: in memory up to a limit, and in files beyond it."""

from __future__ import annotations

import errno
import math
import mmap
import os
import shutil
import tempfile
import weakref
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lensdesign.errors import InputError

WRITTEN = 2**20
"""Bytes that are written at a time where a system cannot reserve the space of a file at once."""


class Scratch:
    """Allocates arrays in memory while all of them fit a limit, and otherwise in files.

    The files have no name, so that none is left when a run ends. Their space is reserved at once, since a
    disk that becomes full during a later write would kill the process. Space is freed when an array, with all
    views of it, is no longer used.

    Parameters
    ----------
    folder
        Folder of the files. It must be on a disk; some systems keep /tmp in memory. None: all arrays lie in
        memory.
    memory_bytes
        Limit of the memory of all arrays together.

    Raises
    ------
    InputError
        If the limit is not usable, or set without a folder.
    """

    def __init__(self, folder: Path | None = None, memory_bytes: float = math.inf) -> None:
        if not memory_bytes >= 0.0:
            raise InputError(f"memory_bytes = {memory_bytes!r}: must be 0 or more")
        if folder is None and math.isfinite(memory_bytes):
            raise InputError(
                f"memory_bytes = {memory_bytes:g}: requires a folder for arrays beyond this limit"
            )
        self.folder, self.memory_bytes = folder, memory_bytes
        self.bytes_in_memory = 0
        self.bytes_in_files = 0

    def array(self, shape: tuple[int, ...], dtype: DTypeLike, what: str = "an array") -> NDArray[Any]:
        """Return an array of zeros.

        Parameters
        ----------
        shape, dtype
            Shape and data type of the array.
        what
            Name of the array in messages.

        Raises
        ------
        InputError
            If the file cannot be made, or the disk is full.
        """
        dtype = np.dtype(dtype)
        size = math.prod(shape) * dtype.itemsize
        in_file = self.folder is not None and size > 0 and self.bytes_in_memory + size > self.memory_bytes
        flat = self._mapped(size, what) if in_file else np.zeros(size, np.uint8)
        self._count(in_file, size)
        weakref.finalize(flat, self._count, in_file, -size).atexit = False
        return flat.view(dtype).reshape(shape)

    def moved(self, values: NDArray[Any], what: str = "an array") -> NDArray[Any]:
        """Return a copy of an array; the memory of the original is freed where it is no longer used.

        Raises
        ------
        InputError
            As :meth:`array`.
        """
        result = self.array(values.shape, values.dtype, what)
        result[...] = values
        return result

    def held(self, values: NDArray[Any], what: str = "an array") -> NDArray[Any]:
        """Return an array unchanged, or a copy in a file if not all arrays fit into memory."""
        return values if self.folder is None else self.moved(values, what)

    def _count(self, in_file: bool, size: int) -> None:
        if in_file:
            self.bytes_in_files += size
        else:
            self.bytes_in_memory += size

    def _mapped(self, size: int, what: str) -> NDArray[np.uint8]:
        try:
            # Unlinked at once; the mapping keeps it.
            with tempfile.TemporaryFile(dir=self.folder, prefix=".scratch.") as file:
                handle = cast(BinaryIO, file)
                _reserve(handle, size)
                return np.frombuffer(mmap.mmap(handle.fileno(), size), np.uint8)
        except OSError as error:
            if error.errno == errno.ENOSPC:
                raise InputError(
                    f"the disk of {self.folder} is full: {1e-9 * size:.2f} GB are needed for {what}, "
                    f"{self._free()} are free"
                ) from error
            raise InputError(
                f"cannot make a file in {self.folder} for {what}: {error.strerror or error}"
            ) from error

    def _free(self) -> str:
        assert self.folder is not None
        return f"{1e-6 * shutil.disk_usage(self.folder).free:.0f} MB"


def scratch_in(folder: Path | None, memory_bytes: float) -> Scratch:
    """Return an allocator with a memory limit and a folder for its files. Default: a temporary folder.

    Raises
    ------
    InputError
        If the folder cannot be created.
    """
    if math.isinf(memory_bytes):
        return Scratch()
    folder = folder or Path(tempfile.gettempdir())
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror or error}") from error
    return Scratch(folder, memory_bytes)


def _reserve(file: BinaryIO, size: int) -> None:
    """Fill a file with zeros, so that its space is reserved on the disk."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size)
        return
    zeros = bytes(WRITTEN)
    for start in range(0, size, WRITTEN):
        file.write(zeros[: size - start])
    file.flush()
