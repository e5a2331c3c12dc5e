"""How many threads linear algebra takes in the processes of a run. Imports nothing that brings NumPy."""

from __future__ import annotations

import os

VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "OMP_NUM_THREADS")


def one_blas_thread() -> None:
    """Let processes that load NumPy from now on do linear algebra in one thread.

    A study's products are small and many: threads wait for each other longer than they work, and how
    they share a sum must not show in its last bits. Variables that are set already stay.
    """
    for name in VARIABLES:
        os.environ.setdefault(name, "1")
