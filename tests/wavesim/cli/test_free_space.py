"""`wavesim reconstruct --free-space`, end to end on a crop of a real series."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from places import GOLDEN
from programs import Command

from wavesim.calibration import free_space

SERIES = GOLDEN / "through_focus"
FRAMES = tuple(SERIES / f"z_+0{z}_um.png" for z in (10, 30, 80))
LIGHT = ("--free-space", "--pixel-pitch-um", 0.32, "--wavelength-um", 0.532)
AT = ("--plane-distance-mm", "0.01,0.03,0.08")


def test_planes_are_predicted_and_written(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(free_space, "SCALE_ITERATIONS", 5)
    more = ("--calibrate", "--iterations", 20, "--predict-mm", "0.05,0", "-o", tmp_path / "out", "--json")
    code, out, err = wavesim("reconstruct", *FRAMES, *LIGHT, *AT, *more)
    assert code == 0, err
    assert "not explained within their noise" in err
    result = json.loads(out)
    calibration = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert calibration["distance_scale"] == result["distance_scale"] == pytest.approx(1.0, abs=0.25)
    assert [plane["plane_distance_mm"] for plane in calibration["planes"]] == [0.01, 0.03, 0.08]
    with np.load(tmp_path / "out" / "predicted.npz") as predicted:
        assert predicted["amplitude"].shape == (2, 210, 288)
        np.testing.assert_array_equal(predicted["plane_distance_mm"], [0.05, 0.0])
        shown = np.array(Image.open(tmp_path / "out" / "predicted_0.05_mm.tif"))
        np.testing.assert_array_equal(shown, predicted["amplitude"][0])
    with np.load(tmp_path / "out" / "reconstruction.npz") as field:
        assert field["values"].shape == (210, 288)
        assert (float(field["pitch_um"]), float(field["wavelength_um"])) == pytest.approx((0.32, 0.532))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((*FRAMES,), "--design: missing"),
        ((*FRAMES, "--predict-mm", "0.05", *AT), "--predict-mm: requires --free-space"),
        ((*FRAMES, *LIGHT, "--plane-distance-mm", "0.01,0.03"), "--plane-distance-mm = '0.01,0.03'"),
        ((*FRAMES, *LIGHT[:3], *AT), "does not state how it was recorded; give --wavelength-um"),
        ((*FRAMES, *LIGHT, *AT, "--method", "paper"), "--method: cannot be used with --free-space"),
        ((*FRAMES, *LIGHT, *AT, "--design", "lens.toml"), "--design: cannot be used with --free-space"),
        ((*FRAMES[:2], "{small}", *LIGHT, *AT), "must have the same size"),
        ((*FRAMES[:2], SERIES / "README.md", *LIGHT, *AT), "not a TIFF or PNG picture"),
        ((FRAMES[0], *LIGHT, "--plane-distance-mm", "0.01"), "two planes or more"),
        ((*FRAMES, *LIGHT, *AT, "--numerical-aperture", "2"), "numerical_aperture = 2"),
    ],
)
def test_what_cannot_be_used_is_named_and_nothing_is_written(
    wavesim: Command, tmp_path: Path, arguments: tuple[object, ...], words: str
) -> None:
    Image.fromarray(np.full((64, 64), 9000, np.uint16)).save(tmp_path / "small.png")
    given = [tmp_path / "small.png" if one == "{small}" else one for one in arguments]
    out = tmp_path / "out"
    code, _, err = wavesim("reconstruct", *given, "-o", out)
    assert code == 2
    assert words in " ".join(err.split())
    assert not out.exists()
