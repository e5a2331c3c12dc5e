"""Free space between grids, as an operator whose size is known beforehand."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from wavesim.analytic.beam import Beam
from wavesim.fields.field import Grid, relative_error
from wavesim.fields.propagator import FreeSpacePropagator

PAIRS = {
    "line": (Grid((4000,), 3e-4, -0.3, (0.0, 0.02)), Grid((7000,), 5e-4, 0.1)),
    "plane": (Grid((120, 130), 4e-4, -0.3, (0.01, 0.02)), Grid((160, 100), 6e-4, 0.1)),
    "back": (Grid((400,), 3e-4, 0.1), Grid((500,), 3e-4, -0.1)),
    "same samples": (Grid((300, 310), 4e-4, -0.3, (0.01, 0.02)), Grid((300, 310), 4e-4, 0.1)),
    "same plane": (Grid((400,), 3e-4, 0.1), Grid((300,), 2e-4, 0.1)),
}


@pytest.fixture(params=PAIRS)
def passage(request: pytest.FixtureRequest) -> FreeSpacePropagator:
    return FreeSpacePropagator(*PAIRS[request.param], 0.532, 1.3)


def noise(grid: Grid, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.asarray(rng.normal(size=grid.shape) + 1j * rng.normal(size=grid.shape))


def test_adjoint_is_exact(passage: FreeSpacePropagator) -> None:
    u, v = noise(passage.source, 1), noise(passage.target, 2)
    there = passage.target.cell * np.vdot(v, passage.forward(u))
    back = passage.source.cell * np.vdot(passage.adjoint(v), u)
    assert abs(there - back) < 1e-11 * abs(there)


def test_beam() -> None:
    beam = Beam(0.532, 0.05, -0.1)
    source, target = Grid((1200,), 1e-4, -0.1), Grid((600,), 3e-4, 0.4, (0.0, 0.02))
    found = FreeSpacePropagator(source, target, 0.532, 1.0).forward(beam.field(source.y_mm, source.z_mm))
    assert relative_error(found, beam.field(target.y_mm, target.z_mm)) < 1e-6


@pytest.mark.parametrize("kind", ["line", "plane", "same samples"])
def test_predicts_its_memory_and_time(kind: str) -> None:
    passage = FreeSpacePropagator(*PAIRS[kind], 0.532, 1.3)
    values = noise(passage.source, 3)
    passage.forward(values)
    tracemalloc.start()
    try:
        passage.forward(values)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert passage.peak_bytes == pytest.approx(peak, rel=0.3)
    assert passage.seconds > 0.0  # held against the time that engines take by benchmarks.chooser
