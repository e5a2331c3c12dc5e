"""Light straight to some pixels, against all pixels and free space between planes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_twins import PIXEL_MM, WAVELENGTH_UM, bars_under_stop, lit_within, twin_scene, unknowns

from lensdesign.lens.lens import Lens
from wavesim.calibration.joint.pixels import DensePixels, SparsePixels, TilesToPlanes, padded_to_fast_shape
from wavesim.calibration.parameters import (
    Unknowns,
    bench_parameters,
    chosen_parameters,
    field_stop_parameters,
)
from wavesim.engines.choosing import engine_for
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.fields.field import Field, Grid
from wavesim.forward.linear_model import LinearModel
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene
from wavesim.scene.source import Source
from wavesim.scene.system_state import SystemState
from wavesim.sensor.measurement import Measurement, noise_misfit

BENCH = {
    "plane_2_shift_x_um": 3.0,
    "plane_2_shift_y_um": -2.0,
    "plane_distance_2_mm": 0.01,
    "sensor_tilt_x_deg": 0.8,
    "decenter_y_mm": 1e-3,
    "light_tilt_x_deg": 0.1,
}
PLANES_MM = 0.0, 0.6


def tiles(scene: Scene) -> Engine:
    return engine_for(scene, "eikonal", error=0.1)


@pytest.fixture(scope="module")
def seen() -> tuple[Lens, DensePixels, SparsePixels, np.ndarray]:
    """Every pixel, and every second one, on planes that nothing has been recorded on yet."""
    scene = twin_scene(60)
    light = Field(scene.object_grid, lit_within(scene, 0.012).astype(np.complex64), WAVELENGTH_UM)
    y, x = scene.object_grid.y_mm[:, None], scene.object_grid.x_mm
    bars = (np.cos(1400.0 * x + 0.3) > 0.2) | (np.cos(2300.0 * y) > 0.6 - 30.0 * x)
    shape = scene.exit_grid.shape
    blank = [Measurement(d, np.ones(shape, np.float32)) for d in PLANES_MM]
    every = DensePixels(scene, light, blank, 1.0, 0.0, tiles)
    centre = (-0.5 * PIXEL_MM, -0.5 * PIXEL_MM)
    fewer = Grid((108, 108), 2 * scene.exit_grid.pitch_mm, scene.exit_grid.z_mm, centre)
    planes = [Measurement(d, np.ones(fewer.shape, np.float32)) for d in PLANES_MM]
    rows = slice(0, 108), slice(108, 216)
    some = SparsePixels(replace(scene, exit_grid=fewer), light, planes, 1.0, 0.0, tiles, rows)
    return scene.lens, every, some, bars.astype(np.float32)


def test_pixels_see_what_they_see_among_all(seen: tuple) -> None:
    lens, every, some, bars = seen
    bench = unknowns(BENCH, lens)
    whole, points = (one.model(bench).amplitudes(bars) for one in (every, some))
    # On the second plane of so small a lens, tiles and free space draw the light's rim differently.
    for one, own, most in zip(whole, points, (1e-3, 0.1), strict=True):
        assert np.linalg.norm(one[::2, ::2] - own) < most * np.linalg.norm(own)
    nominal = some.model(Unknowns()).amplitudes(bars)
    assert np.linalg.norm(nominal[1] - points[1]) > 0.3 * np.linalg.norm(points[1])


def test_the_way_back_is_the_adjoint(seen: tuple) -> None:
    lens, _, some, bars = seen
    operator = some.model(unknowns(BENCH, lens)).engine
    assert isinstance(operator, TilesToPlanes)
    rng = np.random.default_rng(2)
    scene = operator.scene
    there = rng.standard_normal(scene.exit_grid.shape) + 1j * rng.standard_normal(scene.exit_grid.shape)
    lit = Field(scene.object_grid, bars.astype(complex), WAVELENGTH_UM)
    forth = np.vdot(there, operator.forward(lit).values) * scene.exit_grid.cell
    back = operator.adjoint(Field(scene.exit_grid, there, WAVELENGTH_UM)).values
    assert np.vdot(back, lit.values) * scene.object_grid.cell == pytest.approx(forth, rel=1e-5)


@pytest.mark.parametrize(
    "name",
    [
        "plane_2_shift_x_um",
        "plane_distance_2_mm",
        "sensor_tilt_x_deg",
        "decenter_y_mm",
        "tilt_x_deg",
        "surface_2_radius_mm",
        "working_distance_mm",
        "field_stop_shift_x_mm",
        "light_phase_20_waves",
        "plane_2_background",
        "plane_2_background_slope_y",
    ],
)
def test_columns_are_the_slopes_of_the_residuals(seen: tuple, name: str) -> None:
    """About a bench that is not as designed, so that tiles are turned already."""
    lens, _, some, bars = seen
    bench = unknowns(BENCH | {"plane_2_background": 0.01}, lens)
    allowed = *bench_parameters(lens, 2, 0.025, WAVELENGTH_UM), *field_stop_parameters(0.025)
    (parameter,) = chosen_parameters(name, allowed)
    here = LinearModel(some.model(bench), bars, False)
    (column,) = some.columns(bench, here, (parameter,))
    # What a tilt of the sensor does is near the rounding of single precision.
    step = (2.0 if name.startswith("sensor") else 0.2) * parameter.small
    there = bench.changed([parameter], [bench.values.get(parameter, 0.0) + step])
    reference = here.model.engine
    moved = LinearModel(some.model(there, reference), bars, False)
    change = (here.residual - moved.residual) / step
    assert np.linalg.norm(change - column) < 0.1 * np.linalg.norm(column)


@pytest.mark.parametrize("source", [Source(0.5), Source(0.0, 20.0)])
def test_columns_of_several_modes_are_the_slopes_of_the_residuals(seen: tuple, source: Source) -> None:
    lens, every, _, bars = seen
    bench = unknowns(BENCH, lens, SystemState(source=source))
    allowed = bench_parameters(lens, 2, 0.025, WAVELENGTH_UM)
    parameters = chosen_parameters("decenter_y_mm,surface_2_radius_mm", allowed)
    here = LinearModel(every.model(bench), bars, False)
    columns = every.columns(bench, here, parameters)
    for parameter, column in zip(parameters, columns, strict=True):
        step = 0.2 * parameter.small
        there = bench.changed([parameter], [bench.values.get(parameter, 0.0) + step])
        moved = LinearModel(every.model(there, here.model.engine), bars, False)
        change = (here.residual - moved.residual) / step
        assert np.linalg.norm(change - column) < 0.1 * np.linalg.norm(column)


def test_derivatives_of_other_tiles_are_computed_again() -> None:
    """A similar bench may divide the object into other tiles."""
    scene, light, bars, _ = bars_under_stop()
    blank = [Measurement(0.0, np.ones(scene.exit_grid.shape, np.float32))]
    whole, divided = (
        DensePixels(
            scene, light, blank, 1.0, 0.0, lambda one, w=width: FlatTiles(one, error=0.1, tile_width_mm=w)
        )
        for width in (0.06, 0.03)
    )
    bench = Unknowns()
    parameters = chosen_parameters("decenter_x_mm", bench_parameters(scene.lens, 1, 0.06, WAVELENGTH_UM))
    here, other = (LinearModel(pixels.model(bench), bars, False) for pixels in (divided, whole))
    given = [
        pixels.ray_derivatives(bench, linear.model.engine, parameters)
        for pixels, linear in ((divided, here), (whole, other))
    ]
    assert given[0] is not None
    assert given[1] is not None
    assert given[0].apply_to(here.model.engine)
    assert len(given[0].planes[0]) != len(given[1].planes[0])
    own, again = (divided.columns(bench, here, parameters, one) for one in given)
    assert np.linalg.norm(own) > 0.0
    assert np.array_equal(own, again)


def test_pixels_stay_where_they_are_and_new_ones_tell_nothing() -> None:
    grid = Grid((438, 437), 3.2e-3, 0.7, (0.1, -0.2))
    scene = replace(twin_scene(60), exit_grid=grid)
    rng = np.random.default_rng(1)
    plane = Measurement(0.0, 1.0 + rng.random(grid.shape), 0.01 + 0.01 * rng.random(grid.shape))
    wider, (padded,) = padded_to_fast_shape(scene, [plane])
    assert wider.exit_grid.shape == padded.amplitude.shape == (440, 440)
    assert wider.exit_grid.y_mm[1:-1] == pytest.approx(grid.y_mm)
    assert wider.exit_grid.x_mm[1:-2] == pytest.approx(grid.x_mm)
    assert np.array_equal(padded.amplitude[1:-1, 1:-2], plane.amplitude)
    assert padded.sigma is not None
    assert np.isfinite(padded.sigma).sum() == grid.shape[0] * grid.shape[1]
    assert noise_misfit([padded]) == pytest.approx(noise_misfit([plane]))


def test_what_is_fast_or_without_noise_stays() -> None:
    scene = replace(twin_scene(60), exit_grid=Grid((440, 440), 3.2e-3, 0.7))
    assert (
        padded_to_fast_shape(scene, [Measurement(0.0, np.ones((440, 440)), np.ones((440, 440)))])[0] is scene
    )
    slow = replace(scene, exit_grid=Grid((438, 440), 3.2e-3, 0.7))
    assert padded_to_fast_shape(slow, [Measurement(0.0, np.ones((438, 440)))])[0] is slow


def test_points_are_not_blurred(seen: tuple) -> None:
    lens, _, some, _ = seen
    model = some.model(unknowns(BENCH, lens, SystemState(vibration_um=1.0)))
    assert model.pixels is None
    assert [plane.blur_mm for plane in model.recorded] == [0.0, 0.0]
