"""Linear algebra in one thread, where it comes in many small parts.

Its threads then wait for each other longer than they work, and where other processes run beside they wait
ten times as long as the work takes.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS and LAPACK to one thread; Fourier transforms and compiled loops keep theirs."""
    with _controller().limit(limits=1, user_api="blas"):
        yield


@cache
def _controller() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
