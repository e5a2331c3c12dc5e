"""The command `wavesim calibrate`, end to end on a small twin, and what `wavesim reconstruct` makes of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from wavesim_command import frames_and_design, run_wavesim, write_frames

from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose
from wavesim.calibration import from_frames as calibration
from wavesim.camera.mounting import read_mounting

POSE = Pose(decenter_x_mm=1e-3, tilt_y_deg=0.8)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small twin, two frames of a chart through it, mounted with errors, and the chart."""
    folder = tmp_path_factory.mktemp("data")
    write_frames(folder, POSE)
    return folder


def test_a_known_target_calibrates_and_the_reconstruction_takes_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], data: Path, tmp_path: Path
) -> None:
    sought = "--parameters", "decenter_x_mm,tilt_y_deg"
    code, out, err = run_wavesim(
        monkeypatch,
        capsys,
        "calibrate",
        *frames_and_design(data),
        *sought,
        "--known",
        data,
        "-o",
        tmp_path,
        "--json",
    )
    assert code == 0, err
    found = json.loads(out)
    assert found["mounting"]["decenter_x_mm"] == pytest.approx(1e-3, rel=0.05)
    assert found["mounting"]["tilt_y_deg"] == pytest.approx(0.8, rel=0.05)
    assert found["misfit"] < 1.5 * found["misfit_of_noise"] + 0.02 < found["misfit_before"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["calibration.json", "calibration.png"]
    mounting = read_mounting(tmp_path / "calibration.json")
    assert mounting.pose.tilt_y_deg == found["mounting"]["tilt_y_deg"]

    quick = (
        *frames_and_design(data),
        "--engine",
        "eikonal",
        "--kind",
        "amplitude",
        "--iterations",
        12,
        "--truth",
        data,
    )
    figures = []
    for options in ((), ("--calibration", tmp_path / "calibration.json")):
        code, out, err = run_wavesim(
            monkeypatch, capsys, "reconstruct", *quick, *options, "-o", tmp_path / "out", "--json"
        )
        assert code == 0, err
        figures.append(json.loads(out)["truth"]["object_correlation"])
    assert figures[0] < 0.8
    assert figures[1] > 0.95
    code, _, err = run_wavesim(
        monkeypatch, capsys, "reconstruct", *quick, "--calibration", tmp_path / "calibration.json",
        "--tilt-y-deg", 0.8, "-o", tmp_path / "out",
    )  # fmt: skip
    assert code == 2
    assert "--calibration" in err


def test_an_interrupted_search_goes_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], data: Path, tmp_path: Path
) -> None:
    """The second run begins with what the first one has tried."""
    command = (*frames_and_design(data), "--parameters", "decenter_x_mm", "--iterations", 3, "--scale", 1)
    whole = calibration.calibrate
    asked = []

    def cut_off(*arguments: object, **settings: object) -> object:
        progress, asked_now = settings["progress"], 0

        def tell(name: str, *what: object) -> None:
            nonlocal asked_now
            progress(name, *what)  # type: ignore[operator]
            asked_now += name == "fine"
            if asked_now == 4:
                raise KeyboardInterrupt

        asked.append(len(settings["tried"]))  # type: ignore[arg-type]
        return whole(*arguments, **settings | {"progress": tell})  # type: ignore[arg-type]

    monkeypatch.setattr(calibration, "calibrate", cut_off)
    code, _, err = run_wavesim(monkeypatch, capsys, "calibrate", *command, "-o", tmp_path)
    assert code == 130
    assert "4 mountings" in err
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.npz"]

    def watched(*arguments: object, **settings: object) -> object:
        asked.append(len(settings["tried"]))  # type: ignore[arg-type]
        return whole(*arguments, **settings)  # type: ignore[arg-type]

    monkeypatch.setattr(calibration, "calibrate", watched)
    code, _, err = run_wavesim(monkeypatch, capsys, "calibrate", *command, "-o", tmp_path)
    assert code == 0, err
    assert asked == [0, 4]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["calibration.json", "calibration.png"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--parameters", "decentre_x_mm"), "did you mean decenter_x_mm"),
        (("--parameters", ""), "--parameters = ''"),
        (("--kind", "phase"), "--kind = 'phase'"),
        (("--most-mountings", 0), "most_mountings = 0"),
        (("--known", "nowhere.npz"), "nowhere.npz"),
        (("--patch-mm", 5), "patch_mm = 5"),
    ],
)
def test_bad_input_ends_with_one_message_and_no_file(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    data: Path,
    tmp_path: Path,
    options: tuple[object, ...],
    message: str,
) -> None:
    code, out, err = run_wavesim(
        monkeypatch, capsys, "calibrate", *frames_and_design(data), *options, "-o", tmp_path / "out"
    )
    assert code == 2
    assert message in err
    assert out == ""
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["", "[1]", '{"mounting": 3}', '{"mounting": {"decenter_z_mm": 1}}'])
def test_what_is_no_calibration_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"calibration\.json"):
        read_mounting(path)
    with pytest.raises(InputError, match="cannot read"):
        read_mounting(tmp_path / "none.json")
