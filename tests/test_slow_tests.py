"""The list of slow tests, which `make check` leaves out: it names tests that exist."""

from __future__ import annotations

import ast
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import slow_tests
from places import ROOT
from slow_tests import Recorder, listed

TESTS = ROOT / "tests"


def functions_of(path: Path) -> set[str]:
    """Return the test functions of a file, those of classes as `Class::function`."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}::{one.name}" for one in node.body if isinstance(one, ast.FunctionDef)}
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            found.add(node.name)
    return found


def test_slow_tests_exist() -> None:
    names = [name.partition("::") for name in sorted(listed())]
    gone = [
        f"{path}::{function}"
        for path, _, function in names
        if not (TESTS / path).exists() or function not in functions_of(TESTS / path)
    ]
    assert not gone, "renew tests/slow_tests.txt: make slow-tests"


def test_a_function_is_slow_by_all_its_parameters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slow_tests, "LIST", tmp_path / "slow_tests.txt")
    recorder = Recorder()
    times = {"a/test_b.py::test_c[1]": 0.3, "a/test_b.py::test_c[2]": 0.3, "a/test_b.py::test_d": 0.4}
    for name, seconds in times.items():
        report: Any = SimpleNamespace(nodeid=f"tests/{name}", duration=seconds)
        recorder.pytest_runtest_logreport(report)
    recorder.pytest_sessionfinish(pytest.ExitCode.INTERRUPTED)
    assert not slow_tests.LIST.exists()
    recorder.pytest_sessionfinish(pytest.ExitCode.OK)
    assert listed() == {"a/test_b.py::test_c"}
