"""Memory that engines tell of, against what a process takes at the most."""

import json
import subprocess
import sys

import pytest

SHARE, BASE_BYTES = 0.2, 10e6
"""By which predicted and used memory may differ: a fraction, and what libraries take once."""

MEASURE = """
import ctypes, json, sys
from pathlib import Path

import numpy as np

from lensdesign import load_design, scaled
from wavesim import Field, Grid, engine_for
from wavesim.scene.patches import patch_scene
from wavesim.scene.scene import Scene

name, settings, scale, patch_mm, side = json.loads(sys.argv[1])
paper = load_design("designs/paper_singlet.toml")


def scene_of(scale, patch_mm, side=None):
    scene = patch_scene(scaled(paper, scale), patch_mm, plane_distance_mm=2.0 * scale)
    grid = scene.exit_grid
    if side is None:
        return scene
    wide = Grid((side, side), grid.pitch_mm * grid.shape[0] / side, grid.z_mm)
    return Scene(scene.lens, scene.object_grid, wide, scene.wavelength_um)


def status(name):
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return 1024 * int(lines[name].split()[0])


def run(scene, way):
    engine = engine_for(scene, name, **settings)
    grid = scene.object_grid if way == "forward" else scene.exit_grid
    field = Field(grid, np.ones(grid.shape, np.complex64), scene.wavelength_um)
    ctypes.CDLL("libc.so.6").malloc_trim(0)  # what the run before has left free
    Path("/proc/self/clear_refs").write_text("5")  # the peak is now what is held now
    before = status("VmRSS")
    result = getattr(engine, way)(field)
    taken = status("VmHWM") - before - result.values.nbytes
    return taken, engine.cost().peak_bytes_in_single


ways = "forward", "adjoint"
scene = scene_of(scale, patch_mm, side)
for way in ways:
    run(scene, way)  # libraries, and loops that this scene needs compiled
print(json.dumps([run(scene, way) for way in ways]))
"""


@pytest.mark.parametrize(
    ("engine", "settings", "scale", "patch_mm", "side"),
    [
        ("eikonal", {"error": 0.01}, 1.0, 0.1, 2400),
        ("eikonal", {"error": 0.01}, 1 / 8, 0.1, 900),
        ("hierarchical", {}, 1.0, 0.375, 3000),
        ("slices", {"slices": 3, "compensation": "oblique"}, 1 / 48, 0.02, None),
        ("wpm", {}, 1 / 100, 0.008, None),
    ],
)
def test_told_is_about_what_a_process_takes(
    engine: str, settings: dict[str, object], scale: float, patch_mm: float, side: int | None
) -> None:
    given = json.dumps([engine, settings, scale, patch_mm, side])
    command = [sys.executable, "-W", "ignore", "-c", MEASURE, given]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    forward, adjoint = json.loads(done.stdout)
    predicted, taken = forward[1], max(forward[0], adjoint[0])
    assert (1.0 - SHARE) * taken - BASE_BYTES < predicted < (1.0 + SHARE) * taken + BASE_BYTES
