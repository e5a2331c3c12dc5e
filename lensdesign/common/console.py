"""Common behaviour of all commands: errors, JSON output and progress."""

from __future__ import annotations

import atexit
import codecs
import errno
import gc
import io
import json
import math
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from itertools import accumulate
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer
from typer.core import TyperGroup

from lensdesign.common.input_files import files_from
from lensdesign.common.interrupts import TOLD_ERRORS, stop_status, stoppable
from lensdesign.common.settings_files import SettingsCommand, with_settings_file
from lensdesign.common.text import ASCII_SPELLINGS, printable_name, visible
from lensdesign.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions
    from rich.progress import Progress
    from rich.table import Table


MOST_CHARACTERS, MOST_LINES = 8000, 60
"""Largest length of an error message beyond its first line, and largest number of its lines."""


Contents = Mapping[str, Mapping[str, str]]
"""Titles of groups of commands, with the names of their commands and what each does in a few words."""


class _Group(TyperGroup):
    """Commands in titled groups, which exit after an interrupt with the status that shells expect."""

    contents: ClassVar[Contents] = {}
    former_names: ClassVar[Mapping[str, str]] = {}

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command of a name, which may be a former one."""
        return super().get_command(ctx, self.former_names.get(cmd_name, cmd_name))

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands, in the order of the groups."""
        return [name for commands in self.contents.values() for name in commands]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands in their groups."""
        column = max(map(len, self.list_commands(ctx)))
        for title, commands in self.contents.items():
            with formatter.section(title):
                formatter.write_dl([(f"{name:<{column}}", text) for name, text in commands.items()])

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            print(stop.args[0] if stop.args else "interrupted", file=sys.stderr)
            raise typer.Exit(stop_status()) from None


class _App(typer.Typer):
    """A Typer application whose commands list their options in groups, and read them from files."""

    def command(self, name: str | None = None, *, cls: Any = SettingsCommand, **more: Any) -> Any:
        """Return a decorator that registers a command and returns its function as it is."""
        register = super().command(name, cls=cls, **more)

        def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
            register(with_settings_file(function))
            return function

        return decorate


def make_app(purpose: str, contents: Contents, former_names: Mapping[str, str] | None = None) -> typer.Typer:
    """Return a Typer application with the common settings and options of all commands.

    Parameters
    ----------
    purpose
        What the commands are for, in one sentence.
    contents
        All commands in their groups, as the help lists them.
    former_names
        Former names of commands, which the help does not list, with the present ones.
    """
    app = _App(
        cls=type("_ListedGroup", (_Group,), {"contents": contents, "former_names": former_names or {}}),
        help=purpose,
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )

    @app.callback()
    def common(
        context: typer.Context,
        version: Annotated[
            bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
        ] = False,
        outside_files: Annotated[
            bool,
            typer.Option(
                "--outside-files", help="Let designs and studies name files outside their own folders."
            ),
        ] = False,
    ) -> None:
        """Options of every command."""
        if outside_files:
            context.with_resource(files_from("/"))

    return app


def _show_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version

        typer.echo(f"transferlens {version('transferlens')}")
        raise typer.Exit


def run_app(app: typer.Typer) -> None:
    """Run a Typer application.

    Errors of the toolkit become one message and exit status 2, and its warnings one line each.
    """
    # The last garbage collection would take up to 0.2 s at exit and is not needed.
    atexit.register(gc.freeze)
    _spell_out_missing_characters()
    try:
        with stoppable(), warnings.catch_warnings():
            warnings.showwarning = _short_warnings(warnings.showwarning)
            try:
                app()
            finally:
                if sys.stdout is not None:
                    sys.stdout.flush()
    except TOLD_ERRORS as error:
        fail(_message_of(error))


def _message_of(error: Exception) -> str:
    """Return the message of one of `TOLD_ERRORS`; a closed pipe ends the command silently."""
    match error:
        case OverflowError():
            return f"a number of the input is too large or too small to compute with: {error.args[-1]}"
        case MemoryError():
            return f"not enough memory: {error or 'no memory is free'}; reduce the amount of data"
        case UnicodeEncodeError():
            near = error.object[max(error.start - 60, 0) : error.end + 60]
            return f"{printable_name(near)!r} is not UTF-8 and cannot be written; rename the file or folder"
        case OSError(errno=errno.EPIPE):
            _drop_output()
            raise SystemExit(1) from None
        case OSError(filename=None, errno=errno.ENOSPC | errno.EIO | errno.EBADF | errno.EFBIG):
            _drop_output()
            return f"cannot write to standard output: {error.strerror}"
        case OSError():
            named = "" if error.filename is None else f"{os.fsdecode(error.filename)}: "
            return f"{named}{error.strerror or error or type(error).__name__}"
    return str(error)


def _spell_out_missing_characters() -> None:
    """Let characters that standard output cannot encode, such as ≤ on Windows, be written in ASCII.

    An output that is ASCII alone counts as a wrong setting and gets UTF-8, as Click has it for its messages.
    """

    def spelled_out(error: UnicodeError) -> tuple[str, int]:
        if not isinstance(error, UnicodeEncodeError):
            raise error
        missing = error.object[error.start : error.end]
        return "".join(ASCII_SPELLINGS.get(character, "?") for character in missing), error.end

    codecs.register_error("transferlens.spelled_out", spelled_out)
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        is_ascii = codecs.lookup(sys.stdout.encoding).name == "ascii"
        encoding = "utf-8" if is_ascii else sys.stdout.encoding
        sys.stdout.reconfigure(encoding=encoding, errors="transferlens.spelled_out")


def _short_warnings(default: Callable[..., None]) -> Callable[..., None]:
    """Return a function that shows warnings of the toolkit without their location in the code."""

    def show(message: Any, category: type[Warning], *location: Any, **more: Any) -> None:
        if category.__module__.partition(".")[0] in ("lensdesign", "wavesim", "tolerancing"):
            say("warning:", visible(str(message)), to_errors=True)
        else:
            default(message, category, *location, **more)

    return show


def _drop_output() -> None:
    """Discard the remaining output, so that the interpreter does not try to write it again at exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


