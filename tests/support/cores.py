"""Workers of a test run do not take each other's cores."""

from __future__ import annotations

import os


def keep_to_own_cores() -> None:
    """Leave this worker its part of the cores.

    Each would else start as many threads as there are cores: on fields as small as those of tests, threads
    that wait for each other while others work take several times as long as the work itself.
    """
    if not hasattr(os, "sched_setaffinity"):
        return
    number = int(os.environ["PYTEST_XDIST_WORKER"].removeprefix("gw"))
    workers = int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, cores[number % len(cores) :: workers])
