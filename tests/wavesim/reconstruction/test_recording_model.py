"""The model of a recording: pixels that integrate, weights, and the noise of a step."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import load_design, scaled
from wavesim.camera.recorded import Recorded
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.recording_model import RecordingModel
from wavesim.scene.scene import Scene

PITCH = 3.2e-3


@pytest.fixture(scope="module")
def model_parts() -> tuple:
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    grid = Grid((60, 60), 4.2e-4, lens.object_z_mm)
    exit_grid = Grid((216, 216), PITCH, lens.exit_vertex_z_mm + 0.08)
    engine = engine_for(Scene(lens, grid, exit_grid, 0.532), "eikonal", error=0.3)
    stop = (np.hypot(grid.y_mm[:, None], grid.x_mm) < 0.012).astype(complex)
    return engine, Field(grid, stop, 0.532)


@pytest.mark.parametrize("active_width", [0.0, 1.0])
def test_a_step_goes_down_the_misfits_slope(model_parts: tuple, active_width: float) -> None:
    """Against differences of the misfit, with weights, along directions within the field stop."""
    engine, lit = model_parts
    rng = np.random.default_rng(4)
    t = 0.7 + 0.2 * rng.standard_normal(lit.grid.shape)
    truth = 0.7 + 0.2 * rng.standard_normal(lit.grid.shape)
    shape = engine.scene.exit_grid.shape
    blank = [Recorded(d, np.ones(shape)) for d in (0.0, 0.6)]
    seen = RecordingModel(engine, lit, blank, 1.0, active_width).amplitudes(truth.astype(complex))
    planes = [
        Recorded(p.distance_mm, a, np.where(rng.random(shape) < 0.1, np.inf, 1.0 + rng.random(shape)))
        for p, a in zip(blank, seen, strict=True)
    ]
    model = RecordingModel(engine, lit, planes, 1.0, active_width)
    change, _ = model.step(t.astype(complex))

    def cost(values: np.ndarray) -> float:
        misfit = model.step(values.astype(complex))[1]
        return 0.5 * (misfit * model.size) ** 2

    cells = engine.scene.exit_grid.cell / lit.grid.cell
    way = (truth - t) * lit.values.real
    small = 1e-4
    slope = (cost(t + small * way) - cost(t - small * way)) / (2.0 * small) * cells / len(planes)
    assert float(np.vdot(change, way).real) == pytest.approx(-slope, rel=5e-3)


def test_the_noise_of_a_step_is_that_of_a_nearly_unitary_engine(model_parts: tuple) -> None:
    """Less than the closed form by the part of the object's band beyond the aperture."""
    engine, lit = model_parts
    shape, sigma = engine.scene.exit_grid.shape, 0.02
    planes = [Recorded(d, np.ones(shape), np.full(shape, sigma)) for d in (0.0, 0.6)]
    found = RecordingModel(engine, lit, planes, 1.0).noise_of_step()
    whole = sigma * np.sqrt(engine.scene.exit_grid.cell / (2.0 * len(planes) * lit.grid.cell))
    band = np.pi * (0.5 / 0.532e-3 * lit.grid.pitch_mm) ** 2
    assert 0.75 * np.sqrt(band) * whole < found < 1.1 * np.sqrt(band) * whole
