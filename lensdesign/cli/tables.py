"""Tables in the output of commands."""

from __future__ import annotations

from typing import Any

from lensdesign.common.console import print_whole
from lensdesign.common.text import visible


def table(title: str, *columns: str) -> Any:
    """Return a table; it is at least as wide as its title, up to 100 characters."""
    from rich.markup import escape
    from rich.table import Table

    shown = visible(title)
    width = min(len(shown), 100)
    table = Table(title=escape(shown) or None, title_justify="left", title_style="bold", min_width=width)
    for column in columns:
        # A truncated name could be mistaken for another one, so it is wrapped instead.
        side: Any = "right" if column in ("value", "limit") else "left"
        table.add_column(column, justify=side, overflow="fold")
    return table


def print_tables(*tables: Any) -> None:
    """Print tables, one below the other."""
    print_whole(*tables, markup=True)
