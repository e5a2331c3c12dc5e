"""Orientations in which a picture may be stored other than the stated one: mirrored, rotated, transposed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

ORIENTATIONS: dict[str, Callable[[Any], Any]] = {
    "mirrored left to right": lambda a: a[:, ::-1],
    "mirrored top to bottom": lambda a: a[::-1],
    "turned by 180°": lambda a: a[::-1, ::-1],
    "turned by 90°": lambda a: a.T[::-1],
    "turned by -90°": lambda a: a[::-1].T,
    "transposed": lambda a: a.T,
    "transposed and turned by 180°": lambda a: a[::-1, ::-1].T,
}
"""Orientations other than the stated one. The last four keep only the shape of square pictures."""


def square_part(values: Any) -> Any:
    """Return the middle square of a picture."""
    rows, columns = values.shape
    side = min(rows, columns)
    top, left = (rows - side) // 2, (columns - side) // 2
    return values[top : top + side, left : left + side]
