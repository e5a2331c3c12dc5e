"""Rendering of a report as PDF: A4 pages with numbers, an outline, and tables that continue over pages."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from reportlab.lib.colors import HexColor
from reportlab.lib.enums import TA_RIGHT
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import (
    BaseDocTemplate,
    CondPageBreak,
    Flowable,
    Frame,
    LongTable,
    PageTemplate,
    Spacer,
    TableStyle,
)
from reportlab.platypus import Paragraph as PdfParagraph
from reportlab.platypus import Table as PdfTable

from lensdesign.plots.style import BLUE, FAINT, GRID, INK, ORANGE, RED
from tolerancing.report.blocks import (
    Block,
    Cell,
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

MARGIN, HEAD = 15 * mm, 9 * mm
WIDTH = A4[0] - 2 * MARGIN
HEIGHT = A4[1] - 2 * MARGIN - 2 * HEAD

FONT, BOLD, MONO = "DejaVuSans", "DejaVuSans-Bold", "DejaVuSansMono"
SOFT, PALE = HexColor("#5f6872"), HexColor("#f4f7f9")

TYPE_SIZES, PADDING = (7.0, 6.5, 6.0, 5.5, 5.0), 5.0
"""Sizes of type in tables (pt), and the padding of a cell on both sides together (pt)."""

SMALLEST_SCALE = 0.8
"""Smallest scale of a figure that shrinks to fit the rest of a page."""


def register_fonts() -> None:
    """Register the fonts of the report. They are part of matplotlib, and have Greek letters and symbols."""
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
    """Return a paragraph style of a size (pt), by default in the font and colour of the report."""
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


def text_paragraph(text: str, style: str) -> PdfParagraph:
    """Return a paragraph of plain text in one of `STYLES`."""
    return PdfParagraph(escape(plain(text)), STYLES[style])


def tight(points: float) -> list[Any]:
    """Return table commands for a small padding above and below the cells (pt)."""
    return [("TOPPADDING", (0, 0), (-1, -1), points), ("BOTTOMPADDING", (0, 0), (-1, -1), points)]


def write_pdf(report: Report, path: Path) -> None:
    """Write a report as PDF.

    Parameters
    ----------
    report
        Content of the report.
    path
        Path of the file; an existing file is overwritten.
    """
    register_fonts()
    document = _Document(str(path), report)
    story: list[Flowable] = [
        text_paragraph(report.title, "title"),
        text_paragraph(report.subtitle, "soft"),
        Spacer(1, 3 * mm),
    ]
    section = 0
    for k, block in enumerate(report.blocks):
        if isinstance(block, Heading):
            section += block.level == 2
            story.append(CondPageBreak(_height_with_heading(report.blocks[k : k + 4])))
        story += _flowables(block, section)
    story += [Spacer(1, 4 * mm), text_paragraph(report.footer, "soft")]
    with binary_streams():
        document.build(story, canvasmaker=_numbered(report.title))


@contextmanager
def binary_streams() -> Iterator[None]:
    """Write images as bytes. The ASCII encoding that reportlab uses by default is a quarter larger."""
    from reportlab import rl_config

    previous = rl_config.useA85
    rl_config.useA85 = 0
    try:
        yield
    finally:
        rl_config.useA85 = previous


class _Document(BaseDocTemplate):
    """Document with space for a header and a footer on each page. Headings go into the outline."""

    def __init__(self, path: str, report: Report) -> None:
        super().__init__(
            path, pagesize=A4, title=plain(f"Tolerance report: {report.title}"), creator="tolerancing"
        )
        frame = Frame(MARGIN, MARGIN + HEAD, WIDTH, HEIGHT, 0, 0, 0, 0)
        self.addPageTemplates(PageTemplate("page", [frame]))
        self.sections = 0

    def afterFlowable(self, flowable: Flowable) -> None:
        """Add a heading to the outline when it is placed on a page."""
        level = {"h2": 0, "h3": 1}.get(getattr(getattr(flowable, "style", None), "name", ""))
        if level is None:
            return
        self.sections += 1
        key = f"heading-{self.sections}"
        self.canv.bookmarkPage(key)
        self.canv.addOutlineEntry(flowable.getPlainText(), key, level, closed=level == 0)


def _numbered(title: str) -> type[Canvas]:
    """Return a canvas class that writes `n of m` on each page; m is known only at the end."""
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
        return [
            text_paragraph(f"{section}. {block.text}" if block.level == 2 else block.text, f"h{block.level}")
        ]
    if isinstance(block, Paragraph):
        return [text_paragraph(block.text, "soft" if block.soft else "text")]
    if isinstance(block, Warning):
        return [text_paragraph(block.text, "warning")]
    if isinstance(block, Headline):
        return _headline(block)
    if isinstance(block, Facts):
        return _facts(block)
    if isinstance(block, Table):
        return table_flowables(block)
    if isinstance(block, FigureBlock):
        return _figures(block)
    return _code(block)


def _height_with_heading(following: tuple[Block, ...]) -> float:
    """Return the height that a heading needs, so that the block below it begins on the same page."""
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
    number = PdfParagraph(
        escape(block.number), ParagraphStyle("number", STYLES["big"], textColor=HexColor(color))
    )
    text = PdfParagraph(
        f"<b>{escape(plain(block.verdict))}.</b><br/>{escape(plain(block.text))}", STYLES["text"]
    )
    grid = PdfTable([[number, text]], colWidths=[0.24 * WIDTH, 0.76 * WIDTH])
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
    cells = [[text_paragraph(name, "soft"), text_paragraph(cut(text), "text")] for name, text in block.items]
    half = -(-len(cells) // 2)
    blank: list[Any] = ["", ""]
    rows = [
        left + (cells[half + i] if half + i < len(cells) else blank) for i, left in enumerate(cells[:half])
    ]
    grid = PdfTable(rows, colWidths=[0.16 * WIDTH, 0.34 * WIDTH] * 2)
    grid.setStyle(
        TableStyle([("VALIGN", (0, 0), (-1, -1), "TOP"), ("LEFTPADDING", (0, 0), (-1, -1), 0), *tight(0)])
    )
    return [grid, Spacer(1, 2 * mm)]


def _figures(block: FigureBlock) -> list[Flowable]:
    columns, width = _layout(block)
    caption = [text_paragraph(block.caption, "soft")] if block.caption else []
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
    grid = PdfTable(rows, colWidths=[width] * columns, hAlign="LEFT")
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
    """Return the number of panels in a row, and the width of each."""
    return min(block.columns, len(block.panels)), WIDTH / block.columns


def _first_row(block: FigureBlock) -> float:
    """Return the smallest height of the first row of panels with its caption."""
    columns, width = _layout(block)
    scale = SMALLEST_SCALE if columns == block.columns == 1 else 1.0
    return scale * max(_size(panel, width)[1] for panel in block.panels[:columns]) + (
        10 * mm if block.caption else 4 * mm
    )


def _size(panel: Panel, width: float) -> tuple[float, float]:
    """Return the size of a figure, limited by its natural size, the available width and the page."""
    inches = panel.figure.get_size_inches()
    scale = min(width / inches[0], (HEIGHT - 40 * mm) / inches[1], 72.0)
    return inches[0] * scale, inches[1] * scale


class _Picture(Flowable):
    """Figure that is drawn together with its page. It shrinks a little if it then fits the page."""

    def __init__(self, panel: Panel, width: float) -> None:
        super().__init__()
        self.panel = panel
        self.natural = _size(panel, width)

    def wrap(self, width: float, height: float) -> tuple[float, float]:
        scale = min(1.0, max(height / self.natural[1], SMALLEST_SCALE))
        self.width, self.height = scale * self.natural[0], scale * self.natural[1]
        return self.width, self.height

    def draw(self) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from PIL import Image
        from reportlab.lib.utils import ImageReader

        figure = self.panel.figure
        figure.set_dpi(200)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
        self.canv.drawImage(ImageReader(picture), 0.0, 0.0, self.width, self.height)


def _code(block: Code) -> list[Flowable]:
    """Return lines of code, in two columns if there are more than 20. Lines that are too long are wrapped."""
    text = plain(block.text).expandtabs(4)
    columns = 2 if text.count("\n") > 20 else 1
    line_characters = 112  # Width of the page in characters of the code font.
    lines: list[str] = []
    for line in text.splitlines():
        lines += wrapped_code(line, line_characters // columns - 1)
    return [_Lines(tuple(lines), columns), Spacer(1, 3 * mm)]


def wrapped_code(line: str, width: int) -> list[str]:
    """Return a line of code in lines of at most a width.

    A comment behind the code that does not fit is moved in front of it. What continues it is a comment, too.
    """
    if len(line) <= width:
        return [line]
    code, separator, comment = line.rpartition("  # ")
    if separator and code.count('"') % 2 == 0:
        code = code.rstrip()
        if len(code) + len(separator) + len(comment) <= width:
            return [f"{code}{separator}{comment}"]
        return [*wrapped_code(f"# {comment}", width), *wrapped_code(code, width)]
    if line.startswith("#"):
        return textwrap.wrap(line, width, subsequent_indent="# ")
    return textwrap.wrap(line, width, drop_whitespace=False) or [""]


class _Lines(Flowable):
    """Lines of code in columns. They fill a page before they continue on the next one."""

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
        if rows < 5:  # Fewer lines at the foot of a page would be easy to miss.
            return []
        count = rows * self.columns
        return [_Lines(self.lines[:count], self.columns), _Lines(self.lines[count:], self.columns)]

    def draw(self) -> None:
        self.canv.setFont(STYLES["code"].fontName, STYLES["code"].fontSize)
        self.canv.setFillColor(STYLES["code"].textColor)
        for number, line in enumerate(self.lines):
            column, row = divmod(number, self.rows)
            x, y = column * self.width / self.columns, self.height - (row + 0.8) * self.leading
            self.canv.drawString(x, y, line)


def table_flowables(block: Table) -> list[Flowable]:
    """Return a table with its caption. A table that is too wide continues below, with its first column."""
    cells = block.cells()
    caption = [text_paragraph(block.caption, "soft")] if block.caption else []
    story: list[Flowable] = [CondPageBreak(25 * mm), *caption]
    for chosen in _column_groups(_widths(block, cells, TYPE_SIZES[-1])[1]):
        group = Table(tuple(block.columns[k] for k in chosen), ())
        story += [_grid(group, [[row[k] for k in chosen] for row in cells]), Spacer(1, 3 * mm)]
    return story


def _column_groups(least: list[float]) -> list[list[int]]:
    """Return groups of columns that fit the width of a page. The first column is in all groups."""
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
                ("LINEBELOW", (0, 0), (-1, 0), 0.8, HexColor(FAINT)),
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
    """Fraction as a bar, with its interval as a line."""

    def __init__(self, bar: tuple[float, float, float], width: float) -> None:
        super().__init__()
        self.bar, self.width, self.height = bar, width, 6.0

    def draw(self) -> None:
        length_of_bar, low, high = (self.width * value for value in self.bar)
        for color, x, y, length, height in (
            (GRID, 0.0, 0.0, self.width, 4.5),
            (BLUE, 0.0, 0.0, length_of_bar, 4.5),
            (INK, low, 1.6, high - low, 1.3),
        ):
            self.canv.setFillColor(HexColor(color))
            self.canv.rect(x, y, length, height, stroke=0, fill=1)


def _content(cell: Cell, align: str, size: float, width: float) -> PdfParagraph | list[Flowable]:
    text = _cell(cell, align, size, width)
    return text if cell.bar is None else [text, _Bar(cell.bar, width - PADDING)]


def _cell(cell: Cell, align: str, size: float, width: float, head: bool = False) -> PdfParagraph:
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
    return PdfParagraph("<br/>".join(escape(line) for line in lines), style)


def broken_lines(text: str, font: str, size: float, width: float) -> list[str]:
    """Break a text at spaces and after underscores into lines of at most a width (pt)."""
    lines = [""]
    for word in _unbroken_words(text):
        if lines[-1] and pdfmetrics.stringWidth((lines[-1] + word).rstrip(), font, size) > width:
            lines[-1] = lines[-1].rstrip()
            lines.append("")
        lines[-1] += word
    return lines


def _unbroken_words(text: str) -> list[str]:
    return re.findall(r"[^\s_]*_+|[^\s_]+\s*|\s+", text)


def _fitted(block: Table, cells: list[list[Cell]]) -> tuple[list[float], float]:
    """Return widths of columns that fill the page, and the size of type (pt).

    The size is the largest of the first three that breaks no cell, or else the largest that breaks no word.
    """
    for size in TYPE_SIZES[:3]:
        natural, _ = _widths(block, cells, size)
        if sum(natural) <= WIDTH:
            spare = (WIDTH - sum(natural)) / len(natural)
            return [w + spare for w in natural], size
    for size in TYPE_SIZES:
        natural, least = _widths(block, cells, size)
        if sum(least) <= WIDTH:
            break
    else:
        return [w * WIDTH / sum(least) for w in least], TYPE_SIZES[-1]
    stretch = (WIDTH - sum(least)) / sum(n - s for n, s in zip(natural, least, strict=True))
    return [s + stretch * (n - s) for n, s in zip(natural, least, strict=True)], size


def _widths(block: Table, cells: list[list[Cell]], size: float) -> tuple[list[float], list[float]]:
    """Return the natural widths of columns, and the smallest ones that break no word or number (pt)."""
    natural, least = [], []
    for k, column in enumerate(block.columns):
        shown = [plain(row[k].text) for row in cells[:300]]  # Long tables are sampled.
        titles = [pdfmetrics.stringWidth(word.strip(), BOLD, size) for word in _unbroken_words(column.title)]
        texts = [pdfmetrics.stringWidth(text, BOLD, size) for text in shown]
        single = [
            pdfmetrics.stringWidth(word.strip(), BOLD, size)
            for text in shown
            for word in _unbroken_words(text)
        ]
        natural.append(max([*texts, *titles, 0.0]) + PADDING + 1.0)
        needed = single if column.align == "left" else texts
        least.append(min(max([*needed, *titles, 0.0]), 0.3 * WIDTH) + PADDING + 1.0)
    return natural, least
