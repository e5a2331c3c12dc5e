"""The notebooks: each runs from top to bottom, and what they keep is fit to be shown.

They run as they stand but for sizes (SHORTER): what theirs give is held by the packages' own tests. One
kernel runs them all, each without the names of the one before: to start and to import takes longer than some.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import nbformat
import pytest
from jupyter_client import KernelManager
from nbclient import NotebookClient
from places import DESIGNS, GOLDEN, ROOT

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
MOST_BYTES = 600_000

# What stands in a notebook, and what is run in its place.
SHORTER = {
    "design_to_reconstruction": {
        "1 / 16": "1 / 48",
        "iterations=300": "iterations=4",
        "iterations=15": "iterations=2",
        "(-0.03, 0.03), 2e-3": "(-0.02, 0.02), 1e-2",
    },
    "lens_models": {
        "1 / 16": "1 / 64",
        "error=0.01": "error=0.1",
        "(-0.02, 0.02), 2e-3": "(-0.02, 0.02), 1e-2",
        "[5.5, 4.0, 3.0, 2.2, 1.9, 1.55, 1.1, 0.775, 0.56, 0.48]": "[5.5, 1.1]",
    },
    "phase_compensation": {
        "[1.55, 1.23, 1.0, 0.87, 0.82, 0.67, 0.56, 0.5, 0.44]": "[1.55, 0.87]",
        '"slices": 200': '"slices": 12',
        '"slices": 30': '"slices": 6',
    },
    "start_phase": {"1 / 32": "1 / 64", "iterations=500": "iterations=4", "iterations=20": "iterations=2"},
    "store_questions": {"trials=300": "trials=20"},
    "through_focus": {"calibrates=True, iterations=200": "iterations=3", "iterations=200": "iterations=3"},
}


def shorter(path: Path) -> nbformat.NotebookNode:
    """The notebook with smaller cases in it."""
    notebook = nbformat.read(path, as_version=4)
    for text, replaced in SHORTER[path.stem].items():
        assert sum(text in cell.source for cell in notebook.cells if cell.cell_type == "code") >= 1, text
        for cell in notebook.cells:
            cell.source = cell.source.replace(text, replaced)
    return notebook


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for notebooks, with the designs beside it."""
    top = tmp_path_factory.mktemp("top")
    shutil.copytree(DESIGNS, top / "designs")
    shutil.copytree(GOLDEN / "through_focus", top / "tests" / "golden" / "through_focus")
    (top / "notebooks").mkdir()
    return top / "notebooks"


@pytest.fixture(scope="module")
def kernel(folder: Path) -> Iterator[KernelManager]:
    """A running kernel."""
    manager = KernelManager(kernel_name="python3")
    manager.start_kernel(cwd=str(folder))
    yield manager
    manager.shutdown_kernel(now=True)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path, kernel: KernelManager) -> None:
    notebook = shorter(path)
    notebook.cells.insert(0, nbformat.v4.new_code_cell("%reset -f"))
    NotebookClient(notebook, timeout=300, km=kernel).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not [output for output in outputs if output.get("name") == "stderr"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_kept_outputs_are_fit_to_be_shown(path: Path) -> None:
    assert path.stat().st_size < MOST_BYTES
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        lines = [line for line in cell.source.splitlines() if line]
        if cell.cell_type == "markdown":  # one heading at most, and words: no comment signs before every line
            assert len(lines) == 1 or not all(line.startswith("#") for line in lines)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    for cell in code:
        for output in cell.outputs:
            assert output.output_type != "error"
            assert output.get("name") != "stderr"
            said = output.get("text", "") + output.get("data", {}).get("text/plain", "")
            assert not re.search(r"(^|\s)(/[\w.-]+){2,}|[A-Z]:\\|Warning", said)


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) >= 4
