"""How results show themselves in a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from lensdesign.common.text import visible


def html_table(title: str, rows: Sequence[tuple[str, str]], picture: str = "") -> str:
    """A titled table of names and values as HTML, for a ``_repr_html_``.

    Parameters
    ----------
    title
        Above the table; nothing where it is empty.
    rows
        Name and value of each line, as text.
    picture
        Markup set below the table, such as an SVG element; the only part that is not escaped.
    """
    heading = f"<caption>{escape(visible(title))}</caption>" if title else ""
    lines = (
        f"<tr><th style='text-align:left'>{escape(visible(name))}</th>"
        f"<td style='text-align:left'>{escape(visible(value))}</td></tr>"
        for name, value in rows
    )
    return f"<table>{heading}{''.join(lines)}</table>{picture}"
