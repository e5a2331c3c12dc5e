"""Time limits of long computations, which check between steps whether time is left."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_end: ContextVar[float] = ContextVar("deadline", default=math.inf)


clock = time.monotonic
"""The clock of all deadlines, in seconds; tests replace it."""


class DeadlineExceeded(Exception):
    """Raised by :func:`check_time` when the current deadline has passed."""


def now() -> float:
    """Return the time in seconds on the clock of deadlines."""
    return clock()


@contextmanager
def deadline(end: float) -> Iterator[None]:
    """Make :func:`check_time` raise from a time of :func:`now` on; an earlier deadline stays in force."""
    token = _end.set(min(end, _end.get()))
    try:
        yield
    finally:
        _end.reset(token)


@contextmanager
def no_deadline() -> Iterator[None]:
    """Suspend all deadlines, for example while results are saved."""
    token = _end.set(math.inf)
    try:
        yield
    finally:
        _end.reset(token)


def seconds_left() -> float:
    """Return the seconds until the current deadline; infinite without one."""
    end = _end.get()
    return math.inf if end == math.inf else end - now()


def check_time() -> None:
    """Raise :class:`DeadlineExceeded` if the current deadline has passed."""
    if seconds_left() <= 0.0:
        raise DeadlineExceeded
