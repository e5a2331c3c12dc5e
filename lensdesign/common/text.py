"""Texts from files and numbers, as terminals, figures, spreadsheets and JSON may have them."""

from __future__ import annotations

import math
from typing import TypeVar

T = TypeVar("T")

LONGEST_TEXT = 2000

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n")
"""What makes a spreadsheet take a text for a formula."""


def safe_cell(text: str) -> str:
    """A text with an apostrophe before it if a spreadsheet would take it for a formula.

    After OWASP, "CSV Injection". Numbers are no texts, and need none.
    """
    return f"'{text}" if text.startswith(FORMULA_STARTS) else text


def visible(text: str) -> str:
    """A text with its control characters as escapes, and of at most 2000 characters.

    An escape character in a title would else command the terminal, and spoil an SVG file.
    """
    kept = text if len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 3] + "..."
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in kept)


def duration_text(seconds: float) -> str:
    """A time in seconds, minutes or hours."""
    if seconds < 120.0:
        return f"{seconds:.1f} s"
    return f"{seconds / 60.0:.1f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def decimals_text(value: float, places: int = 3) -> str:
    """A number of so many decimals, without a minus sign before a zero."""
    return f"{round(value, places) + 0.0:.{places}f}"


def known_text(cell: str) -> str:
    """The text of a cell of a table, where a number that is none reads "not known"."""
    return "not known" if cell.split(" ")[0] in ("nan", "+nan", "-nan") else cell


def finite_or_none(value: T) -> T | None:
    """JSON knows no infinity, and nothing that is not a number; whatever is no float stays as it is."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
