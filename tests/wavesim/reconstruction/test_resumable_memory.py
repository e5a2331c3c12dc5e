"""What a run that goes on holds of what was kept, and a disk that fills while an iteration is kept."""

from __future__ import annotations

import resource
import signal
import sys
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensdesign import Lens, scaled
from lensdesign.errors import InputError
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid
from wavesim.reconstruction import resumable
from wavesim.reconstruction.object_solver import Reconstructed, SolverState, reconstruct
from wavesim.reconstruction.resumable import saved_state, state_saver
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.runtime.scratch import Scratch
from wavesim.scene.scene import Scene
from wavesim.sensor.measurement import Measurement
from wavesim.targets.illumination import field_stop


@pytest.fixture(scope="module")
def taken(paper_lens: Lens) -> tuple[Any, Field, list[Measurement]]:
    """Engine, light and one recorded plane."""
    lens = scaled(paper_lens, 1 / 32)
    grid = Grid((48, 48), 4.2e-4, lens.object_z_mm)
    behind = Grid((90, 90), 3.2e-3, lens.exit_vertex_z_mm + 0.08)
    engine = engine_for(Scene(lens, grid, behind, 0.532), "eikonal", error=0.3)
    light = Field(grid, field_stop(grid, "disc", 0.019).astype(np.complex64), 0.532)
    return engine, light, [Measurement(0.0, np.abs(engine.forward(light).values).astype(np.float32))]


def resumably(
    taken: tuple[Any, Field, list[Measurement]],
    checkpoint: Checkpoint,
    progress: Callable[[int, float], None],
    scratch: Scratch | None = None,
) -> Reconstructed:
    engine, light, recorded = taken
    # Starred arguments would hold what was kept to the end.
    return reconstruct(
        engine,
        light,
        recorded,
        kind="amplitude",
        iterations=6,
        progress=progress,
        resume=saved_state(checkpoint, scratch or Scratch()),
        keep=state_saver(checkpoint),
        scratch=scratch,
    )


def cut_off(taken: tuple[Any, Field, list[Measurement]], checkpoint: Checkpoint) -> None:
    def stop(number: int, misfit: float) -> None:
        if number == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        resumably(taken, checkpoint, stop)


def test_what_was_kept_is_let_go_of_after_an_iteration(
    taken: tuple[Any, Field, list[Measurement]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resumable, "SAVE_INTERVAL_S", 0.0)
    checkpoint = Checkpoint(tmp_path / "checkpoint.npz", "key")
    assert not checkpoint.kept
    cut_off(taken, checkpoint)
    assert checkpoint.kept
    read: list[weakref.ref] = []

    def watched(*values: Any) -> SolverState:
        read.extend(weakref.ref(values[i]) for i in (0, 1))
        return SolverState(*values)

    monkeypatch.setattr(resumable, "SolverState", watched)
    alive: list[int] = []

    def count(number: int, misfit: float) -> None:
        alive.append(sum(one() is not None for one in read))

    room = Scratch(tmp_path, 0.0)
    resumed = resumably(taken, checkpoint, count, room)
    assert len(read) == 2
    # The step before is needed for the first step alone, and is reported before it is freed.
    assert len(alive) == 4
    assert alive[1:] == [0, 0, 0]
    whole = reconstruct(*taken, kind="amplitude", iterations=6)
    np.testing.assert_allclose(resumed.transmission.values, whole.transmission.values, atol=1e-6)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of files are those of Linux")
def test_a_disk_that_fills_names_the_file_and_leaves_what_was_kept(tmp_path: Path) -> None:
    """The system refuses the process longer files, as a full disk does, in the middle of writing."""
    checkpoint = Checkpoint(tmp_path / "folder" / "checkpoint.npz", "key")
    checkpoint.keep(values=np.arange(10))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with pytest.raises(InputError) as caught:
            checkpoint.keep(values=np.zeros(100_000), more=np.zeros(100_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)
    assert f"cannot write {tmp_path / 'folder' / 'checkpoint.npz'}: " in str(caught.value)
    kept = checkpoint.load()
    assert kept is not None
    assert kept["values"].tolist() == list(range(10))
    assert [path.name for path in checkpoint.path.parent.iterdir()] == ["checkpoint.npz"]
