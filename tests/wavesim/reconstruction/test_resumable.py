"""What a retrieval keeps on its way, and how often."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from places import DESIGNS
from small_twins import small_twin

from lensdesign import load_design, scaled
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid
from wavesim.forward.channel_model import ChannelModel
from wavesim.reconstruction import resumable
from wavesim.reconstruction.object_solver import Reconstructed, SolverState, reconstruct
from wavesim.reconstruction.phase_retrieval import RetrievalState
from wavesim.reconstruction.resumable import retrieve_resumably, saved_state
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.runtime.scratch import Scratch
from wavesim.scene.scene import Scene
from wavesim.scene.source import Source
from wavesim.sensor.measurement import Measurement

DESIGN = DESIGNS / "paper_singlet.toml"


class Clock:
    """A clock that a test advances."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


def test_keeping_takes_no_more_than_its_share(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    clock, kept = Clock(), []
    checkpoint = Checkpoint(tmp_path / "checkpoint.npz", "key")
    state = RetrievalState(np.ones(3, complex), np.ones(3, complex), (0.5,), (0.1,))

    def slow(self: Checkpoint, **data: object) -> None:
        kept.append(clock.now)
        clock.now += 4.0

    monkeypatch.setattr(resumable, "time", clock)
    monkeypatch.setattr(Checkpoint, "keep", slow)
    keep = resumable.state_saver(checkpoint, resumable.SAVE_TIME_FRACTION)
    assert keep is not None
    for _ in range(1000):
        clock.now += 1.0
        keep(state)
    assert kept[0] == 100.0 + resumable.SAVE_INTERVAL_S
    pauses = np.diff(kept)
    np.testing.assert_allclose(pauses, 4.0 / resumable.SAVE_TIME_FRACTION + 4.0)
    assert 4.0 * len(kept) < 1.1 * resumable.SAVE_TIME_FRACTION * (clock.now - 100.0)


def test_it_goes_on_from_what_was_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The field in the units of the recorded amplitudes, and exactly that of an unbroken run."""
    lens = scaled(load_design(DESIGN), 1 / 64)
    grid = Grid((60, 60), 5e-4, lens.object_z_mm)
    exit_grid = Grid((96, 96), 3.2e-3, lens.exit_vertex_z_mm + 0.04)
    engine = engine_for(Scene(lens, grid, exit_grid, 0.532), "eikonal", error=0.3)
    light = Field(grid, (np.sqrt(grid.radius_squared_mm2()) < 0.013).astype(np.complex64), 0.532)
    modelled = np.abs(engine.forward(light).values)
    planes = [Measurement(d, (modelled + 0.1 * modelled.max()).astype(np.float32)) for d in (0.0, 0.4)]
    checkpoint = Checkpoint(tmp_path / "checkpoint.npz", "key")
    whole, maps = retrieve_resumably(engine, light, planes, iterations=5)
    monkeypatch.setattr(resumable, "SAVE_INTERVAL_S", 0.0)
    monkeypatch.setattr(resumable, "SAVE_TIME_FRACTION", np.inf)

    def stop(k: int, _: float) -> None:
        if k == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        retrieve_resumably(engine, light, planes, checkpoint, iterations=5, progress=stop)
    calls: list[int] = []
    rest, _ = retrieve_resumably(
        engine, light, planes, checkpoint, iterations=5, progress=lambda k, _: calls.append(k)
    )
    assert calls == [3, 4]
    np.testing.assert_array_equal(rest.field.values, whole.field.values)
    assert rest.correlation == whole.correlation
    np.testing.assert_allclose(maps[0], np.abs(whole.field.values) - planes[0].amplitude, atol=1e-6 * 64.0)
    for figure, left, plane in zip(whole.residuals, maps, planes, strict=True):
        assert figure == pytest.approx(np.linalg.norm(left) / np.linalg.norm(plane.amplitude), rel=1e-4)
    assert whole.residuals[0] < 0.3


@pytest.mark.parametrize("unit", [2.0**-100, 2.0**100])
def test_amplitudes_of_any_unit_are_retrieved(unit: float) -> None:
    lens = scaled(load_design(DESIGN), 1 / 64)
    grid = Grid((40, 40), 5e-4, lens.object_z_mm)
    engine = engine_for(
        Scene(lens, grid, Grid((64, 64), 3.2e-3, lens.exit_vertex_z_mm + 0.04), 0.532), "eikonal", error=0.3
    )
    light = Field(grid, np.ones(grid.shape, np.complex64), 0.532)
    modelled = np.abs(engine.forward(light).values)
    planes = [Measurement(d, (modelled + 0.1 * modelled.max()).astype(np.float32)) for d in (0.0, 0.4)]
    scaled_planes = [Measurement(p.distance_mm, p.amplitude * np.float32(unit)) for p in planes]
    expected, maps = retrieve_resumably(engine, light, planes, iterations=3, start="uniform")
    found, scaled_maps = retrieve_resumably(engine, light, scaled_planes, iterations=3, start="uniform")
    assert found.residuals == pytest.approx(expected.residuals, rel=1e-5)
    assert found.correlation == pytest.approx(expected.correlation, rel=1e-6)
    largest = float(np.abs(expected.field.values).max())
    np.testing.assert_allclose(found.field.values / unit, expected.field.values, atol=1e-5 * largest)
    np.testing.assert_allclose(scaled_maps[0] / unit, maps[0], atol=1e-5 * largest)


KINDS = ("amplitude", "phase", "complex", "amplitude of a wide source", "amplitude by single steps")
"""Searches of every kind of object, also in light of several modes and without inner iterations."""


class Recorded(NamedTuple):
    """Arguments of a search, all its states, and what it found."""

    given: dict[str, Any]
    states: tuple[SolverState, ...]
    found: Reconstructed


@cache
def uninterrupted(name: str, knows_scale: bool) -> Recorded:
    """A search of a few iterations, with all of its states."""
    engine, light = small_twin()
    light = light.with_values(light.values.astype(np.complex64))
    random, grid = np.random.default_rng(2), engine.scene.exit_grid
    object_values = np.where(random.random(light.grid.shape) < 0.3, 0.3, 1.0).astype(np.complex64)
    kind = name.partition(" ")[0]
    if kind != "amplitude":
        object_values = np.exp(1j * object_values).astype(np.complex64)
    source = Source(0.6) if "source" in name else Source()
    modes = source.few_modes(light.wavelength_um, samples=60)
    blank = [Measurement(d, np.ones(grid.shape, np.float32)) for d in (0.0, 0.3)]
    model = ChannelModel.of_source(engine, light, blank, 1.0, 0.9, modes=modes)
    planes = []
    for plane, amplitude in zip(blank, model.amplitudes(object_values), strict=True):
        sigma = np.full(grid.shape, 0.05 * amplitude.mean(), np.float32)
        noisy = np.abs(amplitude + sigma * random.standard_normal(grid.shape)).astype(np.float32)
        planes.append(Measurement(plane.distance_mm, 3.0 * noisy, 3.0 * sigma))
    given = {
        "engine": engine,
        "illumination": light,
        "recorded": planes,
        "kind": kind,
        "tv_weight": "auto",
        "iterations": 9,
        "iterations_without_tv": 2 if kind == "amplitude" else 0,
        "start": "amplitude" if kind == "complex" else None,
        "scale": 3.0 if knows_scale else None,
        "fill_factor": 0.9,
        "modes": modes,
        "inner_iterations": 1 if "single" in name else 3,
    }
    states = list[SolverState]()
    found = reconstruct(**given, keep=states.append)
    return Recorded(given, tuple(states), found)


@given(name=st.sampled_from(KINDS), knows_scale=st.booleans(), place=st.floats(0.0, 1.0))
@example(name="phase", knows_scale=False, place=1.0)
@example(name="amplitude", knows_scale=False, place=1.0)
@settings(deadline=None, max_examples=25)
def test_a_search_that_continues_at_any_state_finds_the_same_bits(
    name: str, knows_scale: bool, place: float
) -> None:
    whole = uninterrupted(name, knows_scale)
    state = whole.states[round(place * (len(whole.states) - 1))]
    with TemporaryDirectory() as folder:
        checkpoint = Checkpoint(Path(folder) / "checkpoint.npz", "key")
        checkpoint.keep(**vars(state))
        rest = reconstruct(**whole.given, resume=saved_state(checkpoint, Scratch()))
    np.testing.assert_array_equal(rest.transmission.values, whole.found.transmission.values)
    assert rest.misfit == whole.found.misfit
    assert rest.scale == whole.found.scale
    assert rest.stopped_because == whole.found.stopped_because
    for one, other in zip(rest.residual_maps, whole.found.residual_maps, strict=True):
        np.testing.assert_array_equal(one, other)
