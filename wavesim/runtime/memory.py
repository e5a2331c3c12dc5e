"""How much memory a run may take, and what it will take: told before it runs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from lensdesign.common.memory import USABLE_FRACTION, MemoryLimitError, available_bytes
from lensdesign.errors import validate_positive

COMPLEX64, COMPLEX128, FLOAT32, FLOAT64 = 8, 16, 4, 8
"""Bytes of a sample."""

BASE_BYTES = 400_000_000
"""Of the process itself, its libraries and compiled loops."""


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
        return USABLE_FRACTION * available_bytes()
    validate_positive("--memory-gb", memory_gb)
    return 1e9 * memory_gb


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
