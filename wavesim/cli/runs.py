"""The runner of all commands that compute a result, and what they print: progress, tables, memory."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lensdesign.common.console import print_json, print_whole
from lensdesign.common.progress import progress_count
from lensdesign.common.text import known_text
from wavesim.cli.options import print_warnings, warning_messages
from wavesim.runtime.checkpoint import series_in

if TYPE_CHECKING:
    from wavesim.runtime.memory import Memory
    from wavesim.sensor.recording import Progress


CONTINUES = "interrupted; run the same command again to continue"
LOST = "interrupted; nothing was written, and the same command starts from the beginning"


class Run:
    """A run of a command: progress and warnings while it computes; then its report and exit status.

    Parameters
    ----------
    as_json
        Whether the result is printed as JSON.
    resumes
        Whether an interrupted run continues; its interrupts say what was kept.
    folder
        Folder of the checkpoints of a run that continues if it has any (`CheckpointSeries`).
    """

    def __init__(self, as_json: bool, *, resumes: bool = True, folder: Path | None = None) -> None:
        self.as_json, self.resumes, self.folder = as_json, resumes, folder
        self._caught: list[warnings.WarningMessage] = []

    @property
    def messages(self) -> list[str]:
        """Warnings so far, each of them once."""
        return warning_messages(self._caught)

    def tells_memory(self, folder: Path) -> Callable[[Memory], None] | None:
        """Return a callback that prints the memory estimate to standard error; None for JSON."""
        return None if self.as_json else lambda memory: print(memory.line(folder), file=sys.stderr)

    @contextmanager
    def warnings(self) -> Iterator[None]:
        """Collect the warnings of what is computed."""
        with warnings.catch_warnings(record=True) as self._caught:
            warnings.simplefilter("always")
            yield

    @contextmanager
    def computing(self) -> Iterator[Progress]:
        """Show the progress, collect warnings, and print them at the end; yield the callback of progress."""
        with progress(self._on_interrupt) as on_progress, self.warnings():
            yield on_progress
        print_warnings(self.messages)

    def _on_interrupt(self) -> str:
        """Return what an interrupt means for the run; empty where it says so itself."""
        if self.folder is not None:
            return CONTINUES if series_in(self.folder) else LOST
        return "" if self.resumes else LOST

    def report(
        self, summary: dict[str, Any], show: Callable[[dict[str, Any]], None], is_met: bool = True
    ) -> None:
        """Print the result as JSON, or by `show`; the exit status is 1 if it does not meet what is judged."""
        if self.as_json:
            print_json(summary)
        else:
            show(summary)
        if not is_met:
            raise typer.Exit(1)


@contextmanager
def progress(on_interrupt: Callable[[], str] = str) -> Iterator[Progress]:
    """Show the progress, and yield the callback that library functions call.

    An interrupt without a message gets that of `on_interrupt`, if it is not empty.
    """
    with progress_count("starting") as count:
        try:
            yield lambda stage, completed, total: count.update(completed, total or None, stage)
        except KeyboardInterrupt as stop:
            text = on_interrupt()
            if stop.args or not text:
                raise
            raise KeyboardInterrupt(text) from None


def print_table(
    words: Sequence[str],
    numbers: Sequence[str],
    rows: Iterable[Sequence[str]],
    title: str = "",
    notes: str | None = None,
) -> None:
    """Print a table with left-aligned text columns, right-aligned number columns, and notes.

    Parameters
    ----------
    words, numbers
        Headings of the text and of the number columns.
    rows
        Cells of the rows.
    title
        Title above the table.
    notes
        Heading of a last text column; None for no such column.
    """
    from rich.table import Table

    table = Table(box=None, pad_edge=False, title=title or None, title_justify="left")
    # A truncated name could look like another name, so names wrap and numbers never do.
    for name in words:
        table.add_column(name, overflow="fold")
    for name in numbers:
        table.add_column(name, justify="right", no_wrap=True)
    if notes is not None:
        table.add_column(notes, overflow="fold")
    for row in rows:
        table.add_row(*map(known_text, row))
    print_whole(table)
