"""The control of the score test tells another bench from an object that the total variation holds back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lensdesign import load_design, scaled
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.step_noise import noise_of_step
from wavesim.reconstruction.diagnostics.bench_control import Bench, displaced_bench, measured_part
from wavesim.reconstruction.diagnostics.score_test import MOUNTING, SOURCE, ScoreTest, score_test
from wavesim.reconstruction.object_solver import reconstruct
from wavesim.scene.patches import patch_scene
from wavesim.sensor.measurement import Measurement, recorded_intensity

NO_ERRORS = dict.fromkeys(
    (*MOUNTING, *SOURCE, "plane_2_shift_x_um", "plane_2_shift_y_um", "plane_distance_2_mm"), 0.0
)
SCALE = 150.0


def textured(bench: Bench) -> NDArray[np.floating]:
    """Return a grey picture with detail everywhere."""
    grid = bench.light.grid
    x, y = 1e3 * grid.x_mm, 1e3 * grid.y_mm[:, None]
    return np.asarray(0.5 + 0.2 * np.sin(1.4 * x + 0.3 * y) * np.cos(1.1 * y) + 0.02 * x)


def recorded(bench: Bench) -> list[Measurement]:
    """Return planes of the textured picture with shot noise."""
    model = ChannelModel.of_source(bench.engine, bench.light, bench.recorded, SCALE)
    random, planes = np.random.default_rng(1), []
    modelled = model.amplitudes(textured(bench).astype(np.complex64))
    for plane, amplitude in zip(bench.recorded, modelled, strict=True):
        electrons = random.poisson(amplitude.astype(float) ** 2).astype(float)
        planes.append(recorded_intensity(plane.distance_mm, electrons, np.maximum(electrons, 1.0)))
    return planes


@pytest.fixture(scope="module")
def assumed() -> Bench:
    scene = patch_scene(scaled(load_design("designs/paper_singlet.toml"), 1 / 48), 0.02)
    engine, grid = engine_for(scene, "eikonal", error=0.05), scene.object_grid
    inside = np.sqrt(grid.radius_squared_mm2()) < 0.009
    blank = [Measurement(z, np.zeros(scene.exit_grid.shape, np.float32)) for z in (0.0, 0.3)]
    return Bench(engine, Field(grid, inside.astype(np.complex64), scene.wavelength_um), blank)


def control_of(bench: Bench, errors: Mapping[str, float], tv_factor: float) -> tuple[ScoreTest, float]:
    """Return the score test of frames from a bench with errors, and the measured part of its prediction."""
    frames = recorded(displaced_bench(bench, NO_ERRORS | dict(errors)))
    given = replace(bench, recorded=frames)
    weight = (
        tv_factor * noise_of_step(ChannelModel.of_source(bench.engine, bench.light, frames, SCALE)) / SCALE
    )
    settings: dict[str, Any] = {"kind": "amplitude", "scale": SCALE, "fill_factor": 0.0}
    found = reconstruct(
        bench.engine, bench.light, frames, tv_weight=weight, iterations=40, **settings
    ).transmission
    test = score_test(
        bench.engine, bench.light, frames, found.values, fits_scale=False, model_error=1e-3, **settings
    )
    return test, measured_part(given, found, test.estimate, test.fall, **settings)


def test_a_displaced_bench_lowers_the_misfit_as_predicted(assumed: Bench) -> None:
    test, part = control_of(assumed, {"decenter_x_mm": 4e-4, "plane_2_shift_x_um": 0.5}, 1.0)
    assert test.chi_square > 500.0
    assert 0.7 < part < 1.3


def test_an_object_that_the_total_variation_holds_back_does_not(assumed: Bench) -> None:
    test, part = control_of(assumed, {}, 20.0)
    assert test.chi_square > 500.0
    assert part < 0.3


def test_a_bench_is_displaced_in_the_units_of_the_names(assumed: Bench) -> None:
    errors = NO_ERRORS | {
        "decenter_y_mm": 1e-3,
        "tilt_x_deg": 0.1,
        "working_distance_mm": 2e-3,
        "plane_2_shift_y_um": 2.0,
        "plane_distance_2_mm": 0.01,
        "source_deg": 0.2,
    }
    bench = displaced_bench(assumed, errors)
    before, after = assumed.engine.scene, bench.engine.scene
    assert (after.pose.decenter_y_mm, after.pose.tilt_x_deg) == (1e-3, 0.1)
    assert bench.light.grid == after.object_grid
    assert before.object_grid.z_mm - after.object_grid.z_mm == pytest.approx(2e-3)
    assert bench.recorded[0] is assumed.recorded[0]
    assert bench.recorded[1].shift_mm == pytest.approx((0.0, 2e-3))
    assert bench.recorded[1].distance_mm == pytest.approx(0.31)
    assert bench.source.width_deg == 0.2
