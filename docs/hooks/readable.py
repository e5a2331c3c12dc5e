"""Words of code, and numbers with their units in tables, stay whole; pictures open at their full size."""

from __future__ import annotations

import re
from typing import Any

CODE = re.compile(r"<code>([^<\n]+)</code>")
WORD = re.compile(r"\S+")
LONGEST = 40
"""Characters of a word that stays whole, however narrow the page."""

CELL = re.compile(r"(?<=<td>).*?(?=</td>)")
TAGS = re.compile(r"(<code>.*?</code>|<[^>]*>)")
UNIT = r" (?:%|×|[kMG]B|[mµn]m|ms|ns|s|min)(?!\w)"
NUMBER = re.compile(rf"\d[\d.,]*(?:e-\d+(?:{UNIT})?|{UNIT}|-\d\b)")

PICTURE = re.compile(r'(?<=<p>)(<img [^>]*?src="(images/[^"]+)"[^>]*>)')


def on_page_content(html: str, **_: Any) -> str:
    """Put into spans what a line's end must not divide, and pictures that begin a paragraph into links."""
    html = CELL.sub(lambda cell: _numbers_whole(cell[0]), html)
    return PICTURE.sub(r'<a href="\2">\1</a>', CODE.sub(_words_whole, html))


def _words_whole(code: re.Match[str]) -> str:
    words = WORD.sub(lambda m: _whole(m) if len(m[0]) <= LONGEST else m[0], code[1])
    return f"<code>{words}</code>"


def _numbers_whole(cell: str) -> str:
    parts = TAGS.split(cell)
    return "".join(part if i % 2 else NUMBER.sub(_whole, part) for i, part in enumerate(parts))


def _whole(found: re.Match[str]) -> str:
    return f'<span class="whole">{found[0]}</span>'
