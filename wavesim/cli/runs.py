"""What commands tell of a run: before it, while it goes on, and in its summary."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lensdesign.common.console import print_whole, progress_bar
from lensdesign.common.text import finite_or_none, known_text

if TYPE_CHECKING:
    from wavesim.runtime.memory import Memory
    from wavesim.scene.engine import Engine
    from wavesim.sensor.recording import Progress


@contextmanager
def progress() -> Iterator[Progress]:
    """A bar, as library functions tell their progress."""
    with progress_bar() as bar:
        tasks: list[Any] = []

        def tell(what: str, done: int, count: int) -> None:
            if not tasks:
                tasks.append(bar.add_task(what, total=None))
            bar.update(tasks[0], completed=done, total=count or None, description=what)

        yield tell


def print_table(
    words: Sequence[str],
    numbers: Sequence[str],
    rows: Iterable[Sequence[str]],
    title: str = "",
    notes: str | None = None,
) -> None:
    """Print a table of columns of words, flush left, behind them of numbers, flush right, and of notes.

    Parameters
    ----------
    words, numbers
        Headings of the columns.
    rows
        Cells.
    title
        Above the table.
    notes
        Heading of a last column of words; None where there is none.
    """
    from rich.table import Table

    table = Table(box=None, pad_edge=False, title=title or None, title_justify="left")
    # A name that were cut could look like another one, and a number be another: names go on below.
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
    """Tells on standard error what a run will take."""
    return lambda memory: print(memory.line(folder), file=sys.stderr)


def engine_summary(engine: Engine, predicted_error: float) -> dict[str, Any]:
    """What an engine is, and what it says of its error, ready for JSON."""
    return {
        "name": engine.name,
        "settings": engine.settings(),
        "predicted_error": finite_or_none(predicted_error),
    }


def versions() -> dict[str, str]:
    """Versions of what results depend on."""
    import platform
    from importlib.metadata import version

    return {"python": platform.python_version()} | {
        name: version(name) for name in ("transferlens", "numpy", "scipy", "finufft")
    }
