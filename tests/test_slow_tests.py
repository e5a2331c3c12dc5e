"""The list of slow tests, which `make check` leaves out: it names tests that exist."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import slow_tests
from places import ROOT
from slow_tests import SHARED, Recorder, listed, mark_slow

TESTS = ROOT / "tests"


@cache
def functions_of(path: Path) -> frozenset[str]:
    """Return the functions of a file, those of classes as `Class::function`."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}::{one.name}" for one in node.body if isinstance(one, ast.FunctionDef)}
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            found.add(node.name)
    return frozenset(found)


class Item(SimpleNamespace):
    """A test with the names of its fixtures."""

    def add_marker(self, marker: Any) -> None:
        self.marker = marker


def test_every_folder_of_a_package_has_quick_tests() -> None:
    folders: dict[tuple[str, ...], list[Any]] = {}
    for path in sorted(TESTS.rglob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                name = f"tests/{path.relative_to(TESTS).as_posix()}::{node.name}"
                item = Item(nodeid=name, fixturenames=[one.arg for one in node.args.args])
                folders.setdefault(path.parent.relative_to(TESTS).parts[:2], []).append(item)
    for folder, items in folders.items():
        mark_slow(items)
        assert any(not hasattr(item, "marker") for item in items), folder


def test_slow_tests_exist() -> None:
    names = [name.partition("::") for name in sorted(listed())]
    gone = [
        f"{path}::{function}"
        for path, _, function in names
        if not (TESTS / path).exists() or function not in functions_of(TESTS / path)
    ]
    assert not gone, "renew tests/slow_tests.txt: make slow-tests"


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The list, in a folder of the test's own, of what takes longer than half a second."""
    monkeypatch.setattr(slow_tests, "LIST", tmp_path / "slow_tests.txt")
    monkeypatch.setattr(slow_tests, "LIMIT_S", 0.5)
    return tmp_path / "slow_tests.txt"


def record(recorder: Recorder, name: str, seconds: float, fixtures: dict[str, float] | None = None) -> None:
    """Report a test, with the times of the shared fixtures that were made for it."""
    properties = [(SHARED, one) for one in (fixtures or {}).items()]
    for when, duration in (("setup", sum(fixtures.values()) if fixtures else 0.0), ("call", seconds)):
        report: Any = SimpleNamespace(
            nodeid=f"tests/{name}", duration=duration, when=when, user_properties=properties
        )
        recorder.pytest_runtest_logreport(report)


def test_a_function_is_slow_by_all_its_parameters(written: Path) -> None:
    recorder = Recorder()
    for name, seconds in {
        "test_b.py::test_c[1]": 0.3,
        "test_b.py::test_c[2]": 0.3,
        "test_b.py::test_d": 0.4,
    }.items():
        record(recorder, name, seconds)
    recorder.pytest_sessionfinish(pytest.ExitCode.INTERRUPTED)
    assert not written.exists()
    recorder.pytest_sessionfinish(pytest.ExitCode.OK)
    assert listed() == {"test_b.py::test_c"}


def test_a_shared_fixture_is_slow_and_not_the_test_that_makes_it(written: Path) -> None:
    recorder = Recorder()
    record(recorder, "test_b.py::test_c", 0.1, {"test_b.py::measured": 2.0, "test_b.py::lens": 0.1})
    recorder.pytest_sessionfinish(pytest.ExitCode.OK)
    assert listed() == {"test_b.py::measured"}


def test_what_is_slow_without_the_slow_tests_is_added(written: Path) -> None:
    written.write_text("test_b.py::test_c\n")
    recorder = Recorder(adds=True)
    record(recorder, "test_b.py::test_d", 0.6)
    recorder.pytest_sessionfinish(pytest.ExitCode.OK)
    assert listed() == {"test_b.py::test_c", "test_b.py::test_d"}


def test_tests_are_slow_with_a_fixture_of_their_file_or_of_a_folder_above(written: Path) -> None:
    written.write_text("a/test_b.py::own\na/conftest.py::above\n")
    names = {
        "a/test_b.py": ["own", "above", "other"],
        "a/c/test_d.py": ["above", "own"],
        "test_e.py": ["above"],
    }
    items: list[Any] = [
        Item(nodeid=f"tests/{file}::test_{name}[1]", fixturenames=["request", name])
        for file, fixtures in names.items()
        for name in fixtures
    ]
    mark_slow(items)
    marked = [item.nodeid for item in items if hasattr(item, "marker")]
    assert marked == [
        "tests/a/test_b.py::test_own[1]",
        "tests/a/test_b.py::test_above[1]",
        "tests/a/c/test_d.py::test_above[1]",
    ]
