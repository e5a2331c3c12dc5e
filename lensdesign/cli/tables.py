"""Tables as the commands print them."""

from __future__ import annotations

from typing import Any

from lensdesign.common.console import print_whole
from lensdesign.common.text import visible

WIDEST_TITLE = 100
"""Up to which a table is made as wide as its title."""


def table(title: str, *columns: str) -> Any:
    """A table whose title may be longer than its columns."""
    from rich.markup import escape
    from rich.table import Table

    shown = visible(title)
    width = min(len(shown), WIDEST_TITLE)
    table = Table(title=escape(shown) or None, title_justify="left", title_style="bold", min_width=width)
    for column in columns:
        # A name that were cut could look like another one: it goes on below.
        side: Any = "right" if column in ("value", "limit") else "left"
        table.add_column(column, justify=side, overflow="fold")
    return table


def print_tables(*tables: Any) -> None:
    """Print tables, one below the other."""
    print_whole(*tables, markup=True)
