"""Free memory of this machine, and the check of predicted array sizes against it."""

from __future__ import annotations

import os
from pathlib import Path

from lensdesign.errors import InputError

USABLE_FRACTION = 0.8
"""Fraction of the free memory that arrays may use; the rest is for the system and other programs."""

CGROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)
"""Files in which containers state their memory limit and the memory in use."""


class MemoryLimitError(InputError):
    """The requested arrays do not fit into the allowed memory."""


def available_bytes() -> float:
    """Return the free memory of this machine or container in bytes."""
    free = [_machine_bytes()]
    for limit, used in CGROUPS:
        try:
            free.append(int(Path(limit).read_text()) - int(Path(used).read_text()))
        except (OSError, ValueError):
            continue
    return max(float(min(free)), 0.0)


def _machine_bytes() -> int:
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        entries = dict(line.split(":", 1) for line in lines)
        return 1024 * int(entries["MemAvailable"].split()[0])
    except (OSError, ValueError, KeyError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def check_memory(needed_bytes: float, what: str, advice: str, limit_bytes: float | None = None) -> None:
    """Check that arrays fit into memory, before any of them is allocated.

    Parameters
    ----------
    needed_bytes
        Predicted size of all arrays that exist at the same time.
    what
        Purpose of the arrays, with the value that determines their size, such as ``"object_pitch_um = 0.001:
        an object of 80000 x 80000 samples"``.
    advice
        Advice to the user, such as ``"give a larger object_pitch_um or a smaller patch_mm"``.
    limit_bytes
        Allowed size (default: a fraction of the free memory).

    Raises
    ------
    MemoryLimitError
        If the arrays are larger than allowed. The message states both sizes.
    """
    allowed = USABLE_FRACTION * available_bytes() if limit_bytes is None else limit_bytes
    if not needed_bytes <= allowed:
        raise MemoryLimitError(
            f"{what} needs {_size(needed_bytes)} of memory, and {_size(allowed)} are allowed: {advice}"
        )


def _size(count: float) -> str:
    return f"{1e-9 * count:.3g} GB"
