"""The command `wavesim reconstruct`, end to end on a small twin."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from places import GOLDEN
from programs import Command
from quick_verdicts import judge_quickly
from wavesim_command import ENDED, PIXELS, PLANES_MM, frames_and_design

from wavesim.forward import channel_model
from wavesim.reconstruction import assessment, frame_reconstruction, phase_retrieval, resumable
from wavesim.reconstruction import object_solver as reconstruction
from wavesim.sensor.frames import Frame, read_frame, write_frame


def usual(data: Path) -> tuple[object, ...]:
    return (*frames_and_design(data), "--engine", "eikonal")


def test_the_object_is_found_and_all_is_written(wavesim: Command, data: Path, tmp_path: Path) -> None:
    code, out, err = wavesim(
        "reconstruct", *usual(data), "--kind", "amplitude", "--iterations", 15, "--truth", data,
        "--usaf", "bright", "--refocus-mm=-0.006,0.006", "-o", tmp_path / "out", "--json",
    )  # fmt: skip
    assert code == 0, err
    found = json.loads(out)
    assert found["truth"]["object_correlation"] > 0.97
    assert found["truth"]["ssim"] > 0.9
    assert found["usaf"]["smallest_resolved"]["line_width_um"] == pytest.approx(0.87, abs=0.01)
    assert abs(found["refocus_um"]) < 1.0
    assert [plane["plane_distance_mm"] for plane in found["planes"]] == list(PLANES_MM)
    assert all(plane["residual"] < 0.2 and plane["correlation"] > 0.99 for plane in found["planes"])
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "amplitude.tif", "convergence.csv", "curves.png", "phase.tif", "reconstruction.json",
        "reconstruction.npz", "reconstruction.png", "residuals.png", "settings.toml", "svfg.csv",
    ]  # fmt: skip
    with Image.open(tmp_path / "out" / "amplitude.tif") as picture:
        amplitude = np.asarray(picture)
    stored = np.load(tmp_path / "out" / "reconstruction.npz")
    np.testing.assert_allclose(amplitude, np.abs(stored["values"]), atol=1e-6)
    lines = (tmp_path / "out" / "convergence.csv").read_text().splitlines()
    assert len(lines) == found["iterations"] + 1


def test_the_paper_s_way_and_words_for_people(wavesim: Command, data: Path, tmp_path: Path) -> None:
    code, out, err = wavesim(
        "reconstruct", *usual(data), "--method", "paper", "--iterations", 40, "--truth", data,
        "--refocus-mm=-0.004,0.004", "-o", tmp_path / "out",
    )  # fmt: skip
    assert code in ENDED, err
    assert "method paper, complex object, engine eikonal: 40 iterations" in out
    figures = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    assert figures["correlation_a6"] > 0.99
    assert figures["truth"]["object_correlation"] > 0.5
    assert figures["planes"][0]["residual"] < 0.3


@pytest.mark.parametrize(
    ("method", "start"), [("object", "even"), ("object", "amplitude"), ("paper", "model")]
)
@pytest.mark.usefixtures("quick_verdicts")
def test_an_interrupted_run_goes_on_and_ends_as_an_unbroken_one(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path, method: str, start: str
) -> None:
    monkeypatch.setattr(resumable, "SAVE_INTERVAL_S", 0.0)
    monkeypatch.setattr(resumable, "SAVE_TIME_FRACTION", np.inf)
    monkeypatch.setattr(reconstruction, "AMPLITUDE_START", 2)
    options = (*usual(data), "--method", method, "--start", start, "--iterations", 7)
    options = (*options, "--refocus-mm=-0.002,0.002")
    code, _, err = wavesim("reconstruct", *options, "-o", tmp_path / "whole")
    assert code in ENDED, err

    step = {"object": (channel_model.ChannelModel, "step"), "paper": (phase_retrieval, "iterate")}[method]
    call: Any = getattr(*step)
    taken: list[int] = []

    def stopped(*args: Any, **more: Any) -> Any:
        taken.append(1)
        if len(taken) > 3:
            raise KeyboardInterrupt
        return call(*args, **more)

    monkeypatch.setattr(*step, stopped)
    code, out, err = wavesim("reconstruct", *options, "-o", tmp_path / "cut")
    assert (code, out) == (130, "")
    assert "interrupted after 3 of 7 iterations; run the same command again" in err
    assert [path.name for path in (tmp_path / "cut").iterdir()] == ["checkpoint.npz"]

    def counted(*args: Any, **more: Any) -> Any:
        taken.append(1)
        return call(*args, **more)

    taken.clear()
    monkeypatch.setattr(*step, counted)
    code, _, err = wavesim("reconstruct", *options, "-o", tmp_path / "cut")
    assert code in ENDED, err
    result = json.loads((tmp_path / "whole" / "reconstruction.json").read_text())
    assert len(taken) == result["iterations"] - 3
    whole, cut = (np.load(tmp_path / name / "reconstruction.npz")["values"] for name in ("whole", "cut"))
    np.testing.assert_allclose(cut, whole, atol=1e-5)
    assert not (tmp_path / "cut" / "checkpoint.npz").exists()


@pytest.mark.parametrize("as_json", [(), ("--json",)])
def test_an_interrupt_during_the_verdict_keeps_the_object(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path, as_json: tuple[str, ...]
) -> None:
    out, options = tmp_path / "out", (*usual(data), "--kind", "amplitude", "--iterations", 4)
    judge, there = frame_reconstruction.judge_result, list[str]()

    def interrupted(*_: Any) -> Any:
        there.extend(sorted(path.name for path in out.iterdir()))
        raise KeyboardInterrupt

    monkeypatch.setattr(frame_reconstruction, "judge_result", interrupted)
    code, printed, err = wavesim("reconstruct", *options, "-o", out, *as_json)
    assert code == 1, err
    assert {"amplitude.tif", "reconstruction.npz", "residuals.png", "reconstruction.json"} <= set(there)
    stored = json.loads((out / "reconstruction.json").read_text())
    if as_json:
        assert json.loads(printed)["verdict"] == stored["verdict"]
    else:
        assert "verdict: not judged" in printed
    assert (stored["verdict"]["judged"], stored["verdict"]["explained"]) == (False, False)
    assert stored["verdict"]["over_noise"] > 0.0
    first = np.load(out / "reconstruction.npz")["values"]

    monkeypatch.setattr(frame_reconstruction, "judge_result", judge)
    code, _, err = wavesim("reconstruct", *options, "-o", out)
    assert code in ENDED, err
    judged = json.loads((out / "reconstruction.json").read_text())
    assert judged["verdict"]["judged"] is True
    assert [Path(path).name for path in judged["files"]] == stored["files"] == judged["files"]
    np.testing.assert_array_equal(np.load(out / "reconstruction.npz")["values"], first)


@pytest.mark.usefixtures("whole_search")
@pytest.mark.parametrize(
    ("level", "status", "words"),
    [
        ("quick", 0, "Not tested: other benches, correlation with the true object"),
        ("none", 1, "verdict: not judged: no verdict was requested"),
    ],
)
def test_a_smaller_verdict_says_what_was_not_tested_and_keeps_the_object(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path, level: str, status: int,
    words: str,
) -> None:  # fmt: skip
    """Neither makes an engine for its tests, and the object is that of a full verdict."""
    options = (*usual(data), "--kind", "amplitude", "--iterations", 15)
    code, whole, err = wavesim("reconstruct", *options, "-o", tmp_path / "whole")
    assert code == 0, err
    assert "other benches" not in whole

    def unexpected(*_: object, **__: object) -> None:
        raise AssertionError("must not be tested")

    monkeypatch.setattr(assessment, "_score_test", unexpected)
    monkeypatch.setattr(assessment, "_noise_correlation", unexpected)
    code, out, err = wavesim("reconstruct", *options, "--verdict", level, "-o", tmp_path / "out")
    assert code == status, err
    assert words in " ".join(out.split())
    objects = (np.load(tmp_path / name / "reconstruction.npz")["values"] for name in ("whole", "out"))
    np.testing.assert_array_equal(*objects)
    verdicts = (
        json.loads((tmp_path / name / "reconstruction.json").read_text())["verdict"]
        for name in ("whole", "out")
    )
    full, less = verdicts
    assert less["over_noise"] == full["over_noise"]
    assert (less["judged"], less["explained"]) == (status == 0, status == 0)


def test_a_quick_verdict_names_causes_that_were_not_tried(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, data: Path, tmp_path: Path
) -> None:
    def unexpected(*_: object, **__: object) -> None:
        raise AssertionError("must not be tried")

    monkeypatch.setattr(assessment, "CauseTrials", unexpected)
    options = (*usual(data), "--kind", "amplitude", "--iterations", 15, "--decenter-x-mm", 0.004)
    code, out, err = wavesim("reconstruct", *options, "--verdict", "quick", "-o", tmp_path / "out")
    assert code == 1, err
    assert "Not tested: causes" in " ".join(out.split())


def changed(frame: Frame, path: Path, counts: Any = None, **settings: Any) -> Path:
    write_frame(Frame(frame.counts if counts is None else counts, frame.settings.replaced(**settings)), path)
    return path


def bad_frame(data: Path, folder: Path, fault: str) -> Path:
    """The second frame with something wrong."""
    frame, path = read_frame(data / "frame_2.tif"), folder / "bad.tif"
    counts = frame.counts.copy()
    if fault == "size":
        return changed(frame, path, counts[:160, :160].copy())
    if fault == "saturated":
        counts[50:120, 50:120] = frame.settings.clipped_counts
        return changed(frame, path, counts)
    if fault == "empty":
        return changed(frame, path, np.full_like(counts, int(frame.settings.offset_counts)))
    if fault == "pitch":
        return changed(frame, path, pixel_pitch_um=3.3)
    if fault == "wavelength":
        return changed(frame, path, wavelength_um=0.6)
    if fault == "twice":
        return data / "frame_1.tif"
    if fault == "plane":
        return changed(frame, path, plane_distance_mm=PLANES_MM[0])
    path.write_bytes((data / "frame_2.tif").read_bytes()[:3000])
    return path


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("size", "bad.tif: 160 x 160 pixels"),
        ("saturated", "of the pixels are saturated"),
        ("empty", "bad.tif: contains no light"),
        ("pitch", "bad.tif: pixel_pitch_um = 3.3"),
        ("wavelength", "bad.tif: wavelength_um = 0.6"),
        ("plane", "both state plane_distance_mm = 0.0625, but show different intensities"),
        ("twice", "frame_1.tif: is named twice"),
        ("corrupt", "bad.tif: is cut short"),
    ],
)
def test_bad_frames_are_one_message_status_two_and_nothing_written(
    wavesim: Command, data: Path, tmp_path: Path, fault: str, message: str
) -> None:
    bad, folder = bad_frame(data, tmp_path, fault), tmp_path / "out"
    code, out, err = wavesim(
        "reconstruct", data / "frame_1.tif", bad, "--design", data / "twin.toml", "-o", folder
    )
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert message in err
    assert not folder.exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--method", "best"), "--method = 'best': allowed: paper, object"),
        (("--kind", "film"), "--kind = 'film'"),
        (("--start", "model"), "--start = 'model': allowed for object: even, amplitude"),
        (("--iterations", 0), "--iterations = 0"),
        (("--tv-weight", "much"), "--tv-weight = 'much'"),
        (("--tv-weight", -1), "tv_weight = -1"),
        (("--usaf", "grey"), "--usaf = 'grey'"),
        (("--pixel-pitch-um", 5), "frames have pixel_pitch_um = 5, the design's sensor 3.2"),
        (("--plane-distance-mm", "0.1"), "--plane-distance-mm = '0.1': must be 2 numbers"),
        (("--plane-distance-mm", "0.0625,9"), "reaches beyond the sensor's"),
        (("--patch-mm", 1), "patch_mm = 1: must be above 0 and at most"),
        (("--field-stop-mm", 1), "field_stop_mm = 1"),
        (("--truth", "nowhere"), "cannot read the measured field nowhere"),
        (("--refocus-mm", "1"), "--refocus-mm = '1'"),
        (("--chart-at-mm", "0.02,0"), "--chart-at-mm: requires --usaf"),
        (("--chart-at-mm", "0.02,0", "--usaf", "bright"), "chart at 0.02, 0 mm"),
    ],
)
def test_bad_options_are_one_message_status_two_and_nothing_written(
    wavesim: Command, data: Path, tmp_path: Path, options: tuple[object, ...], message: str
) -> None:
    folder = tmp_path / "out"
    code, out, err = wavesim("reconstruct", *usual(data), *options, "-o", folder)
    assert (code, out) == (2, "")
    assert message in err
    assert "Traceback" not in err
    assert not folder.exists()


def test_one_frame_does_for_an_amplitude_object_but_not_for_the_paper_s_way(
    wavesim: Command, data: Path, tmp_path: Path
) -> None:
    one = (data / "frame_1.tif", *usual(data)[2:])
    code, _, err = wavesim("reconstruct", *one, "--method", "paper", "-o", tmp_path / "paper")
    assert code == 2
    assert "--method paper: needs frames of at least two planes" in err
    code, _, err = wavesim(
        "reconstruct", *one, "--kind", "amplitude", "--iterations", 4, "-o", tmp_path / "object"
    )
    assert code in ENDED, err


@pytest.mark.usefixtures("quick_verdicts")
def test_foreign_frames_and_little_diversity_are_told(wavesim: Command, data: Path, tmp_path: Path) -> None:
    for number in (1, 2):
        counts = read_frame(data / f"frame_{number}.tif").counts
        Image.fromarray(counts).save(tmp_path / f"{number}.tif")
    frames = (tmp_path / "1.tif", tmp_path / "2.tif", *usual(data)[2:])
    code, _, err = wavesim("reconstruct", *frames, "-o", tmp_path / "out")
    assert code == 2
    assert "does not state how it was recorded" in err
    code, _, err = wavesim(
        "reconstruct", *frames, "--plane-distance-mm", "0.0625,0.0635", "--exposure", "1,1",
        "--pixel-pitch-um", 3.2, "--wavelength-um", 0.532, "--bits", 16, "--offset-counts", 64,
        "--gain-electrons-per-count", 15.3, "--iterations", 1, "-o", tmp_path / "out",
    )  # fmt: skip
    assert code in ENDED, err
    assert "little diversity between planes 0.0625, 0.0635 mm: dz w^2 / (lambda f^2) =" in err.replace(
        "\n", " "
    )


@pytest.mark.usefixtures("quick_verdicts")
def test_exposures_of_a_plane_are_merged_and_charts_beside_the_middle_told(
    wavesim: Command, data: Path, tmp_path: Path
) -> None:
    chart = ("--patch-mm", 0.09, "--engine", "eikonal", "--error", 0.3, "--chart-at-mm", "0.036,0")
    exposed = (
        *chart,
        "--exposures",
        "1,30",
        "--plane-distance-mm",
        0.0625,
        "--pixels",
        "all",
        "-o",
        tmp_path,
    )
    code, _, err = wavesim("image", data / "twin.toml", *exposed)
    assert code == 0, err
    merged, alone = tmp_path / "merged", tmp_path / "alone"
    both = (tmp_path / "frame_1_1.tif", tmp_path / "frame_1_2.tif")
    usual = (
        "--design",
        data / "twin.toml",
        *chart,
        "--usaf",
        "bright",
        "--kind",
        "amplitude",
        "--iterations",
        8,
    )
    code, out, err = wavesim("reconstruct", *both, *usual, "-o", merged)
    assert code in ENDED, err
    assert re.match(r"memory: about 0\.4\d GB of [\d.]+ GB allowed\n", err)
    assert "chart at 0.036, 0 mm: resolved down to group 9, element 2" in out.replace("\n", " ")
    code, out, err = wavesim("reconstruct", both[0], *usual, "-o", alone, "--json")
    assert code in ENDED
    result = [json.loads((folder / "reconstruction.json").read_text()) for folder in (merged, alone)]
    assert [len(one["planes"][0]["exposures"]) for one in result] == [2, 1]
    assert result[0]["planes"][0]["noise"] < 0.7 * result[1]["planes"][0]["noise"]
    (beside,) = result[0]["usaf"]["beside"]
    assert beside["at_mm"] == [0.036, 0.0]
    assert [one["group"] for one in beside["elements"]] == [9, 9]
    code, _, err = wavesim("reconstruct", *both, *usual[:4], "--method", "paper", "-o", tmp_path / "paper")
    assert code == 2
    assert "--method paper: needs frames of at least two planes" in err


def test_frames_of_swapped_planes_end_with_status_1_and_say_so(
    wavesim: Command, data: Path, tmp_path: Path
) -> None:
    for number, distance in enumerate(reversed(PLANES_MM), start=1):
        frame = read_frame(data / f"frame_{number}.tif")
        swapped = Frame(frame.counts, frame.settings.replaced(plane_distance_mm=distance))
        write_frame(swapped, tmp_path / f"frame_{number}.tif")
    frames = tmp_path / "frame_1.tif", tmp_path / "frame_2.tif"
    code, out, err = wavesim(
        "reconstruct", *frames, *usual(data)[2:], "--kind", "amplitude", "--iterations", 6,
        "-o", tmp_path / "out",
    )  # fmt: skip
    assert code == 1, err
    said = " ".join(out.split())
    assert "verdict: not explained" in said
    assert "Most likely: planes swapped" in said
    result = json.loads((tmp_path / "out" / "reconstruction.json").read_text())["verdict"]
    assert (result["explained"], result["cause"]) == (False, "planes swapped")
    assert result["over_noise"] > 2.0


@pytest.mark.parametrize("option", ["flat", "dark", "bad-pixels"])
def test_a_map_of_another_size_is_refused(wavesim: Command, data: Path, tmp_path: Path, option: str) -> None:
    np.save(tmp_path / "map.npy", np.ones((3, 4)))
    code, _, err = wavesim(
        "reconstruct", *usual(data), f"--{option}", tmp_path / "map.npy", "-o", tmp_path / "out"
    )
    assert code == 2
    assert f"4 x 3 pixels; the frames have {PIXELS} x {PIXELS}" in " ".join(err.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("flat", 0.0, "show no light beyond the dark count"),
        ("dark", 60000.0, "must be a picture without light"),
        ("bad-pixels", 1.0, "marks 100 % of the pixels as bad"),
    ],
)
def test_a_map_that_cannot_be_is_refused_and_nothing_overwritten(
    wavesim: Command, data: Path, tmp_path: Path, option: str, value: float, message: str
) -> None:
    np.save(tmp_path / "map.npy", np.full((PIXELS, PIXELS), value))
    out = tmp_path / "out"
    out.mkdir()
    (out / "reconstruction.json").write_text("kept")
    code, _, err = wavesim("reconstruct", *usual(data), f"--{option}", tmp_path / "map.npy", "-o", out)
    assert code == 2
    assert message in " ".join(err.split())
    assert [path.read_text() for path in out.iterdir()] == ["kept"]


SMALL = GOLDEN / "small_frames"
"""Two exposures on each of two planes, of a camera with a black level of 64 counts."""


def small_frames(
    folder: Path, change: Callable[[str, np.ndarray], np.ndarray] = lambda _, counts: counts
) -> list[Path]:
    """The frames, changed by a function of their name and counts."""
    paths = []
    for name in ("1_1", "1_2", "2_1", "2_2"):
        counts = np.array(Image.open(SMALL / f"frame_{name}.tif"))
        paths.append(folder / f"frame_{name}.tif")
        Image.fromarray(np.ascontiguousarray(change(name, counts))).save(paths[-1])
    return paths


def small_options(offset: float = 64) -> tuple[object, ...]:
    return (
        "--design", SMALL / "twin.toml", "--patch-mm", 0.03, "--kind", "amplitude",
        "--plane-distance-mm", "0.03125,0.03125,0.34375,0.34375",
        "--exposure", "2895.9,86877.0,1694.005,50820.157", "--pixel-pitch-um", 3.2,
        "--wavelength-um", 0.532, "--bits", 12, "--offset-counts", offset,
        "--gain-electrons-per-count", 2.48077, "--read-noise-electrons", 2,
    )  # fmt: skip


@pytest.mark.parametrize("offset", [60, 63, 65, 80])
@pytest.mark.parametrize("exposures", [1, 2])
def test_a_black_level_that_the_frames_contradict_is_named(
    wavesim: Command, tmp_path: Path, offset: float, exposures: int
) -> None:
    paths, options = small_frames(tmp_path), small_options(offset)
    if exposures == 1:
        paths = [paths[0], paths[2]]
        one = {"0.03125,0.03125,0.34375,0.34375": "0.03125,0.34375"}
        one["2895.9,86877.0,1694.005,50820.157"] = "2895.9,1694.005"
        options = tuple(one.get(str(part), part) for part in options)
    code, _, err = wavesim("reconstruct", *paths, *options, "-o", tmp_path / "out")
    assert code == 2
    said = " ".join(err.split())
    assert f"--offset-counts = {offset}: " in said
    measured = re.search(r"mean of ([\d.]+) counts", said)
    assert measured is not None
    assert float(measured[1]) == pytest.approx(64.0, abs=0.2)
    assert len(said) < 500


@pytest.mark.usefixtures("whole_search")
def test_a_camera_that_clips_below_its_largest_count_is_seen(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    judge_quickly(monkeypatch)
    paths = small_frames(tmp_path, lambda name, counts: np.minimum(counts, 4000))
    out = tmp_path / "out"
    code, _, err = wavesim("reconstruct", *paths, *small_options(), "-o", out)
    assert code == 0, err
    said = " ".join(err.split())
    assert "47 pixels share the largest count, 4000 of 4095" in said
    assert "(--saturation-counts) 4000" in said
    assert json.loads((out / "reconstruction.json").read_text())["verdict"]["over_noise"] < 1.1
    code, _, err = wavesim(
        "reconstruct", *paths, *small_options(), "--saturation-counts", 4000, "--iterations", 1, "-o", out
    )
    assert code in ENDED, err
    assert "share the largest count" not in err


@pytest.mark.parametrize(
    ("orientation", "named"),
    [
        (lambda counts: counts[::-1], "mirrored top to bottom"),
        (lambda counts: counts.T, "transposed"),
    ],
)
def test_a_plane_in_another_orientation_is_named_in_the_printed_verdict(
    wavesim: Command,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    orientation: Callable[[np.ndarray], np.ndarray],
    named: str,
) -> None:
    if named != "transposed":  # residuals name a mirrored plane, before causes are tried
        judge_quickly(monkeypatch)
    paths = small_frames(tmp_path, lambda name, counts: orientation(counts) if name[0] == "2" else counts)
    code, out, err = wavesim("reconstruct", *paths, *small_options(), "-o", tmp_path / "out")
    assert code == 1, err
    assert named in " ".join(out.split())
    verdict = json.loads((tmp_path / "out" / "reconstruction.json").read_text())["verdict"]
    assert verdict["cause"] == "orientation"
    assert named in verdict["told"]


def test_one_exposure_in_another_orientation_is_named(wavesim: Command, tmp_path: Path) -> None:
    paths = small_frames(tmp_path, lambda name, counts: counts[::-1] if name == "2_2" else counts)
    code, _, err = wavesim("reconstruct", *paths, *small_options(), "-o", tmp_path / "out")
    assert code == 2
    assert "agrees with the first one if it is mirrored top to bottom" in " ".join(err.split())


def test_frames_of_two_wavelengths_are_refused(wavesim: Command, data: Path, tmp_path: Path) -> None:
    frame = read_frame(data / "frame_2.tif")
    write_frame(Frame(frame.counts, frame.settings.replaced(wavelength_um=0.6)), tmp_path / "red.tif")
    frames = data / "frame_1.tif", tmp_path / "red.tif"
    code, _, err = wavesim("reconstruct", *frames, *usual(data)[2:], "-o", tmp_path / "out")
    assert code == 2
    assert "red.tif: wavelength_um = 0.6; that of" in " ".join(err.split())
    assert not (tmp_path / "out").exists()
