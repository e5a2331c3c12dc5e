"""Results written from Python are those that the commands write."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from places import GOLDEN
from programs import Command
from small_pictures import draw_few_dots
from wavesim_command import ENDED

from lensdesign import load_design, save_design, scaled
from lensdesign.lens.lens import Lens
from wavesim import calibrate_frames, image, reconstruct_colours, reconstruct_frames, reconstruct_layers
from wavesim.calibration.free_space import DEFAULT_FRAME_SETTINGS, reconstruct_free_space
from wavesim.runtime.result import WritableResult
from wavesim.sensor.frame_sets import read_colour_frames, read_frames
from wavesim.sensor.frames import write_frame

STOP = {"field_stop_mm": 0.016}
PATCH = {"patch_mm": 0.03, "engine": "eikonal", "error": 0.1}
OPTIONS = (
    "--patch-mm",
    0.03,
    "--engine",
    "eikonal",
    "--error",
    0.1,
    "--kind",
    "amplitude",
    "--iterations",
    2,
)


@pytest.fixture
def lens(tmp_path: Path) -> Lens:
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    save_design(lens, tmp_path / "twin.toml")
    return load_design(tmp_path / "twin.toml")


def frames_of(lens: Lens, folder: Path, object_: object, **settings: object) -> list[Path]:
    taken = image(lens, object_, **settings, **PATCH)  # type: ignore[arg-type]
    paths = [folder / f"frame_{number}.tif" for number, _ in enumerate(taken.frames, start=1)]
    for path, frame in zip(paths, taken.frames, strict=True):
        write_frame(frame, path)
    return paths


def check_same_files(command: Path, python: Path) -> None:
    """The command also writes its options, warnings of the run, and how it was called."""
    names = {path.name for path in command.iterdir()} - {"settings.toml"}
    assert {path.name for path in python.iterdir()} == names
    for name in names:
        if name.endswith(".npz"):
            with np.load(command / name) as first, np.load(python / name) as second:
                assert set(first) == set(second)
                for key in first:
                    np.testing.assert_array_equal(first[key], second[key])
        elif name.endswith(".json"):
            first, second = (json.loads((folder / name).read_text()) for folder in (command, python))
            only_of_command = {"design", "warnings", "frames", "planes_mm", "object", "calibrated"}
            only_of_command |= {"aperture_stated"}
            # The estimate depends on the memory that is free.
            compared = (set(first) | set(second)) - only_of_command - {"memory"}
            assert {key: first.get(key) for key in compared} == {key: second.get(key) for key in compared}
        else:
            assert (command / name).read_bytes() == (python / name).read_bytes(), name


@pytest.mark.parametrize("kind", ["object", "layers", "colours", "calibration"])
def test_files_written_from_python_are_those_of_the_command(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, lens: Lens, kind: str
) -> None:
    draw_few_dots(monkeypatch)
    settings = {"kind": "amplitude", "iterations": 2, **PATCH}
    out, design = tmp_path / "command", tmp_path / "twin.toml"
    found: WritableResult
    if kind == "layers":
        stack = {"layers_um": (-20.0, 0.0), "planes_mm": (0.03, 0.2), **STOP}
        paths = frames_of(lens, tmp_path, ("tissue", "empty"), **stack)
        options = ("--layers-um", "-20,0", "--undetermined-layers", "--field-stop-mm", 0.016, *OPTIONS)
        code, _, err = wavesim("reconstruct", *paths, "--design", design, *options, "-o", out)
        frames = read_frames(paths, lens=lens)
        found = reconstruct_layers(lens, frames, (-20.0, 0.0), undetermined=True, **STOP, **settings)
    elif kind == "colours":
        paths = frames_of(lens, tmp_path, "star", wavelengths_um=(0.532, 0.635), planes_mm=(0.03, 0.3))
        code, _, err = wavesim("colours", design, *paths, *OPTIONS, "-o", out)
        found = reconstruct_colours(lens, read_colour_frames(paths, lens=lens), **settings)
    else:
        paths = frames_of(lens, tmp_path, "star", planes_mm=(0.03, 0.2))
        frames = read_frames(paths, lens=lens)
        if kind == "object":
            code, _, err = wavesim("reconstruct", *paths, "--design", design, *OPTIONS, "-o", out)
            found = reconstruct_frames(lens, frames, **settings)
        else:
            options = ("--parameters", "decenter_x_mm", "--max-mountings", 2, "--verdict", "none")
            code, _, err = wavesim(
                "calibrate", *paths, "--design", design, *OPTIONS, *options, "--no-deviations", "-o", out
            )
            found = calibrate_frames(
                lens, frames, parameters="decenter_x_mm", most_mountings=2, verdict="none",
                deviations=False, **settings,
            )  # fmt: skip
    assert code in ENDED, err
    summary = found.write(tmp_path / "python", {"design": lens.title or "twin"})
    assert [Path(path).exists() for path in summary["files"]] == [True] * len(summary["files"])
    if kind == "calibration":  # an unjudged search can be continued
        (out / "checkpoint.npz").unlink(missing_ok=True)
    check_same_files(out, tmp_path / "python")


def test_a_field_without_a_lens_is_written_as_by_the_command(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    draw_few_dots(monkeypatch)
    paths = [GOLDEN / "through_focus" / f"z_+0{z}_um.png" for z in (10, 30, 80)]
    light = ("--free-space", "--pixel-pitch-um", 0.32, "--wavelength-um", 0.532, "--iterations", 2)
    planes = ("--plane-distance-mm", "0.01,0.03,0.08", "--predict-mm", "0.05")
    code, _, err = wavesim("reconstruct", *paths, *light, *planes, "-o", tmp_path / "command")
    assert code == 0, err
    known = {"pixel_pitch_um": 0.32, "wavelength_um": 0.532, "plane_distance_mm": (0.01, 0.03, 0.08)}
    frames = read_frames(paths, assumed=DEFAULT_FRAME_SETTINGS, **known)
    found = reconstruct_free_space(frames, iterations=2)
    assert found.table()[0][0] == "samples"
    found.write(tmp_path / "python", predict_mm=(0.05,))
    check_same_files(tmp_path / "command", tmp_path / "python")
