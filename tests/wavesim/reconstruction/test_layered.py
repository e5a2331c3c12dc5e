"""The search for layers: its gradient against finite differences, and layers without noise."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensdesign import load_design, scaled
from lensdesign.analysis.oversampling import ObjectKind
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.reconstruction.layered import _PARAMETERS, LayersObjective, find_layers
from wavesim.runtime.checkpoint import CheckpointSeries
from wavesim.scene.engine import Engine
from wavesim.scene.patches import patch_scene
from wavesim.sensor.measurement import Measurement
from wavesim.targets.layers import LayerStack


@cache
def small_engine() -> Engine:
    scene = patch_scene(scaled(load_design("designs/paper_singlet.toml"), 1 / 64), 0.016)
    return engine_for(scene, "eikonal", error=0.1)


def two_layers(distances_um: tuple[float, ...] = (-20.0, 0.0)) -> LayerStack:
    scene = small_engine().scene
    grid = scene.object_grid
    inside = np.hypot(grid.x_mm, grid.y_mm[:, None]) < 0.006
    light = Field(grid, inside.astype(complex), scene.wavelength_um)
    return LayerStack(grid, light, distances_um, inside.astype(float))


def recorded_of(
    stack: LayerStack, layers: list[np.ndarray], distances_mm: tuple[float, ...] = (0.0, 0.1)
) -> list[Measurement]:
    """The amplitudes at distances behind the exit grid, known to 1e-3 of the largest."""
    engine = small_engine()
    field = engine.forward(stack.light.with_values(stack.forward(layers).behind))
    planes = []
    for distance_mm in distances_mm:
        frequencies = np.fft.fftfreq(field.grid.shape[0], field.grid.pitch_mm)
        squared = (1e3 / stack.light.wavelength_um) ** 2 - frequencies[:, None] ** 2 - frequencies**2
        phase = np.exp(2j * np.pi * distance_mm * np.sqrt(np.maximum(squared, 0.0)))
        amplitude = np.abs(np.fft.ifft2(np.fft.fft2(field.values) * phase * (squared > 0.0)))
        planes.append(Measurement(distance_mm, amplitude, np.full(amplitude.shape, 1e-3 * amplitude.max())))
    return planes


@pytest.mark.parametrize("kind", ["amplitude", "phase", "complex"])
def test_the_gradient_is_that_of_finite_differences(kind: ObjectKind) -> None:
    stack = two_layers()
    rng = np.random.default_rng(3)
    truth = [rng.uniform(0.3, 1.0, stack.grid.shape) for _ in range(2)]
    even = Field(stack.grid, np.ones(stack.grid.shape, complex), stack.light.wavelength_um)
    objective = LayersObjective(
        ChannelModel.of_source(small_engine(), even, recorded_of(stack, truth), None), stack, kind
    )
    objective.fit_scale(objective.start())
    objective.tv_weight = 0.01
    at = objective.start() + 0.2 * rng.uniform(size=objective.start().size)
    direction, step = rng.normal(size=at.size), 1e-5
    numeric = (objective(at + step * direction)[0] - objective(at - step * direction)[0]) / (2.0 * step)
    # The adjoint of the eikonal engine is exact up to its single precision.
    assert objective(at)[1] @ direction == pytest.approx(numeric, rel=5e-3)


@pytest.mark.parametrize("kind", ["amplitude", "phase"])
def test_two_layers_are_found_each_on_its_own_plane(kind: ObjectKind) -> None:
    stack = two_layers()
    x, y = stack.grid.x_mm, stack.grid.y_mm[:, None]
    discs = [np.hypot(x - at_x, y - at_y) < 0.0015 for at_x, at_y in ((0.002, 0.001), (-0.002, 0.0))]
    truth = [np.where(disc, 0.3 if kind == "amplitude" else np.exp(1.5j), 1.0) for disc in discs]
    found = find_layers(small_engine(), stack, recorded_of(stack, truth), kind=kind, iterations=120)
    for layer, distance_um, true in zip(found.transmissions, stack.distances_um, truth, strict=True):
        assert layer.grid.z_mm == pytest.approx(stack.grid.z_mm + 1e-3 * distance_um)
        values, expected = layer.values[stack.lit], true[stack.lit]
        values, expected = values - values.mean(), expected - expected.mean()
        correlation = abs(np.vdot(values, expected)) / np.linalg.norm(values) / np.linalg.norm(expected)
        assert correlation > 0.95
    assert found.misfit[-1] < 0.1 * found.misfit[0]


def test_a_stated_scale_is_kept_and_determines_the_product_of_the_layers() -> None:
    stack = two_layers()
    disc = np.hypot(stack.grid.x_mm - 0.002, stack.grid.y_mm[:, None]) < 0.0015
    truth = [np.where(disc, 0.3, 0.8), np.where(disc[:, ::-1], 0.3, 0.9)]
    engine, recorded = small_engine(), recorded_of(stack, truth)
    found = find_layers(engine, stack, recorded, iterations=60, scale=1.0)
    assert found.scale == pytest.approx(1.0)
    expected = np.linalg.norm((truth[0] * truth[1])[stack.lit])
    product = np.abs(found.transmissions[0].values * found.transmissions[1].values)
    assert np.linalg.norm(product[stack.lit]) == pytest.approx(expected, rel=0.02)
    modelled = engine.forward(
        stack.light.with_values(stack.forward([one.values for one in found.transmissions]).behind)
    )
    error = np.abs(modelled.values) - recorded[0].amplitude
    assert error == pytest.approx(found.residual_maps[0], abs=1e-3 * recorded[0].amplitude.max())


def test_the_brightest_part_of_a_layer_is_1_also_in_a_pinhole() -> None:
    stack = two_layers((0.0,))
    radius = np.hypot(stack.grid.x_mm, stack.grid.y_mm[:, None])
    pinhole = np.where(radius < 0.0005, 1.0, 0.0)
    assert 0.0 < pinhole.sum() / np.count_nonzero(stack.lit) < 0.01
    layers, factor = _PARAMETERS["amplitude"].normalized([0.5 * pinhole, 0.8 * stack.lit], stack.lit)
    assert factor == pytest.approx(0.4)
    for layer in layers:
        assert np.abs(layer).max() == pytest.approx(1.0)
    _, factor = _PARAMETERS["amplitude"].normalized([0.0 * pinhole, 0.8 * stack.lit], stack.lit)
    assert factor == pytest.approx(0.8)


def test_a_search_on_many_planes_begins_with_the_nearest_and_the_farthest() -> None:
    stack, seen = two_layers(), list[tuple[int, float]]()
    disc = np.hypot(stack.grid.x_mm - 0.002, stack.grid.y_mm[:, None]) < 0.0015
    truth = [np.where(disc, 0.3, 1.0), np.where(disc[:, ::-1], 0.3, 1.0)]
    recorded = recorded_of(stack, truth, (0.05, 0.0, 0.1))
    found = find_layers(
        small_engine(), stack, recorded, iterations=30, progress=lambda *values: seen.append(values)
    )
    assert seen == list(enumerate(found.misfit))
    assert len(seen) == 30
    of_two = find_layers(small_engine(), stack, recorded[1:], iterations=20)
    assert found.misfit[:20] == pytest.approx(of_two.misfit, rel=1e-6)
    assert len(found.residual_maps) == 3
    assert found.misfit[-1] < of_two.misfit[-1]


@pytest.mark.parametrize("kind", ["amplitude", "phase"])
def test_a_search_that_continues_after_an_interrupt_finds_the_same_bits(kind: str, tmp_path: Path) -> None:
    """After an interrupt in any of the rounds, also on the first two of three planes, and at the end."""
    stack = two_layers()
    disc = np.hypot(stack.grid.x_mm - 0.002, stack.grid.y_mm[:, None]) < 0.0015
    values = np.where(disc, 0.3, 1.0)
    truth = [values if kind == "amplitude" else np.exp(1j * values) for values in (values, values[:, ::-1])]
    given: dict[str, Any] = {"kind": kind, "tv_weight": 1e-3, "iterations": 45}
    recorded = recorded_of(stack, truth, (0.05, 0.0, 0.1))
    whole = find_layers(small_engine(), stack, recorded, **given)
    for stop in (3, 14, 29, 31, len(whole.misfit) - 1):

        def interrupt(index: int, _: float, stop: int = stop) -> None:
            if index == stop:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            find_layers(
                small_engine(),
                stack,
                recorded,
                progress=interrupt,
                checkpoints=CheckpointSeries(tmp_path, f"{stop}"),
                **given,
            )
        seen = list[int]()
        found = find_layers(
            small_engine(),
            stack,
            recorded,
            progress=lambda index, _, seen=seen: seen.append(index),
            checkpoints=CheckpointSeries(tmp_path, f"{stop}"),
            **given,
        )
        assert len(seen) < len(whole.misfit) or stop < 20  # the length of the first round
        assert (found.misfit, found.scale, found.stopped_because) == (
            whole.misfit,
            whole.scale,
            whole.stopped_because,
        )
        for one, other in zip(found.transmissions, whole.transmissions, strict=True):
            np.testing.assert_array_equal(one.values, other.values)
