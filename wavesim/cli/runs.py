"""Output of commands: progress, tables, memory estimates and summaries."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lensdesign.common.console import print_whole
from lensdesign.common.progress import progress_count
from lensdesign.common.text import finite_or_none, known_text

if TYPE_CHECKING:
    from wavesim.runtime.memory import Memory
    from wavesim.scene.engine import Engine
    from wavesim.sensor.recording import Progress


@contextmanager
def progress(*, resumes: bool = True) -> Iterator[Progress]:
    """Show the progress, and yield the callback that library functions call.

    An interrupt of a run that does not resume says that its work is lost.
    """
    with progress_count("starting") as count:
        try:
            yield lambda stage, completed, total: count.update(completed, total or None, stage)
        except KeyboardInterrupt as stop:
            if resumes or stop.args:
                raise
            raise KeyboardInterrupt(
                "interrupted; nothing was written, and the same command starts from the beginning"
            ) from None


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


def memory_teller(folder: Path) -> Callable[[Memory], None]:
    """Return a callback that prints the memory estimate of a run to standard error."""
    return lambda memory: print(memory.line(folder), file=sys.stderr)


def engine_summary(engine: Engine, predicted_error: float) -> dict[str, Any]:
    """Return name, settings and predicted error of an engine for JSON."""
    return {
        "name": engine.name,
        "settings": engine.settings(),
        "predicted_error": finite_or_none(predicted_error),
    }


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that results depend on."""
    import platform
    from importlib.metadata import version

    return {"python": platform.python_version()} | {
        name: version(name) for name in ("transferlens", "numpy", "scipy", "finufft")
    }
