"""Status codes of traced rays."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """Status of a traced ray; for all but OK, the trace also gives the surface at which the ray failed.

    Attributes
    ----------
    OK
        The ray arrived.
    MISSED
        The ray does not intersect the surface.
    CLIPPED
        The ray meets the surface outside its clear aperture.
    TOTAL_REFLECTION
        The ray is totally reflected at the surface.
    NOT_CONVERGED
        The search for the intersection did not converge.
    """

    OK = 0
    MISSED = 1
    CLIPPED = 2
    TOTAL_REFLECTION = 3
    NOT_CONVERGED = 4
