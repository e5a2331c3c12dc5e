"""Derivatives of recorded amplitudes with the mounting, against those of engines made anew."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import load_design, scaled
from lensdesign.lens.poses import Pose
from wavesim.calibration.parameters import mounting_parameters
from wavesim.calibration.response import mounting_response
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid
from wavesim.forward.channel_model import ChannelModel
from wavesim.scene.scene import Scene, placed_light, placed_scene
from wavesim.scene.system_state import SystemState
from wavesim.sensor.measurement import Measurement, placed_planes

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
PARAMETERS = mounting_parameters(LENS, 2)
STEPS = {"tilt_x_deg": 0.01, "tilt_y_deg": 0.01, "working_distance_mm": 2e-4}
HERE = SystemState(Pose(decenter_x_mm=1e-3, tilt_y_deg=0.2), plane_distance_errors_mm=(1e-3, 0.0))


class Bench:
    """Bars behind a small twin, with a mounting that can be moved."""

    def __init__(self) -> None:
        grid = Grid((120, 120), 4.2e-4, LENS.object_z_mm)
        exit_grid = Grid((216, 216), 3.2e-3, LENS.exit_vertex_z_mm + 0.08)
        self.scene = Scene(LENS, grid, exit_grid, 0.532)
        radius = np.hypot(grid.y_mm[:, None], grid.x_mm)
        stop = 1.0 / (1.0 + np.exp((radius - 0.02) / 5e-4))
        self.light = Field(grid, stop.astype(np.complex64), 0.532)
        bars = 0.5 * (1.0 + np.sign(np.sin(2e3 * np.pi * grid.x_mm / 3.0)))
        self.transmission = np.broadcast_to(bars, grid.shape).astype(np.complex64)
        self.recorded = [
            Measurement(0.0, np.ones(exit_grid.shape)),
            Measurement(0.6, np.ones(exit_grid.shape)),
        ]

    def model(self, mounting: SystemState, fill_factor: float = 0.0) -> ChannelModel:
        engine = engine_for(placed_scene(self.scene, mounting), "eikonal", error=0.3)
        planes = placed_planes(self.recorded, mounting)
        return ChannelModel.of_source(engine, placed_light(self.light, mounting), planes, 1.0, fill_factor)

    def response(self, mounting: SystemState, fill_factor: float = 0.0, **settings: float) -> np.ndarray:
        model = self.model(mounting, fill_factor)
        return mounting_response(model, self.transmission, mounting, (), **settings).residual


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize(("blur_pixels", "fill_factor"), [(0.0, 0.0), (4.0, 1.0)])
def test_derivatives_are_those_of_the_engine(bench: Bench, blur_pixels: float, fill_factor: float) -> None:
    """Light near the aperture's edge, which moves with the lens but not in the generator, is what differs."""
    found = mounting_response(
        bench.model(HERE, fill_factor), bench.transmission, HERE, PARAMETERS, blur_pixels=blur_pixels
    )
    for parameter, change in zip(PARAMETERS, found.changes, strict=True):
        name, value = parameter.name, parameter.value(HERE)
        step = STEPS.get(name, 5e-5)
        up, down = (
            bench.response(parameter.set(HERE, value + s), fill_factor, blur_pixels=blur_pixels)
            for s in (step, -step)
        )
        numeric = (down - up) / (2.0 * step)  # the residual falls as the model grows
        sizes = np.linalg.norm(change), np.linalg.norm(numeric)
        assert np.dot(change, numeric) > 0.95 * sizes[0] * sizes[1], name
        assert sizes[0] == pytest.approx(sizes[1], rel=0.1), name


def test_a_scale_that_is_fitted_takes_its_part_out(bench: Bench) -> None:
    model = bench.model(HERE)
    fitted = mounting_response(model, bench.transmission, HERE, PARAMETERS, fits_scale=True)
    model.scale = 3.0
    again = mounting_response(model, bench.transmission, HERE, PARAMETERS, fits_scale=True)
    assert again.misfit == pytest.approx(fitted.misfit)
    assert again.changes == pytest.approx(fitted.changes, abs=1e-5 * np.abs(fitted.changes).max())
    assert fitted.misfit < mounting_response(model, bench.transmission, HERE, ()).misfit


def test_unknown_pixels_do_not_count(bench: Bench) -> None:
    model = bench.model(HERE)
    before = mounting_response(model, bench.transmission, HERE, PARAMETERS[:1], blur_pixels=2.0)
    spoilt = []
    for plane in bench.recorded:
        sigma, amplitude = np.ones(plane.amplitude.shape), plane.amplitude.copy()
        sigma[100:110, 100:110] = np.inf
        amplitude[100:110, 100:110] = 1e3
        spoilt.append(Measurement(plane.distance_mm, amplitude, sigma))
    masked = ChannelModel.of_source(model.engine, model.illumination, placed_planes(spoilt, HERE), 1.0, 0.0)
    after = mounting_response(masked, bench.transmission, HERE, PARAMETERS[:1], blur_pixels=2.0)
    assert after.misfit == pytest.approx(before.misfit, rel=0.02)
