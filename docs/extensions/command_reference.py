"""The reference of all commands, from the applications themselves: it cannot differ from what they do."""

from __future__ import annotations

import importlib
import inspect
import re
from typing import Any

MARK = re.compile(r"^<!-- commands of (\w+) -->$", re.MULTILINE)


def setup(app: Any) -> dict[str, bool]:
    """Put every command of an application in the place of its mark."""
    app.connect("source-read", _filled)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _filled(app: Any, docname: str, source: list[str]) -> None:
    source[0] = MARK.sub(lambda mark: application(mark[1]), source[0])


def application(package: str) -> str:
    """All commands of one package's application, as Markdown."""
    import typer

    group: Any = typer.main.get_command(importlib.import_module(f"{package}.cli.commands").app)
    context = group.make_context(package, [], resilient_parsing=True)
    names = group.list_commands(context)
    return "\n\n".join(_command(package, name, group.get_command(context, name)) for name in names)


def _command(package: str, name: str, command: Any) -> str:
    from lensdesign.common.help_pages import help_record

    context = command.make_context(f"{package} {name}", [], resilient_parsing=True)
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option"]
    rows = [_row(*help_record(p, context)) for p in arguments]
    for title, members in command.groups(options):
        rows += [f"| **{title}** | | |", *(_row(*help_record(p, context)) for p in members)]
    needed = [help_record(p, context)[0].split(", ")[-1] for p in options if p.required]
    usage = " ".join([*(help_record(p, context)[0] for p in arguments), *needed, "[OPTIONS]"])
    return "\n".join(
        [
            f"### {package} {name}",
            "",
            inspect.cleandoc(command.help),
            "",
            f"    {package} {name} {usage}",
            "",
            "| argument or option | meaning | |",
            "| --- | --- | --- |",
            *rows,
        ]
    )


def _row(names: str, meaning: str) -> str:
    """A row of the table: names, meaning, and what --help has in brackets behind it (default, range)."""
    plain, bracket, notes = meaning.rpartition("  [")
    if not bracket:
        plain, notes = (meaning, "") if not meaning.startswith("[") else ("", meaning[1:])
    return "| " + " | ".join([f"`{_cell(names)}`", _cell(plain), _cell(notes.removesuffix("]"))]) + " |"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", r"\|")
