"""Kept kernels go when something that they were compiled from has changed."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lensdesign.lens.shapes.compiled import SOURCES
from lensdesign.lens.shapes.registry import shape_classes
from lensdesign.tracing.kept_kernels import drop_outdated


@pytest.fixture
def formula(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A module with a formula, which is imported."""
    path = tmp_path / "some_formula.py"
    path.write_text("def sag(r):\n    return r * r\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("some_formula")
    yield path
    sys.modules.pop("some_formula")


def kernel_in(folder: Path) -> Any:
    """What Numba says of a kernel."""
    return SimpleNamespace(__module__="room.kernel", stats=SimpleNamespace(cache_path=str(folder)))


def test_kernels_stay_while_their_sources_do(formula: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    drop_outdated(kernel_in(kept), ["some_formula"])
    for name in ("kernel.trace-1.py311.nbi", "other_kernel.trace-1.py311.nbi", "kernel.trace-1.py311.1.nbc"):
        (kept / name).touch()
    drop_outdated(kernel_in(kept), ["some_formula"])
    assert (kept / "kernel.trace-1.py311.nbi").exists()
    formula.write_text("def sag(r):\n    return 2 * r\n", encoding="utf-8")
    drop_outdated(kernel_in(kept), ["some_formula"])
    assert not (kept / "kernel.trace-1.py311.nbi").exists()
    assert (kept / "other_kernel.trace-1.py311.nbi").exists()


def test_nothing_is_touched_where_nothing_is_kept(formula: Path, tmp_path: Path) -> None:
    drop_outdated(lambda: None, ["some_formula"])
    drop_outdated(SimpleNamespace(stats=SimpleNamespace(cache_path=None)), ["some_formula"])
    (tmp_path / "file").touch()
    drop_outdated(kernel_in(tmp_path / "file" / "kept"), ["some_formula"])


def test_kernels_of_rays_are_kept_with_the_formulas_of_all_shapes() -> None:
    assert {shape.__module__ for shape in shape_classes()} < SOURCES
    assert all(name in sys.modules for name in SOURCES)
