"""Status codes of traced rays."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """Status of a traced ray; for all but OK, the trace also gives the surface at which the ray failed."""

    OK = 0
    MISSED = 1
    CLIPPED = 2
    TOTAL_REFLECTION = 3
    NOT_CONVERGED = 4
