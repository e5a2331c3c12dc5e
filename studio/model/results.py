"""Folders of frames, reconstructions and calibrations: their contents for the page."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lensdesign.common.input_files import read_json
from lensdesign.errors import InputError

PICTURES = (
    "reconstruction.png",
    "residuals.png",
    "curves.png",
    "calibration.png",
    "frames.png",
    "object.png",
)
MAX_BYTES = 64_000_000
"""Largest size of a file that is shown."""


@dataclass(frozen=True, eq=False)
class FolderContents:
    """Contents of a folder of results.

    Attributes
    ----------
    verdict
        Goodness of fit in words; empty without one.
    explained
        Whether the model explains the frames; None if unknown.
    facts
        Names and values, including those of a calibration.
    pictures
        Names and bytes of PNG files.
    page
        Self-contained HTML page with a zoomable picture; empty without one.
    """

    verdict: str
    explained: bool | None
    facts: tuple[tuple[str, str], ...]
    pictures: tuple[tuple[str, bytes], ...]
    page: str


def read_folder(folder: Path, report: Callable[[str], None]) -> FolderContents:
    """Read a folder of `wavesim image`, `reconstruct` or `calibrate`.

    Raises
    ------
    InputError
        If the folder holds no results of these commands.
    """
    names = ("reconstruction.json", "calibration.json", "image.json")
    summaries = [path for name in names if (path := folder / name).is_file()]
    if not summaries:
        raise InputError(f"{folder}: holds none of {', '.join(names)}: give a folder that wavesim wrote")
    report(f"reading {folder}")
    values = read_json(summaries[0])
    verdict: Any = values.get("verdict") or {}
    pictures = tuple(
        (name, path.read_bytes())
        for name in PICTURES
        if (path := folder / name).is_file() and path.stat().st_size <= MAX_BYTES
    )
    report("creating the zoomable page")
    explained = verdict.get("explained") if isinstance(verdict, dict) else None
    words = str(verdict.get("words", "")) if isinstance(verdict, dict) else ""
    return FolderContents(words, explained, tuple(_facts(values)), pictures, _page(folder))


def _facts(values: dict[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return scalar values of nested tables with their names."""
    found = []
    for name, value in values.items():
        shown = f"{prefix}{name.replace('_', ' ')}"
        if isinstance(value, dict) and name != "verdict":
            found += _facts(value, f"{shown}, ")
        elif isinstance(value, bool | int | str):
            found.append((shown, str(value)))
        elif isinstance(value, float):
            found.append((shown, f"{value:.6g}"))
    return found


def _page(folder: Path) -> str:
    """Return the page that `wavesim view` writes for the folder."""
    with tempfile.TemporaryDirectory() as name:
        page = Path(name) / "view.html"
        command = [sys.executable, "-m", "wavesim.cli", "view", str(folder.resolve()), "-o", str(page)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode or page.stat().st_size > MAX_BYTES:
            return ""
        return page.read_text(encoding="utf-8")
