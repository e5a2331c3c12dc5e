"""Progress on standard error: a live line in a terminal, otherwise a line every ten seconds."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from lensdesign.common.console import message_console, progress_bar
from lensdesign.common.deadlines import now
from lensdesign.common.text import visible

if TYPE_CHECKING:
    from rich.progress import Progress


LINE_INTERVAL_S = 10.0
"""Time between two lines if standard error is not a terminal."""


class ProgressLines:
    """Prints the current text every ten seconds, with the elapsed time.

    Parameters
    ----------
    text
        Text at the beginning.
    """

    def __init__(self, text: str) -> None:
        self._text, self._began, self._ended = text, now(), threading.Event()
        self._thread = threading.Thread(target=self._print, daemon=True, name="progress")

    def update(self, text: str) -> None:
        """Replace the text."""
        self._text = text

    def __enter__(self) -> ProgressLines:
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._ended.set()
        self._thread.join(1.0)

    def _print(self) -> None:
        while not self._ended.wait(LINE_INTERVAL_S):
            print(f"{now() - self._began:.0f} s: {visible(self._text)}", file=sys.stderr, flush=True)


@contextmanager
def progress_text(text: str) -> Iterator[Any]:
    """Show a text, which `update` replaces, until the block ends."""
    console = message_console()
    if console.is_terminal:
        with console.status(text) as status:
            yield status
    else:
        with ProgressLines(text) as lines:
            yield lines


class ProgressCount:
    """Progress in completed steps: a bar in a terminal, otherwise a line every ten seconds."""

    def __init__(self, lines: ProgressLines | None, bar: Progress | None, what: str) -> None:
        self._lines, self._bar, self._began = lines, bar, now()
        self._first: int | None = None
        self._done = 0
        self._total: int | None = None
        self._task = None if bar is None else bar.add_task(what, total=None)

    def advance(self, more: int, total: int | None, what: str) -> None:
        """Show that some more steps are completed; the total number may be unknown."""
        self.update(self._done + more, total, what)

    def update(self, done: int, total: int | None, what: str) -> None:
        """Show the completed and the total number of steps, if it is known, and the name of the next one.

        A stage begins where fewer steps are completed than before, or none of another total number. The
        remaining time is that of the stage.
        """
        if done < self._done or (done == 0 and total != self._total):
            self._first, self._began = None, now()
            if self._bar is not None and self._task is not None:
                self._bar.remove_task(self._task)
                self._task = self._bar.add_task(visible(what), total=total)
        self._done, self._total = done, total
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=done, total=total, description=visible(what))
        if self._lines is not None:
            self._first = done if self._first is None else self._first
            made = done - self._first
            left = ""
            if made and total is not None:
                left = f", about {(now() - self._began) / made * (total - done):.0f} s more"
            count = "" if not done else f": {done}"
            if total is not None:
                count = f": {done} of {total}"
            self._lines.update(f"{what}{count}{left}")


@contextmanager
def progress_count(what: str) -> Iterator[ProgressCount]:
    """Show the progress of some steps until the block ends."""
    if message_console().is_terminal:
        with progress_bar() as bar:
            yield ProgressCount(None, bar, what)
    else:
        with ProgressLines(what) as lines:
            yield ProgressCount(lines, None, what)
