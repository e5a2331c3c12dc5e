"""Calls of a user's Python code in which every exception becomes a failure of the trial."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import TypeVar

from lensdesign.common.text import visible
from lensdesign.errors import TransferLensError

Result = TypeVar("Result")


def run_user_code(work: Callable[[], Result], file: str) -> Result:
    """Call a user's code and return its result.

    Exceptions of every kind become a TransferLensError. This includes ``sys.exit``, which would otherwise end
    a run with status 0, as if all trials were done. KeyboardInterrupt passes, because it comes from the user.
    Code that ends the process itself (``os._exit``, a signal) is handled by the pool of workers.

    Parameters
    ----------
    work
        Function to call.
    file
        Name of the file with the code.

    Raises
    ------
    TransferLensError
        If the code raises an exception. The message holds the type of the exception and the line of the
        file, in printable characters.
    """
    try:
        return work()
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise TransferLensError(_error_text(error, file)) from error


def _error_text(error: BaseException, file: str) -> str:
    """Return the message, type and line of an exception. An exception of a user may fail even at that."""
    try:
        text = str(error)
    except BaseException:
        text = "no message (its __str__ failed)"
    if isinstance(error, SystemExit):
        text = f"{text or 0}: a merit must not end the run"
    kind = "" if isinstance(error, TransferLensError) else f"{type(error).__name__}: "
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    location = f" ({file}, line {lines[-1]})" if lines and not isinstance(error, TransferLensError) else ""
    return visible(kind + text) + visible(location)
