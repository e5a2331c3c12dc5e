"""Tables as the commands print them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from lensdesign.common.text import visible


def print_table(
    title: str,
    words: Sequence[str],
    numbers: Sequence[str],
    rows: Iterable[Sequence[str]],
    last: Sequence[str] = (),
    *,
    no_wrap: bool = False,
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
    no_wrap
        Whether the first column keeps its width.
    """
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    heading = escape(visible(title)) or None
    table = Table(title=heading, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for k, name in enumerate(words):
        table.add_column(name, no_wrap=no_wrap and k == 0)
    for name in numbers:
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(*row)
    if last:
        table.add_section()
        table.add_row(*last)
    Console().print(table)
