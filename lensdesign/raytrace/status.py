"""What became of a ray."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """Outcome of a ray; anything but OK comes with the surface at which it ended."""

    OK = 0
    MISSED = 1
    CLIPPED = 2
    TOTAL_REFLECTION = 3
    NOT_CONVERGED = 4
