"""Cache of compiled kernels between processes, valid only while their sources stay the same.

Numba checks only the date of the module that contains a kernel. It does not notice that a function which the
kernel uses from another module has changed, so that an outdated kernel would silently give wrong numbers.

If neither the folders of the modules nor the home folder can be written, as for a service, the kernels are
cached in a temporary folder that only this user can write.
"""

from __future__ import annotations

import os
import stat
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from multiprocessing import parent_process
from pathlib import Path
from typing import Any
from uuid import uuid4

import numba

from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError


class KernelCacheWarning(UserWarning):
    """Warn that compiled kernels are cached in an unusual folder, or not at all."""


def cached_njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return Numba's `njit` with a cache between processes where one can be written.

    Parameters
    ----------
    **options
        Options of `numba.njit`.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        try:
            return _with_own_files(numba.njit(cache=True, **options)(function))
        except RuntimeError:  # none of Numba's cache folders can be written
            folder = _private_folder()
        if folder is None:
            return numba.njit(**options)(function)
        numba.config.CACHE_DIR = folder
        return _with_own_files(numba.njit(cache=True, **options)(function))

    return compiled


def _with_own_files(kernel: Any) -> Any:
    """Return a kernel that stores what it compiles in files with names that are not used twice.

    Numba counts the files of a function, so that two processes that compile it at the same time for
    different arguments may choose the same name. The index of one would then point to the code of the other.
    """
    cache_file = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if cache_file is not None:  # None if compilation is disabled
        base = cache_file._index_name.removesuffix(".nbi")
        cache_file._data_name = lambda number: f"{base}.{uuid4().hex}.nbc"
    return kernel


@cache
def _private_folder() -> str | None:
    """Return a temporary folder that only this user can write, or None; child processes use it too."""
    folder = (
        Path(tempfile.gettempdir()) / f"transferlens-kernels-{os.getuid() if hasattr(os, 'getuid') else 0}"
    )
    with suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
    private = _is_private(folder)
    outcome = f"are cached in {folder}" if private else "are not cached: every process compiles its own"
    if parent_process() is None:
        warnings.warn(
            f"compiled kernels {outcome}; the usual folders cannot be written; set NUMBA_CACHE_DIR to a "
            "folder that can",
            KernelCacheWarning,
            stacklevel=4,
        )
    if not private:
        return None
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    return str(folder)


def _is_private(folder: Path) -> bool:
    """Return whether only this user can write a folder; other users could place code in it."""
    try:
        found = folder.lstat()
    except OSError:
        return False
    own = not hasattr(os, "getuid") or (found.st_uid == os.getuid() and not found.st_mode & 0o022)
    return stat.S_ISDIR(found.st_mode) and own and os.access(folder, os.W_OK | os.X_OK)


def drop_outdated(kernel: Any, modules: Iterable[str]) -> None:
    """Remove the cached kernels of a module if they were compiled from other sources.

    Parameters
    ----------
    kernel
        One of the compiled functions of the module.
    modules
        Names of the imported modules whose functions the kernels use, including their own.
    """
    stats = getattr(kernel, "stats", None)
    if stats is None or not stats.cache_path:  # compilation or caching is disabled
        return
    files = sorted({str(sys.modules[name].__file__) for name in modules})
    digest = sha256(b"\0".join(Path(file).read_bytes() for file in files)).hexdigest()
    folder, module = Path(stats.cache_path), kernel.__module__.rpartition(".")[2]
    record = folder / f"{module}.sources"
    if record.is_file() and record.read_text(encoding="utf-8") == digest:
        return
    # A folder that cannot be written contains no cached kernels either.
    with suppress(OSError, InputError):
        folder.mkdir(parents=True, exist_ok=True)
        for file in (*folder.glob(f"{module}.*.nbi"), *folder.glob(f"{module}.*.nbc")):
            file.unlink(missing_ok=True)
        with atomic_path(record) as path:
            path.write_text(digest, encoding="utf-8")
