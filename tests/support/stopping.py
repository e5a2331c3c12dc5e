"""Signals that child processes are to heed."""

from __future__ import annotations

import signal


def heeding() -> None:
    """As `preexec_fn`: what is started in the background of a shell, or by nohup, would ignore them."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
