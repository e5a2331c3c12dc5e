"""Background jobs in a child process, with progress and cancellation."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable
from typing import Any

from lensdesign.errors import TransferLensError


class Job:
    """A function that runs in a child process.

    Parameters
    ----------
    work
        Function to call with `arguments` and a progress callback that takes a line of text. The function, the
        arguments and the result must be picklable.
    arguments
        Arguments of the function.
    on_change
        Called in a thread of this process after each line and at the end.

    Attributes
    ----------
    lines
        Lines of progress so far.
    state
        ``running``, ``done``, ``failed`` or ``cancelled``.
    result
        Result of the function; if it failed, the reason.
    """

    def __init__(
        self, work: Callable[..., Any], arguments: tuple[Any, ...], on_change: Callable[[], None]
    ) -> None:
        context = multiprocessing.get_context("spawn")
        self.state = "running"
        self.lines: list[str] = []
        self.result: Any = None
        self._on_change = on_change
        self._messages, sending = context.Pipe(duplex=False)
        self._process = context.Process(target=_run, args=(work, arguments, sending), daemon=True)
        self._process.start()
        sending.close()  # only the process has the other end, so that its death ends a message, too
        threading.Thread(target=self._follow, daemon=True, name="job").start()

    @property
    def progress(self) -> str:
        """Last line of progress; empty at the start."""
        return self.lines[-1] if self.lines else ""

    def cancel(self) -> None:
        """Stop the job and discard its work."""
        if self.state == "running":
            self.state = "cancelled"
            self._process.terminate()
            self._on_change()

    def _follow(self) -> None:
        while self.state == "running":
            try:
                if not self._messages.poll(0.2):
                    continue
                kind, value = self._messages.recv()
            except (EOFError, OSError):
                self._end("failed", "the process ended before its work was done")
                continue
            if kind == "line":
                self.lines.append(value)
                self._on_change()
            else:
                self._end(kind, value)
        self._process.join()
        self._messages.close()

    def _end(self, state: str, result: Any) -> None:
        if self.state == "running":
            self.state, self.result = state, result
            self._on_change()


def _run(work: Callable[..., Any], arguments: tuple[Any, ...], messages: Any) -> None:
    """Run the work in the child process, and send its progress and result."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        messages.send(("done", work(*arguments, lambda line: messages.send(("line", line)))))
    except TransferLensError as error:
        messages.send(("failed", str(error)))


def _end_with_parent() -> None:
    """End this process when its parent ends, because nobody waits for the result any more."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
