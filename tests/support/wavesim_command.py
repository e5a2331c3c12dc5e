"""The command `wavesim` as tests run it, and frames of a small twin for it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from programs import Ended, run_program
from small_pictures import draw_few_dots

from lensdesign import load_design, save_design, scaled
from lensdesign.lens.poses import Pose
from wavesim.engines.choosing import engine_for
from wavesim.fields.files import write_field
from wavesim.sensor.camera_noise import Electronics
from wavesim.sensor.frames import write_frame
from wavesim.sensor.recording import Recorder, Recording
from wavesim.sensor.sensor import Camera
from wavesim.sensor.windows import exit_scene, sensor_window
from wavesim.targets.patch import make_illumination, make_target, object_patch

PATCH_MM, PLANES_MM, PIXELS = 0.045, (0.0625, 0.6875), 176

ENDED = (0, 1)
"""Statuses of a reconstruction that ended: a few iterations need not explain the frames."""


def run_wavesim(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: object
) -> Ended:
    """Exit status, standard output and standard error; pictures are of few dots, which are drawn sooner."""
    draw_few_dots(monkeypatch)
    return run_program(monkeypatch, capsys, "wavesim", *arguments)


def write_frames(folder: Path, pose: Pose = Pose()) -> None:
    """A small twin, two frames of a chart through it as it is mounted, and the chart."""
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    save_design(lens, folder / "twin.toml")
    patch = object_patch(lens, PATCH_MM)
    target = make_target(patch, "usaf", "bright", numerical_aperture=0.5)
    light = make_illumination(patch)
    sensor = sensor_window(lens, patch, PLANES_MM, PIXELS)
    scene = exit_scene(lens, patch, sensor, PLANES_MM[0], pose, oversampling=2)
    electronics = Electronics(full_well_electrons=1e6, read_noise_electrons=1.0, bits=16)
    recording = Recording(Camera(sensor, electronics), PLANES_MM, 1)
    behind = light.with_values(light.values * target.transmission.values)
    frames, _ = Recorder(recording, engine_for(scene, "eikonal", error=0.3)).frames(behind)
    for number, frame in enumerate(frames, start=1):
        write_frame(frame, folder / f"frame_{number}.tif")
    write_field(target.transmission, folder / "object.npz")


def frames_and_design(folder: Path) -> tuple[object, ...]:
    """Arguments that name what :func:`write_frames` wrote, for the engine it took."""
    frames = folder / "frame_1.tif", folder / "frame_2.tif"
    return (*frames, "--design", folder / "twin.toml", "--patch-mm", PATCH_MM, "--error", 0.3)


def written(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Figures and fields of a reconstruction."""
    with np.load(folder / "reconstruction.npz") as stored:
        return json.loads((folder / "reconstruction.json").read_text()), dict(stored)
