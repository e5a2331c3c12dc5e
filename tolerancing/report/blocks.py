"""What a report is made of, whatever it is rendered to: headings, tables, figures; and numbers in words."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LONGEST_CELL = 600
"""Characters of a cell; what is longer stands in the store."""

CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")
"""Characters that neither HTML nor a page of paper can show."""

UNIT_UM = re.compile(r"(?<=\d )um\b|(?<=\()um(?=\))")
"""Behind a number, or as the unit of a heading; names of columns stay."""

Align = Literal["left", "right"]


@dataclass(frozen=True)
class Heading:
    """Title of a section (level 2) or of a part of one (level 3)."""

    text: str
    level: Literal[2, 3] = 2


@dataclass(frozen=True)
class Paragraph:
    """Some sentences; `soft` ones explain what stands beside them."""

    text: str
    soft: bool = False


@dataclass(frozen=True)
class Warning:
    """What the reader must know before believing the rest."""

    text: str


@dataclass(frozen=True)
class Headline:
    """The one number of the report, whether it is good, and what it means."""

    number: str
    verdict: str
    text: str
    failed: bool


@dataclass(frozen=True)
class Facts:
    """Short facts, each with its name."""

    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Cell:
    """A table's cell that is more than text.

    Attributes
    ----------
    text
        What it says.
    failed
        Whether that is beyond a limit.
    bar
        Share, and the ends of its interval, to draw as a bar.
    """

    text: str
    failed: bool = False
    bar: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Column:
    """Title of a table's column, and to which side its cells are set."""

    title: str
    align: Align = "right"


@dataclass(frozen=True)
class Table:
    """A table; a plain string is a cell without more."""

    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell | str, ...], ...]
    caption: str = ""

    def cells(self) -> list[list[Cell]]:
        """All rows, cut to `LONGEST_CELL` characters a cell."""
        cells = [[c if isinstance(c, Cell) else Cell(cut(c)) for c in row] for row in self.rows]
        return [[replace(cell, text=in_micrometres(cell.text)) for cell in row] for row in cells]


@dataclass(frozen=True, eq=False)
class Panel:
    """One figure.

    Attributes
    ----------
    figure
        Drawn by matplotlib.
    alt
        What it shows, for who cannot see it.
    points
        By the gid of a collection of markers in the figure: numbers of the trials that they stand for, in the
        order in which they are drawn.
    """

    figure: Figure
    alt: str
    points: Mapping[str, Sequence[int]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class FigureBlock:
    """Panels in rows of so many, as far as the page is wide enough."""

    panels: tuple[Panel, ...]
    columns: int = 1
    caption: str = ""


@dataclass(frozen=True)
class Code:
    """Text that stands as it is."""

    text: str


Block = Heading | Paragraph | Warning | Headline | Facts | Table | FigureBlock | Code


@dataclass(frozen=True)
class Report:
    """All of a report.

    Attributes
    ----------
    title
        Of the study.
    subtitle
        A line below it.
    blocks
        Its content, in order.
    trials : mapping of int to str
        What the points of figures say when they are pointed at, by trial.
    footer
        What stands at the end.
    """

    title: str
    subtitle: str
    blocks: tuple[Block, ...]
    trials: Mapping[int, str]
    footer: str


def plain(text: str) -> str:
    """Text without characters that cannot be shown."""
    return CONTROL.sub("�", text)


def in_micrometres(text: str) -> str:
    """A text for people: the unit that files write as um."""
    return UNIT_UM.sub("µm", text)


def cut(text: str, most: int = LONGEST_CELL) -> str:
    """Text of at most so many characters."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def table(headings: Sequence[str], rows: Sequence[Sequence[Cell | str]], caption: str = "") -> Table:
    """A table whose headings that start with ``<`` stand over text, the others over numbers."""
    titles = [in_micrometres(heading) for heading in headings]
    columns = tuple(Column(t.removeprefix("<"), "left" if t.startswith("<") else "right") for t in titles)
    return Table(columns, tuple(tuple(row) for row in rows), caption)


def number_text(value: float | None, digits: int = 4) -> str:
    """A number with so many digits; a dash where there is none."""
    if value is None or np.isnan(value):
        return "–"
    if np.isinf(value):
        return "∞" if value > 0.0 else "−∞"
    return f"{value:.{digits}g}".replace("-", "−")


def signed_text(value: float | None) -> str:
    """A number with its sign; a dash where there is none."""
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:+.3g}".replace("-", "−")


def percent_text(share: float | None) -> str:
    """A share in per cent; a dash where there is none."""
    return "–" if share is None or not np.isfinite(share) else f"{100.0 * share:.1f} %"


def span_text(low: float, high: float) -> str:
    """An interval of shares."""
    return f"{percent_text(low)} – {percent_text(high)}"


def joined(items: Sequence[str]) -> str:
    """`a, b and c`."""
    return " and ".join([", ".join(items[:-1]), items[-1]]) if len(items) > 1 else "".join(items)


def counted(count: int, one: str, many: str = "") -> str:
    """`1 trial`, `2 trials`."""
    return f"{count:,} {one if count == 1 else many or one + 's'}"
