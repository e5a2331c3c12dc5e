"""The command `wavesim calibrate`, end to end on a small twin, and what `wavesim reconstruct` makes of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from programs import Command
from wavesim_command import frames_and_design, write_frames

from lensdesign import Lens, load_design
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose
from wavesim.calibration import calibration_problem, calibration_result, frame_calibration
from wavesim.calibration.calibration_result import field_stop_of, read_calibration
from wavesim.calibration.joint.gauss_newton_step import GaussNewtonStep
from wavesim.calibration.joint.search import FitResult, JointSearch, SearchState
from wavesim.calibration.parameters import chosen_parameters
from wavesim.reconstruction import frame_reconstruction
from wavesim.reconstruction.calibrated_bench import JUDGED_OBJECT, CalibratedBench

POSE = Pose(decenter_x_mm=1e-3, tilt_y_deg=0.8)

FILES = ["calibration.json", "calibration.png", "settings.toml"]
"""Files of a calibration; that of an unknown object adds the one that was judged."""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small twin, two frames of a chart through it, mounted with errors, and the chart."""
    folder = tmp_path_factory.mktemp("data")
    write_frames(folder, POSE)
    return folder


@pytest.mark.usefixtures("quick_verdicts")
def test_a_known_target_calibrates_and_the_reconstruction_takes_it(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path
) -> None:
    sought = "--parameters", "decenter_x_mm,tilt_y_deg"
    code, out, err = wavesim(
        "calibrate", *frames_and_design(data), *sought, "--truth", data, "-o", tmp_path, "--json"
    )
    assert code == 0, err
    found = json.loads(out)
    assert found["state"]["pose"]["decenter_x_mm"] == pytest.approx(1e-3, rel=0.05)
    assert found["state"]["pose"]["tilt_y_deg"] == pytest.approx(0.8, rel=0.05)
    assert found["misfit"] < 1.5 * found["misfit_of_noise"] + 0.02 < found["misfit_before"]
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES
    mounting = read_calibration(tmp_path / "calibration.json", load_design(data / "twin.toml"))
    assert mounting.pose.tilt_y_deg == found["state"]["pose"]["tilt_y_deg"]

    quick = (
        *frames_and_design(data),
        "--engine",
        "eikonal",
        "--kind",
        "amplitude",
        "--iterations",
        8,
        "--truth",
        data,
    )
    figures = []
    for ended, options in ((1, ()), (0, ("--calibration", tmp_path / "calibration.json"))):
        code, out, err = wavesim("reconstruct", *quick, *options, "-o", tmp_path / "out", "--json")
        assert code == ended, err
        figures.append(json.loads(out)["truth"]["object_correlation"])
    assert figures[0] < 0.8
    assert figures[1] > 0.95
    code, _, err = wavesim(
        "reconstruct", *quick, "--calibration", tmp_path / "calibration.json",
        "--tilt-y-deg", 0.8, "-o", tmp_path / "out",
    )  # fmt: skip
    assert code == 2
    assert "--calibration" in err


@pytest.mark.usefixtures("quick_verdicts", "whole_search")
def test_its_figures_are_those_of_a_reconstruction_with_it(
    wavesim: Command, data: Path, tmp_path: Path
) -> None:
    """A reconstruction with the same options uses the object that was judged, or finds the same anew."""
    given = (*frames_and_design(data)[:-2], "--kind", "amplitude")  # the error is not stated
    sought = "--parameters", "decenter_x_mm,tilt_y_deg", "--iterations", 3, "--max-mountings", 3
    _, out, _ = wavesim("calibrate", *given, *sought, "-o", tmp_path, "--json")
    calibrated = json.loads(out)
    judged, command = tmp_path / JUDGED_OBJECT, ("reconstruct", *given, "--truth", data, "--usaf", "bright")
    command = (*command, "--calibration", tmp_path / "calibration.json", "-o", tmp_path / "out")

    def reconstructed(*options: object) -> dict[str, Any]:
        _, out, err = wavesim(*command, *options, "--json")
        assert out, err
        found: dict[str, Any] = json.loads(out)
        return found

    used = reconstructed()
    assert used["found_by"] == "calibration"
    assert used["verdict"] == calibrated["verdict"]
    for options in (("--iterations", 2), ("--starts", 2), ("--verdict", "quick")):
        assert "found_by" not in reconstructed(*options)
    judged.write_bytes(judged.read_bytes()[:2000])  # a damaged file does no harm
    anew = reconstructed()
    assert "found_by" not in anew
    for name in ("over_noise", "held_out_over_noise", "explained", "least_correlation", "bench"):
        assert calibrated["verdict"][name] == anew["verdict"][name]
    assert calibrated["over_noise"] == anew["verdict"]["over_noise"]
    for name in ("iterations", "misfit", "scale", "planes", "truth", "usaf", "oversampling", "engine"):
        assert used[name] == anew[name], name


