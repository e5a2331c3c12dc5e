"""Memory of a reconstruction and of what follows it: predicted, and kept by files."""

from __future__ import annotations

import os
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensdesign import load_design
from wavesim.fields.field import Field, Grid
from wavesim.forward import bands, channel_model, exit_field, pixel_means
from wavesim.metrics import transmitted_band
from wavesim.metrics.result_quality import truth_metrics
from wavesim.reconstruction.memory import (
    COMPARED_BYTES,
    MOVABLE_COMPARED_BYTES,
    SHARPNESS_BYTES,
    paper_bytes,
    reconstruction_bytes,
    retrieval_bytes,
)
from wavesim.reconstruction.object_solver import reconstruct
from wavesim.reconstruction.phase_retrieval import retrieve
from wavesim.reconstruction.refocusing import refocus_field
from wavesim.reconstruction.resumable import retrieve_resumably
from wavesim.runtime import threads as blocks
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Cost, Engine
from wavesim.scene.scene import Scene
from wavesim.scene.settings import Kind
from wavesim.scene.source import Source
from wavesim.sensor.measurement import Measurement
from wavesim.targets.patch import LIGHT_BYTES, Patch, make_illumination

SHAPE = (4000, 300)
"""Many rows: what goes in blocks of rows is to be small beside all."""


class Nothing(Engine):
    """Lets the field through as it is; takes no memory but its result."""

    name = "nothing"

    def __init__(self, shape: tuple[int, int]) -> None:
        lens = load_design("designs/paper_singlet.toml")
        before = Grid(shape, 0.4e-3, lens.object_z_mm)
        behind = Grid(shape, 3.2e-3, lens.exit_vertex_z_mm + 5.0)
        super().__init__(Scene(lens, before, behind, 0.532))

    def _forward(self, values: Any) -> Any:
        return values.copy()

    _adjoint = _forward

    def cost(self) -> Cost:
        return Cost(0.1, 0.0, 0)

    def at_wavelength(self, wavelength_um: float) -> Nothing:
        other = Nothing(self.scene.object_grid.shape)
        other.scene = replace(self.scene, wavelength_um=wavelength_um)
        return other

    def error_terms(self) -> tuple:
        return ()

    def settings(self) -> dict:
        return {}


def arrays_of(
    engine: Engine, distances_mm: tuple[float, ...], with_sigma: bool, room: Scratch
) -> tuple[Field, list[Measurement]]:
    """Light and recorded planes, in files or in memory."""
    grid, random = engine.scene.object_grid, np.random.default_rng(1)
    light = Field(grid, room.moved(np.ones(grid.shape, np.complex64)), 0.532)

    def noise(size: float) -> np.ndarray:
        return room.moved(np.float32(size) * (random.random(grid.shape, np.float32) + np.float32(1.0)))

    # So little noise that the misfit is far above it, where steps take most.
    return light, [Measurement(d, noise(1.0), noise(1e-3) if with_sigma else None) for d in distances_mm]


