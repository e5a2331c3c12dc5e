"""Kernels that are not kept yet are compiled by one of the workers, not by all at once."""

from __future__ import annotations

import fcntl
from pathlib import Path
from threading import RLock
from typing import Any


def take_turns(lock: Path) -> None:
    """Compile kernels of this process only while no other does: what it has compiled is then found kept."""
    from numba.core.dispatcher import Dispatcher

    compiled, turn, depth = Dispatcher.compile, RLock(), 0
    handle = lock.open("rb")

    def compile_in_turn(self: Any, signature: Any) -> Any:
        nonlocal depth
        with turn:  # a kernel compiles those that it calls: only the outermost waits for other processes
            if depth == 0:
                fcntl.flock(handle, fcntl.LOCK_EX)
            depth += 1
            try:
                return compiled(self, signature)
            finally:
                depth -= 1
                if depth == 0:
                    fcntl.flock(handle, fcntl.LOCK_UN)

    Dispatcher.compile = compile_in_turn
