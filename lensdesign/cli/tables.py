"""Tables in the output of commands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.markup import escape

from lensdesign.common.console import print_whole
from lensdesign.common.text import visible


def table(title: str, *columns: str) -> Any:
    """Return a table; it is at least as wide as its title, up to 100 characters."""
    from rich.table import Table

    shown = visible(title)
    width = min(len(shown), 100)
    table = Table(title=escape(shown) or None, title_justify="left", title_style="bold", min_width=width)
    for column in columns:
        # A truncated name could be mistaken for another one, so it is wrapped instead.
        side: Any = "right" if column in ("value", "limit") else "left"
        table.add_column(column, justify=side, overflow="fold")
    return table


def print_columns(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]], width: int = 80) -> None:
    """Print a table with a column of names and one column for each head, in parts that are not too wide.

    Parameters
    ----------
    title
        Title above the first part.
    heads
        Headings of the columns of values.
    rows
        A name, followed by one value for each heading.
    width
        Largest width of a part in characters; a part has at least one column of values.
    """
    shown = [[visible(cell) for cell in row] for row in rows]
    headings = [visible(head) for head in heads]
    border = 2  # characters between columns
    names = max(len(row[0]) for row in shown)
    begin = 0
    while begin < len(headings):
        used, end = names, begin
        while end < len(headings):
            own = max(len(headings[end]), *(len(row[end + 1]) for row in shown)) + border
            if end > begin and used + own > width:
                break
            used, end = used + own, end + 1
        part = table(title if begin == 0 else "", "", *headings[begin:end])
        part.box, part.pad_edge = SIMPLE_HEAD, False
        for column in part.columns[1:]:
            column.justify = "right"
        for row in shown:
            values = row[begin + 1 : end + 1]
            if any(value.strip() for value in values):
                part.add_row(*map(escape, (row[0], *values)))
        print_tables(part)
        begin = end


def print_tables(*tables: Any) -> None:
    """Print tables, one below the other."""
    print_whole(*tables, markup=True)
