"""Tables of a report's PDF: columns as wide as they need, heads repeated from page to page."""

from __future__ import annotations

import re
from xml.sax.saxutils import escape

from reportlab.lib.colors import HexColor
from reportlab.lib.enums import TA_RIGHT
from reportlab.lib.units import mm
from reportlab.pdfbase import pdfmetrics
from reportlab.platypus import CondPageBreak, Flowable, LongTable, Spacer, TableStyle
from reportlab.platypus import Paragraph as Words

from tolerancing.report.blocks import Cell, Table, plain
from tolerancing.report.figures.style import BLUE, EDGE, GRID, INK, RED
from tolerancing.report.pdf.style import BOLD, FONT, PALE, WIDTH, style_of, tight, words

SIZES, PADDING = (7.0, 6.5, 6.0, 5.5, 5.0), 5.0
"""Of type; of both sides of a cell together."""

WHOLE_SIZES = 3
"""Of the sizes, the first so many are tried for cells on one line each."""

SAMPLED_ROWS = 300
"""Of a table, that its columns' widths follow."""


def table_flowables(block: Table) -> list[Flowable]:
    """A table with its caption; one too wide for the page goes on below, under its first column."""
    cells = block.cells()
    caption = [words(block.caption, "soft")] if block.caption else []
    story: list[Flowable] = [CondPageBreak(25 * mm), *caption]
    for chosen in _column_groups(_widths(block, cells, SIZES[-1])[1]):
        part = Table(tuple(block.columns[k] for k in chosen), ())
        story += [_grid(part, [[row[k] for k in chosen] for row in cells]), Spacer(1, 3 * mm)]
    return story


def _column_groups(least: list[float]) -> list[list[int]]:
    """Columns that go beside each other on a page; the first one stands in all groups."""
    groups = [[0]]
    for k in range(1, len(least)):
        if len(groups[-1]) > 1 and sum(least[i] for i in [*groups[-1], k]) > WIDTH:
            groups.append([0])
        groups[-1].append(k)
    return groups


def _grid(block: Table, cells: list[list[Cell]]) -> LongTable:
    widths, size = _fitted(block, cells)
    head = [_cell(Cell(c.title), c.align, size, w, True) for c, w in zip(block.columns, widths, strict=True)]
    rows = [
        [_content(cell, c.align, size, w) for cell, c, w in zip(row, block.columns, widths, strict=True)]
        for row in cells
    ]
    grid = LongTable([head, *rows], colWidths=widths, repeatRows=1, splitInRow=1)
    grid.setStyle(
        TableStyle(
            [
                ("BACKGROUND", (0, 0), (-1, 0), PALE),
                ("LINEBELOW", (0, 0), (-1, 0), 0.8, HexColor(EDGE)),
                ("LINEBELOW", (0, 1), (-1, -1), 0.4, HexColor(GRID)),
                ("VALIGN", (0, 0), (-1, 0), "BOTTOM"),
                ("VALIGN", (0, 1), (-1, -1), "TOP"),
                ("LEFTPADDING", (0, 0), (-1, -1), 0.5 * PADDING),
                ("RIGHTPADDING", (0, 0), (-1, -1), 0.5 * PADDING),
                *tight(1.8),
            ]
        )
    )
    return grid


class _Bar(Flowable):
    """A share as a bar, with its interval as a line."""

    def __init__(self, bar: tuple[float, float, float], width: float) -> None:
        super().__init__()
        self.bar, self.width, self.height = bar, width, 6.0

    def draw(self) -> None:
        share, low, high = (self.width * value for value in self.bar)
        for color, x, y, length, height in (
            (GRID, 0.0, 0.0, self.width, 4.5),
            (BLUE, 0.0, 0.0, share, 4.5),
            (INK, low, 1.6, high - low, 1.3),
        ):
            self.canv.setFillColor(HexColor(color))
            self.canv.rect(x, y, length, height, stroke=0, fill=1)


def _content(cell: Cell, align: str, size: float, width: float) -> Words | list[Flowable]:
    text = _cell(cell, align, size, width)
    return text if cell.bar is None else [text, _Bar(cell.bar, width - PADDING)]


def _cell(cell: Cell, align: str, size: float, width: float, head: bool = False) -> Words:
    font = BOLD if head or cell.failed else FONT
    style = style_of(
        "cell",
        size,
        leading=1.2 * size,
        fontName=font,
        textColor=HexColor(RED if cell.failed else INK),
        splitLongWords=1,
        **({"alignment": TA_RIGHT} if align == "right" else {}),
    )
    lines = broken_lines(plain(cell.text), font, size, width - PADDING)
    return Words("<br/>".join(escape(line) for line in lines), style)


def broken_lines(text: str, font: str, size: float, width: float) -> list[str]:
    """Lines no wider than a width, broken at spaces and after underscores."""
    lines = [""]
    for part in _parts(text):
        if lines[-1] and pdfmetrics.stringWidth((lines[-1] + part).rstrip(), font, size) > width:
            lines[-1] = lines[-1].rstrip()
            lines.append("")
        lines[-1] += part
    return lines


def _parts(text: str) -> list[str]:
    return re.findall(r"[^\s_]*_+|[^\s_]+\s*|\s+", text)


def _fitted(block: Table, cells: list[list[Cell]]) -> tuple[list[float], float]:
    """Widths of columns that fill the page, in the largest type that breaks no cell, or else no word."""
    for size in SIZES[:WHOLE_SIZES]:
        natural, _ = _widths(block, cells, size)
        if sum(natural) <= WIDTH:
            spare = (WIDTH - sum(natural)) / len(natural)
            return [w + spare for w in natural], size
    for size in SIZES:
        natural, least = _widths(block, cells, size)
        if sum(least) <= WIDTH:
            break
    else:
        return [w * WIDTH / sum(least) for w in least], SIZES[-1]
    give = (WIDTH - sum(least)) / sum(n - s for n, s in zip(natural, least, strict=True))
    return [s + give * (n - s) for n, s in zip(natural, least, strict=True)], size


def _widths(block: Table, cells: list[list[Cell]], size: float) -> tuple[list[float], list[float]]:
    """Widths that columns would like to have, and those that they need."""
    natural, least = [], []
    for k, column in enumerate(block.columns):
        shown = [plain(row[k].text) for row in cells[:SAMPLED_ROWS]]
        titles = [pdfmetrics.stringWidth(part.strip(), BOLD, size) for part in _parts(column.title)]
        texts = [pdfmetrics.stringWidth(text, BOLD, size) for text in shown]
        parts = [pdfmetrics.stringWidth(p.strip(), BOLD, size) for text in shown for p in _parts(text)]
        natural.append(max([*texts, *titles, 0.0]) + PADDING + 1.0)
        kept = parts if column.align == "left" else texts
        least.append(min(max([*kept, *titles, 0.0]), 0.3 * WIDTH) + PADDING + 1.0)
    return natural, least
