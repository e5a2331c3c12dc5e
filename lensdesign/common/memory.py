"""How much memory this machine has left, and the check of predicted arrays against it."""

from __future__ import annotations

import os
from pathlib import Path

from lensdesign.errors import InputError

USABLE_FRACTION = 0.8
"""Fraction of the free memory that arrays may take; the rest is for the system and other programs."""

CGROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)
"""Where containers state their memory limit, and how much of it is in use."""


class MemoryLimitError(InputError):
    """What is asked for cannot be done within the memory allowed."""


def available_bytes() -> float:
    """Memory that this machine, or the container that this runs in, has left."""
    left = [_machine_bytes()]
    for limit, used in CGROUPS:
        try:
            left.append(int(Path(limit).read_text()) - int(Path(used).read_text()))
        except (OSError, ValueError):
            continue
    return max(float(min(left)), 0.0)


def _machine_bytes() -> int:
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        entries = dict(line.split(":", 1) for line in lines)
        return 1024 * int(entries["MemAvailable"].split()[0])
    except (OSError, ValueError, KeyError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def check_memory(needed_bytes: float, what: str, advice: str, limit_bytes: float | None = None) -> None:
    """Refuse arrays that memory does not hold, before any of them is allocated.

    Parameters
    ----------
    needed_bytes
        Predicted size of all arrays that exist at the same time.
    what
        What needs them, with the value that decides their size, as in ``"object_pitch_um = 0.001: an object
        of 80000 x 80000 samples"``.
    advice
        What to change, as in ``"give a larger object_pitch_um or a smaller patch_mm"``.
    limit_bytes
        Allowed size. By default a fraction of the memory that is free.

    Raises
    ------
    MemoryLimitError
        If the arrays take more than is allowed. The message states both sizes.
    """
    allowed = USABLE_FRACTION * available_bytes() if limit_bytes is None else limit_bytes
    if not needed_bytes <= allowed:
        raise MemoryLimitError(
            f"{what} needs {_size(needed_bytes)} of memory, and {_size(allowed)} are allowed: {advice}"
        )


def _size(count: float) -> str:
    return f"{1e-9 * count:.3g} GB"
