"""Slopes of a recording's model, and the way back to the object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_twins import small_twin

from wavesim.fields.field import Grid
from wavesim.fields.propagator import propagator_to
from wavesim.fields.tilted_planes import TiltedPropagator
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.linear_model import CachedSamples, FreeSpaceMeasurement, LinearModel
from wavesim.forward.pixel_means import PixelMeans
from wavesim.scene.source import Source
from wavesim.scene.system_state import SystemState
from wavesim.sensor.measurement import Measurement, placed_planes, recorded_intensity


@pytest.fixture(scope="module")
def parts() -> tuple:
    """A model with two planes, and a transmission that is not the one that they recorded."""
    engine, lit = small_twin()
    rng = np.random.default_rng(1)
    truth, now = (0.7 + 0.2 * rng.standard_normal(lit.grid.shape) for _ in range(2))
    blank = [Measurement(d, np.ones(engine.scene.exit_grid.shape)) for d in (0.0, 0.6)]
    seen = ChannelModel.of_source(engine, lit, blank, 1.0, 1.0).amplitudes(truth.astype(complex))
    planes = [
        replace(p, amplitude=2.0 * a, sigma=1.0 + rng.random(a.shape), background=np.full(a.shape, 0.01))
        for p, a in zip(blank, seen, strict=True)
    ]
    return engine, lit, planes, now.astype(complex)


def linear(
    parts: tuple,
    *,
    changed: dict | None = None,
    transmission: np.ndarray | None = None,
    tilt_deg: tuple[float, float] = (0.0, 0.0),
    blur_mm: float = 0.0,
) -> LinearModel:
    engine, lit, planes, now = parts
    both = planes[0], replace(planes[1], **(changed or {}))
    planes = [replace(p, tilt_deg=tilt_deg, blur_mm=blur_mm) for p in both]
    model = ChannelModel.of_source(engine, lit, planes, None, 1.0)
    return LinearModel(model, now if transmission is None else transmission, True)


def test_the_way_back_is_the_adjoint(parts: tuple) -> None:
    here, rng = linear(parts), np.random.default_rng(2)
    change = rng.standard_normal(parts[3].shape) + 1j * rng.standard_normal(parts[3].shape)
    left = rng.standard_normal(here.residual.shape)
    there = float(np.vdot(here.jacobian_times_object(change), left))
    assert float(np.vdot(change, here.adjoint_to_object(left)).real) == pytest.approx(there, rel=1e-5)


def test_slopes_are_those_of_the_residuals(parts: tuple) -> None:
    """The scale follows by itself, so that what it does is left out of the differences too."""
    here, small = linear(parts), 1e-3
    direction, seen = np.random.default_rng(3).standard_normal(parts[3].shape), here.measurement
    assert isinstance(seen, FreeSpaceMeasurement)
    cases = {
        "object": (
            here.jacobian_times_object(direction),
            linear(parts, transmission=parts[3] + 1e-4 * direction),
            1e-4,
        ),
        "distance": (
            here.amplitude_change_on_plane(1, seen.by_distance(1)),
            linear(parts, changed={"distance_mm": 0.6 + small}),
            small,
        ),
        "tilt": (here.amplitude_changes(seen.by_tilt(1)), linear(parts, tilt_deg=(0.0, 1e-3)), 1e-3),
        "shift": (
            here.amplitude_change_on_plane(1, seen.by_shift(1, 0)),
            linear(parts, changed={"shift_mm": (1e-5, 0.0)}),
            1e-2,
        ),
    }
    pitch_mm = parts[0].scene.exit_grid.pitch_mm
    variance_um2 = 1e6 * (0.02 * pitch_mm) ** 2
    cases["blur"] = (
        here.amplitude_changes(seen.by_blur()),
        linear(parts, blur_mm=0.02 * pitch_mm),
        variance_um2,
    )
    for name, (slope, there, step) in cases.items():
        found = here.without_scale((here.residual - there.residual) / step)
        assert np.linalg.norm(found - slope) < 0.05 * np.linalg.norm(slope), name


def test_a_background_adds_its_share_of_the_mean(parts: tuple) -> None:
    plane = parts[2][1]
    mean = float(np.mean(plane.amplitude**2))
    here, there = linear(parts), linear(parts, changed={"background": plane.background + 1e-3 * mean})
    found = here.without_scale((here.residual - there.residual) / 1e-3)
    assert np.linalg.norm(found - here.jacobian_times_background(1)) < 0.05 * np.linalg.norm(found)


def test_an_uneven_background_adds_a_slope(parts: tuple) -> None:
    plane = parts[2][1]
    rising = 1e-3 * float(np.mean(plane.amplitude**2)) * np.linspace(-1.0, 1.0, plane.amplitude.shape[1])
    here, there = linear(parts), linear(parts, changed={"background": plane.background + rising})
    found = here.without_scale((here.residual - there.residual) / 1e-3)
    assert np.linalg.norm(found - here.jacobian_times_background(1, (1, 0))) < 0.08 * np.linalg.norm(found)


@pytest.mark.parametrize("parameter", ["exposure", "nonlinearity"])
def test_slopes_of_what_is_wrong_with_the_measured_light(parts: tuple, parameter: str) -> None:
    engine, lit, planes, now = parts
    planes = [replace(p, fraction_per_intensity=np.full(p.amplitude.shape, 0.05)) for p in planes]
    # The slopes are those about measured amplitudes that the model explains.
    modelled = ChannelModel.of_source(engine, lit, planes, 2.0, 1.0).amplitudes(now)
    planes = [replace(p, amplitude=a) for p, a in zip(planes, modelled, strict=True)]
    state = (
        SystemState(plane_exposure_errors=(0.0, 1e-3))
        if parameter == "exposure"
        else SystemState(nonlinearity=1e-3)
    )
    changed = [
        replace(p, background=nominal.background)
        for p, nominal in zip(placed_planes(planes, state), planes, strict=True)
    ]
    here, there = (
        LinearModel(ChannelModel.of_source(engine, lit, each, 2.0, 1.0), now, False)
        for each in (planes, changed)
    )
    # The residuals are relative to the measured light, which differs between the two.
    found = (here.residual - there.residual * (there.size / here.size)) / 1e-3
    slope = here.jacobian_times_exposure(1) if parameter == "exposure" else here.jacobian_times_nonlinearity()
    assert np.linalg.norm(found - slope) < 0.02 * np.linalg.norm(slope)


GRID = Grid((48, 40), 3.2e-3, 1.0)
TILTS = (0.0, 0.0), (2.0, -1.0)


def spectrum(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal(GRID.shape) + 1j * rng.standard_normal(GRID.shape)


@pytest.fixture(params=TILTS, ids=["upright", "tilted"])
def samples(request: pytest.FixtureRequest) -> CachedSamples:
    propagator = propagator_to(GRID, 0.532, 0.4, complex, (1e-3, -2e-3), request.param)
    assert isinstance(propagator, TiltedPropagator) == any(request.param)
    return CachedSamples(PixelMeans(GRID, 0.9), spectrum(1), propagator)


def test_intensities_and_products_agree_with_the_pixels(samples: CachedSamples) -> None:
    rows, others = (samples.pixels.propagate(spectrum(seed), samples.propagator) for seed in (1, 2))
    assert samples.intensity() == pytest.approx(samples.pixels.intensity(rows))
    assert samples.products(spectrum(2)) == pytest.approx(samples.pixels.products(rows, others))


def test_the_adjoint_is_that_of_the_pixels_and_can_be_repeated(samples: CachedSamples) -> None:
    change = np.random.default_rng(3).random(GRID.shape)
    expected = spectrum(4)
    samples.pixels.add_adjoint(
        samples.pixels.propagate(spectrum(1), samples.propagator), change, samples.propagator, expected
    )
    for _ in range(2):
        total = spectrum(4)
        samples.add_adjoint(change, total)
        assert total == pytest.approx(expected)


def test_residuals_without_bias_have_the_mean_0_where_few_electrons_fall() -> None:
    """Of the true object, over many draws of noise, whose root is biased."""
    engine, lit = small_twin()
    t = 0.7 + 0.2 * np.random.default_rng(7).standard_normal(lit.grid.shape)
    blank = [Measurement(0.3, np.ones(engine.scene.exit_grid.shape))]
    intensity = (
        ChannelModel.of_source(engine, lit, blank, 1.0, 1.0).amplitudes(t.astype(complex))[0].astype(float)
        ** 2
    )
    electrons = intensity * 4.0 / np.median(intensity)
    random, draws = np.random.default_rng(8), 40
    plain, corrected = (np.zeros(intensity.shape) for _ in range(2))
    for _ in range(draws):
        noisy = electrons + np.sqrt(electrons + 1.0) * random.standard_normal(electrons.shape)
        scale = np.median(intensity) / 4.0
        plane = recorded_intensity(0.3, noisy * scale, (np.maximum(noisy, 0.0) + 1.0) * scale**2)
        linear = LinearModel(ChannelModel.of_source(engine, lit, [plane], 1.0, 1.0), t, False)
        plain += linear.residual[0] / draws
        corrected += linear.unbiased_residual()[0] / draws
    assert abs(corrected.mean()) < 0.2 * abs(plain.mean())


@pytest.mark.parametrize("source", [Source(2.0), Source(bandwidth_nm=60.0)])
def test_slopes_in_light_of_a_source(parts: tuple, source: Source) -> None:
    """The residuals are those of the forward model, and the adjoint belongs to the differences."""
    engine, lit, planes, now = parts
    modes = source.few_modes(0.532, samples=lit.grid.shape[0])

    def at(transmission: np.ndarray) -> LinearModel:
        return LinearModel(
            ChannelModel.of_source(engine, lit, planes, 2.0, 1.0, modes=modes), transmission, False
        )

    here, rng, step = at(now), np.random.default_rng(4), 1e-4
    modelled = here.model.amplitudes(now)
    root = [np.sqrt(weight) for weight in here.model.weights]
    for plane, weight, amplitude, residual in zip(planes, root, modelled, here.residual, strict=True):
        np.testing.assert_allclose(
            residual * here.size, weight * (plane.amplitude - amplitude), atol=2e-4 * float(amplitude.max())
        )
    direction = rng.standard_normal(now.shape) + 1j * rng.standard_normal(now.shape)
    change = here.jacobian_times_object(direction)
    difference = (here.residual - at(now + step * direction).residual) / step
    assert float(np.linalg.norm(change - difference)) < 0.02 * float(np.linalg.norm(difference))
    left = rng.standard_normal(here.residual.shape)
    forward = float(np.vdot(change, left))
    assert float(np.vdot(direction, here.adjoint_to_object(left)).real) == pytest.approx(forward, rel=1e-4)
