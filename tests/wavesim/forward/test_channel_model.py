"""The model of a recording: pixels that integrate, weights, and the noise of a step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from small_twins import small_twin

from lensdesign.lens.lens import Sensor
from wavesim.engines.registry import engine_on
from wavesim.fields.propagator import propagate
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.step_noise import noise_of_step
from wavesim.runtime import threads
from wavesim.scene.light_errors import LightErrors
from wavesim.scene.source import Source, SourceMode
from wavesim.sensor.measurement import Measurement
from wavesim.sensor.sensor import light_on_pixels, on_sensor

PITCH = 3.2e-3


@pytest.fixture(scope="module", autouse=True)
def two_threads() -> Iterator[None]:
    """Whatever number of cores there is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threads, "THREADS", 2)
        yield


@pytest.fixture(scope="module")
def model_parts() -> tuple:
    return small_twin()


@pytest.mark.parametrize(
    ("fill_factor", "modes"),
    [
        (0.0, ()),
        (1.0, ()),
        (1.0, Source(2.0).modes(0.532, 1, 4)),
        (1.0, Source(2.0, 60.0).modes(0.532, 1, 2)),
    ],
)
def test_a_step_goes_down_the_misfits_slope(
    model_parts: tuple, fill_factor: float, modes: Sequence[SourceMode]
) -> None:
    """Against differences of the misfit, with weights, shifts, tilts, backgrounds and wide or broad light."""
    engine, lit = model_parts
    rng = np.random.default_rng(4)
    t = 0.7 + 0.2 * rng.standard_normal(lit.grid.shape)
    truth = 0.7 + 0.2 * rng.standard_normal(lit.grid.shape)
    shape = engine.scene.exit_grid.shape
    blank = [Measurement(d, np.ones(shape)) for d in (0.0, 0.6)]
    seen = ChannelModel.of_source(engine, lit, blank, 1.0, fill_factor).amplitudes(truth.astype(complex))
    planes = [
        Measurement(
            p.distance_mm,
            a,
            np.where(rng.random(shape) < 0.1, np.inf, 1.0 + rng.random(shape)),
            (1e-3 * n, -2e-3 * n),
            0.02 * n * np.mean(a * a) * rng.random(shape),
            (0.9 * n, -1.4 * n),
        )
        for n, (p, a) in enumerate(zip(blank, seen, strict=True))
    ]
    model = ChannelModel.of_source(engine, lit, planes, 1.0, fill_factor, modes=modes)
    change, *_ = model.step(t.astype(complex))

    def cost(values: np.ndarray) -> float:
        misfit = model.step(values.astype(complex))[1]
        return 0.5 * (misfit * model.size) ** 2

    cells = engine.scene.exit_grid.cell / lit.grid.cell
    way = (truth - t) * lit.values.real
    small = 1e-4
    slope = (cost(t + small * way) - cost(t - small * way)) / (2.0 * small) * cells / len(planes)
    assert float(np.vdot(change, way).real) == pytest.approx(-slope, rel=5e-3)


def test_light_of_a_wide_source_is_that_of_its_directions_added_up(model_parts: tuple) -> None:
    engine, lit = model_parts
    rng = np.random.default_rng(5)
    t = (0.7 + 0.2 * rng.standard_normal(lit.grid.shape)).astype(complex)
    blank = [Measurement(d, np.ones(engine.scene.exit_grid.shape)) for d in (0.0, 0.6)]
    modes = Source(2.0).modes(0.532, 1, 4)
    found = ChannelModel.of_source(engine, lit, blank, 1.0, 1.0, modes=modes).amplitudes(t)
    apart = [
        ChannelModel.of_source(engine, LightErrors(mode.tilt_deg).on(lit), blank, 1.0, 1.0).amplitudes(t)
        for mode in modes
    ]
    for number, one in enumerate(found):
        expected = sum(m.weight * a[number] ** 2 for m, a in zip(modes, apart, strict=True))
        assert np.allclose(one**2, expected, atol=1e-10 * expected.max())
        assert np.linalg.norm(one - apart[0][number]) > 0.1 * np.linalg.norm(one)


