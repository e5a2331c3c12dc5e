"""Compiled kernels are kept from process to process: only while what they were compiled from is the same.

Numba keeps a kernel by the date of the module in which it stands, and does not see that a function which the
kernel takes from another module has changed. One with an old formula would give wrong numbers in silence.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

from lensdesign.errors import InputError, atomic_path


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
