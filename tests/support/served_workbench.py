"""The workbench in a process of its own, and pages of it in a real browser.

Without Chromium, tests that need one are skipped.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium found on this machine")
MILLISECONDS = 90_000


class Served:
    """A server in a process of its own, and its address."""

    def __init__(self, design: Path, cache: Path) -> None:
        self.design = design
        self.environment = os.environ | {"XDG_CACHE_HOME": str(cache), "OPENBLAS_NUM_THREADS": "1"}
        self.begin()

    def begin(self) -> None:
        command = [sys.executable, "-m", "lensdesign.cli", "studio", str(self.design), "--no-open"]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=self.environment
        )
        assert self.process.stdout is not None
        lines = iter(self.process.stdout.readline, "")
        self.address = next(line.split()[-1] for line in lines if "http://" in line)

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


def opened(browser: Any, served: Served, width: int = 1440) -> Any:
    """Return a page with the settled figures of a lens."""
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.set_default_timeout(MILLISECONDS)
    page.goto(served.address)
    settled(page)
    return page


def settled(page: Any) -> None:
    page.locator(".text-block[data-state=settled] .constraint").first.wait_for(timeout=MILLISECONDS)


def until(description: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not description():
        assert time.monotonic() < end
        time.sleep(0.05)
