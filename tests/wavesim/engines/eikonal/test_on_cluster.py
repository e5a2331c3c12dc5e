"""Super-tiles in a Dask cluster: what comes back is what comes here, also where a worker dies."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from dask_cluster import Cluster

from lensdesign import Lens, scaled
from lensdesign.common.clusters import ClusterError
from lensdesign.errors import InputError
from wavesim.engines.choosing import engine_for
from wavesim.engines.eikonal import on_cluster as cluster_tiles
from wavesim.engines.eikonal.engine import HierarchicalTiles
from wavesim.engines.eikonal.on_cluster import (
    ClusterExecutor,
    ScenePacket,
    add,
    engine_of,
    propagate_tile,
    rows_for,
    tiles_in,
    validate_tiled,
)
from wavesim.fields.carrier_interpolation import CarrierInterpolation
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.scene.scene import Scene

pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def scene(paper_lens: Lens) -> Scene:
    twin = scaled(paper_lens, 1.0 / 32.0)
    grid = Grid((200, 200), 0.5e-3, twin.object_z_mm)
    return Scene(twin, grid, Grid((250, 240), 3.0e-3, twin.sensor_z_mm[0]), 0.532)


@pytest.fixture
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    yield made
    made.close()


def noise(grid: Grid, seed: int = 1) -> Field:
    rng = np.random.default_rng(seed)
    return Field(grid, (rng.normal(size=grid.shape) + 0.5j).astype(np.complex64), 0.532)


def engine_on(scene: Scene) -> HierarchicalTiles:
    return HierarchicalTiles(scene, error=3e-2, tiles_across=2)


@pytest.fixture
def in_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Several rounds of super-tiles, and bands that end within super-tiles' footprints."""
    monkeypatch.setattr(cluster_tiles, "ROUND", 4)
    monkeypatch.setattr(cluster_tiles, "BAND_BYTES", 100_000)


@pytest.mark.usefixtures("in_rounds")
def test_a_worker_that_is_killed_half_way_changes_nothing(scene: Scene, cluster: Cluster) -> None:
    """Bands of the first round are there already."""
    first, _ = cluster.worker(), cluster.worker()
    here, away = engine_on(scene), engine_on(scene)
    calls: list[tuple[int, int]] = []

    def report(done: int, count: int) -> None:
        calls.append((done, count))
        if len(calls) == 7:
            first.kill()

    away.progress = report
    field, back = noise(scene.object_grid), noise(scene.exit_grid)
    with tiles_in(cluster.address) as take:
        take(away)
        there = away.forward(field).values
        returned = away.adjoint(back).values
    assert away.elsewhere is None
    count = len(here.groups)
    assert count > 7
    assert calls == 2 * [(done, count) for done in range(1, count + 1)]
    assert first.wait(timeout=600) != 0
    assert relative_error(there, here.forward(field).values) < 1e-6
    assert relative_error(returned, here.adjoint(back).values) < 1e-6


@pytest.mark.usefixtures("in_rounds")
def test_sums_are_made_by_workers(scene: Scene, cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    """The computer that asks carries no tile and adds none; what it has kept is not carried again."""
    cluster.worker()
    field, back, here = noise(scene.object_grid), noise(scene.exit_grid), engine_on(scene)
    there, returned = here.forward(field).values, here.adjoint(back).values
    sums: dict[int, Any] = {}
    next(here.forward_in_bands(field, 100, sums))
    del sums[1], sums[6]

    def refuse(*_: Any) -> None:
        raise AssertionError("done here")

    monkeypatch.setattr("wavesim.engines.eikonal.executors.propagate_tiles", refuse)
    for name in ("add", "collect"):
        monkeypatch.setattr(CarrierInterpolation, name, refuse)
    away = engine_on(scene)
    with tiles_in(cluster.address) as take:
        take(away)
        assert relative_error(away.forward(field).values, there) < 1e-6
        assert relative_error(away.adjoint(back).values, returned) < 1e-6
        calls: list[int] = []
        away.progress = lambda done, _: calls.append(done)
        bands = list(away.forward_in_bands(field, 100, sums))
        assert isinstance(away.elsewhere, ClusterExecutor)
        with pytest.raises(ValueError, match="no number"):
            away.elsewhere.cluster.finish([away.elsewhere.cluster.hold(float, "no number")])
    count = len(away.groups)
    assert calls == [count - 1, count]
    assert sorted(sums) == list(range(count))
    assert [rows.start for rows, _ in bands] == [0, 100, 200]
    assert relative_error(np.concatenate([values for _, values in bands]), there) < 1e-6


@pytest.mark.usefixtures("in_rounds")
def test_a_scheduler_that_goes_away_is_told_and_what_was_kept_stays(scene: Scene, cluster: Cluster) -> None:
    cluster.worker()
    engine, field = engine_on(scene), noise(scene.object_grid)
    engine.progress = lambda done, _: cluster.close() if done == 2 else None
    sums: dict[int, Any] = {}
    with tiles_in(cluster.address) as take:
        take(engine)
        with pytest.raises(ClusterError, match="scheduler is gone"):
            next(engine.forward_in_bands(field, 100, sums))
    assert 0 < len(sums) < len(engine.groups)


@pytest.mark.usefixtures("in_rounds")
def test_a_last_worker_that_dies_is_told_and_what_was_kept_stays(
    scene: Scene, cluster: Cluster, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("lensdesign.common.clusters.REPORT_SECONDS", 0.5)
    monkeypatch.setattr("lensdesign.common.clusters.WAIT_SECONDS", 2.0)
    only = cluster.worker()
    engine, field = engine_on(scene), noise(scene.object_grid)
    engine.progress = lambda done, _: only.kill() if done == 2 else None
    sums: dict[int, Any] = {}
    with tiles_in(cluster.address) as take:
        take(engine)
        with pytest.raises(ClusterError, match="last worker is gone"):
            next(engine.forward_in_bands(field, 100, sums))
    assert 0 < len(sums) < len(engine.groups)
    assert "last worker is gone; waiting" in capsys.readouterr().err


def test_only_tiles_in_two_levels_go_to_a_cluster(scene: Scene) -> None:
    with pytest.raises(InputError, match="a cluster needs engine hierarchical"):
        validate_tiled(engine_for(scene, "no-lens"))


def test_a_worker_refuses_another_version(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    packet = pickle.loads(pickle.dumps(ScenePacket("1.0", scene, engine_on(scene).settings(), "key")))
    monkeypatch.setattr(cluster_tiles, "_engines", {})
    with pytest.raises(InputError, match=r"worker on .* version .* 1\.0"):
        engine_of(packet)
    packet = replace(packet, toolkit_version=cluster_tiles.toolkit_version())
    assert engine_of(packet) is engine_of(packet)
    assert list(cluster_tiles._engines) == ["key"]


def test_what_a_worker_adds_to_stays_as_it_is(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tasks are tried again."""
    engine = engine_on(scene)
    monkeypatch.setattr(cluster_tiles, "engine_of", lambda _: engine)
    packet: Any = None
    part = np.ones([p.stop - p.start for p in engine.groups[0].part], np.complex64)
    field, band = propagate_tile(packet, 0, part), (40, 90)
    needed = rows_for(packet, 0, band, field)
    assert 0 < len(needed) < len(field)
    before = np.ones((50, scene.exit_grid.shape[1]), np.complex64)
    alone, after = add(packet, band, None, [0], [needed]), add(packet, band, before, [0], [needed])
    assert np.array_equal(before, np.ones_like(before))
    assert np.abs(alone).max() > 0.0
    np.testing.assert_allclose(after, alone + before, atol=1e-6 * np.abs(alone).max())
