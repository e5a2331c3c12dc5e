"""Objects of layers by the commands: `wavesim image` and `wavesim reconstruct --layers-um`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from programs import Command
from wavesim_command import ENDED

from lensdesign import load_design, save_design, scaled

PATCH = ("--patch-mm", 0.03, "--field-stop-mm", 0.016, "--engine", "eikonal", "--error", 0.02)


@pytest.fixture
def frames(wavesim: Command, tmp_path: Path) -> Path:
    """Frames of two pictures, one on each of two layers, on two planes with three exposures."""
    save_design(scaled(load_design("designs/paper_singlet.toml"), 1 / 64), tmp_path / "twin.toml")
    y, x = np.mgrid[:40, :40]
    for number, (at_x, at_y) in enumerate(((12, 20), (27, 16)), start=1):
        disc = np.hypot(x - at_x, y - at_y) < 6
        Image.fromarray(np.where(disc, 40, 255).astype(np.uint8)).save(tmp_path / f"picture_{number}.png")
    code, out, err = wavesim(
        "image", tmp_path / "twin.toml", "--object", tmp_path / "picture_1.png", "--object",
        tmp_path / "picture_2.png", "--layers-um", "-20,0", "--exposures", "1,30,1000", *PATCH,
        "-o", tmp_path / "frames",
    )  # fmt: skip
    assert code == 0, err
    assert "layer at -20 µm" in out
    return tmp_path / "frames"


def reconstruct(wavesim: Command, frames: Path, *options: object, planes: str = "*") -> tuple[int, str, str]:
    return wavesim(
        "reconstruct", *sorted(frames.glob(f"frame_{planes}_*.tif")), "--design", frames.parent / "twin.toml",
        "--layers-um", "-20,0", *PATCH, *options, "-o", frames.parent / "found",
    )  # fmt: skip


def test_layers_are_imaged_found_and_written(wavesim: Command, frames: Path) -> None:
    about = json.loads((frames / "image.json").read_text())["object"]
    assert [layer["distance_um"] for layer in about["layers"]] == [-20.0, 0.0]
    layers = [np.load(frames / layer["file"])["values"] for layer in about["layers"]]
    assert not np.allclose(*layers)
    options = ("--kind", "amplitude", "--truth", frames, "--iterations", 160)
    code, out, err = reconstruct(wavesim, frames, *options)
    assert code in ENDED, err
    assert "4 measurements for each unknown" in out
    found = json.loads((frames.parent / "found" / "reconstruction.json").read_text())
    assert min(layer["truth"]["object_correlation"] for layer in found["layers"]) > 0.93
    assert sorted(path.name for path in (frames.parent / "found").iterdir()) == [
        "convergence.csv", "layer_1.npz", "layer_1_amplitude.tif", "layer_1_phase.tif", "layer_2.npz",
        "layer_2_amplitude.tif", "layer_2_phase.tif", "reconstruction.json", "reconstruction.png",
        "residuals.png", "settings.toml",
    ]  # fmt: skip


def test_one_plane_is_refused(wavesim: Command, frames: Path) -> None:
    code, _, err = reconstruct(wavesim, frames, "--kind", "amplitude", planes="1")
    assert code == 2
    assert "--layers-um: 1 plane gives" in err
    assert "record 2 such planes" in err
    assert "--undetermined-layers" in err
    assert not (frames.parent / "found").exists()


def test_the_field_stop_of_a_calibration_limits_the_layers(wavesim: Command, frames: Path) -> None:
    stop = {"field_stop_mm": 0.016, "field_stop_at_mm": [0.0, 0.0], "field_stop_from": "frames"}
    calibration = frames.parent / "calibration.json"
    calibration.write_text(json.dumps({"mounting": {}, **stop, "field_stop_doubt": "it could lie elsewhere"}))
    inputs = ("reconstruct", *sorted(frames.glob("frame_*.tif")), "--design", frames.parent / "twin.toml")
    options = ("--layers-um", "-20,0", "--kind", "amplitude", "--iterations", 2, "--json")
    patch = ("--patch-mm", 0.03, "--engine", "eikonal", "--error", 0.02)
    found = []
    for name, stops in (("calibrated", ("--calibration", calibration)), ("stated", PATCH[2:4])):
        code, out, err = wavesim(*inputs, *options, *patch, *stops, "-o", frames.parent / name)
        assert code in ENDED, err
        found.append(json.loads(out))
    calibrated, stated = found
    assert (calibrated["field_stop_mm"], calibrated["field_stop_from"]) == (0.016, "calibration")
    assert stated["field_stop_from"] == "stated"
    assert calibrated["oversampling_ratio"] == stated["oversampling_ratio"]
    assert "it could lie elsewhere" in json.dumps(calibrated["verdict"])
    assert "it could lie elsewhere" not in json.dumps(stated["verdict"])


def test_options_that_do_not_fit_are_refused(wavesim: Command, frames: Path) -> None:
    design = frames.parent / "twin.toml"
    for option, message in (("--calibrate", "--calibrate"), ("--method=paper", "--method")):
        code, _, err = reconstruct(wavesim, frames, option)
        assert code == 2
        assert f"{message}: cannot be used with --layers-um" in err
    code, _, err = wavesim(
        "image", design, "--object", "star", "--object", "tissue", *PATCH, "-o", frames.parent / "other"
    )
    assert code == 2
    assert "2 objects for 1 layer" in err
    code, _, err = wavesim("image", design, "--layers-um", "0,-20", *PATCH, "-o", frames.parent / "other")
    assert code == 2
    assert "--layers-um" in err
    assert "ascending" in err
