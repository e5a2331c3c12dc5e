"""Channels of several wavelengths: the adjoint, the slope, and the sums that pixels measure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from small_twins import small_twin

from wavesim.fields.field import Field
from wavesim.forward.channel_model import Channel, ChannelModel, Response
from wavesim.scene.engine import Engine
from wavesim.sensor.colour_filters import ColourFilters
from wavesim.sensor.measurement import Measurement

WAVELENGTHS_UM = (0.45, 0.532, 0.635)


@pytest.fixture(scope="module")
def parts() -> tuple[list[Engine], list[Field]]:
    engine, light = small_twin()
    lights = [Field(light.grid, light.values, one) for one in WAVELENGTHS_UM]
    return [engine.at_wavelength(one) for one in WAVELENGTHS_UM], lights


def colour_model(
    engines: Sequence[Engine],
    lights: Sequence[Field],
    recorded: Sequence[Measurement],
    responses: Sequence[Sequence[Response]],
) -> ChannelModel:
    """A transmission for each wavelength, recorded by pixels that integrate."""
    channels = [
        Channel(engine, light, [plane[n] for plane in responses], n)
        for n, (engine, light) in enumerate(zip(engines, lights, strict=True))
    ]
    return ChannelModel.of(channels, recorded, 1.0, 1.0)


def mosaic(shape: tuple[int, int]) -> list[np.ndarray]:
    return ColourFilters.bayer(WAVELENGTHS_UM).on_pixels(shape)


@pytest.mark.parametrize("recording", ["in turn", "monochrome", "mosaic"])
def test_a_step_goes_down_the_misfits_slope(parts: tuple[list[Engine], list[Field]], recording: str) -> None:
    """Against differences of the misfit, with weights and backgrounds."""
    engines, lights = parts
    rng = np.random.default_rng(4)
    grid, shape = lights[0].grid, engines[0].scene.exit_grid.shape
    responses: list[Sequence[Response]] = {
        "in turn": [(1.0, 0.0, 0.0), (0.0, 0.8, 0.0), (0.0, 0.0, 1.0), (0.5, 0.0, 0.0)],
        "monochrome": [(1.0, 0.7, 0.9)] * 2,
        "mosaic": [tuple(mosaic(shape))] * 2,
    }[recording]
    t = 0.7 + 0.2 * rng.standard_normal((3, *grid.shape))
    truth = 0.7 + 0.2 * rng.standard_normal((3, *grid.shape))
    blank = [Measurement(0.3 * n, np.ones(shape)) for n in range(len(responses))]
    seen = colour_model(engines, lights, blank, responses).amplitudes(truth.astype(complex))
    planes = [
        Measurement(
            plane.distance_mm,
            amplitude,
            np.where(rng.random(shape) < 0.1, np.inf, 1.0 + rng.random(shape)),
            background=0.02 * n * np.mean(amplitude**2) * rng.random(shape),
        )
        for n, (plane, amplitude) in enumerate(zip(blank, seen, strict=True))
    ]
    model = colour_model(engines, lights, planes, responses)
    change, *_ = model.step(t.astype(complex))

    def cost(values: np.ndarray) -> float:
        return 0.5 * (model.step(values.astype(complex))[1] * model.size) ** 2

    cells = engines[0].scene.exit_grid.cell / grid.cell
    way = (truth - t) * lights[0].values.real
    small = 1e-4
    slope = (cost(t + small * way) - cost(t - small * way)) / (2.0 * small) * cells
    # Each wavelength's change is divided by its passes, by which an inner product must multiply it.
    product = sum(
        passes * float(np.vdot(one, other).real)
        for passes, one, other in zip(model.passes, change, way, strict=True)
    )
    assert product == pytest.approx(-slope, rel=5e-3)


def test_fields_on_pixels_and_their_adjoint_have_one_inner_product(
    parts: tuple[list[Engine], list[Field]],
) -> None:
    """Changes of intensities by transmissions against the adjoint of weights of pixels."""
    engines, lights = parts
    rng = np.random.default_rng(1)
    shape, grid = engines[0].scene.exit_grid.shape, lights[0].grid
    responses = [tuple(mosaic(shape))] * 2
    blank = [Measurement(0.0, np.ones(shape)), Measurement(0.4, np.ones(shape))]
    model = colour_model(engines, lights, blank, responses)
    t, v = (rng.standard_normal((3, *grid.shape)) + 1j * rng.standard_normal((3, *grid.shape)) for _ in "tv")
    weights = [rng.standard_normal(shape) for _ in blank]

    def intensity(values: np.ndarray) -> list[np.ndarray]:
        return [one**2 for one in model.amplitudes(values)]

    # An intensity is quadratic: its change is the exact central difference.
    changes = [0.5 * (up - down) for up, down in zip(intensity(t + v), intensity(t - v), strict=True)]
    forward = sum(float(np.vdot(w, one)) for w, one in zip(weights, changes, strict=True))
    spectra = model.spectra(t)
    totals = [np.zeros_like(one) for one in spectra]
    for index, (spectrum, total) in enumerate(zip(spectra, totals, strict=True)):
        model.add_adjoint(index, spectrum, weights, total)
    adjoint = 0.0
    for index, change in enumerate(model.to_transmission(totals)):
        on_object = change * model.passes[index] * model.peak_powers[index]
        adjoint += 2.0 * float(np.vdot(on_object, v[index]).real)
    cells = lights[0].grid.cell / engines[0].scene.exit_grid.cell
    assert forward == pytest.approx(adjoint * cells, rel=1e-6)


def test_one_wavelength_of_three_is_that_of_the_model_of_one(
    parts: tuple[list[Engine], list[Field]],
) -> None:
    engines, lights = parts
    shape, grid = engines[1].scene.exit_grid.shape, lights[1].grid
    t = np.random.default_rng(2).random(grid.shape).astype(complex)
    blank = [Measurement(0.0, np.ones(shape)), Measurement(0.3, np.ones(shape))]
    one = ChannelModel.of_source(engines[1], lights[1], blank, 1.0, 1.0)
    responses = [(0.0, 1.0, 0.0)] * 2
    three = colour_model(engines, lights, blank, responses)
    stacked = np.stack([t, t, t])
    for single, several in zip(one.amplitudes(t), three.amplitudes(stacked), strict=True):
        assert several == pytest.approx(single, rel=1e-9, abs=1e-9)
    (change, misfit, _), (changes, misfits, _) = one.step(t), three.step(stacked)
    assert misfits == pytest.approx(misfit, rel=1e-9)
    assert changes[1] == pytest.approx(change, rel=1e-6, abs=1e-9)


def test_a_mosaic_measures_its_filters_sum(parts: tuple[list[Engine], list[Field]]) -> None:
    engines, lights = parts
    shape, grid = engines[0].scene.exit_grid.shape, lights[0].grid
    t = np.random.default_rng(3).random((3, *grid.shape)).astype(complex)
    blank = [Measurement(0.0, np.ones(shape))]
    table = mosaic(shape)
    (found,) = colour_model(engines, lights, blank, [tuple(table)]).amplitudes(t)
    expected = np.zeros(shape)
    for index, response in enumerate(table):
        alone = [1.0 if n == index else 0.0 for n in range(3)]
        (amplitude,) = colour_model(engines, lights, blank, [alone]).amplitudes(t)
        expected += response * amplitude**2
    assert found**2 == pytest.approx(expected, rel=1e-6, abs=1e-12)