def test_broad_light_is_recorded_as_simulated_frames_record_it(model_parts: tuple) -> None:
    """Simulated frames have more wavelengths, and pixels that integrate exactly."""
    engine, lit = model_parts
    t = np.random.default_rng(5).standard_normal(lit.grid.shape)  # scatters all of the light
    grid, source = engine.scene.exit_grid, Source(bandwidth_nm=60.0)
    blank = [Measurement(0.3, np.ones(grid.shape))]
    (broad,), (narrow,) = (
        ChannelModel.of_source(engine, lit, blank, 1.0, 1.0, modes=modes).amplitudes(t)
        for modes in (source.few_modes(0.532, samples=lit.grid.shape[0]), ())
    )
    sensor = Sensor(pixel_pitch_um=1e3 * PITCH, pixels=grid.shape[::-1], plane_distances_mm=(1.0,))
    finer = replace(
        grid, shape=(2 * grid.shape[0], 2 * grid.shape[1]), pitch_mm=0.5 * PITCH, z_mm=grid.z_mm + 0.3
    )
    expected = np.zeros(grid.shape)
    for weight, _, wavelength_um, _ in source.modes(0.532, samples=lit.grid.shape[0]):
        scene = replace(engine.scene, wavelength_um=wavelength_um)
        behind = engine_on(engine, scene).forward(
            replace(lit, values=t * lit.values, wavelength_um=wavelength_um)
        )
        expected += weight * light_on_pixels(
            propagate(behind, finer, coarse_output=True), sensor, fill_factor=1.0
        )
    change = expected - narrow**2
    assert np.linalg.norm(change) > 0.05 * np.linalg.norm(expected)
    assert np.linalg.norm(broad**2 - expected) < 0.05 * np.linalg.norm(change)


def test_the_noise_of_a_step_is_that_of_a_nearly_unitary_engine(model_parts: tuple) -> None:
    """Less than the closed form by the part of the object's band beyond the aperture."""
    engine, lit = model_parts
    shape, sigma = engine.scene.exit_grid.shape, 0.02
    planes = [Measurement(d, np.ones(shape), np.full(shape, sigma)) for d in (0.0, 0.6)]
    found = noise_of_step(ChannelModel.of_source(engine, lit, planes, 1.0))
    whole = sigma * np.sqrt(engine.scene.exit_grid.cell / (2.0 * len(planes) * lit.grid.cell))
    band = np.pi * (0.5 / 0.532e-3 * lit.grid.pitch_mm) ** 2
    assert 0.75 * np.sqrt(band) * whole < found < 1.1 * np.sqrt(band) * whole


@pytest.mark.parametrize("fill_factor", [0.0, 1.0])
def test_a_shifted_sensor_with_a_background_sees_the_light_shifted_and_added_to(
    model_parts: tuple, fill_factor: float
) -> None:
    """By whole pixels, a shift is a roll of what the sensor in place sees."""
    engine, lit = model_parts
    shape = engine.scene.exit_grid.shape
    background = np.full(shape, 0.03)
    planes = [
        Measurement(0.6, np.ones(shape)),
        Measurement(0.6, np.ones(shape), None, (3 * PITCH, -PITCH), background),
    ]
    still, moved = ChannelModel.of_source(engine, lit, planes, 1.0, fill_factor).amplitudes(
        np.ones(lit.grid.shape)
    )
    expected = np.sqrt(np.roll(still**2, (1, -3), (0, 1)) + 0.03)
    assert np.allclose(moved, expected, atol=1e-5 * still.max())


