"""Folders of frames, reconstructions and calibrations: their contents for the page."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.common.input_files import read_json
from lensdesign.common.text import quantity_label
from lensdesign.errors import InputError

PICTURES = (
    "reconstruction.png",
    "residuals.png",
    "curves.png",
    "calibration.png",
    "frames.png",
    "object.png",
)
CHARTS = ("curves.png", "calibration.png")
"""Pictures without images, all of whose colours may be inverted."""

MAX_BYTES, MAX_PIXELS = 64_000_000, 2**25
"""Largest size of a picture that is shown in bytes and in pixels, checked before pixels are decoded."""


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
        Name of each PNG file, its bytes, and those of a version for a dark page.
    page
        Self-contained HTML page with a zoomable picture; empty without one.
    """

    verdict: str
    explained: bool | None
    facts: tuple[tuple[str, str], ...]
    pictures: tuple[tuple[str, bytes, bytes], ...]
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
        (name, data := path.read_bytes(), dark_picture(data, name in CHARTS))
        for name in PICTURES
        if _is_shown(path := folder / name)
    )
    report("creating the zoomable page")
    explained = verdict.get("explained") if isinstance(verdict, dict) else None
    words = str(verdict.get("words", "")) if isinstance(verdict, dict) else ""
    return FolderContents(words, explained, tuple(_facts(values)), pictures, _page(folder))


def _is_shown(path: Path) -> bool:
    """Return whether a file is a picture of a size that the page shows."""
    from PIL import Image

    if not path.is_file() or path.stat().st_size > MAX_BYTES:
        return False
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path) as picture:
            return picture.width * picture.height <= MAX_PIXELS
    except Image.DecompressionBombError:
        return False
    except (OSError, ValueError, SyntaxError):
        return True  # the browser shows what it can


def dark_picture(data: bytes, is_chart: bool) -> bytes:
    """Return a PNG picture for a dark page, with light text on a dark ground.

    Images inside the picture keep their values, because an inverted one would show another object.

    Parameters
    ----------
    data
        Bytes of a PNG picture with dark text on a white ground.
    is_chart
        Whether the whole picture may be inverted, because it contains no image.
    """
    from PIL import Image
    from scipy import ndimage

    try:
        with Image.open(BytesIO(data)) as picture:
            values = np.asarray(picture.convert("RGB"), float)
    except (OSError, ValueError, Image.DecompressionBombError):
        return data  # the browser shows what it can
    # Everything but the largest connected parts is ground, text and lines.
    parts, _ = ndimage.label(np.min(values, axis=2) < 250.0)
    largest = 0.01 * parts.size
    is_image = np.zeros(parts.shape, bool)
    if not is_chart:
        for number, box in enumerate(ndimage.find_objects(parts), start=1):
            if (box[0].stop - box[0].start) * (box[1].stop - box[1].start) > largest:
                is_image[box] |= ndimage.binary_fill_holes(parts[box] == number)
    paper, ink = np.array([26.0, 30.0, 34.0]), np.array([215.0, 221.0, 227.0])
    lightness = values.mean(axis=2, keepdims=True) / 255.0
    # The hue stays: only the lightness is inverted.
    inverted = ink + (paper - ink) * lightness + (values - 255.0 * lightness)
    dark = np.where(is_image[..., None], values, np.clip(inverted, 0.0, 255.0)).astype(np.uint8)
    stream = BytesIO()
    Image.fromarray(dark).save(stream, "png")
    return stream.getvalue()


def _facts(values: dict[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return scalar values of nested tables with their names."""
    found = []
    for name, value in values.items():
        shown = f"{prefix}{quantity_label(name)}"
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
