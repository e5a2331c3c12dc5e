"""Tables as the commands print them."""

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
    """Print a table of columns of words and, behind them, of numbers.

    Parameters
    ----------
    title
        Above the table; none where it is empty.
    words, numbers
        Headings of the columns that are flush left and flush right.
    rows, last
        The cells; `last` below a line.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    heading = visible(title) or None
    table = Table(title=heading, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    # A name that were cut could look like another one, and a number be another: names go on below.
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
