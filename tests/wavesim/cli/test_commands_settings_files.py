"""Runs of `wavesim` that are repeated from the settings in the folder of their results."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from programs import Command
from wavesim_command import ENDED, frames_and_design


def test_frames_are_simulated_again_from_their_folder(wavesim: Command, data: Path, tmp_path: Path) -> None:
    run = tmp_path / "run.toml"
    run.write_text('patch-mm = 0.05\nplanes-mm = [0.1]\nobject = "star"\nengine = "eikonal"\nerror = 0.3\n')
    first, again = tmp_path / "deep" / "first", tmp_path / "again"
    code, _, err = wavesim("image", data / "twin.toml", "--settings", run, "--seed", 5, "-o", first)
    assert code == 0, err
    assert json.loads((first / "image.json").read_text())["object"]["name"] == "star"
    code, _, err = wavesim("image", "--settings", first / "settings.toml", "-o", again)
    assert code == 0, err
    for name in ("frame_1.tif", "object.npz"):
        assert (first / name).read_bytes() == (again / name).read_bytes()
    code, _, err = wavesim("image", "--settings", first / "settings.toml", "-o", again, "--seed", 6)
    assert code == 0, err
    assert (first / "frame_1.tif").read_bytes() != (again / "frame_1.tif").read_bytes()


@pytest.mark.usefixtures("quick_verdicts")
def test_a_reconstruction_is_repeated_from_its_folder(wavesim: Command, data: Path, tmp_path: Path) -> None:
    first, again = tmp_path / "first", tmp_path / "again"
    code, _, err = wavesim(
        "reconstruct", *frames_and_design(data), "--engine", "eikonal", "--iterations", 3, "-o", first
    )
    assert code in ENDED, err
    assert wavesim("reconstruct", "--settings", first / "settings.toml", "-o", again)[0] == code
    found = [np.load(folder / "reconstruction.npz")["values"] for folder in (first, again)]
    assert np.array_equal(*found)


def test_a_wrong_file_is_one_message_and_status_2(wavesim: Command, data: Path, tmp_path: Path) -> None:
    run, out = tmp_path / "run.toml", tmp_path / "out"
    for text, parts in {
        "patch_mm = 0.1": ("run.toml: no option of image: patch_mm (did you mean patch-mm?); allowed: ",),
        "[calibrate]\nseed = 1\n[image]\nseed = 1.5": ("[calibrate] no option", "seed = 1.5", "whole number"),
        "patch-mm = -1": ("patch_mm = -1", "(patch-mm: set in "),
        'engine = "best"': ("engine = 'best'", "(engine: set in "),
    }.items():
        run.write_text(text)
        code, printed, err = wavesim("image", data / "twin.toml", "--settings", run, "-o", out)
        assert (code, printed, out.exists()) == (2, "", False)
        assert err.startswith("error: ")
        for part in parts:
            assert part in err
