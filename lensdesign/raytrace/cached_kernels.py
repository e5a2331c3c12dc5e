"""Compiled kernels are kept from process to process: only while what they were compiled from is the same.

Numba keeps a kernel by the date of the module in which it stands, and does not see that a function which the
kernel takes from another module has changed. One with an old formula would give wrong numbers in silence.

Where nothing can be written beside the modules or in a home, as for a service, they are kept in a temporary
folder of the user's own.
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

import numba

from lensdesign.errors import InputError, atomic_path


class KernelCacheWarning(UserWarning):
    """Compiled kernels are kept elsewhere than Numba would, or not at all."""


def cached_njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Numba's `njit`, whose kernels are kept from process to process where that can be."""

    def compiled(function: Callable[..., Any]) -> Any:
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError:  # no place that Numba knows can be written
            place = _own_place()
        if place is None:
            return numba.njit(**options)(function)
        numba.config.CACHE_DIR = place
        return numba.njit(cache=True, **options)(function)

    return compiled


@cache
def _own_place() -> str | None:
    """A temporary folder that nobody else can write to, for child processes too; None without one."""
    place = (
        Path(tempfile.gettempdir()) / f"transferlens-kernels-{os.getuid() if hasattr(os, 'getuid') else 0}"
    )
    with suppress(OSError):
        place.mkdir(mode=0o700, exist_ok=True)
    private = _is_private(place)
    told = f"are kept in {place}" if private else "are not kept: every process compiles its own"
    if parent_process() is None:
        warnings.warn(
            f"compiled kernels {told}; no other place can be written, unless NUMBA_CACHE_DIR names one",
            KernelCacheWarning,
            stacklevel=4,
        )
    if not private:
        return None
    os.environ["NUMBA_CACHE_DIR"] = str(place)
    return str(place)


def _is_private(place: Path) -> bool:
    """Whether only this user can write there: whoever else can has his code run here."""
    try:
        found = place.lstat()
    except OSError:
        return False
    own = not hasattr(os, "getuid") or (found.st_uid == os.getuid() and not found.st_mode & 0o022)
    return stat.S_ISDIR(found.st_mode) and own and os.access(place, os.W_OK | os.X_OK)


def drop_outdated(kernel: Any, modules: Iterable[str]) -> None:
    """Remove a module's kept kernels if they were not compiled from these sources.

    Parameters
    ----------
    kernel
        One of the module's compiled functions.
    modules
        Names of imported modules whose functions its kernels take, its own among them.
    """
    stats = getattr(kernel, "stats", None)
    if stats is None or not stats.cache_path:  # Numba is told not to compile, or to keep nothing
        return
    files = sorted({str(sys.modules[name].__file__) for name in modules})
    digest = sha256(b"\0".join(Path(file).read_bytes() for file in files)).hexdigest()
    folder, module = Path(stats.cache_path), kernel.__module__.rpartition(".")[2]
    told = folder / f"{module}.sources"
    if told.is_file() and told.read_text(encoding="utf-8") == digest:
        return
    # Into a folder that cannot be written Numba has put nothing either.
    with suppress(OSError, InputError):
        folder.mkdir(parents=True, exist_ok=True)
        for index in folder.glob(f"{module}.*.nbi"):
            index.unlink(missing_ok=True)
        with atomic_path(told) as path:
            path.write_text(digest, encoding="utf-8")
