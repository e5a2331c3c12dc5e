"""What the three commands share: one way to fail, to print JSON, and to show progress."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.errors import TransferLensError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress


def make_app(purpose: str) -> typer.Typer:
    """A Typer application with the looks and the options that all commands have."""
    app = typer.Typer(
        help=purpose,
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )

    @app.callback()
    def common(
        version: Annotated[
            bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
        ] = False,
    ) -> None:
        """Options of every command."""

    return app


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"transferlens {version('transferlens')}")
        raise typer.Exit


def run_app(app: typer.Typer) -> None:
    """Run a Typer application; our own errors become one clear message and exit status 2.

    An interrupt exits with status 130, as shells expect.
    """
    try:
        app()
    except TransferLensError as error:
        fail(str(error))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        raise SystemExit(130) from None


def fail(message: str) -> None:
    """Print an error message, plainly, and exit with status 2."""
    print(f"error: {message}", file=sys.stderr)
    raise SystemExit(2)


def print_json(data: dict[str, Any]) -> None:
    """Print one JSON object, and nothing else, on standard output."""
    print(json.dumps(data, indent=2, allow_nan=False))


def message_console() -> Console:
    """Console for messages and progress, on standard error, so that standard output stays clean."""
    from rich.console import Console

    return Console(stderr=True)


def progress_bar(*extra_columns: Any) -> Progress:
    """A progress bar on standard error with elapsed and remaining time; silent where there is no terminal."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
        *extra_columns,
        console=message_console(),
    )
