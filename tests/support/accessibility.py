"""Faults of pages in accessibility, as a script finds them in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

_SCRIPT = (Path(__file__).parent / "accessibility.js").read_text(encoding="utf-8")


def faults(page: Any) -> list[str]:
    """Return what is wrong with names, roles, contrast and sizes of targets on a page."""
    found: list[str] = page.evaluate(_SCRIPT[_SCRIPT.index("() =>") :])
    return found
