"""Tests that `make check` leaves out because they take long.

The list `tests/slow_tests.txt` names one function in a line, with its file: a test, or a fixture that several
tests share, with which all tests that use it are slow. `make slow-tests` writes the list anew from the times
of all tests. It then adds what is slow when they are left out, because what a test computes first serves
others. Times depend on the machine, so that only functions far above the limit are sure to be in it.
"""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Generator
from pathlib import Path
from time import perf_counter
from typing import Any

import pytest
from places import ROOT

TESTS = ROOT / "tests"
LIST = TESTS / "slow_tests.txt"

LIMIT_S = 0.5
"""Time of a test function with all its parameters, or of a shared fixture, above which it is slow."""

SHARED = "shared fixture"


def listed() -> frozenset[str]:
    """Return the slow functions, as `folder/test_file.py::test_name` from the folder of the tests."""
    return frozenset(LIST.read_text(encoding="utf-8").split())


def function_of(test: str) -> str:
    """Return the function of a test's identifier, without its parameters and the folder of the tests."""
    return test.partition("[")[0].removeprefix("tests/")


def mark_slow(items: list[pytest.Item]) -> None:
    """Mark the tests of slow functions, and those that use slow fixtures."""
    slow = listed()
    for item in items:
        file = function_of(item.nodeid).partition("::")[0]
        folders = file.split("/")[:-1]
        files = [file, *("/".join([*folders[:depth], "conftest.py"]) for depth in range(len(folders) + 1))]
        fixtures = {f"{one}::{name}" for one in files for name in getattr(item, "fixturenames", ())}
        if function_of(item.nodeid) in slow or fixtures & slow:
            item.add_marker(pytest.mark.slow)


class FixtureClock:
    """Plugin that tells the recorder how long each shared fixture took, in the process that makes it."""

    def __init__(self) -> None:
        self._item: pytest.Item | None = None

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        self._item = item

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Generator[None, Any, Any]:
        start = perf_counter()
        result = yield
        file = Path(inspect.getfile(fixturedef.func))
        if self._item is not None and fixturedef.scope != "function" and file.is_relative_to(TESTS):
            name = f"{file.relative_to(TESTS).as_posix()}::{fixturedef.argname}"
            self._item.user_properties.append((SHARED, (name, perf_counter() - start)))
        return result


class Recorder:
    """Plugin that writes the list from the times of all tests, or adds those of a run without slow ones."""

    def __init__(self, *, adds: bool = False) -> None:
        self._adds = adds
        self._seconds: Counter[str] = Counter()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        seconds = report.duration
        if report.when == "setup":
            for fixture, taken in (value for name, value in report.user_properties if name == SHARED):
                seconds -= taken
                self._seconds[fixture] = max(self._seconds[fixture], taken)
        self._seconds[function_of(report.nodeid)] += seconds  # type: ignore[assignment]

    def pytest_sessionfinish(self, exitstatus: int) -> None:
        if exitstatus != pytest.ExitCode.OK:
            return
        slow = {name for name, seconds in self._seconds.items() if seconds > LIMIT_S}
        if self._adds:
            slow |= listed()
        LIST.write_text("".join(f"{name}\n" for name in sorted(slow)), encoding="utf-8")
