"""Memory of object-domain reconstruction: told beforehand, and kept by files."""

from __future__ import annotations

import os
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensdesign import load_design
from wavesim.camera.recorded import Recorded
from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.from_object import Kind, reconstruct
from wavesim.reconstruction.memory import reconstruction_bytes
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Cost, Engine
from wavesim.scene.scene import Scene


class Nothing(Engine):
    """Lets the field through as it is; takes no memory but its result."""

    name = "nothing"

    def __init__(self, shape: tuple[int, int]) -> None:
        lens = load_design("designs/paper_singlet.toml")
        grids = [Grid(shape, 3.2e-3, z) for z in (lens.object_z_mm, lens.exit_vertex_z_mm + 5.0)]
        super().__init__(Scene(lens, *grids, 0.532))

    def _forward(self, values: Any) -> Any:
        return values.copy()

    _adjoint = _forward

    def cost(self) -> Cost:
        return Cost(0.1, 0.0, 0)

    def neglected(self) -> tuple:
        return ()

    def settings(self) -> dict:
        return {}


def arrays_of(
    engine: Engine, distances_mm: tuple[float, ...], with_sigma: bool, room: Scratch
) -> tuple[Field, list[Recorded]]:
    """Light and recorded planes, in files or in memory."""
    grid, random = engine.scene.object_grid, np.random.default_rng(1)
    light = Field(grid, room.moved(np.ones(grid.shape, np.complex64)), 0.532)

    def noise() -> np.ndarray:
        return room.moved(random.random(grid.shape, np.float32) + np.float32(1.0))

    return light, [Recorded(d, noise(), noise() if with_sigma else None) for d in distances_mm]


@pytest.mark.parametrize(("kind", "active_width"), [("amplitude", 1.0), ("amplitude", 0.0), ("complex", 0.0)])
@pytest.mark.parametrize(
    ("distances_mm", "with_sigma"), [((0.0,), True), ((0.0, 20.0), True), ((5.0, 9.0, 20.0), False)]
)
@pytest.mark.parametrize("in_files", [False, True])
def test_memory_is_told_beforehand(
    tmp_path: Path,
    kind: Kind,
    active_width: float,
    distances_mm: tuple[float, ...],
    with_sigma: bool,
    in_files: bool,
) -> None:
    engine = Nothing((600, 640))
    told = reconstruction_bytes(
        engine, distances_mm, kind=kind, active_width=active_width, with_sigma=with_sigma
    )
    expected = told.least_bytes if in_files else told.most_bytes
    settings: dict[str, Any] = {"kind": kind, "active_width": active_width, "iterations": 2}
    settings["tv_weight"] = "auto" if with_sigma else 0.02
    # Compiled loops, as they are loaded, take memory once.
    small = Nothing((8, 8))
    reconstruct(small, *arrays_of(small, distances_mm, with_sigma, Scratch()), **settings)
    tracemalloc.start()
    try:
        room = Scratch(tmp_path, 0.0) if in_files else Scratch()
        light, recorded = arrays_of(engine, distances_mm, with_sigma, room)
        tracemalloc.reset_peak()
        reconstruct(engine, light, recorded, scratch=room, **settings)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert 0.77 * peak < expected < 1.3 * peak


LIMITED = """
import pathlib, resource, sys
import numpy as np
sys.path.insert(0, {tests!r})
from test_memory import Nothing, arrays_of
from wavesim.reconstruction.from_object import reconstruct
from wavesim.reconstruction.memory import reconstruction_bytes
from wavesim.runtime.scratch import Scratch

def run(shape, room):
    engine = Nothing(shape)
    light, recorded = arrays_of(engine, (0.0, 20.0), True, room)
    settings = dict(kind="amplitude", active_width=1.0, tv_weight="auto", iterations=2)
    reconstruct(engine, light, recorded, scratch=room, **settings)
    return reconstruction_bytes(engine, (0.0, 20.0), kind="amplitude", active_width=1.0)

run((64, 64), Scratch())  # compiles and loads all
status = pathlib.Path("/proc/self/status").read_text()
used = 1024 * int(status.split("VmData:")[1].split()[0])
shape = (1600, 1700)
told = reconstruction_bytes(Nothing(shape), (0.0, 20.0), kind="amplitude", active_width=1.0)
limit = (told.least_bytes + told.most_bytes) // 2
resource.setrlimit(resource.RLIMIT_DATA, (used + limit, used + limit))
room = Scratch() if {in_memory} else Scratch(pathlib.Path({folder!r}), 0.3 * limit - 0.3 * told.least_bytes)
try:
    run(shape, room)
except MemoryError:
    print("too much")
else:
    print("done")
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of memory are those of Linux")
def test_a_limit_of_memory_is_kept_by_files(tmp_path: Path) -> None:
    """The system refuses a process more; with all arrays in memory the same run fails."""
    said = []
    for in_memory in (True, False):
        code = LIMITED.format(tests=str(Path(__file__).parent), folder=str(tmp_path), in_memory=in_memory)
        result = subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "MALLOC_ARENA_MAX": "1", "MALLOC_MMAP_THRESHOLD_": "1000000"},
            capture_output=True,
            text=True,
            check=False,
        )
        said.append(result.stdout.strip() or result.stderr)
    assert said == ["too much", "done"]
    assert list(tmp_path.iterdir()) == []