@pytest.mark.parametrize("fill_factor", [0.0, 1.0])
def test_a_tilt_of_the_sensor_changes_what_it_sees_as_in_simulated_frames(
    model_parts: tuple, fill_factor: float
) -> None:
    engine, lit = model_parts
    grid, tilt_deg = engine.scene.exit_grid, (2.4, -1.8)
    t = 0.7 + 0.6 * np.random.default_rng(6).standard_normal(lit.grid.shape)
    planes = [Measurement(0.3, np.ones(grid.shape), tilt_deg=tilt) for tilt in ((0.0, 0.0), tilt_deg)]
    upright, tilted = ChannelModel.of_source(engine, lit, planes, 1.0, fill_factor).amplitudes(t)
    finer = replace(grid, shape=(432, 432), pitch_mm=0.5 * PITCH, z_mm=grid.z_mm + 0.3)
    there = propagate(engine.forward(lit.with_values(t * lit.values)), finer, coarse_output=True)
    sensor = Sensor(pixel_pitch_um=1e3 * PITCH, pixels=(216, 216), plane_distances_mm=(1.0,))
    before, after = (
        light_on_pixels(on_sensor(there, tilt), sensor, fill_factor=fill_factor)
        for tilt in ((0.0, 0.0), tilt_deg)
    )
    change = after - before
    assert np.linalg.norm(change) > 1e-3 * np.linalg.norm(after)
    assert np.linalg.norm(tilted**2 - upright**2 - change) < 0.05 * np.linalg.norm(change)


def test_once_a_plane_has_its_amplitudes_more_rounds_change_nothing(model_parts: tuple) -> None:
    """Of one plane at points, a round of length 1 replaces the amplitudes, and leaves none to replace."""
    engine, lit = model_parts
    amplitude = 0.1 + np.random.default_rng(8).random(engine.scene.exit_grid.shape)
    model = ChannelModel.of_source(engine, lit, [Measurement(0.0, amplitude)], 1.0)
    once, misfit, _ = model.step(lit.values)
    for rounds in (2, 4):
        again, same, _ = model.step(lit.values, rounds)
        assert np.allclose(again, once, atol=1e-12 * np.abs(once).max())
        assert same == misfit
    short, *_ = model.step(lit.values, 2, 0.5)
    assert np.allclose(short, 1.5 * once, atol=1e-12 * np.abs(once).max())


@pytest.mark.parametrize("length", [0.5, 1.0])
def test_planes_in_turn_leave_the_amplitudes_of_the_last_plane(model_parts: tuple, length: float) -> None:
    """Of one plane at points, the field has its amplitudes, whatever the first length (of 1 at most)."""
    engine, lit = model_parts
    amplitude = 0.1 + np.random.default_rng(8).random(engine.scene.exit_grid.shape)
    model = ChannelModel.of_source(engine, lit, [Measurement(0.0, amplitude)], 1.0)
    once, misfit, _ = model.step(lit.values)
    for rounds in (2, 4):
        again, same, _ = model.step(lit.values, rounds, length, planes_in_turn=True)
        assert np.allclose(length * again, once, atol=1e-12 * np.abs(once).max())
        assert same == misfit


def test_planes_in_turn_and_planes_at_once_are_the_same_for_one_plane_of_pixels(model_parts: tuple) -> None:
    engine, lit = model_parts
    amplitude = 0.1 + np.random.default_rng(8).random(engine.scene.exit_grid.shape)
    model = ChannelModel.of_source(engine, lit, [Measurement(0.6, amplitude)], 1.0, 1.0)
    at_once, in_turn = (
        model.step(lit.values, 3, planes_in_turn=planes_in_turn)[0] for planes_in_turn in (False, True)
    )
    assert np.allclose(in_turn, at_once, atol=1e-10 * np.abs(at_once).max())


@pytest.mark.parametrize("rounds", [1, 3])
def test_directions_that_are_all_the_same_are_one(model_parts: tuple, rounds: int) -> None:
    engine, lit = model_parts
    random = np.random.default_rng(9)
    planes = [Measurement(d, 0.1 + random.random(engine.scene.exit_grid.shape)) for d in (0.0, 0.6)]
    one, many = (
        ChannelModel.of_source(engine, lit, planes, 1.0, 1.0, modes=modes).step(lit.values, rounds, 1.3)
        for modes in ((), Source(1e-9).few_modes(0.532))
    )
    assert np.allclose(many[0], one[0], atol=1e-8 * np.abs(one[0]).max())
    assert many[1] == pytest.approx(one[1])
