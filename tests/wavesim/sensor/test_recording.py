"""Light carried plane by plane and band by band: the same frames as through free space, within the memory."""

from __future__ import annotations

import errno
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dask_cluster import Cluster
from programs import Command

from lensdesign import load_design, save_design, scaled
from lensdesign.common import clusters
from wavesim.engines.choosing import engine_for
from wavesim.engines.eikonal import executors, tile_store
from wavesim.fields.field import relative_error
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene
from wavesim.scene.system_state import SystemState
from wavesim.sensor import recording as image_recording
from wavesim.sensor.camera_noise import Electronics
from wavesim.sensor.frames import Frame, read_frame
from wavesim.sensor.merged_exposures import estimate_intensity
from wavesim.sensor.recording import PARTS, Recorder, Recording, drop_parts
from wavesim.sensor.sensor import Camera
from wavesim.sensor.windows import OVERSAMPLING, exit_scene, footprint_mm, light_window, sensor_window
from wavesim.targets.patch import make_illumination, make_target, object_patch

PLANES_MM = (0.0625, 0.6875)
CAMERA = Electronics(full_well_electrons=1e8, read_noise_electrons=0.0, bits=16, offset_counts=0.0)
TILES = (
    "--engine",
    "hierarchical",
    "--patch-mm",
    0.05,
    "--error",
    0.1,
    "--tile-width-mm",
    0.006,
    "--plane-distance-mm",
    0.0625,
)


class Scenery:
    """A small twin with a chart in front of it."""

    def __init__(self) -> None:
        self.engines: dict[Any, Engine] = {}
        self.lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
        patch = object_patch(self.lens, 0.05)
        light = make_illumination(patch)
        chart = make_target(patch, "usaf", "bright", numerical_aperture=0.5)
        self.behind = light.with_values(light.values * chart.transmission.values)
        self.sensor = sensor_window(self.lens, patch, PLANES_MM, 216)
        self.windows = tuple(light_window(self.sensor, footprint_mm(self.lens, patch, z)) for z in PLANES_MM)
        self.scene = exit_scene(self.lens, patch, self.windows[0], PLANES_MM[0], oversampling=OVERSAMPLING)

    def engine(self, name: str, scene: Scene) -> Engine:
        narrow = {"tile_width_mm": 0.006} if name == "hierarchical" else {}
        place = name, scene.exit_grid
        if place not in self.engines:
            self.engines[place] = engine_for(scene, name, error=0.03, **narrow)
        return self.engines[place]

    def recording(self, planes_mm: tuple[float, ...], seed: int | None, **changes: Any) -> Recording:
        camera, windows = Camera(self.sensor, CAMERA), self.windows[: len(planes_mm)]
        return Recording(camera, planes_mm, seed, windows=windows, **changes)

    def recorder(self, name: str, recording: Recording, **changes: Any) -> Recorder:
        make = lambda scene: self.engine(name, scene)  # noqa: E731
        return Recorder(recording, self.engine(name, self.scene), make, **changes)

    def imaged(self, name: str, recording: Recording, **changes: Any) -> tuple[tuple[Frame, ...], float]:
        return self.recorder(name, recording, **changes).frames(self.behind)


@pytest.fixture(scope="module")
def scenery() -> Scenery:
    return Scenery()


