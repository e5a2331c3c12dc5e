"""Benchmarks are run by hand: what they import is there, and every one of them is on the list."""

from __future__ import annotations

import ast
import importlib
from importlib.util import find_spec
from pathlib import Path

import pytest
from places import ROOT

from benchmarks import full_plane_slices
from benchmarks.__main__ import SCRIPTS

FILES = sorted((ROOT / "benchmarks").rglob("*.py"))
OURS = ("lensdesign", "wavesim", "tolerancing", "studio", "benchmarks")
SHARED = {
    "__init__",
    "__main__",
    "timing",
    "others",
    "docs_pictures",
    "explaining_pictures",
    "against_commit",
    "attacked_runs",
    "independent_frames",
}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_what_a_benchmark_imports_is_there(path: Path) -> None:
    """Of this project, inside functions too."""
    missing = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom) or not node.module:
            continue
        if node.module.partition(".")[0] not in OURS:
            continue
        module = importlib.import_module(node.module)
        absent = [alias.name for alias in node.names if not hasattr(module, alias.name)]
        missing += [f"{node.module}.{name}" for name in absent if not find_spec(f"{node.module}.{name}")]
    assert missing == []


def test_every_benchmark_is_run() -> None:
    folder = ROOT / "benchmarks"
    alone = {path.stem for path in FILES if path.parent == folder} - SHARED
    together = {path.parent.name for path in FILES if path.parent != folder and path.stem == "__main__"}
    assert alone | together == set(SCRIPTS)


def test_slices_on_a_plane_do_what_they_do_on_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small twin of what `python -m benchmarks.full_plane_slices` does at a quarter of the lens."""
    monkeypatch.setattr(full_plane_slices, "OBJECT_PITCH_UM", 0.4)
    line, plane = (
        full_plane_slices.carried(1.0 / 48.0, on_line, 10, "oblique", "single") for on_line in (True, False)
    )
    for one in (line, plane):
        assert one.error < 0.12
        assert one.correlation > 0.99
        assert one.contrast > 0.94
        assert one.refocus_um == pytest.approx(0.0, abs=0.6)
    assert plane.error == pytest.approx(line.error, rel=0.3)
