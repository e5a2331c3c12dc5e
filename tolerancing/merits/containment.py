"""A user's code kept to its call: whatever it does to leave the program is a fault of the code alone."""

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
    """The code would have ended the process."""


def run_user_code(work: Callable[[], Result], file: str) -> Result:
    """Do what a user's code does.

    Exceptions of every kind become ordinary ones, ``sys.exit`` and ``os._exit`` among them: they would end a
    run with status 0, as if all were done. An interrupt is the user's, and passes.

    Parameters
    ----------
    work
        What to do.
    file
        Name of the code's file.

    Raises
    ------
    TransferLensError
        Whatever the code raised, with its kind and the line of the file, in printable characters.
    """
    try:
        with _process_kept():
            return work()
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise TransferLensError(_told(error, file)) from error


@contextmanager
def _process_kept() -> Iterator[None]:
    """Have ``os._exit`` raise, but for other threads and for processes that the code starts."""
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


def _told(error: BaseException, file: str) -> str:
    """What an exception says, and where; one of a user's may fail even at that."""
    try:
        text = str(error)
    except BaseException:
        text = "it cannot say why"
    if isinstance(error, SystemExit):
        text = f"{text or 0}: asks for the end of the run"
    kind = "" if isinstance(error, TransferLensError | _Ended) else f"{type(error).__name__}: "
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    place = f" ({file}, line {lines[-1]})" if lines and not isinstance(error, TransferLensError) else ""
    return visible(kind + text) + visible(place)
