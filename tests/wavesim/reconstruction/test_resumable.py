"""What a retrieval keeps on its way, and how often."""

from pathlib import Path

import numpy as np
import pytest
from places import DESIGNS

from lensdesign import load_design, scaled
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid
from wavesim.reconstruction import resumable
from wavesim.reconstruction.phase_retrieval import RetrievalState
from wavesim.reconstruction.resumable import retrieve_resumably
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.scene.scene import Scene
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