def test_bands_give_the_frames_that_free_space_gives(
    scenery: Scenery, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(image_recording, "BAND_ROWS", 100)
    state = SystemState(plane_distance_errors_mm=(0.0, 0.004), plane_shifts_um=((0.0, 0.0), (1.3, -0.7)))
    recording = scenery.recording(PLANES_MM, None, state=state)
    bands, beyond = scenery.imaged("hierarchical", recording)
    free, expected_beyond = scenery.imaged("eikonal", recording)
    for one, other in zip(bands, free, strict=True):
        seen, expected = estimate_intensity(one)[0], estimate_intensity(other)[0]
        assert relative_error(np.sqrt(np.maximum(seen, 0.0)), np.sqrt(np.maximum(expected, 0.0))) < 0.06
    assert beyond == pytest.approx(expected_beyond, abs=2e-3)


def test_a_run_that_was_cut_off_goes_on(
    scenery: Scenery, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = scenery.recording(PLANES_MM[:1], 3)
    whole, _ = scenery.imaged("hierarchical", recording)
    carry, carried = executors.propagate_tiles, list[Any]()

    def counted(way: Any, group: Any, *rest: Any) -> Any:
        if len(carried) == 3:
            raise KeyboardInterrupt
        carried.append(group)
        return carry(way, group, *rest)

    monkeypatch.setattr(executors, "propagate_tiles", counted)
    with pytest.raises(KeyboardInterrupt):
        scenery.imaged("hierarchical", recording, folder=tmp_path)
    assert len(list((tmp_path / PARTS / "plane_1").glob("*.npy"))) == 3
    carried.clear()
    monkeypatch.setattr(executors, "propagate_tiles", carry)
    calls: list[tuple[str, int, int]] = []
    again, _ = scenery.imaged(
        "hierarchical", recording, folder=tmp_path, progress=lambda *what: calls.append(what)
    )
    for one, other in zip(again, whole, strict=True):
        assert np.array_equal(one.counts, other.counts)
    assert calls[0][:2] == ("plane 1", 4)  # three were there
    assert calls[-1][1] == calls[-1][2]
    drop_parts(tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_command_ends_plainly_where_a_disk_is_full_and_goes_on(
    wavesim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_design(scaled(load_design("designs/paper_singlet.toml"), 1 / 32), tmp_path / "twin.toml")
    save, saved = np.save, list[Any]()

    def full(*values: Any, **options: Any) -> None:
        if len(saved) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        saved.append(values)
        save(*values, **options)

    command = ("image", tmp_path / "twin.toml", *TILES, "-o", tmp_path / "out")
    with monkeypatch.context() as patched:
        patched.setattr(tile_store.np, "save", full)
        code, _, err = wavesim(*command)
    assert code == 2
    assert "the disk is full. Parts stored so far: 2." in err
    code, out, err = wavesim(*command)
    assert code == 0
    assert err.startswith("memory: about ")
    assert "hierarchical" in out
    assert not (tmp_path / "out" / PARTS).exists()


def test_the_command_takes_no_more_memory_than_it_may(wavesim: Command, tmp_path: Path) -> None:
    save_design(scaled(load_design("designs/paper_singlet.toml"), 1 / 32), tmp_path / "twin.toml")
    command = ("image", tmp_path / "twin.toml", *TILES, "--memory-gb", 0.2, "-o", tmp_path / "out")
    code, _, err = wavesim(*command)
    assert code == 2
    assert "this picture needs at least 0.3" in err
    assert "--memory-gb 0.4 or more" in err
    assert not (tmp_path / "out").exists()


MEASURE = """
import sys
sys.path[:0] = ["tests/support", "tests/wavesim/sensor"]
from test_recording import PLANES_MM, Scenery
from pathlib import Path
import tempfile
scenery = Scenery()
recording = scenery.recording(PLANES_MM, 1)
with tempfile.TemporaryDirectory() as folder:
    recorder = scenery.recorder("hierarchical", recording, folder=Path(folder))
    need = recorder.memory()
    recorder.frames(scenery.behind)
# Not ru_maxrss: that counts the process by which this one was started.
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(need.most_bytes, 1024 * int(status["VmHWM"].split()[0]))
"""


def test_the_estimate_is_about_what_a_process_takes() -> None:
    done = subprocess.run([sys.executable, "-c", MEASURE], check=True, capture_output=True, text=True)
    predicted, taken = map(float, done.stdout.split())
    assert 0.7 < taken / predicted < 1.3


def test_frames_from_a_cluster_are_those_made_here(
    wavesim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    save_design(scaled(load_design("designs/paper_singlet.toml"), 1 / 32), tmp_path / "twin.toml")
    (tmp_path / "cluster").mkdir()
    cluster = Cluster(tmp_path / "cluster")
    command = ("image", tmp_path / "twin.toml", *TILES, "--no-noise")
    try:
        cluster.worker()
        code, _, _ = wavesim(*command, "--cluster", cluster.address, "-o", tmp_path / "there")
    finally:
        cluster.close()
    assert code == 0
    assert wavesim(*command, "-o", tmp_path / "here")[0] == 0
    here, there = (
        read_frame(tmp_path / place / "frame_1.tif").counts.astype(int) for place in ("here", "there")
    )
    assert np.max(np.abs(here - there)) <= 1
    monkeypatch.setattr(clusters, "CONNECT_SECONDS", 1.0)
    code, _, err = wavesim(
        "image", tmp_path / "twin.toml", "--patch-mm", 0.05, "--engine", "eikonal",
        "--error", 0.5, "--cluster", "tcp://127.0.0.1:1", "-o", tmp_path / "x",
    )  # fmt: skip
    assert code == 2
    assert "no Dask scheduler answers" in err


def test_the_need_grows_with_what_is_recorded(scenery: Scenery) -> None:
    recording, needs = scenery.recording(PLANES_MM, 0), []
    for exposures in ((1.0,), (1.0, 30.0, 1000.0)):
        camera = replace(recording.camera, exposures=exposures)
        recorder = scenery.recorder("hierarchical", replace(recording, camera=camera))
        needs.append(recorder.memory())
    pixels = scenery.sensor.pixels[0] * scenery.sensor.pixels[1]
    assert needs[1].most_bytes - needs[0].most_bytes == 2 * 2 * 2 * pixels
    assert needs[0].least_bytes < needs[0].most_bytes
    assert needs[0].file_bytes == 2 * recorder.engine.sums_bytes  # type: ignore[attr-defined]
