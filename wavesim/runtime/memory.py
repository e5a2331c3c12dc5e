"""How much memory a run may take, and what it will take: told before it runs."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

from lensdesign.errors import InputError, refuse_not_positive

COMPLEX64, COMPLEX128, FLOAT32, FLOAT64 = 8, 16, 4, 8
"""Bytes of a sample."""

BASE_BYTES = 400_000_000
"""Of the process itself, its libraries and compiled loops."""

SHARE = 0.8
"""Of the memory that is free, which a run takes where it was given no limit."""

CGROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)
"""Where containers say how much they may take, and how much they have taken."""


class MemoryLimitError(InputError):
    """What is asked for cannot be done within the memory allowed."""


@dataclass(frozen=True)
class Need:
    """What a run, or a part of one, will take.

    Needs add up where arrays are held at the same time; of steps that follow each other, `a | b` is what
    either takes at the most.

    Attributes
    ----------
    most_bytes : int
        With all arrays in memory.
    least_bytes : int
        With all that can be moved in files.
    file_bytes : int
        In files in any case.
    """

    most_bytes: int
    least_bytes: int
    file_bytes: int = 0

    def __add__(self, other: Need) -> Need:
        return Need(
            self.most_bytes + other.most_bytes,
            self.least_bytes + other.least_bytes,
            self.file_bytes + other.file_bytes,
        )

    def __or__(self, other: Need) -> Need:
        return Need(
            max(self.most_bytes, other.most_bytes),
            max(self.least_bytes, other.least_bytes),
            max(self.file_bytes, other.file_bytes),
        )


def memory_limit(memory_gb: float | None) -> float:
    """Bytes that a run may take: those given, or a share of what is free.

    Raises
    ------
    InputError
        If the limit is not usable.
    """
    if memory_gb is None:
        return SHARE * available_bytes()
    refuse_not_positive("--memory-gb", memory_gb)
    return 1e9 * memory_gb


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
        told = dict(line.split(":", 1) for line in lines)
        return 1024 * int(told["MemAvailable"].split()[0])
    except (OSError, ValueError, KeyError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


@dataclass(frozen=True)
class Memory:
    """What a run will take, and what it may."""

    need: Need
    limit_bytes: float

    def room_for_arrays(self, what: str) -> float:
        """Bytes of movable arrays that may lie in memory; `what` names the run in messages.

        Raises
        ------
        MemoryLimitError
            If it takes more than it may even with all that can be moved in files.
        """
        least, limit = self.need.least_bytes, self.limit_bytes
        if least > limit:
            raise MemoryLimitError(
                f"{what} needs {1e-9 * least:.3g} GB of memory at least, and may take {1e-9 * limit:.3g} GB: "
                f"take --memory-gb {math.ceil(1e-8 * least) / 10.0:g} or more, a smaller --patch-mm, or "
                "coarser samples (--object-pitch-um)"
            )
        return math.inf if self.need.most_bytes <= limit else limit - least

    def line(self, folder: Path) -> str:
        """Told before the run."""
        told = self.as_dict()
        taken, allowed, files = (1e-9 * told[f"{name}_bytes"] for name in ("predicted", "limit", "file"))
        line = f"memory: about {taken:.2g} GB of {allowed:.3g} GB allowed"
        return line + (f", {files:.2g} GB in files under {folder}" if files >= 0.01 else "")

    def as_dict(self) -> dict[str, float]:
        """Ready for JSON."""
        beyond = max(self.need.most_bytes - self.limit_bytes, 0.0)
        return {
            "limit_bytes": self.limit_bytes,
            "predicted_bytes": min(self.need.most_bytes, self.limit_bytes),
            "file_bytes": self.need.file_bytes + beyond,
        }
