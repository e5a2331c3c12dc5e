"""Servers of the workbench, and a browser."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from places import DESIGNS
from served_workbench import CHROMIUM, Served


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Served]]:
    started: list[Served] = []

    def begin(title: str | None = None) -> Served:
        design = tmp_path / "lens.toml"
        text = (DESIGNS / "paper_singlet.toml").read_text()
        if title is not None:
            text = text.replace('"Spatial information transfer lens, Table 1"', json.dumps(title))
        design.write_text(text)
        started.append(Served(design, tmp_path / "cache"))
        return started[-1]

    yield begin
    for one in started:
        one.kill()


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A server for tests that change nothing."""
    folder = tmp_path_factory.mktemp("served")
    design = folder / "lens.toml"
    shutil.copy(DESIGNS / "paper_singlet.toml", design)
    one = Served(design, folder / "cache")
    yield one
    one.kill()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()
