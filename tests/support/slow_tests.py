"""Tests that `make check` leaves out because they take long.

The list `tests/slow_tests.txt` names one test function in a line, with its file. `make slow-tests` runs all
tests and writes it anew. Times depend on the machine, so that only functions far above the limit are sure to
be in it.
"""

from __future__ import annotations

from collections import Counter

import pytest
from places import ROOT

LIST = ROOT / "tests" / "slow_tests.txt"

LIMIT_S = 0.5
"""Time of a test function with all its parameters above which it is slow."""


def listed() -> frozenset[str]:
    """Return the slow functions, as `folder/test_file.py::test_name` from the folder of the tests."""
    return frozenset(LIST.read_text(encoding="utf-8").split())


def function_of(test: str) -> str:
    """Return the function of a test's identifier, without its parameters and the folder of the tests."""
    return test.partition("[")[0].removeprefix("tests/")


def mark_slow(items: list[pytest.Item]) -> None:
    """Mark the tests of slow functions."""
    slow = listed()
    for item in items:
        if function_of(item.nodeid) in slow:
            item.add_marker(pytest.mark.slow)


class Recorder:
    """Plugin that writes the list from the times of a run."""

    def __init__(self) -> None:
        self._seconds: Counter[str] = Counter()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._seconds[function_of(report.nodeid)] += report.duration  # type: ignore[assignment]

    def pytest_sessionfinish(self, exitstatus: int) -> None:
        if exitstatus != pytest.ExitCode.OK:
            return
        slow = sorted(name for name, seconds in self._seconds.items() if seconds > LIMIT_S)
        LIST.write_text("".join(f"{name}\n" for name in slow), encoding="utf-8")