def test_an_interrupted_search_goes_on(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path
) -> None:
    """The second run begins after the steps that the first one has made, and comes to the same."""
    command = (*frames_and_design(data), "--parameters", "rigid", "--iterations", 3, "--scale", 1)
    command = (*command, "--max-mountings", 4)  # later steps are saved like the first ones
    whole, began = JointSearch.run, []

    def cut_off(search: JointSearch, state: SearchState) -> FitResult:
        began.append(len(state.trail))
        keep = search.keep

        def kept(state: SearchState) -> None:
            keep(state)  # type: ignore[misc]
            raise KeyboardInterrupt

        return whole(replace(search, keep=kept), state)

    monkeypatch.setattr(JointSearch, "run", cut_off)
    code, _, err = wavesim("calibrate", *command, "-o", tmp_path)
    assert code == 130
    assert "interrupted after" in err
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.npz"]

    def watched(search: JointSearch, state: SearchState) -> FitResult:
        began.append(len(state.trail))
        return whole(search, state)

    monkeypatch.setattr(JointSearch, "run", watched)
    code, _, err = wavesim("calibrate", *command, "-o", tmp_path)
    assert code in (0, 1), err
    assert began[0] == 0 < began[1]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*FILES, JUDGED_OBJECT])
    found = json.loads((tmp_path / "calibration.json").read_text())
    assert found["mountings_tried"] > began[1]
    assert set(found["deviations"]) == {"decenter_x_mm", "decenter_y_mm", "tilt_x_deg", "tilt_y_deg"}


@pytest.mark.parametrize(
    "part", [(frame_calibration, "reconstruct_frames"), (calibration_result, "_calibration_figure")]
)
def test_an_interrupt_after_the_search_keeps_the_bench(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path, part: tuple[Any, str]
) -> None:
    """Also if it comes while the bench is drawn for the first time."""
    completed = getattr(*part)

    def interrupted(*_: object, **__: object) -> None:
        monkeypatch.setattr(*part, completed)
        raise KeyboardInterrupt

    monkeypatch.setattr(*part, interrupted)
    command = (*frames_and_design(data), "--parameters", "decenter_x_mm", "--iterations", 2, "--scale", 1)
    code, out, err = wavesim("calibrate", *command, "--max-mountings", 2, "-o", tmp_path)
    assert code == 1, err
    assert "not judged" in out
    stored = json.loads((tmp_path / "calibration.json").read_text())
    assert (stored["verdict"], stored["explained"]) == (None, None)
    assert list(stored["values"]) == ["decenter_x_mm"]


def test_a_bench_without_verdict_and_deviations_is_the_same(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path
) -> None:
    """Estimates are as good; it says what it does not know, and the picture of the bench is drawn."""
    command = (*frames_and_design(data), "--kind", "amplitude", "--iterations", 3, "--max-mountings", 3)
    command = (*command, "--parameters", "decenter_x_mm,tilt_y_deg")
    code, _, err = wavesim("calibrate", *command, "--verdict", "none", "-o", tmp_path / "with")
    assert code == 1, err

    def unexpected(*_: object, **__: object) -> None:
        raise AssertionError("must not be computed")

    monkeypatch.setattr(frame_calibration, "reconstruct_frames", unexpected)
    monkeypatch.setattr(GaussNewtonStep, "eliminated", unexpected)
    options = "--verdict", "none", "--no-deviations"
    code, out, err = wavesim("calibrate", *command, *options, "-o", tmp_path / "without")
    assert code == 1, err
    assert "standard deviations: not computed (--no-deviations)" in out
    assert "verdict: not judged: --verdict none" in out
    whole, less = (
        json.loads((tmp_path / name / "calibration.json").read_text()) for name in ("with", "without")
    )
    assert (less["verdict"], less["explained"], less["sought"]) == (None, None, [])
    assert less["applied"] == less["values"]
    assert (less["not_told"], less["not_told_from"]) == (None, None)
    for name, deviation in whole["deviations"].items():
        assert less["deviations"][name] is None
        assert less["values"][name] == pytest.approx(whole["values"][name], abs=deviation)
    assert (tmp_path / "without" / "calibration.png").stat().st_size > 0


def test_a_search_without_verdict_goes_on_to_one(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path
) -> None:
    """The same command without the option tries no bench again, and then removes the checkpoint."""
    command = (*frames_and_design(data), "--parameters", "decenter_x_mm", "--iterations", 2, "--scale", 1)
    command = (*command, "--max-mountings", 2, "-o", tmp_path)
    code, _, err = wavesim("calibrate", *command, "--verdict", "none", "--no-deviations")
    assert code == 1, err
    assert (tmp_path / "checkpoint.npz").exists()
    searched, began = JointSearch.run, list[int]()

    def watched(search: JointSearch, state: SearchState) -> FitResult:
        began.append(len(state.trail))
        return searched(search, state)

    monkeypatch.setattr(JointSearch, "run", watched)
    code, _, err = wavesim("calibrate", *command)
    assert code in (0, 1), err
    assert began[0] == 2
    found = json.loads((tmp_path / "calibration.json").read_text())
    assert found["verdict"]["judged"] is True
    assert found["deviations"]["decenter_x_mm"] > 0.0
    assert not (tmp_path / "checkpoint.npz").exists()


