"""Execution of user code: every exception and every attempt to exit becomes an error of that call."""

from __future__ import annotations

import os
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from lensdesign.common.interrupts import END_PROCESS
from lensdesign.common.text import visible
from lensdesign.errors import TransferLensError

Result = TypeVar("Result")


class _Ended(BaseException):
    """Raised if user code tries to end the process."""


def run_user_code(work: Callable[[], Result], file: str) -> Result:
    """Call user code and convert every exception to a TransferLensError.

    This includes ``sys.exit`` and ``os._exit``, which would otherwise end a run with status 0 as if it were
    complete. A KeyboardInterrupt passes unchanged.

    Parameters
    ----------
    work
        Function that calls the user code.
    file
        Name of the file of the user code.

    Raises
    ------
    TransferLensError
        If the code raises. The message has the kind of the exception and the line of the file, in printable
        characters.
    """
    try:
        with _exit_intercepted():
            return work()
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise TransferLensError(_error_message(error, file)) from error


@contextmanager
def _exit_intercepted() -> Iterator[None]:
    """Let ``os._exit`` raise, except in other threads and in processes that the code starts."""
    own = os.getpid(), threading.get_ident()

    def refuse(status: int) -> None:
        if (os.getpid(), threading.get_ident()) != own:
            END_PROCESS(status)
        raise _Ended(f"os._exit({status!r}) would end the run")

    os._exit = refuse  # type: ignore[assignment]
    try:
        yield
    finally:
        os._exit = END_PROCESS


def _error_message(error: BaseException, file: str) -> str:
    """Return the message and line of an exception, whose ``__str__`` may itself fail."""
    try:
        text = str(error)
    except BaseException:
        text = "no message (its __str__ failed)"
    if isinstance(error, SystemExit):
        text = f"{text or 0}: would end the run"
    kind = "" if isinstance(error, TransferLensError | _Ended) else f"{type(error).__name__}: "
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    location = f" ({file}, line {lines[-1]})" if lines and not isinstance(error, TransferLensError) else ""
    return visible(kind + text) + visible(location)