HEAD_COLOURS = {"error:": "red", "not met:": "red", "warning:": "yellow", "beyond a guideline:": "yellow"}
"""Colours in which lines begin on a terminal, unless the environment variable NO_COLOR is set."""


def say(head: str, text: str, *, to_errors: bool = False) -> None:
    """Print a line that begins with one of the words of `HEAD_COLOURS`, in its colour on a terminal.

    Parameters
    ----------
    head
        First words of the line.
    text
        The rest of the line.
    to_errors
        Whether the line goes to standard error, and not to standard output.
    """
    coloured = head if os.environ.get("NO_COLOR") else typer.style(head, fg=HEAD_COLOURS[head], bold=True)
    typer.echo(f"{coloured} {text}", err=to_errors)


def fail(message: str) -> None:
    """Print an error message and exit with status 2."""
    # Messages contain names and values from files, which may be arbitrarily long.
    lines = [visible(line) for line in message.split("\n")]
    ends = accumulate(map(len, lines[:MOST_LINES]))
    count = max(1, sum(end <= MOST_CHARACTERS for end in ends))
    shown = lines[:count]
    if count < len(lines):
        shown.append(f"and {len(lines) - count} more lines")
    say("error:", "\n".join(shown), to_errors=True)
    raise SystemExit(2)


def print_json(data: dict[str, Any]) -> None:
    """Print one JSON object on standard output."""
    try:
        text = json.dumps(data, indent=2, allow_nan=False)
    except ValueError:
        names = ", ".join(_not_finite(data)[:5])
        raise InputError(
            f"no finite result for {names}: numbers of the input are too large or too small to compute with"
        ) from None
    print(text)


def _not_finite(data: Any, name: str = "") -> list[str]:
    """Return the names of the numbers that are not finite."""
    if isinstance(data, float):
        return [] if math.isfinite(data) else [name]
    inner: Iterable[tuple[Any, Any]] = ()
    if isinstance(data, dict):
        inner = data.items()
    elif isinstance(data, list | tuple):
        inner = enumerate(data)
    return [found for key, value in inner for found in _not_finite(value, f"{name}.{key}".lstrip("."))]


@contextmanager
def messages_only() -> Iterator[None]:
    """Redirect everything printed inside the block to standard error, also by libraries and child processes.

    Standard output then contains results only.
    """
    with redirect_stdout(sys.stderr):
        try:
            kept = os.dup(1)
        except OSError:  # standard output is closed
            yield
            return
        try:
            _redirect_output(2)
            yield
        finally:
            _redirect_output(kept)
            os.close(kept)


def _redirect_output(descriptor: int) -> None:
    """Redirect standard output to a descriptor after flushing what was printed before."""
    if sys.__stdout__ is not None:
        sys.__stdout__.flush()
    with suppress(OSError):  # standard error is closed
        os.dup2(descriptor, 1)


def message_console() -> Console:
    """Return a console for messages and progress on standard error."""
    from rich.console import Console

    return Console(stderr=True)


def print_whole(*tables: Table, markup: bool = False) -> None:
    """Print rich tables on standard output, one below the other, without cutting any cell.

    In a pipe or a file, each table has its full width, so that each row is one line. In a terminal, or if
    `COLUMNS` is set, words are wrapped to that width, and names only if they do not fit otherwise. A table
    whose numbers need more width exceeds it.

    Parameters
    ----------
    *tables
        Rich tables.
    markup
        Whether cells contain rich's markup; otherwise they are printed literally.
    """
    from rich.console import Console

    plain: dict[str, Any] = {"highlight": False, "markup": markup, "emoji": False}
    console = Console(**plain)
    has_width = console.is_terminal or os.environ.get("COLUMNS", "").isdecimal()
    for table in tables:
        for column in table.columns:
            column.overflow = "fold"
        options = console.options.update(max_width=100_000)  # no limit, to measure the full width
        whole = console.measure(table, options=options).maximum
        # A name that continues on the next line cannot be copied, so it is whole if there is space for it.
        names = [c for c in table.columns if not c.no_wrap and not any(" " in str(cell) for cell in c.cells)]
        for column in names:
            column.no_wrap = True
            if _least_width(table, console, options, whole) > console.width:
                column.no_wrap = False
        width = max(console.width, _least_width(table, console, options, whole) if has_width else whole)
        Console(**plain, width=width).print(table, crop=False)


def _least_width(table: Table, console: Console, options: ConsoleOptions, whole: int) -> int:
    """Return the width of a table with wrapped columns of words and all other columns at full width."""
    saved, narrowest = 0, 12  # a wrapped column keeps at least so many characters
    for column in table.columns:
        if not column.no_wrap:
            cells = [column.header, *column.cells] if table.show_header else list(column.cells)
            widest = max((console.measure(cell, options=options).maximum for cell in cells), default=0)
            saved += max(widest - narrowest, 0)
    return whole - saved


def progress_bar(*extra_columns: Any) -> Progress:
    """Return a progress bar on standard error with elapsed and remaining time; silent without a terminal.

    It disappears at the end, so that only messages remain.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = message_console()
    # Older releases of rich end even a disabled bar with an empty line.
    console.quiet = not console.is_terminal
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
        *extra_columns,
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