def test_a_known_object_needs_no_option_for_less(wavesim: Command, data: Path, tmp_path: Path) -> None:
    known = (*frames_and_design(data), "--parameters", "decenter_x_mm", "--truth", data, "-o", tmp_path)
    code, out, err = wavesim("calibrate", *known, "--verdict", "none")
    assert (code, "not judged: --verdict none" in out) == (1, True), err
    code, out, err = wavesim("calibrate", *known, "--no-deviations")
    assert (code, out) == (2, "")
    assert "--deviations: are not computed with --known" in " ".join(err.split())


def test_deviations_are_needed_for_frames_without_an_object(
    wavesim: Command, data: Path, tmp_path: Path
) -> None:
    frames = frames_and_design(data)
    code, out, err = wavesim(
        "calibrate", *frames, "--empty", data / "frame_1.tif", "--no-deviations", "-o", tmp_path / "out"
    )
    assert (code, out) == (2, "")
    assert "--deviations: must be computed with --empty" in " ".join(err.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("quick_verdicts")
def test_both_in_one_run(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path
) -> None:
    """The bench that is found is what the reconstruction takes, and lies beside it."""
    given: list[object] = []
    searched = JointSearch.run

    def one_step(search: JointSearch, state: SearchState) -> FitResult:
        return searched(replace(search, most_benches=2), state)

    def few(*asked: object) -> tuple[object, ...]:
        """Of each part: the search has tests of its own."""
        return chosen_parameters(*asked)[::16]  # type: ignore[arg-type]

    def taken(*arguments: object, **settings: object) -> object:
        given.append(settings["calibration"])
        return reconstruct_frames(*arguments, **settings)  # type: ignore[arg-type]

    monkeypatch.setattr(JointSearch, "run", one_step)
    monkeypatch.setattr(calibration_problem, "chosen_parameters", few)
    reconstruct_frames = frame_reconstruction.reconstruct_frames
    monkeypatch.setattr(frame_reconstruction, "reconstruct_frames", taken)
    monkeypatch.setenv("COLUMNS", "200")  # headings do not wrap
    command = (
        *frames_and_design(data),
        "--kind",
        "amplitude",
        "--iterations",
        3,
        "-o",
        tmp_path,
        "--calibrate",
    )
    code, out, err = wavesim("reconstruct", *command)
    assert code in (0, 1), err
    assert "deviation from the design" in out
    path = tmp_path / "calibration" / "calibration.json"
    assert sorted(one.name for one in path.parent.iterdir()) == ["calibration.json", "calibration.png"]
    (taken_bench,), written = given, read_calibration(path, load_design(data / "twin.toml"))
    assert isinstance(taken_bench, CalibratedBench)
    assert taken_bench.state.light == written.light
    assert taken_bench.state.plane_shifts_um == written.plane_shifts_um
    assert taken_bench.state.pose == written.pose
    code, _, err = wavesim("reconstruct", *command, "--calibration", path)
    assert code == 2
    assert "give only one of them" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--parameters", "decentre_x_mm"), "did you mean decenter_x_mm"),
        (("--parameters", ""), "--parameters = ''"),
        (("--kind", "film"), "--kind = 'film'"),
        (("--max-mountings", 0), "max-mountings"),
        (("--truth", "nowhere.npz"), "nowhere.npz"),
        (("--patch-mm", 5), "patch_mm = 5"),
    ],
)
def test_bad_input_ends_with_one_message_and_no_file(
    wavesim: Command, data: Path, tmp_path: Path, options: tuple[object, ...], message: str
) -> None:
    code, out, err = wavesim("calibrate", *frames_and_design(data), *options, "-o", tmp_path / "out")
    assert code == 2
    assert message in err
    assert out == ""
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["", "[1]", '{"mounting": 3}', '{"mounting": {"decenter_z_mm": 1}}'])
def test_what_is_no_calibration_is_refused(tmp_path: Path, paper_lens: Lens, text: str) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"calibration\.json"):
        read_calibration(path, paper_lens)
    with pytest.raises(InputError, match="cannot read"):
        read_calibration(tmp_path / "none.json", paper_lens)


def test_the_field_stop_of_a_calibration_is_read(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    table = {"mounting": {}, "field_stop_mm": 0.03, "field_stop_at_mm": [0.01, -0.02]}
    path.write_text(json.dumps(table | {"field_stop_from": "frames"}))
    assert field_stop_of(path) == (0.03, (0.01, -0.02), "")
    path.write_text(json.dumps(table | {"field_stop_from": "patch"}))
    assert field_stop_of(path) is None
    path.write_text(json.dumps(table | {"field_stop_from": "frames", "field_stop_at_mm": [0.01]}))
    with pytest.raises(InputError, match="field_stop_mm, field_stop_at_mm"):
        field_stop_of(path)
