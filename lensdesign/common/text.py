"""Texts and numbers in a form that is safe for terminals, figures, spreadsheets and JSON."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TypeVar

T = TypeVar("T")

UNIT_SYMBOLS = {"um": "µm", "deg": "°", "percent": "%", "c": "°C", "mm3": "mm³"}
"""Units as people write them, by their spelling in names and files."""

ASCII_SPELLINGS = {
    "µ": "u",
    "°": " deg",
    "≤": "<=",
    "≥": ">=",
    "²": "2",
    "³": "3",
    "±": "+-",
    "×": "x",
    "·": "*",
    "−": "-",
    "–": "-",
    "…": "...",
    "λ": "lambda",
    "é": "e",
}
"""Spellings of characters that an output device may not have."""

OTHER_UNITS = ("mm", "nm", "waves", "fringes")
"""Further units with which names end; people write them in the same way."""


def safe_cell(text: str) -> str:
    """Return a text, preceded by an apostrophe if a spreadsheet would interpret it as a formula.

    See OWASP, "CSV Injection". It is not needed for numbers.
    """
    # First characters of a text that a spreadsheet interprets as a formula.
    formula_starts = ("=", "+", "-", "@", "\t", "\r", "\n")
    return f"'{text}" if text.startswith(formula_starts) else text


def visible(text: str) -> str:
    """Return at most 2000 characters of a text, with control characters as escapes.

    Otherwise an escape character in a title could control the terminal or make an SVG file invalid.
    """
    most_characters = 2000
    kept = text if len(text) <= most_characters else text[: most_characters - 3] + "..."
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in kept)


def printable_name(name: str) -> str:
    """Return the name of a file as it can be stored and printed: bytes that are not UTF-8 become escapes."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def alternatives(words: Iterable[str]) -> str:
    """Return words as alternatives: "a, b or c"."""
    *first, last = words
    return f"{', '.join(first)} or {last}" if first else last


def duration_text(seconds: float) -> str:
    """Return a time as text in seconds, minutes or hours."""
    if seconds < 120.0:
        return f"{seconds:.1f} s"
    return f"{seconds / 60.0:.1f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def decimals_text(value: float, places: int = 3) -> str:
    """Return a number with a number of decimals, without a minus sign before zero."""
    return f"{round(value, places) + 0.0:.{places}f}"


def known_text(cell: str) -> str:
    """Return the text of a table cell, with "not known" in place of NaN."""
    return "not known" if cell.split(" ")[0] in ("nan", "+nan", "-nan") else cell


def finite_or_none(value: T) -> T | None:
    """Return None for a float that is not finite, which JSON cannot represent; else the value itself."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def round_number_below(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that does not exceed a value."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(s * power for s in (1.0, 2.0, 5.0) if s * power <= value * (1.0 + 1e-9))


def quantity_text(value: float, unit: str = "", digits: int = 4) -> str:
    """Return a number with a number of decimals, or as a power of ten from 100000 on, and its unit."""
    return number_with_unit(f"{value:.4e}" if abs(value) >= 1e5 else f"{value:.{digits}f}", unit)


def number_with_unit(number: str, unit: str) -> str:
    """Return a number with its unit as people write them, such as 4.8° or 3.2 µm.

    Parameters
    ----------
    number
        The number as a text.
    unit
        Unit as names of parameters and files have it, such as ``um`` and ``deg``; "" for none.
    """
    symbol = unit_symbol(unit)
    return f"{number}{'' if symbol == '°' else ' '}{symbol}".rstrip()


def unit_symbol(unit: str) -> str:
    """Return a unit as people write it, such as µm for the ``um`` of names and files."""
    return UNIT_SYMBOLS.get(unit, unit)


def relation_symbol(relation: str) -> str:
    """Return a relation, such as ``<=``, as people write it: ≤."""
    return {"<=": "≤", ">=": "≥"}.get(relation, relation)


def words_and_unit(name: str) -> tuple[str, str]:
    """Split the name of a quantity, such as ``tilt_x_deg``, into words and unit: "tilt x" and "deg".

    The unit is "" if the name does not end in one. A width within the name, such as ``0p775um``, becomes a
    number with its unit.
    """
    head, _, tail = name.rpartition("_")
    has_unit = bool(head) and tail in (*UNIT_SYMBOLS, *OTHER_UNITS)
    words = re.sub(r"(?<![A-Za-z0-9])(\d+(?:p\d+)?)um(?![A-Za-z0-9])", _width, head if has_unit else name)
    return words.replace("_", " "), tail if has_unit else ""


def _width(match: re.Match[str]) -> str:
    return f"{match[1].replace('p', '.')} µm"


def quantity_label(name: str) -> str:
    """Return the name of a quantity for people, with its unit in brackets: ``tilt_x_deg`` is "tilt x (°)"."""
    return name_with_unit(*words_and_unit(name))


def quantity_sentence(name: str, number: str) -> str:
    """Return a quantity with its value, such as "tilt x 0.1°" for ``tilt_x_deg``."""
    words, unit = words_and_unit(name)
    return f"{words} {number_with_unit(number, unit)}"


def name_with_unit(name: str, unit: str) -> str:
    """Return the name of a quantity with its unit, for axes and columns of tables."""
    return f"{name} ({unit_symbol(unit)})" if unit else name


def counted_reasons(reasons: Mapping[str, int]) -> dict[str, int]:
    """Return how often each reason occurs, the most frequent first.

    Reasons that differ only in their numbers count as one, which is the most frequent of them.

    Parameters
    ----------
    reasons
        Sentences, and how often each of them occurs.
    """
    kinds: dict[str, Counter[str]] = {}
    for reason, count in reasons.items():
        kinds.setdefault(re.sub(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", "#", reason), Counter())[reason] += count
    totals = {kind.most_common(1)[0][0]: kind.total() for kind in kinds.values()}
    return dict(sorted(totals.items(), key=lambda one: -one[1]))