def peak_bytes(work: Callable[[], object]) -> int:
    """Largest memory of the arrays that exist while something runs."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(("kind", "fill_factor"), [("amplitude", 1.0), ("amplitude", 0.0), ("complex", 0.0)])
@pytest.mark.parametrize(
    ("distances_mm", "with_sigma"), [((0.0,), True), ((0.0, 20.0), True), ((5.0, 9.0, 20.0), False)]
)
def test_the_estimate_is_about_what_is_taken(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    kind: Kind,
    fill_factor: float,
    distances_mm: tuple[float, ...],
    with_sigma: bool,
) -> None:
    """In memory and in files."""
    for place, name, value in (
        (channel_model, "ROWS", 2),
        (exit_field, "ROWS", 2),
        (pixel_means, "COLUMNS", 4),
        (bands, "BAND", 400),
        (bands, "NEW_ROWS", 2),
    ):
        monkeypatch.setattr(place, name, value)  # blocks are small beside a whole field
    monkeypatch.setattr(pixel_means, "rows_in", lambda bytes_of_row: 4)
    shape, settings = (480, 400), {"kind": kind, "fill_factor": fill_factor}

    def run(engine: Nothing, room: Scratch) -> tuple[int, int]:
        light, recorded = arrays_of(engine, distances_mm, with_sigma, room)
        weight = "auto" if with_sigma else 0.02
        reconstruct(engine, light, recorded, scratch=room, iterations=2, tv_weight=weight, **settings)
        need = reconstruction_bytes(engine, recorded, **settings)
        return need.most_bytes, need.least_bytes

    # Compiled loops take memory once, as they are compiled or loaded. Some are reached at this size alone.
    most, least = run(Nothing(shape), Scratch())
    engine = Nothing(shape)
    in_memory = peak_bytes(lambda: run(engine, Scratch()))
    in_files = peak_bytes(lambda: run(engine, Scratch(tmp_path, 0.0)))
    assert 0.97 * in_memory < most < 1.3 * in_memory
    assert 0.97 * in_files < least < 1.3 * in_files


@pytest.mark.parametrize(
    ("source", "tilt_deg"),
    [
        (Source(0.3), (0.0, 0.0)),
        (Source(), (1.0, 0.7)),
        (Source(0.3), (1.0, 0.7)),
        (Source(0.0, 5.0), (0.0, 0.0)),
        (Source(0.0, 5.0), (1.0, 0.7)),
    ],
)
def test_memory_of_a_wide_or_broad_source_and_a_tilted_sensor_is_told_beforehand(
    source: Source, tilt_deg: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pixel_means, "rows_in", lambda bytes_of_row: 16)  # small beside a whole field
    modes = source.modes(0.532, rings=1)[:4]

    def run(engine: Nothing) -> float:
        light, recorded = arrays_of(engine, (0.0, 20.0), True, Scratch())
        tilted = [replace(plane, tilt_deg=tilt_deg) for plane in recorded]
        reconstruct(engine, light, tilted, fill_factor=1.0, iterations=2, tv_weight="auto", modes=modes)
        return reconstruction_bytes(engine, tilted, fill_factor=1.0, modes=modes).most_bytes

    run(Nothing((8, 8)))
    engine = Nothing((110, 120))
    taken = peak_bytes(lambda: run(engine))
    assert 0.77 * taken < run(engine) < 1.3 * taken


LIMITED = """
import pathlib, resource, sys
import numpy as np
sys.path.insert(0, {tests!r})
from test_memory import Nothing, arrays_of
from wavesim.reconstruction.phase_retrieval import retrieve
from wavesim.reconstruction.object_solver import reconstruct
from wavesim.reconstruction.memory import reconstruction_bytes
from wavesim.runtime.scratch import Scratch
from wavesim.sensor.measurement import Measurement

def run(shape, room):
    engine = Nothing(shape)
    light, recorded = arrays_of(engine, (0.0, 20.0), True, room)
    settings = dict(kind="amplitude", fill_factor=1.0, tv_weight="auto", iterations=2)
    reconstruct(engine, light, recorded, scratch=room, **settings)

run((64, 64), Scratch())  # compiles and loads all
status = pathlib.Path("/proc/self/status").read_text()
used = 1024 * int(status.split("VmData:")[1].split()[0])
shape = (1100, 1200)
engine = Nothing(shape)
recorded = [Measurement(distance, *np.zeros((2, *shape), np.float32)) for distance in (0.0, 20.0)]
predicted = reconstruction_bytes(engine, recorded, kind="amplitude", fill_factor=1.0)
del engine, recorded
limit = (predicted.least_bytes + predicted.most_bytes) // 2
resource.setrlimit(resource.RLIMIT_DATA, (used + limit, used + limit))
room = Scratch() if {in_memory} else Scratch(pathlib.Path({folder!r}), 0.3 * (limit - predicted.least_bytes))
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


@pytest.fixture(scope="module")
def engine() -> Nothing:
    return Nothing(SHAPE)


def peak(work: Callable[[], object]) -> float:
    """Bytes for each sample that something takes."""
    return peak_bytes(work) / (SHAPE[0] * SHAPE[1])


def noise(seed: int) -> Any:
    return np.random.default_rng(seed).random(SHAPE, np.float32) + np.float32(1.0)


