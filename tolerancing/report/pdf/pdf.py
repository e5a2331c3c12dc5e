"""A report as a PDF: A4, numbered pages, an outline, tables that go on over pages."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from reportlab.lib.colors import HexColor
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import (
    BaseDocTemplate,
    CondPageBreak,
    Flowable,
    Frame,
    PageTemplate,
    Spacer,
    TableStyle,
)
from reportlab.platypus import Paragraph as Words
from reportlab.platypus import Table as Grid

from tolerancing.report.blocks import (
    Block,
    Code,
    Facts,
    FigureBlock,
    Heading,
    Headline,
    Panel,
    Paragraph,
    Report,
    Table,
    Warning,
    cut,
    plain,
)
from tolerancing.report.figures.style import BLUE, RED
from tolerancing.report.pdf.style import (
    FONT,
    HEAD,
    HEIGHT,
    MARGIN,
    PALE,
    SOFT,
    STYLES,
    WIDTH,
    register_fonts,
    tight,
    words,
)
from tolerancing.report.pdf.tables import table_flowables

DOTS_PER_INCH = 200
LINE_CHARACTERS = 112
"""Of a line of code, in its size of type."""

LINES_OF_ONE_COLUMN, FEWEST_LINES = 20, 5

LEAST_SHARE = 0.8
"""Of its size, to which a figure that stands alone shrinks so as to fit what is left of a page."""


def write_pdf(report: Report, path: Path) -> None:
    """Write a report as PDF.

    Parameters
    ----------
    report
        What it says.
    path
        The file; written over.
    """
    register_fonts()
    document = _Document(str(path), report)
    story: list[Flowable] = [
        words(report.title, "title"),
        words(report.subtitle, "soft"),
        Spacer(1, 3 * mm),
    ]
    section = 0
    for place, block in enumerate(report.blocks):
        if isinstance(block, Heading):
            section += block.level == 2
            story.append(CondPageBreak(_room(report.blocks[place : place + 4])))
        story += _flowables(block, section)
    story += [Spacer(1, 4 * mm), words(report.footer, "soft")]
    with binary_streams():
        document.build(story, canvasmaker=_numbered(report.title))


@contextmanager
def binary_streams() -> Iterator[None]:
    """Pictures as bytes in place of the letters that reportlab writes by default, a quarter more."""
    from reportlab import rl_config

    before = rl_config.useA85
    rl_config.useA85 = 0
    try:
        yield
    finally:
        rl_config.useA85 = before


class _Document(BaseDocTemplate):
    """Pages with room for a head and a foot; headings go into the outline."""

    def __init__(self, path: str, report: Report) -> None:
        super().__init__(
            path, pagesize=A4, title=plain(f"Tolerance report: {report.title}"), creator="tolerancing"
        )
        frame = Frame(MARGIN, MARGIN + HEAD, WIDTH, HEIGHT, 0, 0, 0, 0)
        self.addPageTemplates(PageTemplate("page", [frame]))
        self.sections = 0

    def afterFlowable(self, flowable: Flowable) -> None:
        """Note headings in the outline, as they land on a page."""
        level = {"h2": 0, "h3": 1}.get(getattr(getattr(flowable, "style", None), "name", ""))
        if level is None:
            return
        self.sections += 1
        key = f"heading-{self.sections}"
        self.canv.bookmarkPage(key)
        self.canv.addOutlineEntry(flowable.getPlainText(), key, level, closed=level == 0)


def _numbered(title: str) -> type[Canvas]:
    """A canvas whose pages say `n of m`, which is known only at the end."""
    shown = cut(plain(title), 90)

    class NumberedCanvas(Canvas):
        def __init__(self, *parts: Any, **more: Any) -> None:
            super().__init__(*parts, **more)
            self._pages: list[dict[str, Any]] = []

        def showPage(self) -> None:
            self._pages.append(dict(self.__dict__))
            self._startPage()

        def save(self) -> None:
            for number, page in enumerate(self._pages, start=1):
                self.__dict__.update(page)
                self.setFont(FONT, 7)
                self.setFillColor(SOFT)
                self.drawString(MARGIN, A4[1] - MARGIN, shown)
                self.drawRightString(A4[0] - MARGIN, A4[1] - MARGIN, "Tolerance report")
                self.line(MARGIN, A4[1] - MARGIN - 3, A4[0] - MARGIN, A4[1] - MARGIN - 3)
                self.drawRightString(A4[0] - MARGIN, MARGIN, f"{number} of {len(self._pages)}")
                super().showPage()
            super().save()

    return NumberedCanvas


def _flowables(block: Block, section: int) -> list[Flowable]:
    if isinstance(block, Heading):
        return [words(f"{section}. {block.text}" if block.level == 2 else block.text, f"h{block.level}")]
    if isinstance(block, Paragraph):
        return [words(block.text, "soft" if block.soft else "text")]
    if isinstance(block, Warning):
        return [words(block.text, "warning")]
    if isinstance(block, Headline):
        return _headline(block)
    if isinstance(block, Facts):
        return _facts(block)
    if isinstance(block, Table):
        return table_flowables(block)
    if isinstance(block, FigureBlock):
        return _figures(block)
    return _code(block)


def _room(following: tuple[Block, ...]) -> float:
    """Height that a heading needs below it, so that what it is over begins on its page."""
    height = 0.0
    for block in following:
        if isinstance(block, FigureBlock):
            return min(height + _first_row(block), HEIGHT)
        if not isinstance(block, Heading | Paragraph):
            break
        height += 12 * mm
    return height + 22 * mm


def _headline(block: Headline) -> list[Flowable]:
    color = RED if block.failed else BLUE
    number = Words(escape(block.number), ParagraphStyle("number", STYLES["big"], textColor=HexColor(color)))
    text = Words(f"<b>{escape(plain(block.verdict))}.</b><br/>{escape(plain(block.text))}", STYLES["text"])
    grid = Grid([[number, text]], colWidths=[0.24 * WIDTH, 0.76 * WIDTH])
    grid.setStyle(
        TableStyle(
            [
                ("BACKGROUND", (0, 0), (-1, -1), PALE),
                ("LINEBEFORE", (0, 0), (0, -1), 3, HexColor(color)),
                ("VALIGN", (0, 0), (-1, -1), "MIDDLE"),
                ("LEFTPADDING", (0, 0), (0, -1), 10),
                ("BOTTOMPADDING", (0, 0), (-1, -1), 8),
            ]
        )
    )
    return [grid, Spacer(1, 3 * mm)]


def _facts(block: Facts) -> list[Flowable]:
    cells = [[words(name, "soft"), words(cut(text), "text")] for name, text in block.items]
    half = -(-len(cells) // 2)
    blank: list[Any] = ["", ""]
    rows = [
        left + (cells[half + i] if half + i < len(cells) else blank) for i, left in enumerate(cells[:half])
    ]
    grid = Grid(rows, colWidths=[0.16 * WIDTH, 0.34 * WIDTH] * 2)
    grid.setStyle(
        TableStyle([("VALIGN", (0, 0), (-1, -1), "TOP"), ("LEFTPADDING", (0, 0), (-1, -1), 0), *tight(0)])
    )
    return [grid, Spacer(1, 2 * mm)]


def _figures(block: FigureBlock) -> list[Flowable]:
    columns, width = _layout(block)
    caption = [words(block.caption, "soft")] if block.caption else []
    if len(block.panels) == 1 and block.columns == 1:
        return [
            CondPageBreak(_first_row(block)),
            *caption,
            _Picture(block.panels[0], width),
            Spacer(1, 4 * mm),
        ]
    images: list[Any] = [
        _Picture(panel, width - (4.0 if block.columns > 1 else 0.0)) for panel in block.panels
    ]
    images += [""] * (-len(images) % columns)
    rows = [images[i : i + columns] for i in range(0, len(images), columns)]
    grid = Grid(rows, colWidths=[width] * columns, hAlign="LEFT")
    grid.setStyle(
        TableStyle(
            [
                ("LEFTPADDING", (0, 0), (-1, -1), 0),
                ("RIGHTPADDING", (0, 0), (-1, -1), 0),
                ("VALIGN", (0, 0), (-1, -1), "TOP"),
                *tight(2),
            ]
        )
    )
    return [CondPageBreak(_first_row(block)), *caption, grid, Spacer(1, 2 * mm)]


def _layout(block: FigureBlock) -> tuple[int, float]:
    """Panels in a row, and the width of each."""
    return min(block.columns, len(block.panels)), WIDTH / block.columns


def _first_row(block: FigureBlock) -> float:
    """Height that the first row of panels takes at least, with its caption."""
    columns, width = _layout(block)
    share = LEAST_SHARE if columns == block.columns == 1 else 1.0
    return share * max(_size(panel, width)[1] for panel in block.panels[:columns]) + (
        10 * mm if block.caption else 4 * mm
    )


def _size(panel: Panel, width: float) -> tuple[float, float]:
    """Of a figure: no larger than its natural size, the width at hand, and a page."""
    inches = panel.figure.get_size_inches()
    scale = min(width / inches[0], (HEIGHT - 40 * mm) / inches[1], 72.0)
    return inches[0] * scale, inches[1] * scale


class _Picture(Flowable):
    """A figure, drawn when its page is; a little smaller where that lets it stay on a page."""

    def __init__(self, panel: Panel, width: float) -> None:
        super().__init__()
        self.panel = panel
        self.natural = _size(panel, width)

    def wrap(self, width: float, height: float) -> tuple[float, float]:
        share = min(1.0, max(height / self.natural[1], LEAST_SHARE))
        self.width, self.height = share * self.natural[0], share * self.natural[1]
        return self.width, self.height

    def draw(self) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from PIL import Image
        from reportlab.lib.utils import ImageReader

        figure = self.panel.figure
        figure.set_dpi(DOTS_PER_INCH)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
        self.canv.drawImage(ImageReader(picture), 0.0, 0.0, self.width, self.height)


def _code(block: Code) -> list[Flowable]:
    """Lines as they stand; many in two columns."""
    text = plain(block.text).expandtabs(4)
    columns = 2 if text.count("\n") > LINES_OF_ONE_COLUMN else 1
    lines: list[str] = []
    for line in text.splitlines():
        lines += textwrap.wrap(line, LINE_CHARACTERS // columns - 1, drop_whitespace=False) or [""]
    return [_Lines(tuple(lines), columns), Spacer(1, 3 * mm)]


class _Lines(Flowable):
    """Lines of code in columns, which fill a page before the next one."""

    def __init__(self, lines: tuple[str, ...], columns: int) -> None:
        super().__init__()
        self.lines, self.columns = lines, columns
        self.rows = -(-len(lines) // columns)
        self.leading = STYLES["code"].leading

    def wrap(self, width: float, height: float) -> tuple[float, float]:
        self.width, self.height = width, self.rows * self.leading
        return self.width, self.height

    def split(self, width: float, height: float) -> list[Flowable]:
        rows = int(height // self.leading)
        if rows < FEWEST_LINES:
            return []
        kept = rows * self.columns
        return [_Lines(self.lines[:kept], self.columns), _Lines(self.lines[kept:], self.columns)]

    def draw(self) -> None:
        self.canv.setFont(STYLES["code"].fontName, STYLES["code"].fontSize)
        self.canv.setFillColor(STYLES["code"].textColor)
        for number, line in enumerate(self.lines):
            column, row = divmod(number, self.rows)
            x, y = column * self.width / self.columns, self.height - (row + 0.8) * self.leading
            self.canv.drawString(x, y, line)
