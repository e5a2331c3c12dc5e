"""The command `wavesim colours`, end to end on a small twin."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from programs import Command

from lensdesign import load_design, save_design, scaled
from wavesim.reconstruction import resumable
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.sensor.frames import read_frame


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("design") / "twin.toml"
    save_design(scaled(load_design("designs/paper_singlet.toml"), 1 / 64), path)
    return path


QUICK = ("--patch-mm", 0.02, "--engine", "eikonal", "--error", 0.1)
LIGHT = ("--wavelengths-um", "0.45,0.635")
PLANES = ("--planes-mm", "0.03,0.2", "--exposures", "1,30")


def coloured_picture(path: Path) -> Path:
    """A picture whose left half is red, and whose right half is blue."""
    values = np.zeros((16, 16, 3), np.uint8)
    values[:, :8, 0], values[:, 8:, 2] = 255, 255
    Image.fromarray(values).save(path)
    return path


def test_channels_of_a_picture_are_found_behind_colour_filters(
    wavesim: Command, twin: Path, tmp_path: Path
) -> None:
    picture, frames, output = coloured_picture(tmp_path / "halves.png"), tmp_path / "frames", tmp_path / "out"
    how = (*QUICK, *LIGHT, *PLANES, "--colour-filters", "bayer", "--channels")
    code, out, err = wavesim("image", twin, "--object", picture, *how, "-o", frames, "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["colours"]["pattern"] == ["RG", "GB"]
    stated = read_frame(frames / "frame_1_1.tif").settings
    assert stated.wavelengths_um == (0.45, 0.635)
    assert stated.colours is not None
    assert stated.colours.responses["R"] == (0.04, 0.9)
    arguments = ("--kind", "amplitude", "--scale", 1, "--truth", frames)
    code, out, err = wavesim("colours", twin, frames, *QUICK, *arguments, "-o", output, "--json")
    summary = json.loads(out)
    largest = max(plane["over_noise"] for plane in summary["planes"])
    assert (code, summary["explained"]) == ((0, True) if largest <= 1.3 else (1, False))
    assert min(one["object_correlation"] for one in summary["truth"]) > 0.8
    wrong = ("--kind", "amplitude", "--despace-mm", 0.03, "--iterations", 5, "-o", tmp_path / "wrong")
    code, out, _ = wavesim("colours", twin, frames, *QUICK, *wrong)
    assert code == 1
    assert "not explained by noise" in out
    assert {
        "reconstruction_0.45_um.npz",
        "reconstruction_0.635_um.npz",
        "reconstruction.png",
        "colours.json",
    } <= {path.name for path in output.iterdir()}
    blue, red = (np.abs(np.load(output / f"reconstruction_{one}_um.npz")["values"]) for one in (0.45, 0.635))
    middle = blue.shape[1] // 2
    rows = slice(middle - 8, middle + 8)
    left, right = slice(middle - 10, middle - 3), slice(middle + 3, middle + 10)
    assert blue[rows, right].mean() > 3.0 * blue[rows, left].mean()
    assert red[rows, left].mean() > 3.0 * red[rows, right].mean()


def test_heights_are_found_from_subfolders_of_wavelengths(
    wavesim: Command, twin: Path, tmp_path: Path
) -> None:
    frames, output = tmp_path / "frames", tmp_path / "out"
    how = (*QUICK, *LIGHT, *PLANES, "--all-wavelengths", "--thickness-um", 0.3)
    code, out, err = wavesim("image", twin, "--object", "tissue", *how, "-o", frames, "--json")
    assert (code, err) == (0, "")
    images = json.loads(out)["images"]
    assert [one["wavelength_um"] for one in images] == [0.45, 0.635]
    assert images[0]["sensor"]["pixels"] == images[1]["sensor"]["pixels"]
    folders = [frames / f"{one}_um" for one in (0.45, 0.635)]
    arguments = ("--film-index", 1.5, "--repeats", 2, "--iterations", 5, "--truth", frames)
    code, out, _ = wavesim("colours", twin, *folders, *QUICK, *arguments, "-o", output)
    assert code == 0
    assert ": explained by noise" in out
    assert "standard deviation" in out
    stored = np.load(output / "heights.npz")
    assert stored["height_um"].shape == stored["deviation_um"].shape == stored["ambiguous"].shape
    assert float(stored["deviation_um"].min()) > 0.0
    assert (output / "heights.png").exists()


def with_object(changes: tuple) -> tuple:
    return changes if "--object" in changes else ("--object", "tissue", *changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (("--wavelengths-um", "0.5"), "--wavelengths-um"),
        (("--colour-filters", "bayer"), "--colour-filters: requires --wavelengths-um"),
        ((*LIGHT, "--wavelength-um", 0.5), "--wavelength-um, --wavelengths-um: give only one"),
        ((*LIGHT, "--ghosts", "coherent"), "cannot be used with --wavelengths-um"),
        ((*LIGHT, "--colour-filters", "bayer", "--all-wavelengths"), "--all-wavelengths, --colour-filters"),
        ((*LIGHT, "--channels", "--thickness-um", 1.0), "--channels, --thickness-um: give only one"),
        (("--film-index", 1.4), "--film-index: requires --thickness-um"),
        (("--channels",), "--channels: has no effect on the object 'tissue'"),
        (
            ("--object", "phase", "--thickness-um", 0.3),
            "--thickness-um: cannot be used with the object 'phase'",
        ),
        (("--wavelengths-um", "0.45,0.9", "--colour-filters", "bayer"), "typical Bayer filters"),
    ],
)
def test_options_that_do_not_go_together_are_named(
    wavesim: Command, twin: Path, tmp_path: Path, changes: tuple, message: str
) -> None:
    code, _, err = wavesim("image", twin, *QUICK, *with_object(changes), "-o", tmp_path / "out")
    assert code == 2
    assert message in err
    assert not (tmp_path / "out").exists()


def test_frames_at_once_are_not_those_of_one_wavelength(wavesim: Command, twin: Path, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    assert wavesim("image", twin, *QUICK, *LIGHT, *PLANES, "--object", "tissue", "-o", frames)[0] == 0
    code, _, err = wavesim(
        "reconstruct", frames / "frame_1_1.tif", "--design", twin, *QUICK, "-o", tmp_path / "out"
    )
    assert code == 2
    assert "use `wavesim colours`" in err
    code, _, err = wavesim("colours", twin, tmp_path, *QUICK, "-o", tmp_path / "out")
    assert code == 2
    assert "contains no frame_*.tif" in err
    code, _, err = wavesim(
        "colours", twin, frames, *QUICK, "--truth", tmp_path, "--iterations", 1, "-o", "out"
    )
    assert code == 2
    assert "has no object at 0.45 um" in err


def test_an_interrupted_run_continues_and_leaves_no_checkpoint(
    wavesim: Command, twin: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    taken = (*QUICK, *LIGHT, *PLANES, "--object", "tissue", "-o", tmp_path / "frames")
    code, _, err = wavesim("image", twin, *taken)
    assert code == 0, err
    command = ("colours", twin, tmp_path / "frames", *QUICK, "--iterations", 6)
    monkeypatch.setattr(resumable, "SAVE_INTERVAL_S", 0.0)
    code, _, err = wavesim(*command, "-o", tmp_path / "whole")
    assert code in (0, 1), err
    keep = Checkpoint.keep

    def interrupted(self: Checkpoint, **data: object) -> None:
        keep(self, **data)
        raise KeyboardInterrupt

    monkeypatch.setattr(Checkpoint, "keep", interrupted)
    code, _, err = wavesim(*command, "-o", tmp_path / "out")
    assert code == 130
    assert "run the same command again to continue" in " ".join(err.split())
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["checkpoint_search_1.npz"]
    monkeypatch.setattr(Checkpoint, "keep", keep)
    code, _, err = wavesim(*command, "-o", tmp_path / "out")
    assert code in (0, 1), err
    found, expected = ({p.name: p for p in (tmp_path / name).iterdir()} for name in ("out", "whole"))
    assert set(found) == set(expected)
    for name in (one for one in found if one.endswith((".npz", ".csv"))):
        assert found[name].read_bytes() == expected[name].read_bytes()