def test_light_and_refocusing_take_what_is_told(engine: Nothing) -> None:
    patch = Patch(engine.scene.object_grid, 0.1, 0.532)
    assert 0.8 * LIGHT_BYTES < peak(lambda: make_illumination(patch)) < 1.2 * LIGHT_BYTES
    part = Field(
        Nothing((250, 250)).scene.object_grid,
        np.exp(1j * noise(1).ravel()[: 250**2].reshape(250, 250)),
        0.532,
    )
    carried = SHAPE[0] * SHAPE[1] / 250**2 * peak(lambda: refocus_field(part, (-0.002, 0.002), 2.1e-3))
    assert 0.7 * carried < SHARPNESS_BYTES < 1.4 * carried


def test_a_comparison_keeps_within_what_is_told_and_to_files_where_there_is_no_room(
    engine: Nothing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blocks, "BLOCK", 256)  # a whole field has many blocks
    monkeypatch.setattr(transmitted_band, "BLOCK_ZONES", 0.5)  # each of which is small
    grid = engine.scene.object_grid
    fields = [
        Field(grid, (noise(seed) + 1j * noise(seed + 1)).astype(np.complex64), 0.532) for seed in (1, 3)
    ]
    light = fields[0].with_values(np.ones(SHAPE, np.complex64))

    def compare(room: Scratch, rows: slice = slice(None)) -> None:
        scene = engine.scene if rows == slice(None) else Nothing((64, SHAPE[1])).scene
        found, true, lit = (Field(scene.object_grid, one.values[rows], 0.532) for one in (*fields, light))
        truth_metrics(found, true, lit, np.ones(scene.object_grid.shape, bool), scene, room)

    compare(Scratch(), slice(64))  # compiled loops and libraries take memory once
    in_memory, in_files = peak(lambda: compare(Scratch())), peak(lambda: compare(Scratch(tmp_path, 0.0)))
    assert in_files < 0.75 * in_memory
    assert in_files < COMPARED_BYTES < 1.3 * in_files
    assert in_memory < COMPARED_BYTES + MOVABLE_COMPARED_BYTES < 1.3 * in_memory


def test_the_paper_s_way_takes_what_is_told(engine: Nothing) -> None:
    grid = engine.scene.object_grid
    light = Field(grid, np.ones(SHAPE, np.complex64), 0.532)
    given = [Measurement(distance, 64.0 * noise(seed), noise(3)) for seed, distance in enumerate((0.0, 20.0))]
    small = Nothing((8, 8))
    retrieve_resumably(
        small,
        Field(small.scene.object_grid, np.ones((8, 8), np.complex64), 0.532),
        [Measurement(one.distance_mm, one.amplitude[:8, :8], one.sigma[:8, :8]) for one in given],
        iterations=1,
    )
    taken = peak(lambda: retrieve_resumably(engine, light, given, iterations=2)) + 8.0 + 16.0
    most = paper_bytes(engine, given).most_bytes / engine.scene.object_grid.size
    assert 0.9 * taken < most < 1.3 * taken


@pytest.mark.parametrize("distances", [(0.0, 3.0), (2.0, 22.0), (2.0, 8.0, 22.0)])
@pytest.mark.parametrize("masked", [False, True])
def test_appendix_a_takes_what_is_listed(distances: tuple[float, ...], masked: bool) -> None:
    shape = (900, 850)
    rng, grid = np.random.default_rng(5), Grid(shape, 3.2e-3, 0.0)
    sigma = np.ones(shape, np.float32)
    sigma[5, 7] = np.inf
    given = [
        Measurement(d, 60.0 + rng.random(shape, dtype=np.float32), sigma if masked else None)
        for d in distances
    ]
    retrieve(
        Grid((8, 8), 3.2e-3, 0.0), 0.532, [Measurement(d, np.ones((8, 8))) for d in (0.0, 1.0)], tv_step=0
    )
    taken = peak_bytes(lambda: retrieve(grid, 0.532, given, iterations=3))
    assert retrieval_bytes(shape, len(given)) == pytest.approx(taken, rel=0.3)
