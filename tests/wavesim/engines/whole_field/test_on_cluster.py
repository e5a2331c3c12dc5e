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
from wavesim.engines.whole_field import on_cluster as cluster_tiles
from wavesim.engines.whole_field.engine import WholeFieldEngine
from wavesim.engines.whole_field.on_cluster import ScenePacket, refuse_no_tiles, tiles_in, work
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


def test_a_worker_that_is_killed_half_way_changes_nothing(scene: Scene, cluster: Cluster) -> None:
    first, _ = cluster.worker(), cluster.worker()
    here = WholeFieldEngine(scene, error=3e-2, tiles_across=2)
    away = WholeFieldEngine(scene, error=3e-2, tiles_across=2)
    away.report = lambda done, _: first.kill() if done == 3 else None
    field, back = noise(scene.object_grid), noise(scene.exit_grid)
    with tiles_in(cluster.address) as take:
        take(away)
        there = away.forward(field).values
        returned = away.adjoint(back).values
    assert len(here.groups) > 3
    assert first.wait(timeout=600) != 0
    assert relative_error(there, here.forward(field).values) < 1e-5
    assert relative_error(returned, here.adjoint(back).values) < 1e-5


def test_a_scheduler_that_goes_away_is_told_and_what_was_kept_stays(scene: Scene, cluster: Cluster) -> None:
    cluster.worker()
    engine = WholeFieldEngine(scene, error=3e-2, tiles_across=2)
    engine.report = lambda done, _: cluster.close() if done == 2 else None
    sums: dict[int, Any] = {}
    with tiles_in(cluster.address) as take:
        take(engine)
        bands = engine.forward_in_bands(noise(scene.object_grid), 100, sums)
        with pytest.raises(ClusterError, match="scheduler is gone"):
            next(bands)
    assert 0 < len(sums) < len(engine.groups)


def test_only_tiles_in_two_levels_go_to_a_cluster(scene: Scene) -> None:
    with pytest.raises(InputError, match="a cluster needs engine two-level"):
        refuse_no_tiles(engine_for(scene, "no-lens"))


def test_a_worker_does_what_is_done_here(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = WholeFieldEngine(scene, error=3e-2)
    packet = pickle.loads(pickle.dumps(ScenePacket("1.0", scene, engine.settings(), "key")))
    monkeypatch.setattr(cluster_tiles, "_engines", {})
    part = np.ones([p.stop - p.start for p in engine.groups[0].part], np.complex64)
    with pytest.raises(InputError, match=r"worker on .* has version .*, this is 1\.0"):
        work(packet, "forward", 0, part)
    packet = replace(packet, toolkit_version=cluster_tiles.toolkit_version())
    done = work(packet, "forward", 0, part)
    assert done.shape == engine.groups[0].shape
    assert np.abs(done).max() > 0.0
    assert list(cluster_tiles._engines) == ["key"]
