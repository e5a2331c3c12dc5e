"""Tables of the command line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from lensdesign.common.console import print_whole
from lensdesign.common.text import known_text, visible


def print_table(
    title: str,
    words: Sequence[str],
    numbers: Sequence[str],
    rows: Iterable[Sequence[str]],
    last: Sequence[str] = (),
) -> None:
    """Print a table with columns of text, followed by columns of numbers.

    Parameters
    ----------
    title
        Title above the table; no title if it is empty.
    words, numbers
        Headings of the left-aligned text columns, and of the right-aligned number columns.
    rows, last
        Cells of the rows; `last` is a row of totals below a line.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    heading = visible(title) or None
    table = Table(title=heading, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    # A truncated name could look like another name, so names wrap and numbers never do.
    for name in words:
        table.add_column(name, overflow="fold")
    for name in numbers:
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*map(known_text, row))
    if last:
        table.add_section()
        table.add_row(*map(known_text, last))
    print_whole(table)
