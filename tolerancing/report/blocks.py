"""Content of a report as blocks (headings, tables, figures), independent of the output format.

The sections of a report produce these blocks. :mod:`tolerancing.report.html` and
:mod:`tolerancing.report.pdf` render the same blocks, so that page and PDF cannot differ in content.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tolerancing.prediction.study_prediction import PredictedYield
    from tolerancing.statistics.yields import Yield

LONGEST_CELL = 600
"""Most characters in a table's cell; the store holds the full text."""

CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")
"""Characters that neither HTML nor PDF can show."""

UNIT_UM = re.compile(r"(?<=\d )um\b|(?<=\()um(?=\))")
"""The unit um after a number or in parentheses, but not within the name of a column."""

Align = Literal["left", "right"]


@dataclass(frozen=True)
class Heading:
    """Title of a section (level 2) or of a subsection (level 3)."""

    text: str
    level: Literal[2, 3] = 2


@dataclass(frozen=True)
class Paragraph:
    """Paragraph of text. A `soft` one explains the neighbouring block, and is set in a lighter style."""

    text: str
    soft: bool = False


@dataclass(frozen=True)
class Warning:
    """Warning that limits what the reader may conclude from the report."""

    text: str


@dataclass(frozen=True)
class Headline:
    """Main number of the report, its verdict, and an explanation."""

    number: str
    verdict: str
    text: str
    failed: bool


@dataclass(frozen=True)
class Facts:
    """List of short facts, as pairs of name and text."""

    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Cell:
    """Table cell with a mark or a bar.

    Attributes
    ----------
    text
        Text of the cell.
    failed
        Whether its value misses a limit.
    bar
        Fraction, and the ends of its interval, to draw as a bar; None for no bar.
    """

    text: str
    failed: bool = False
    bar: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Column:
    """Title of a table's column, and alignment of its cells."""

    title: str
    align: Align = "right"


@dataclass(frozen=True)
class Table:
    """Table with its columns, rows and caption. A plain string is a cell with text only."""

    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell | str, ...], ...]
    caption: str = ""

    def cells(self) -> list[list[Cell]]:
        """Return all rows as cells, each cut to `LONGEST_CELL` characters."""
        cells = [[c if isinstance(c, Cell) else Cell(cut(c)) for c in row] for row in self.rows]
        return [[replace(cell, text=in_micrometres(cell.text)) for cell in row] for row in cells]


@dataclass(frozen=True, eq=False)
class Panel:
    """A figure.

    Attributes
    ----------
    figure
        The matplotlib figure.
    alt
        Description of the figure for readers who cannot see it.
    points
        Trial numbers of the markers in a collection, by the gid of the collection, in drawing order.
    """

    figure: Figure
    alt: str
    points: Mapping[str, Sequence[int]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class FigureBlock:
    """Panels in rows of at most `columns`, as far as the page is wide enough."""

    panels: tuple[Panel, ...]
    columns: int = 1
    caption: str = ""


@dataclass(frozen=True)
class Code:
    """Text that is shown unchanged in a fixed-width font."""

    text: str


Block = Heading | Paragraph | Warning | Headline | Facts | Table | FigureBlock | Code


@dataclass(frozen=True)
class Report:
    """Complete content of a report.

    Attributes
    ----------
    title
        Title of the study.
    subtitle
        Line below the title.
    blocks
        Content in order.
    trials : mapping of int to str
        Tooltip of the points in figures, by trial number.
    footer
        Text at the end.
    """

    title: str
    subtitle: str
    blocks: tuple[Block, ...]
    trials: Mapping[int, str]
    footer: str


def plain(text: str) -> str:
    """Replace characters that cannot be shown."""
    return CONTROL.sub("�", text)


def in_micrometres(text: str) -> str:
    """Replace the unit um, as files write it, by µm."""
    return UNIT_UM.sub("µm", text)


def cut(text: str, most: int = LONGEST_CELL) -> str:
    """Shorten a text to at most `most` characters."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def table(headings: Sequence[str], rows: Sequence[Sequence[Cell | str]], caption: str = "") -> Table:
    """Return a table. A heading that starts with ``<`` is for a text column, any other for numbers."""
    titles = [in_micrometres(heading) for heading in headings]
    columns = tuple(Column(t.removeprefix("<"), "left" if t.startswith("<") else "right") for t in titles)
    return Table(columns, tuple(tuple(row) for row in rows), caption)


def number_text(value: float | None, digits: int = 4) -> str:
    """Format a number with significant digits; a dash for None or NaN."""
    if value is None or np.isnan(value):
        return "–"
    if np.isinf(value):
        return "∞" if value > 0.0 else "−∞"
    return f"{value:.{digits}g}".replace("-", "−")


def signed_text(value: float | None) -> str:
    """Format a number with its sign; a dash if it is None or not finite."""
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:+.3g}".replace("-", "−")


def percent_text(fraction: float | None) -> str:
    """Format a fraction in per cent; a dash if it is None or not finite."""
    return "–" if fraction is None or not np.isfinite(fraction) else f"{100.0 * fraction:.1f} %"


def span_text(low: float, high: float) -> str:
    """Format an interval of fractions in per cent."""
    return f"{percent_text(low)} – {percent_text(high)}"


def yield_text(found: Yield | PredictedYield | None) -> str:
    """Format a yield with its interval; a dash if there is none."""
    return "–" if found is None else f"{percent_text(found.fraction)} ({span_text(found.low, found.high)})"


def joined(items: Sequence[str]) -> str:
    """Join items as in `a, b and c`."""
    return " and ".join([", ".join(items[:-1]), items[-1]]) if len(items) > 1 else "".join(items)


def counted(count: int, one: str, many: str = "") -> str:
    """Format a count with its noun, as in `1 trial` or `2 trials`."""
    return f"{count:,} {one if count == 1 else many or one + 's'}"
