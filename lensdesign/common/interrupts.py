"""Signals that end a command: it stops in an orderly way and reports what has been saved."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from lensdesign.common.atomic_files import UNFINISHED
from lensdesign.errors import TransferLensError

REPEAT_SECONDS = 1.0
"""Time after the first signal in which repeated signals are ignored, since a key may be pressed twice."""

GRACE_SECONDS = 10.0
"""Time limit for an orderly stop; after it, the process ends immediately."""

TOLD_ERRORS = (TransferLensError, OSError, MemoryError, OverflowError, UnicodeEncodeError)
"""Errors of which :func:`lensdesign.common.console.run_app` makes a message for the user."""


class _Stop:
    """State of the first signal, and handling of later ones."""

    def __init__(self, others: Callable[[Any], object]) -> None:
        self.others = others
        self.number: int | None = None
        self.at = 0.0
        self.is_swallowed = False

    def handle_signal(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal."""
        if self.number is None:
            self.number, self.at = number, time.monotonic()
            last = threading.Timer(GRACE_SECONDS, self.end_at_once)
            last.daemon = True
            last.start()
            raise KeyboardInterrupt
        if self.is_swallowed:
            self.is_swallowed = False
            raise KeyboardInterrupt
        if time.monotonic() - self.at > REPEAT_SECONDS:
            self.end_at_once()

    def reraise_interrupt(self, unraisable: Any) -> None:
        """Raise an interrupt again that occurred where it cannot propagate, as in callbacks of a compiler.

        Other exceptions are passed to `others`, the previous hook.
        """
        if self.number is None or not issubclass(unraisable.exc_type, KeyboardInterrupt):
            self.others(unraisable)
            return
        self.is_swallowed = True
        # An interrupt that a callback has swallowed is raised again after 0.05 s.
        threading.Timer(0.05, signal.pthread_kill, (threading.main_thread().ident, self.number)).start()

    def end_at_once(self) -> None:
        """End the process immediately; workers end with the process that started them."""
        _remove_unfinished()
        os.write(2, b"interrupted; ended without an orderly stop\n")
        os._exit(self.status)

    @property
    def status(self) -> int:
        """Exit status that shells expect."""
        return 128 + (self.number or signal.SIGINT)


def _remove_unfinished() -> None:
    """Remove unfinished files and folders."""
    for path in list(UNFINISHED):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                path.unlink(missing_ok=True)
        UNFINISHED.discard(path)


_stop: _Stop | None = None


def stop_status() -> int:
    """Return the exit status of an interrupted command."""
    return _stop.status if _stop else 128 + signal.SIGINT


@contextmanager
def stoppable() -> Iterator[None]:
    """Make signals that end a command raise KeyboardInterrupt once; exit with its status if not caught.

    A nested use, and a use in another thread than the main one, have no effect.
    """
    global _stop
    if _stop is not None or threading.current_thread() is not threading.main_thread():
        yield
        return
    _stop = _Stop(sys.unraisablehook)
    signals = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    previous = {number: signal.getsignal(number) for number in signals}
    sys.unraisablehook = _stop.reraise_interrupt
    for number, handler in previous.items():
        # Signals stay ignored if a shell (background command) or nohup has set that.
        if handler != signal.SIG_IGN:
            signal.signal(number, _stop.handle_signal)
    try:
        yield
    except (KeyboardInterrupt, Exception) as error:
        stop = _interrupt_in(error, _stop.number)
        if stop is None:
            raise
        print(stop.args[0] if stop.args else "interrupted", file=sys.stderr)
        raise SystemExit(_stop.status) from None
    finally:
        _remove_unfinished()
        for number, handler in previous.items():
            signal.signal(number, handler)
        if _stop.number is not None:
            _clear_interrupted_code()
        sys.unraisablehook, _stop = _stop.others, None


def _interrupt_in(error: BaseException, number: int | None) -> KeyboardInterrupt | None:
    """Return the interrupt that caused an error, or None.

    Before version 3.12, Python converts an exception in `__set_name__` to a RuntimeError. Libraries
    that catch everything, as some do while they import their parts, raise other errors in its place, and
    compiled ones do so without naming the cause. An unexpected error after signal `number` therefore counts
    as caused by it, but not an error with a message for the user.
    """
    found: BaseException | None = error
    while found is not None and not isinstance(found, KeyboardInterrupt):
        found = found.__cause__ or found.__context__
    if found is None and number is not None and not isinstance(error, TOLD_ERRORS):
        return KeyboardInterrupt()
    return found


def _clear_interrupted_code() -> None:
    """Make Python exit with the given status after an interrupt inside `exec`.

    Python remembers that an interrupt has left code in a string (such as that of a dataclass) until it
    executes other code. It would otherwise exit as if the interrupt had not been caught.
    """
    exec("")
