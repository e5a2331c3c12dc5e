"""Time limits that long computations keep by themselves: they ask, between steps, whether time is left."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_end: ContextVar[float] = ContextVar("deadline", default=math.inf)


class OutOfTime(Exception):
    """Raised by :func:`check_time` when the deadline that holds has passed."""


def now() -> float:
    """Return the time in seconds by which deadlines are kept; tests replace it."""
    return time.monotonic()


@contextmanager
def deadline(end: float) -> Iterator[None]:
    """Have :func:`check_time` raise from a time on, by :func:`now`; an earlier deadline still holds."""
    token = _end.set(min(end, _end.get()))
    try:
        yield
    finally:
        _end.reset(token)


@contextmanager
def no_deadline() -> Iterator[None]:
    """Suspend all deadlines, for the short work that saves what was found."""
    token = _end.set(math.inf)
    try:
        yield
    finally:
        _end.reset(token)


def seconds_left() -> float:
    """Return the seconds until the deadline that holds; infinite where there is none."""
    end = _end.get()
    return math.inf if end == math.inf else end - now()


def check_time() -> None:
    """Raise :class:`OutOfTime` if the deadline that holds has passed."""
    if seconds_left() <= 0.0:
        raise OutOfTime
