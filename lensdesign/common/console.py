"""What the three commands share: one way to fail, to print JSON, and to show progress."""

from __future__ import annotations

import atexit
import errno
import gc
import json
import math
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from lensdesign.common.input_files import files_from
from lensdesign.common.interrupts import stop_status, stoppable
from lensdesign.common.text import visible
from lensdesign.errors import InputError, TransferLensError

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions
    from rich.progress import Progress
    from rich.table import Table


LONGEST_LINE, MOST_LINES = 4000, 60
"""Most characters of a line of an error message, and most lines of it."""


class _Group(TyperGroup):
    """Commands that say so when they are stopped, and exit with the status that shells expect."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            print(stop.args[0] if stop.args else "interrupted", file=sys.stderr)
            raise typer.Exit(stop_status()) from None


def make_app(purpose: str) -> typer.Typer:
    """A Typer application with the looks and the options that all commands have."""
    app = typer.Typer(
        cls=_Group,
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


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"transferlens {version('transferlens')}")
        raise typer.Exit


def run_app(app: typer.Typer) -> None:
    """Run a Typer application; errors of ours become one clear message and exit status 2, warnings a line."""
    # Its last round takes a fifth of a second where much was imported, and frees what ends anyhow.
    atexit.register(gc.freeze)
    try:
        with stoppable(), warnings.catch_warnings():
            warnings.showwarning = _told(warnings.showwarning)
            try:
                app()
            finally:
                if sys.stdout is not None:
                    sys.stdout.flush()
    except TransferLensError as error:
        fail(str(error))
    except OverflowError as error:
        fail(f"a number of the input is too large or too small to compute with: {error.args[-1]}")
    except MemoryError as error:
        fail(f"not enough memory: {error or 'the machine has none left'}; ask for less at a time")
    except OSError as error:
        if error.errno == errno.EPIPE:
            _drop_output()
            raise SystemExit(1) from None
        if error.filename is None and error.errno in (errno.ENOSPC, errno.EIO, errno.EBADF, errno.EFBIG):
            _drop_output()
            fail(f"cannot write to standard output: {error.strerror}")
        named = "" if error.filename is None else f"{os.fsdecode(error.filename)}: "
        fail(f"{named}{error.strerror or error or type(error).__name__}")


def _told(shown: Callable[..., None]) -> Callable[..., None]:
    """Tells warnings of the toolkit without the place in the code; others as they were shown."""

    def show(message: Any, category: type[Warning], *place: Any, **more: Any) -> None:
        if category.__module__.partition(".")[0] in ("lensdesign", "wavesim", "tolerancing"):
            print(f"warning: {visible(str(message))}", file=sys.stderr)
        else:
            shown(message, category, *place, **more)

    return show


def _drop_output() -> None:
    """Keep the interpreter from trying once more, at its end, to write what could not be written."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def fail(message: str) -> None:
    """Print an error message, plainly, and exit with status 2."""
    lines = [visible(line) for line in message.split("\n")]
    # Names and values of files stand in messages, and files may hold anything.
    lines = [line if len(line) <= LONGEST_LINE else f"{line[:LONGEST_LINE]}..." for line in lines]
    if len(lines) > MOST_LINES:
        lines = [*lines[:MOST_LINES], f"and {len(lines) - MOST_LINES} more lines"]
    print("error: " + "\n".join(lines), file=sys.stderr)
    raise SystemExit(2)


def print_json(data: dict[str, Any]) -> None:
    """Print one JSON object, and nothing else, on standard output."""
    try:
        text = json.dumps(data, indent=2, allow_nan=False)
    except ValueError:
        where = ", ".join(_not_finite(data)[:5])
        raise InputError(
            f"no finite result for {where}: numbers of the input are too large or too small to compute with"
        ) from None
    print(text)


def _not_finite(data: Any, name: str = "") -> list[str]:
    """Names of the numbers that are not finite."""
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
    """Have all that is printed meanwhile go to standard error, so that standard output holds results alone.

    Whoever prints: a library, a user's code, and processes that are started meanwhile.
    """
    with redirect_stdout(sys.stderr):
        try:
            kept = os.dup(1)
        except OSError:  # standard output is closed
            yield
            return
        try:
            _lead_to(2)
            yield
        finally:
            _lead_to(kept)
            os.close(kept)


def _lead_to(descriptor: int) -> None:
    """Lead standard output elsewhere, but for what was printed before."""
    if sys.__stdout__ is not None:
        sys.__stdout__.flush()
    with suppress(OSError):  # standard error is closed
        os.dup2(descriptor, 1)


def message_console() -> Console:
    """Console for messages and progress, on standard error, so that standard output stays clean."""
    from rich.console import Console

    return Console(stderr=True)


WIDEST = 100_000
"""Columns of text that no table needs: a limit for measuring how wide a table is."""

NARROWEST = 12
"""Characters that a column of words keeps where a line is too short for whole words."""


def print_whole(*tables: Table, markup: bool = False) -> None:
    """Print rich tables on standard output so that no cell loses a character, one below the other.

    Into a pipe or a file each table is as wide as it needs, so that each row is one line. In a terminal, or
    where `COLUMNS` is set, lines keep to that width: words go on below. A table whose numbers alone need more
    than that is as wide as they need.

    Parameters
    ----------
    *tables
        Rich tables.
    markup
        Whether cells hold rich's markup; else they are printed as they are.
    """
    from rich.console import Console

    plain: dict[str, Any] = {"highlight": False, "markup": markup, "emoji": False}
    console = Console(**plain)
    has_width = console.is_terminal or os.environ.get("COLUMNS", "").isdecimal()
    for table in tables:
        for column in table.columns:
            column.overflow = "fold"
        options = console.options.update(max_width=WIDEST)
        whole = console.measure(table, options=options).maximum
        width = max(console.width, _least_width(table, console, options, whole) if has_width else whole)
        Console(**plain, width=width).print(table, crop=False)


def _least_width(table: Table, console: Console, options: ConsoleOptions, whole: int) -> int:
    """Width of a table whose columns of words are narrow, and whose other columns are whole."""
    spared = 0
    for column in table.columns:
        if not column.no_wrap:
            cells = [column.header, *column.cells] if table.show_header else list(column.cells)
            widest = max((console.measure(cell, options=options).maximum for cell in cells), default=0)
            spared += max(widest - NARROWEST, 0)
    return whole - spared


def progress_bar(*extra_columns: Any) -> Progress:
    """A progress bar on standard error with elapsed and remaining time; silent where there is no terminal.

    It goes away in the end, so that a message of what went wrong stands alone.
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
