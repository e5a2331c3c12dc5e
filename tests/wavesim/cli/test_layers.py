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
