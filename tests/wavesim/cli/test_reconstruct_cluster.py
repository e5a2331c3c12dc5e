"""`wavesim reconstruct` whose super-tiles a cluster does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dask_cluster import Cluster
from programs import Command
from wavesim_command import ENDED, written

from lensdesign.common.clusters import ClusterError
from wavesim.engines.eikonal.executors import ThisComputer
from wavesim.reconstruction import frame_reconstruction, resumable


@pytest.mark.usefixtures("quick_verdicts")
def test_super_tiles_done_by_a_cluster_make_the_same(run: Command, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    options = ("--engine", "hierarchical", "--kind", "amplitude", "--iterations", 1, "--tv-weight", 0.02)
    code, _, err = run(*options, "-o", tmp_path / "here")
    assert code in ENDED, err
    cluster = Cluster(tmp_path)
    try:
        cluster.worker()
        code, _, err = run(*options, "--cluster", cluster.address, "-o", tmp_path / "away")
    finally:
        cluster.close()
    assert code in ENDED, err
    (_, here), (_, away) = written(tmp_path / "here"), written(tmp_path / "away")
    np.testing.assert_allclose(away["values"], here["values"], atol=1e-5)


@pytest.mark.usefixtures("quick_verdicts")
def test_a_cluster_that_goes_away_is_one_message_and_the_same_command_goes_on(
    run: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resumable, "SAVE_INTERVAL_S", 0.0)
    uses, most = [0], [1000]

    class Away(ThisComputer):
        def plane(self, *given: Any) -> Any:
            self._use()
            return super().plane(*given)

        def parts(self, *given: Any) -> Any:
            self._use()
            return super().parts(*given)

        def _use(self) -> None:
            uses[0] += 1
            if uses[0] > most[0]:
                raise ClusterError("the cluster's scheduler is gone")

    @contextmanager
    def tiles(address: str | None) -> Iterator[Callable[[Any], Any]]:
        def take(engine: Any) -> Any:
            engine.elsewhere = Away(engine.groups, engine.scene.exit_grid.shape)
            return engine

        yield take

    monkeypatch.setattr(frame_reconstruction, "tiles_in", tiles)
    options = ("--engine", "hierarchical", "--kind", "amplitude", "--iterations", 3, "--tv-weight", 0.02)
    options = (*options, "--cluster", "tcp://nowhere:1", "-o", tmp_path / "out")
    half = 6  # three iterations on half of the samples
    for most[0], said in (
        (1, "no iteration was saved"),
        (half + 4, "to continue from the last saved iteration"),
    ):
        uses[0] = 0
        code, out, err = run(*options)
        assert (code, out) == (2, "")
        assert err.splitlines()[-1].startswith("error: the cluster's scheduler is gone; ")
        assert err.endswith(f"{said}\n")
        assert "Traceback" not in err
    uses[0], most[0] = 0, 1000
    code, _, err = run(*options)
    assert code in ENDED, err
    assert uses[0] == 3  # the last iteration, and the amplitudes of the result


@pytest.mark.parametrize(
    ("options", "message"),
    [(("--cluster", "tcp://nowhere:1"), "--cluster: engine eikonal"), (("--device", "gpu"), "--device")],
)
def test_bad_options_are_one_message_status_two_and_nothing_written(
    run: Command, tmp_path: Path, options: tuple[object, ...], message: str
) -> None:
    code, out, err = run("--engine", "eikonal", *options, "-o", tmp_path / "out")
    assert (code, out) == (2, "")
    assert message in err
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()
