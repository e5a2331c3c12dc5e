"""The examples of the public names: each runs when pasted into a new Python session beside the designs."""

from __future__ import annotations

import doctest
import importlib
import inspect
import shutil
from pathlib import Path

import pytest
from places import DESIGNS
from quick_verdicts import judge_quickly
from small_pictures import draw_few_dots

PACKAGES = ("lensdesign", "wavesim", "tolerancing")
NAMES = [(package, name) for package in PACKAGES for name in importlib.import_module(package).__all__]


@pytest.fixture(scope="module")
def session_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the designs. Examples share it, so that a study is run by the first that needs it."""
    folder = tmp_path_factory.mktemp("examples")
    shutil.copytree(DESIGNS, folder / "designs")
    return folder


@pytest.mark.parametrize(("package", "name"), NAMES, ids=[f"{package}.{name}" for package, name in NAMES])
def test_example_runs(
    package: str, name: str, session_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    public = getattr(importlib.import_module(package), name)
    documented = public if inspect.isclass(public) or inspect.isroutine(public) else type(public)
    text = inspect.cleandoc(documented.__doc__ or "")
    example = doctest.DocTestParser().get_doctest(text, {"folder": tmp_path}, f"{package}.{name}", None, None)
    assert example.examples, f"{package}.{name} has no example"
    assert not any(doctest.SKIP in step.options for step in example.examples)
    monkeypatch.chdir(session_folder)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # a cache of an earlier session would be used
    judge_quickly(monkeypatch)
    draw_few_dots(monkeypatch)
    failures: list[str] = []
    doctest.DocTestRunner(verbose=False).run(example, out=failures.append)
    assert not failures, "".join(failures)
