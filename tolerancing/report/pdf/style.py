"""Type, colours and measures of a report's PDF."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from reportlab.lib.colors import HexColor
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfbase import pdfmetrics
from reportlab.platypus import Paragraph as Words

from tolerancing.report.blocks import plain
from tolerancing.report.figures.style import BLUE, INK, ORANGE

MARGIN, HEAD = 15 * mm, 9 * mm
WIDTH = A4[0] - 2 * MARGIN
HEIGHT = A4[1] - 2 * MARGIN - 2 * HEAD

FONT, BOLD, MONO = "DejaVuSans", "DejaVuSans-Bold", "DejaVuSansMono"
SOFT, PALE = HexColor("#5f6872"), HexColor("#f4f7f9")


def register_fonts() -> None:
    """Fonts that have Greek letters and signs; matplotlib brings them along."""
    from matplotlib import get_data_path
    from reportlab.lib.fonts import addMapping
    from reportlab.pdfbase.ttfonts import TTFont

    known = pdfmetrics.getRegisteredFontNames()
    folder = Path(get_data_path()) / "fonts" / "ttf"
    for name in (FONT, BOLD, MONO):
        if name not in known:
            pdfmetrics.registerFont(TTFont(name, str(folder / f"{name}.ttf")))
    for bold, name in enumerate((FONT, BOLD)):
        addMapping(FONT, bold, 0, name)


def style_of(name: str, size: float, **more: Any) -> ParagraphStyle:
    """A style of so many points, in the report's font and ink unless told otherwise."""
    own: dict[str, Any] = {"fontName": FONT, "textColor": HexColor(INK), "leading": 1.35 * size} | more
    return ParagraphStyle(name, fontSize=size, **own)


STYLES = {
    "title": style_of("title", 17, fontName=BOLD),
    "h2": style_of("h2", 12.5, fontName=BOLD, spaceBefore=12, spaceAfter=4, textColor=HexColor(BLUE)),
    "h3": style_of("h3", 9.5, fontName=BOLD, spaceBefore=8, spaceAfter=2),
    "text": style_of("text", 8.5, spaceAfter=4),
    "soft": style_of("soft", 7.5, spaceAfter=4, textColor=SOFT),
    "warning": style_of(
        "warning", 8.5, backColor=HexColor("#fff4e0"), borderColor=HexColor(ORANGE), borderWidth=0.6,
        borderPadding=5, spaceBefore=8, spaceAfter=10,
    ),
    "big": style_of("big", 24, fontName=BOLD, textColor=HexColor(BLUE)),
    "code": style_of("code", 6.6, fontName=MONO, leading=8.2),
}  # fmt: skip


def words(text: str, style: str) -> Words:
    """A paragraph of text as it stands, in one of `STYLES`."""
    return Words(escape(plain(text)), STYLES[style])


def tight(points: float) -> list[Any]:
    """Little room above and below a table's cells."""
    return [("TOPPADDING", (0, 0), (-1, -1), points), ("BOTTOMPADDING", (0, 0), (-1, -1), points)]
