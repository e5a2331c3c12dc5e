"""Help of commands: options in titled groups, and a short help for commands with many options."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

from typer.core import TyperCommand

from lensdesign.common.option_groups import OptionGroup

MOST_OPTIONS = 15
"""Largest number of options that `--help` shows, itself included."""

HELP_ALL = "--help-all"

ALWAYS_SHOWN = frozenset({HELP_ALL, "--settings"})
"""Options of every command, which its short help shows."""

UNITS = {
    "mm": "mm",
    "um": "µm",
    "nm": "nm",
    "deg": "deg",
    "gb": "GB",
    "seconds": "s",
    "hours": "h",
    "electrons": "electrons",
    "count": "electrons per count",
    "waves": "waves",
}
"""Units by the last word of an option's name."""

# Typer's names of types, which differ between its releases.
VALUES = {
    "float": "NUMBER",
    "int": "INTEGER",
    "integer": "INTEGER",
    "str": "TEXT",
    "text": "TEXT",
    "path": "PATH",
    "range": "",
}

Row = tuple[str, str]


class GroupedCommand(TyperCommand):
    """A command whose help lists the options in titled groups.

    `--help` of a command with many options shows those that its function names by
    :func:`lensdesign.common.option_groups.most_used`. `--help-all` shows all of them.
    """

    def get_help_option_names(self, ctx: Any) -> list[str]:
        """Return the names of the help option."""
        return [*sorted(super().get_help_option_names(ctx), key=len), HELP_ALL]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments; remember which help is requested."""
        ctx.meta[HELP_ALL] = HELP_ALL in args
        return super().parse_args(ctx, args)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the parts of the usage line; names of arguments without the braces of choices."""
        return [
            re.sub(r"^\{(\w+)(\.\.\.)?\}(\.\.\.)?$", r"\1\2", piece)
            for piece in super().collect_usage_pieces(ctx)
        ]

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Write the description of the command."""
        for paragraph in inspect.cleandoc(self.help or "").split("\n\n"):
            formatter.write_paragraph()
            indent = "  "
            formatter.write("\n".join(_wrapped(paragraph, formatter.width, indent)) + "\n")

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options."""
        params = [param for param in self.get_params(ctx) if not getattr(param, "hidden", False)]
        sections: dict[str, list[Row]] = {}
        arguments = [help_record(param, ctx) for param in params if param.param_type_name == "argument"]
        if arguments:
            sections["Arguments"] = arguments
        options = [param for param in params if param.param_type_name == "option"]
        is_long = len(options) > MOST_OPTIONS
        is_short = is_long and not ctx.meta.get(HELP_ALL)
        shown = self._most_used(options) if is_short else options
        for title, members in self.groups(shown):
            rows = sections.setdefault(title, [])
            for param in members:
                if HELP_ALL not in param.opts:
                    rows.append(help_record(param, ctx))
                elif is_long:
                    rows.append(("-h, --help", "Show the most used options and exit."))
                    if not is_short:
                        rows.append((HELP_ALL, "Show all options and exit."))
                else:
                    rows.append((f"-h, --help, {HELP_ALL}", "Show this message and exit."))
        widest = max(len(names) for rows in sections.values() for names, _ in rows)
        for title, rows in sections.items():
            with formatter.section(title):
                for names, text in rows:
                    formatter.write(_lines(names, text, min(widest, 28), formatter.width))
        if is_short:
            formatter.write_paragraph()
            formatter.write(f"More options: {ctx.command_path} {HELP_ALL}\n")

    def groups(self, options: Iterable[Any]) -> list[tuple[str, list[Any]]]:
        """Return titles with their options: titles in the order of :class:`OptionGroup`, most used first."""
        names = getattr(self.callback, "most_used", ())
        members: dict[str, list[Any]] = {}
        for param in sorted(options, key=lambda one: _position(names, one.name)):
            title = OptionGroup.OUTPUT if HELP_ALL in param.opts else param.rich_help_panel or "Options"
            members.setdefault(str(title), []).append(param)
        *first, last = map(str, OptionGroup)
        return [(title, members[title]) for title in (*first, "Options", last) if title in members]

    def _most_used(self, options: list[Any]) -> list[Any]:
        """Return the options of the short help."""
        names = getattr(self.callback, "most_used", [param.name for param in options])
        always = [param for param in options if not ALWAYS_SHOWN.isdisjoint(param.opts)]
        own = [param for param in options if ALWAYS_SHOWN.isdisjoint(param.opts)]
        chosen = [param for param in own if param.name in names][: MOST_OPTIONS - len(always)]
        return [*chosen, *always]


def help_record(param: Any, ctx: Any) -> Row:
    """Return the names of an argument or option with its value, and its text with unit and default."""
    names, text = param.get_help_record(ctx)
    # Older releases of Typer put a backslash before the bracket.
    text = re.sub(r"\[default: \((.*)\)\]$", r"[default: \1]", (text or "").replace("\\[", "["))
    if param.param_type_name == "argument" and param.metavar is not None:
        names = param.metavar
    elif param.metavar is None and not getattr(param, "is_flag", False):
        names = re.sub(r"(?<= )(<.*>(\.\.\.)?|[A-Z ]+)$", lambda found: _value(found[0]), names)
    first, *former = [one for one in param.opts if one.startswith("--")] or [""]
    if HELP_ALL not in param.opts:
        for name in former:  # former names keep working, but the help does not show them
            names = names.replace(f", {name}", "", 1)
    unit = UNITS.get(first.rpartition("-")[2])
    if unit is None or f"in {unit}" in text:
        return names, text
    plain, bracket, notes = text.rpartition("  [")
    return names, f"{plain}  [{unit}; {notes}" if bracket else f"{text}  [{unit}]"


def _value(shown: str) -> str:
    """Return how the help shows a value for which Typer shows its type."""
    inner = re.sub(r"^list\[(.*)\]$", r"\1", shown.removesuffix("...").removeprefix("<").removesuffix(">"))
    if "|" in inner:
        return f"[{inner}]"
    return " ".join(VALUES.get(word.lower(), word.upper()) for word in re.split("[ ,]", inner)).strip()


def _position(names: Sequence[str], name: str) -> int:
    """Return the position of a name among the most used ones; all others follow them."""
    return names.index(name) if name in names else len(names)


def _lines(names: str, text: str, column: int, width: int) -> str:
    """Return one row of a list; long names have a line of their own."""
    indent = " " * (column + 4)
    lines = _wrapped(text, width, indent)
    if lines and len(names) <= column:
        lines[0] = f"  {names:<{column + 2}}{lines[0].lstrip()}"
    else:
        # A long list of choices continues below its first one.
        choices = names.replace("|", "|\0").split("\0")
        first, below = ["  "], " " * (names.rfind(" ") + 4)
        for choice in choices:
            if len(first[-1]) + len(choice) > width:
                first.append(below)
            first[-1] += choice
        lines = first + lines
    return "\n".join(lines) + "\n"


def _wrapped(text: str, width: int, indent: str) -> list[str]:
    """Return the lines of a text, which is broken only at spaces."""
    # Defaults and units in brackets stay together if they are short.
    kept = re.sub(r"\[[^\]]{1,30}\]$", lambda found: found[0].replace(" ", "\0"), " ".join(text.split()))
    lines = textwrap.wrap(
        kept, width, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False
    )
    return [line.replace("\0", " ") for line in lines]
