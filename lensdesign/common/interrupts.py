"""Interrupts, terminations and hang-ups end a command alike: it unwinds, and says what is kept."""

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

from lensdesign.errors import UNFINISHED

SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]

NERVOUS_SECONDS = 1.0
"""After the first signal, in which others are not heeded: keys are pressed twice, groups signalled as one."""

GRACE_SECONDS = 10.0
"""In which a command must have unwound; what holds it up then is left behind."""

LOST_SECONDS = 0.05
"""After which an interrupt is raised again that a callback has swallowed."""


class _Stop:
    """The first signal, and what becomes of those that follow."""

    def __init__(self, others: Callable[[Any], object]) -> None:
        self.others = others
        self.number: int | None = None
        self.at = 0.0
        self.lost = False

    def heed(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal."""
        if self.number is None:
            self.number, self.at = number, time.monotonic()
            last = threading.Timer(GRACE_SECONDS, self.end_at_once)
            last.daemon = True
            last.start()
            raise KeyboardInterrupt
        if self.lost:
            self.lost = False
            raise KeyboardInterrupt
        if time.monotonic() - self.at > NERVOUS_SECONDS:
            self.end_at_once()

    def swallowed(self, told: Any) -> None:
        """Raise an interrupt again that came up where none can be raised, as in callbacks of a compiler.

        Other faults go to `others`, the hook that was there before.
        """
        if self.number is None or not issubclass(told.exc_type, KeyboardInterrupt):
            self.others(told)
            return
        self.lost = True
        threading.Timer(
            LOST_SECONDS, signal.pthread_kill, (threading.main_thread().ident, self.number)
        ).start()

    def end_at_once(self) -> None:
        """End without unwinding; workers end with the process that started them."""
        _sweep()
        os.write(2, b"interrupted; ended before all had come to its end\n")
        os._exit(self.status)

    @property
    def status(self) -> int:
        """Exit status, as shells expect it."""
        return 128 + (self.number or signal.SIGINT)


def _sweep() -> None:
    """Remove what is unfinished."""
    for path in list(UNFINISHED):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                path.unlink(missing_ok=True)
        UNFINISHED.discard(path)


_stop: _Stop | None = None


def stop_status() -> int:
    """Exit status of a command that was interrupted."""
    return _stop.status if _stop else 128 + signal.SIGINT


@contextmanager
def stoppable() -> Iterator[None]:
    """Let signals that end a command raise KeyboardInterrupt, once; if nobody takes it, end with its status.

    Within another of its kind, and in threads beside the main one, it does nothing.
    """
    global _stop
    if _stop is not None or threading.current_thread() is not threading.main_thread():
        yield
        return
    _stop = _Stop(sys.unraisablehook)
    before = {number: signal.getsignal(number) for number in SIGNALS}
    sys.unraisablehook = _stop.swallowed
    for number, handler in before.items():
        # A shell that starts a command in its background, or nohup, has it ignore them.
        if handler != signal.SIG_IGN:
            signal.signal(number, _stop.heed)
    try:
        yield
    except (KeyboardInterrupt, Exception) as error:
        stop = _interrupt_behind(error)
        if stop is None:
            raise
        print(stop.args[0] if stop.args else "interrupted", file=sys.stderr)
        raise SystemExit(_stop.status) from None
    finally:
        _sweep()
        for number, handler in before.items():
            signal.signal(number, handler)
        if _stop.number is not None:
            _forget_code_given_up()
        sys.unraisablehook, _stop = _stop.others, None


def _interrupt_behind(error: BaseException) -> KeyboardInterrupt | None:
    """The interrupt that was raised, also where another error was made of it.

    Until version 3.12 Python makes a RuntimeError of what comes up while a class names its descriptors.
    """
    found: BaseException | None = error
    while found is not None and not isinstance(found, KeyboardInterrupt):
        found = found.__cause__
    return found


def _forget_code_given_up() -> None:
    """Have Python end with the status that it is told, also where a string of code was interrupted.

    It remembers code that an interrupt has left, as that which makes a dataclass on import, until it begins
    other code, and would at last end as if nobody had taken the interrupt.
    """
    exec("")
