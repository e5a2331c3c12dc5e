"""What a drawing is made of: strokes and texts on sheets, in mm from the lower left corner, y upward."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

FONT = "DejaVuSans"
"""Has the signs that drawings need; matplotlib brings it along."""

SHEET_MM = (297.0, 210.0)
"""A4 across."""

ASCENT, DESCENT = 0.78, 0.24
"""Of the tallest and lowest letters, in sizes of type."""

THICK_MM, THIN_MM = 0.5, 0.25
"""Visible edges and frames; all other lines (ISO 128)."""

LEAST_MM = 1.6
"""Size of type below which a text is cut rather than set smaller."""

MOST_LETTERS = 500
"""Of a text that is cut; more fill no line of a sheet."""

CHAIN: tuple[float, ...] = (8.0, 1.2, 1.2, 1.2)
"""Long dash, dot: centre lines."""

_UNPRINTABLE = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff]")

Anchor = Literal["start", "middle", "end"]
Point = tuple[float, float]


class Area(NamedTuple):
    """A rectangle."""

    left: float
    bottom: float
    right: float
    top: float

    @property
    def width(self) -> float:
        """From left to right."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """From bottom to top."""
        return self.top - self.bottom

    def overlaps(self, other: Area) -> bool:
        """Whether two rectangles have an area in common."""
        return (
            self.left < other.right
            and other.left < self.right
            and self.bottom < other.top
            and other.bottom < self.top
        )


@dataclass(frozen=True)
class Stroke:
    """A polygon, open or closed, or filled."""

    points: tuple[Point, ...]
    width_mm: float = THIN_MM
    dashes_mm: tuple[float, ...] = ()
    closed: bool = False
    filled: bool = False


@dataclass(frozen=True)
class Text:
    """One line of text.

    Attributes
    ----------
    x_mm, y_mm
        Of its anchor on the base line.
    text
        What it says; shown as it stands.
    size_mm
        Of the type, from line to line.
    anchor
        Which end of the text stands at x, y.
    upward
        Whether it reads from bottom to top.
    """

    x_mm: float
    y_mm: float
    text: str
    size_mm: float = 3.0
    anchor: Anchor = "start"
    upward: bool = False

    @property
    def width_mm(self) -> float:
        """Length along the base line."""
        return text_width_mm(self.text, self.size_mm)

    @property
    def box(self) -> Area:
        """Where its letters may stand."""
        before = {"start": 0.0, "middle": 0.5, "end": 1.0}[self.anchor] * self.width_mm
        after = self.width_mm - before
        above, below = ASCENT * self.size_mm, DESCENT * self.size_mm
        x, y = self.x_mm, self.y_mm
        if self.upward:
            return Area(x - above, y - before, x + below, y + after)
        return Area(x - before, y - below, x + after, y + above)


Item = Stroke | Text


@dataclass(frozen=True)
class Sheet:
    """One page of a drawing."""

    items: tuple[Item, ...]

    @property
    def texts(self) -> tuple[Text, ...]:
        """Its texts alone."""
        return tuple(item for item in self.items if isinstance(item, Text))


@dataclass(frozen=True)
class Drawing:
    """Sheets, one for each glass element, ready to be written.

    Attributes
    ----------
    title
        In full; on the sheets it may be cut.
    sheets
        In order.
    """

    title: str
    sheets: tuple[Sheet, ...]


def plain(text: str) -> str:
    """Text without characters that cannot be shown."""
    return _UNPRINTABLE.sub("\ufffd", text)


def font_file() -> Path:
    """The font that all texts are set in."""
    from matplotlib import get_data_path

    return Path(get_data_path()) / "fonts" / "ttf" / f"{FONT}.ttf"


def register_font() -> None:
    """Make the font known to reportlab, once."""
    from reportlab.pdfbase import pdfmetrics
    from reportlab.pdfbase.ttfonts import TTFont

    if FONT not in pdfmetrics.getRegisteredFontNames():
        pdfmetrics.registerFont(TTFont(FONT, str(font_file())))


@lru_cache(maxsize=4096)
def _width_per_size(text: str) -> float:
    from reportlab.pdfbase import pdfmetrics

    register_font()
    return float(pdfmetrics.stringWidth(text, FONT, 1000.0)) / 1000.0


def text_width_mm(text: str, size_mm: float) -> float:
    """Length of a line of text."""
    return size_mm * _width_per_size(text)


def fitted(text: str, width_mm: float, size_mm: float, least_mm: float = LEAST_MM) -> tuple[str, float]:
    """Text and size of type with which it keeps to a width: first smaller, then cut."""
    text = plain(text)
    size = min(size_mm, width_mm / max(_width_per_size(text), 1e-9))
    if size >= least_mm:
        return text, size
    text = text[:MOST_LETTERS]
    while text and text_width_mm(f"{text}…", least_mm) > width_mm:
        text = text[:-1]
    return f"{text}…", least_mm


def line(x0: float, y0: float, x1: float, y1: float, width_mm: float = THIN_MM) -> Stroke:
    """A straight line."""
    return Stroke(((x0, y0), (x1, y1)), width_mm)


def frame(area: Area, width_mm: float = THIN_MM) -> Stroke:
    """The border of a rectangle."""
    left, bottom, right, top = area
    return Stroke(((left, bottom), (right, bottom), (right, top), (left, top)), width_mm, closed=True)


def circle(x: float, y: float, radius_mm: float) -> Stroke:
    """A circle, as a polygon that nobody can tell from one at its size."""
    turns = [2.0 * math.pi * i / 48 for i in range(48)]
    return Stroke(
        tuple((x + radius_mm * math.cos(t), y + radius_mm * math.sin(t)) for t in turns), closed=True
    )


def cell(
    area: Area, text: str, size_mm: float = 3.0, anchor: Anchor = "start", least_mm: float = LEAST_MM
) -> Text:
    """A line of text in the middle of a rectangle's height, no wider than it."""
    room = 1.5
    shown, size = fitted(text, area.width - 2.0 * room, size_mm, least_mm)
    x = {
        "start": area.left + room,
        "middle": 0.5 * (area.left + area.right),
        "end": area.right - room,
    }[anchor]
    return Text(x, 0.5 * (area.bottom + area.top) - 0.36 * size, shown, size, anchor)
