"""Names and commands in the text as links: to the reference, and to the page of commands."""

from __future__ import annotations

import importlib
import re
from functools import cache
from typing import Any

FENCE = re.compile(r"(^```.*?^```$)", re.DOTALL | re.MULTILINE)
DOTTED = re.compile(r"(?<![`\[])`((?:lensdesign|wavesim|tolerancing)\.\w[\w.]*)`(?!`)")
COMMAND = re.compile(r"(?<![`\[])`(lensdesign|wavesim|tolerancing) ([a-z-]+)\b([^`]*)`(?!`)")
BARE = re.compile(r"(?<![`\[])`(\w+)`(?!`)")
ROLE = re.compile(r":(?:class|func|meth|mod|attr|exc|data):<code>~?([\w.]+)(?:\(\))?</code>")
# Pages on which a public name of a package, by itself, means just that.
PACKAGE_OF_PAGE = {"engines.md": "wavesim", "reconstruction.md": "wavesim"}


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Link what stands between backticks, outside fenced blocks, where there is something to link to."""
    uri = page.file.src_uri
    if "/" in uri or uri == "commands.md":
        return markdown
    parts = FENCE.split(markdown)
    return "".join(part if i % 2 else _linked(part, PACKAGE_OF_PAGE.get(uri)) for i, part in enumerate(parts))


def on_page_content(html: str, **_: Any) -> str:
    """Link what docstrings name by a role, such as a class."""
    return ROLE.sub(lambda m: _reference(m[1], m[1]), html)


def _linked(text: str, package: str | None) -> str:
    text = COMMAND.sub(_command, text)
    if package is not None:
        names = importlib.import_module(package).__all__
        text = BARE.sub(lambda m: _reference(f"{package}.{m[1]}", m[1]) if m[1] in names else m[0], text)
    return DOTTED.sub(lambda m: _reference(m[1], m[1]), text)


def _reference(identifier: str, shown: str) -> str:
    return f'<autoref optional identifier="{identifier}"><code>{shown}</code></autoref>'


def _command(found: re.Match[str]) -> str:
    if found[2] not in _commands(found[1]):
        return found[0]
    return f"[{found[0]}](commands.md#{found[1]}-{found[2]})"


@cache
def _commands(package: str) -> frozenset[str]:
    import typer

    group: Any = typer.main.get_command(importlib.import_module(f"{package}.cli.commands").app)
    return frozenset(group.commands)
