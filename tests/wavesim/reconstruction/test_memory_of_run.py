"""Memory of a whole run, told beforehand: what follows the iterations, against what it takes."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensdesign import load_design
from wavesim.camera.recorded import Recorded
from wavesim.evaluation.judgement import truth_figures
from wavesim.fields.field import Field, Grid
from wavesim.objects.patch import LIGHT_BYTES, Patch, make_illumination
from wavesim.reconstruction.memory import REFOCUSED_BYTES, run_need
from wavesim.reconstruction.refocusing import refocus_field
from wavesim.reconstruction.resumable import retrieve_resumably
from wavesim.runtime import threads as blocks
from wavesim.runtime.memory import BASE_BYTES
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Cost, Engine
from wavesim.scene.scene import Scene

SHAPE = (4000, 300)
"""Many rows: what goes in blocks of rows is to be small beside all."""


class Nothing(Engine):
    """Lets the field through as it is; takes no memory but its result."""

    name = "nothing"

    def __init__(self, shape: tuple[int, int]) -> None:
        lens = load_design("designs/paper_singlet.toml")
        before, behind = (
            Grid(shape, 0.4e-3, lens.object_z_mm),
            Grid(shape, 3.2e-3, lens.exit_vertex_z_mm + 5.0),
        )
        super().__init__(Scene(lens, before, behind, 0.532))

    def _forward(self, values: Any) -> Any:
        return values.copy()

    _adjoint = _forward

    def cost(self) -> Cost:
        return Cost(0.1, 0.0, 0)

    def neglected(self) -> tuple:
        return ()

    def settings(self) -> dict:
        return {}


@pytest.fixture(scope="module")
def engine() -> Nothing:
    return Nothing(SHAPE)


def told(engine: Any, **settings: Any) -> tuple[float, float]:
    """Most and least bytes for each sample, the process itself left out."""
    usual = {"method": "object", "kind": "amplitude", "active_width": 1.0, "frames_bytes": 0}
    usual |= {"shown": engine.scene.object_grid.size, "carried": 0, "truth": False}
    need = run_need(engine, (0.0, 20.0), **(usual | settings))
    return tuple(
        (n - BASE_BYTES) / engine.scene.object_grid.size for n in (need.most_bytes, need.least_bytes)
    )


def peak(work: Any) -> float:
    """Bytes for each sample that something takes."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / (SHAPE[0] * SHAPE[1])
    finally:
        tracemalloc.stop()


def noise(seed: int) -> Any:
    return np.random.default_rng(seed).random(SHAPE, np.float32) + np.float32(1.0)


def test_light_and_refocusing_take_what_is_told(engine: Nothing) -> None:
    patch = Patch(engine.scene.object_grid, 0.1, 0.532)
    assert 0.8 * LIGHT_BYTES < peak(lambda: make_illumination(patch)) < 58.0
    part = Field(
        Nothing((250, 250)).scene.object_grid,
        np.exp(1j * noise(1).ravel()[: 250**2].reshape(250, 250)),
        0.532,
    )
    carried = SHAPE[0] * SHAPE[1] / 250**2 * peak(lambda: refocus_field(part, (-0.002, 0.002), 2.1e-3))
    assert 0.7 * carried < REFOCUSED_BYTES < 1.4 * carried


def test_a_comparison_keeps_within_what_is_told_and_to_files_where_there_is_no_room(
    engine: Nothing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blocks, "BLOCK", 256)  # a whole field has many blocks
    grid = engine.scene.object_grid
    fields = [
        Field(grid, (noise(seed) + 1j * noise(seed + 1)).astype(np.complex64), 0.532) for seed in (1, 3)
    ]
    light = fields[0].with_values(np.ones(SHAPE, np.complex64))

    def compare(room: Scratch) -> None:
        inside = np.ones(SHAPE, bool)
        truth_figures(fields[0], fields[1], light, inside, engine, room)

    most, least = told(engine, truth=True)
    held = 24.0  # light, truth and what was found: made before
    in_memory, in_files = peak(lambda: compare(Scratch())), peak(lambda: compare(Scratch(tmp_path, 0.0)))
    assert in_files < 0.75 * in_memory
    assert in_memory + held < 1.05 * most
    assert in_files < least


def test_the_paper_s_way_takes_what_is_told(engine: Nothing) -> None:
    grid = engine.scene.object_grid
    light = Field(grid, np.ones(SHAPE, np.complex64), 0.532)
    planes = [Recorded(distance, 64.0 * noise(seed), noise(3)) for seed, distance in enumerate((0.0, 20.0))]
    small = Nothing((8, 8))
    retrieve_resumably(
        small,
        Field(small.scene.object_grid, np.ones((8, 8), np.complex64), 0.532),
        [Recorded(one.distance_mm, one.amplitude[:8, :8], one.sigma[:8, :8]) for one in planes],
        iterations=1,
    )
    taken = peak(lambda: retrieve_resumably(engine, light, planes, iterations=2)) + 8.0 + 16.0
    most, _ = told(engine, method="paper")
    assert 0.7 * taken < most < 1.6 * taken
