"""Prediction of the memory of a run, and its limit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from lensdesign.common.memory import USABLE_FRACTION, MemoryLimitError, available_bytes
from lensdesign.errors import validate_positive

COMPLEX64, COMPLEX128, FLOAT32, FLOAT64 = 8, 16, 4, 8
"""Bytes of a sample."""

BASE_BYTES = 400_000_000
"""Memory of the process itself, with its libraries and compiled loops."""


@dataclass(frozen=True)
class MemoryNeed:
    """Memory that a run, or a part of one, needs.

    The sum `a + b` is for arrays that exist at the same time; `a | b` is the larger need of successive steps.

    Attributes
    ----------
    most_bytes : int
        Memory with all arrays in memory.
    least_bytes : int
        Memory with all movable arrays in files.
    file_bytes : int
        Size of the files that are needed in any case.
    """

    most_bytes: int
    least_bytes: int
    file_bytes: int = 0

    def __add__(self, other: MemoryNeed) -> MemoryNeed:
        return MemoryNeed(
            self.most_bytes + other.most_bytes,
            self.least_bytes + other.least_bytes,
            self.file_bytes + other.file_bytes,
        )

    def __or__(self, other: MemoryNeed) -> MemoryNeed:
        return MemoryNeed(
            max(self.most_bytes, other.most_bytes),
            max(self.least_bytes, other.least_bytes),
            max(self.file_bytes, other.file_bytes),
        )


def in_memory(count: int) -> MemoryNeed:
    """Return the need for arrays that stay in memory; `count` is their size in bytes."""
    return MemoryNeed(count, count)


def movable(count: int) -> MemoryNeed:
    """Return the need for arrays that can lie in files; `count` is their size in bytes."""
    return MemoryNeed(count, 0)


def memory_limit(memory_gb: float | None) -> float:
    """Return the bytes that a run may use: the given limit, or a fraction of the free memory.

    Raises
    ------
    InputError
        If the limit is not usable.
    """
    if memory_gb is None:
        return USABLE_FRACTION * available_bytes()
    validate_positive("--memory-gb", memory_gb)
    return 1e9 * memory_gb


@dataclass(frozen=True)
class Memory:
    """Memory that a run needs, and its limit."""

    need: MemoryNeed
    limit_bytes: float

    @property
    def is_sufficient(self) -> bool:
        """True if the run fits in its limit, at least with all movable arrays in files."""
        return self.need.least_bytes <= self.limit_bytes

    @property
    def sufficient_gb(self) -> float:
        """Smallest limit in GB, rounded up, in which the run fits."""
        return math.ceil(1e-8 * self.need.least_bytes) / 10.0

    def room_for_arrays(self, what: str) -> float:
        """Return the bytes of movable arrays that may stay in memory; `what` names the run in messages.

        Raises
        ------
        MemoryLimitError
            If the run exceeds its limit even with all movable arrays in files.
        """
        least, limit = self.need.least_bytes, self.limit_bytes
        if not self.is_sufficient:
            raise MemoryLimitError(
                f"{what} needs at least {1e-9 * least:.3g} GB of memory (allowed: {1e-9 * limit:.3g} GB); "
                f"use --memory-gb {self.sufficient_gb:g} or more, a smaller --patch-mm, or "
                "coarser samples (--object-pitch-um)"
            )
        return math.inf if self.need.most_bytes <= limit else limit - least

    def line(self, folder: Path) -> str:
        """Return the line that a command prints before the run."""
        sizes = self.as_dict()
        needed, allowed, files = (1e-9 * sizes[f"{name}_bytes"] for name in ("predicted", "limit", "file"))
        line = f"memory: about {needed:.2g} GB of {allowed:.3g} GB allowed"
        return line + (f", {files:.2g} GB in files under {folder}" if files >= 0.01 else "")

    def as_dict(self) -> dict[str, float]:
        """Return the sizes in bytes, by their names in JSON files."""
        beyond = max(self.need.most_bytes - self.limit_bytes, 0.0)
        return {
            "limit_bytes": self.limit_bytes,
            "predicted_bytes": min(self.need.most_bytes, self.limit_bytes),
            "file_bytes": self.need.file_bytes + beyond,
        }
