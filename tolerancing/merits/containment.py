"""A user's code kept to its call: whatever it does to leave the program is a fault of the code alone."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import TypeVar

from lensdesign.common.text import visible
from lensdesign.errors import TransferLensError

Result = TypeVar("Result")


def run_user_code(work: Callable[[], Result], file: str) -> Result:
    """Do what a user's code does.

    Exceptions of every kind become ordinary ones, ``sys.exit`` among them: it would end a run with status 0,
    as if all were done. An interrupt is the user's, and passes.

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
        return work()
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise TransferLensError(_told(error, file)) from error


def _told(error: BaseException, file: str) -> str:
    """What an exception says, and where; one of a user's may fail even at that."""
    try:
        text = str(error)
    except BaseException:
        text = "it cannot say why"
    if isinstance(error, SystemExit):
        text = f"{text or 0}: asks for the end of the run"
    kind = "" if isinstance(error, TransferLensError) else f"{type(error).__name__}: "
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    place = f" ({file}, line {lines[-1]})" if lines and not isinstance(error, TransferLensError) else ""
    return visible(kind + text) + visible(place)
