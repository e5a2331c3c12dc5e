"""Speed of the workbench: figures while a slider moves, the page in a browser, its start, its memory."""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.timing import DESIGNS
from studio.model.analysis import AnalysisRequest, patch_of, rays_of, waves_of
from studio.model.document import opened
from studio.model.editing import with_value
from studio.model.whatif import WhatIf

ROUNDS = 100
EDITS = 1000
GRADE = "precision"

# A slider is moved as a hand does; when the page shows another spread, or another yield, the clock stops.
DRAG = """async ([rounds, still]) => {
  const deep = (wanted) => {
    const found = [];
    const walk = (root) => {
      found.push(...root.querySelectorAll(wanted));
      for (const node of root.querySelectorAll("*")) if (node.shadowRoot) walk(node.shadowRoot);
    };
    walk(document);
    return found;
  };
  const slider = deep("input[type=range]").find((one) => one.ariaLabel.startsWith("surface 2 radius"));
  const spread = () => deep(".constraint")[1]?.dataset.value;
  const good = () => deep(".yield")[0]?.dataset.limits;
  const rays = [], waves = [];
  for (let k = 0; k < rounds; k++) {
    const before = [spread(), good()], began = performance.now();
    slider.value = -12 - 0.005 * ((k % 40) + 1);
    slider.dispatchEvent(new Event("input"));
    let first = 0, second = 0;
    while (!second && performance.now() - began < 5000) {
      await new Promise((next) => requestAnimationFrame(next));
      if (!first && spread() !== before[0]) first = performance.now() - began;
      if (good() !== before[1]) second = performance.now() - began;
    }
    rays.push(first || 5000);
    waves.push(second || 5000);
    await new Promise((next) => setTimeout(next, still));
  }
  return [rays, waves];
}"""


def main() -> None:
    """Measure and print."""
    print(f"load of the machine before: {os.getloadavg()[0]:.1f} of {os.cpu_count()} processors")
    computing()
    with tempfile.TemporaryDirectory() as folder:
        in_browser(Path(folder))


def computing() -> None:
    """Seconds of each stage of the figures, wall and processor."""
    from studio.model.built import manufacturing_quality

    _, editing = opened(DESIGNS / "paper_singlet.toml")
    made = manufacturing_quality(GRADE, editing.lens)
    stages = {
        "layout, spread, footprint, spots": rays_of,
        "pupils of three fields, yield": waves_of,
        "patch": patch_of,
    }
    for settled in (False, True):
        for name, stage in stages.items():
            wall, own = [], []
            for k in range(ROUNDS // 10 if settled else ROUNDS):
                tables = with_value(editing.now.tables, ("surface", 1, "radius_mm"), -12.0 - 1e-4 * (k + 1))
                lens = editing.changed(tables, "").lens
                asked = AnalysisRequest(lens, WhatIf({"lens.decenter_y_mm": 0.01}), made, 0.0)
                began, used = time.perf_counter(), time.process_time()
                stage(asked, settled=settled)
                wall.append(time.perf_counter() - began)
                own.append(time.process_time() - used)
            when = "at rest" if settled else "moving"
            print(
                f"{name}, {when}: {1e3 * statistics.median(wall):.1f} ms, "
                f"processor {1e3 * statistics.median(own):.1f} ms"
            )


@contextmanager
def served() -> Iterator[str]:
    """Provide the address of the workbench of the paper's lens, served by a process of its own."""
    with tempfile.TemporaryDirectory() as folder, server_of(Path(folder)) as (address, _):
        yield address


@contextmanager
def server_of(folder: Path) -> Iterator[tuple[str, int]]:
    """Serve the paper's lens from a copy in a folder; provide the address, and the process's number."""
    design = Path(shutil.copy(DESIGNS / "paper_singlet.toml", folder / "lens.toml"))
    server = subprocess.Popen(
        [sys.executable, "-m", "lensdesign.cli", "studio", str(design), "--no-open"],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"XDG_CACHE_HOME": str(folder)},
    )
    assert server.stdout is not None
    try:
        yield (
            next(line.split()[-1] for line in iter(server.stdout.readline, "") if "http://" in line),
            server.pid,
        )
    finally:
        server.terminate()
        server.wait()


def in_browser(folder: Path) -> None:
    """The page: from the command to figures, from a slider to them, and the server's memory."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        print("in the browser: left out, no Chromium found")
        return
    from playwright.sync_api import sync_playwright

    began = time.perf_counter()
    with server_of(folder) as (address, process), sync_playwright() as driver:
        answered = time.perf_counter() - began
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        asked = time.perf_counter()
        page.goto(address)
        page.locator(".constraint").first.wait_for(timeout=120_000)
        shown = time.perf_counter() - asked
        print(f"start: server {answered:.1f} s, page with figures {shown:.1f} s after that")
        page.locator(".yield").first.wait_for(timeout=120_000)
        page.wait_for_timeout(5000)
        rays, waves = page.evaluate(DRAG, [ROUNDS, 50])
        print(f"slider to spread in the page: median {statistics.median(rays):.0f} ms of {ROUNDS}")
        print(f"slider to predicted yield in the page: median {statistics.median(waves):.0f} ms")
        memory = [_megabytes(process)]
        for _ in range(4):
            _edits(page, EDITS // 4)
            page.wait_for_timeout(3000)
            memory.append(_megabytes(process))
        print(f"server's memory after {EDITS} edits, every quarter: {json.dumps(memory)} MB")
        browser.close()


def _edits(page: Any, count: int) -> None:
    box = page.get_by_label("surface 2 radius, mm", exact=True)
    for k in range(count):
        box.press("ArrowUp" if k % 2 else "ArrowDown")


def _megabytes(process: int) -> int:
    """Resident memory of a process."""
    line = next(
        row for row in Path(f"/proc/{process}/status").read_text().splitlines() if row.startswith("VmRSS")
    )
    return round(int(line.split()[1]) / 1024)


if __name__ == "__main__":
    main()
