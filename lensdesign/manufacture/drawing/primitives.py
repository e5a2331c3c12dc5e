"""Elements of a drawing: strokes and texts on sheets, in mm from the lower left corner, y upwards."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

FONT = "DejaVuSans"
"""Font with all signs that drawings need; matplotlib includes it."""

SHEET_MM = (297.0, 210.0)
"""Width and height of a sheet: A4 landscape."""

ASCENT, DESCENT = 0.78, 0.24
"""Height of the tallest and depth of the lowest letters, as fractions of the type size."""

THICK_MM, THIN_MM = 0.5, 0.25
"""Line widths of visible edges and frames, and of all other lines (ISO 128)."""

LEAST_MM = 1.6
"""Smallest type size; a longer text is truncated."""

CENTRE_LINE_DASHES: tuple[float, ...] = (8.0, 1.2, 1.2, 1.2)
"""Dash pattern of centre lines in mm: long dash, gap, dot, gap."""

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
        """Width in mm."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """Height in mm."""
        return self.top - self.bottom


@dataclass(frozen=True)
class Stroke:
    """A polygon: open, closed or filled."""

    points: tuple[Point, ...]
    width_mm: float = THIN_MM
    dashes_mm: tuple[float, ...] = ()
    closed: bool = False
    filled: bool = False


@dataclass(frozen=True)
class Text:
    """A line of text.

    Attributes
    ----------
    x_mm, y_mm
        Position of the anchor on the base line in mm.
    text
        The text.
    size_mm
        Type size in mm: distance between lines.
    anchor
        Point of the text at x, y: start, middle or end.
    upward
        Whether the text reads from bottom to top.
    """

    x_mm: float
    y_mm: float
    text: str
    size_mm: float = 3.0
    anchor: Anchor = "start"
    upward: bool = False

    @property
    def width_mm(self) -> float:
        """Length along the base line in mm."""
        return text_width_mm(self.text, self.size_mm)

    @property
    def box(self) -> Area:
        """Bounding box of the letters."""
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
    """A page of a drawing."""

    items: tuple[Item, ...]

    @property
    def texts(self) -> tuple[Text, ...]:
        """Texts of the sheet."""
        return tuple(item for item in self.items if isinstance(item, Text))


@dataclass(frozen=True)
class Drawing:
    """Sheets of a lens, one for each glass element.

    Attributes
    ----------
    title
        Full title; the sheets may truncate it.
    sheets
        Sheets in the order of the elements.
    """

    title: str
    sheets: tuple[Sheet, ...]


def plain(text: str) -> str:
    """Return a text without unprintable characters."""
    return _UNPRINTABLE.sub("\ufffd", text)


def font_file() -> Path:
    """Return the path of the font of all texts."""
    from matplotlib import get_data_path

    return Path(get_data_path()) / "fonts" / "ttf" / f"{FONT}.ttf"


def register_font() -> None:
    """Register the font with reportlab, unless it is registered."""
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
    """Return the length of a line of text in mm."""
    return size_mm * _width_per_size(text)


def fitted(text: str, width_mm: float, size_mm: float, least_mm: float = LEAST_MM) -> tuple[str, float]:
    """Return the text and type size that fit a width: the text is first set smaller, then truncated."""
    text = plain(text)
    size = min(size_mm, width_mm / max(_width_per_size(text), 1e-9))
    if size >= least_mm:
        return text, size
    text = text[:500]  # no line of a sheet holds more letters
    while text and text_width_mm(f"{text}…", least_mm) > width_mm:
        text = text[:-1]
    return f"{text}…", least_mm


def line(x0: float, y0: float, x1: float, y1: float, width_mm: float = THIN_MM) -> Stroke:
    """Return a straight line."""
    return Stroke(((x0, y0), (x1, y1)), width_mm)


def frame(area: Area, width_mm: float = THIN_MM) -> Stroke:
    """Return the border of a rectangle."""
    left, bottom, right, top = area
    return Stroke(((left, bottom), (right, bottom), (right, top), (left, top)), width_mm, closed=True)


def circle(x: float, y: float, radius_mm: float) -> Stroke:
    """Return a circle as a polygon with 48 corners."""
    angles = [2.0 * math.pi * i / 48 for i in range(48)]
    return Stroke(
        tuple((x + radius_mm * math.cos(t), y + radius_mm * math.sin(t)) for t in angles), closed=True
    )


def cell(
    area: Area, text: str, size_mm: float = 3.0, anchor: Anchor = "start", least_mm: float = LEAST_MM
) -> Text:
    """Return a line of text that is vertically centred in a rectangle and fits its width."""
    margin = 1.5
    fitting, size = fitted(text, area.width - 2.0 * margin, size_mm, least_mm)
    x = {
        "start": area.left + margin,
        "middle": 0.5 * (area.left + area.right),
        "end": area.right - margin,
    }[anchor]
    return Text(x, 0.5 * (area.bottom + area.top) - 0.36 * size, fitting, size, anchor)
