"""The command `wavesim image`, end to end on a small twin."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from programs import Command

from lensdesign import load_design, save_design, scaled
from wavesim import write_state
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.fields import sampling_checks
from wavesim.scene.state_files import state_from_table
from wavesim.sensor.frames import read_frame
from wavesim.sensor.merged_exposures import estimate_intensity
from wavesim.targets.patch import make_target, object_patch


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("design") / "twin.toml"
    save_design(scaled(load_design("designs/paper_singlet.toml"), 1 / 32), path)
    return path


QUICK = ("--patch-mm", 0.05, "--engine", "eikonal", "--error", 0.3)


@pytest.mark.parametrize("object_", ["star", "phase", "usaf", "tissue"])
def test_an_object_that_is_too_fine_has_a_message_with_options(
    wavesim: Command, twin: Path, tmp_path: Path, object_: str
) -> None:
    options = ("--object", object_, "--object-pitch-um", 5, "-o", tmp_path / "out")
    code, _, err = wavesim("image", twin, *QUICK, *options)
    assert code == 2
    said = " ".join(err.split())
    assert re.search("object.pitch.um", said)
    assert "inner_radius_mm" not in said
    assert not (tmp_path / "out").exists()


def test_planes_that_need_too_many_samples_are_refused_before_the_engine_works(
    wavesim: Command, monkeypatch: pytest.MonkeyPatch, twin: Path, tmp_path: Path
) -> None:
    def work(*_: object, **__: object) -> None:
        raise AssertionError("the engine works")

    monkeypatch.setattr(sampling_checks, "MOST_SAMPLES", 1000)
    monkeypatch.setattr(FlatTiles, "forward", work)
    code, _, err = wavesim("image", twin, *QUICK, "-o", tmp_path / "out")
    assert code == 2
    assert "--patch-mm" in err or "patch_mm" in err


def test_frames_truth_and_record(wavesim: Command, twin: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    code, out, err = wavesim("image", twin, *QUICK, "--seed", 5, "-o", folder, "--json")
    assert (code, err) == (0, "")
    data = json.loads(out)
    assert sorted(path.name for path in folder.iterdir()) == [
        "frame_1.tif", "frame_2.tif", "frames.png", "image.json", "object.npz", "object.png",
        "object_amplitude.tif", "object_phase.tif", "settings.toml",
    ]  # fmt: skip
    assert json.loads((folder / "image.json").read_text())["engine"] == data["engine"]
    lens = load_design(twin)
    frames = [read_frame(folder / f"frame_{n}.tif") for n in (1, 2)]
    assert tuple(f.settings.plane_distance_mm for f in frames) == lens.sensor.plane_distances_mm
    assert all(f.settings.pixel_pitch_um == 3.2 for f in frames)
    # Light of amplitude 1 through the chart's clear part: nearly all of it must be on the sensor.
    stored = np.load(folder / "object.npz")
    side = len(stored["values"])
    x = (np.arange(side) - 0.5 * (side - 1)) * float(stored["pitch_um"])
    passed = np.abs(stored["values"]) ** 2 * (np.hypot(x, x[:, None]) < 25.0)
    sent = float(passed.sum()) * float(stored["pitch_um"]) ** 2
    for frame in frames:
        assert float(estimate_intensity(frame)[0].sum()) * 3.2**2 == pytest.approx(sent, rel=0.1)
    assert data["sensor"]["seed"] == 5
    assert data["frames"][0]["brightest_counts"] == frames[0].counts.max()
    assert 0.0 <= data["energy_share_beyond_pixel_limit"] < 0.01


def test_the_same_seed_gives_the_same_frames_and_words_for_people(
    wavesim: Command, twin: Path, tmp_path: Path
) -> None:
    counts = {}
    for name, options in {"a": ("--seed", 1), "b": ("--seed", 1), "c": ("--no-noise",)}.items():
        code, out, _ = wavesim(
            "image", twin, *QUICK, "--plane-distance-mm", "0.1", "--object", "star", "--ground", "dark",
            *options, "-o", tmp_path / name,
        )  # fmt: skip
        assert code == 0
        counts[name] = read_frame(tmp_path / name / "frame_1.tif").counts
    assert np.array_equal(counts["a"], counts["b"])
    assert not np.array_equal(counts["a"], counts["c"])
    for text in ("object star", "engine eikonal", "frame_1.tif", f"wrote 7 files to {tmp_path / 'c'}"):
        assert text in out.replace("\n", " ")


def test_results_are_replaced_and_what_else_is_there_stays(
    wavesim: Command, twin: Path, tmp_path: Path
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "frame_1.tif").write_text("old")
    code, _, _ = wavesim("image", twin, *QUICK, "--plane-distance-mm", "0.1", "-o", tmp_path)
    assert code == 0
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert read_frame(tmp_path / "frame_1.tif").counts.max() > 1000
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize(("polarization", "words"), [("unpolarized", "unpolarized light"), (45.0, "45 deg")])
def test_frames_of_polarized_light(
    wavesim: Command, twin: Path, tmp_path: Path, polarization: str | float, words: str
) -> None:
    command = ("image", twin, *QUICK, "--plane-distance-mm", "0.1", "--no-noise", "--coating", "bare")
    code, out, _ = wavesim(*command, "--polarization", polarization, "-o", tmp_path / "light")
    assert code == 0
    assert words in out
    data = json.loads((tmp_path / "light/image.json").read_text())
    assert (data["polarization"], data["coating"]) == (polarization, "bare")
    assert wavesim(*command, "--polarization", "scalar", "-o", tmp_path / "scalar")[0] == 0
    scalar = json.loads((tmp_path / "scalar/image.json").read_text())
    assert scalar["polarization"] == "scalar"
    found, expected = (read_frame(tmp_path / name / "frame_1.tif").counts for name in ("light", "scalar"))
    assert 0 < np.max(np.abs(found.astype(int) - expected)) < 0.02 * expected.max()
    limits = (one["energy_share_beyond_pixel_limit"] for one in (data, scalar))
    assert next(limits) == pytest.approx(next(limits), rel=0.02)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--polarization", "wobbly"), "--polarization = 'wobbly': must be one of auto, scalar"),
        (("--polarization", "30", "--ghost", "0.01"), "--polarization, --ghost: coherent ghosts"),
        (
            ("--engine", "eikonal", "--polarization", "30", "--hierarchical"),
            "hierarchical propagates scalar waves",
        ),
        (("--object", "usef"), "object = 'usef'"),
        (("--object", "none.png", "--picture-pixel-um", 1), "cannot read the picture none.png"),
        (("--patch-mm", 1), "patch_mm = 1: must be above 0 and at most"),
        (("--patch-mm", 0.05, "--field-stop-mm", 0.06), "field_stop_mm = 0.06"),
        (("--ground", "grey"), "ground = 'grey'"),
        (("--illumination", "sun"), "illumination = 'sun'"),
        (("--waist-mm", 0.01), "--waist-mm: requires --illumination gaussian"),
        (("--plane-distance-mm", "0.1,0.1"), "--plane-distance-mm = '0.1,0.1'"),
        (("--plane-distance-mm", "near"), "--plane-distance-mm = 'near'"),
        (("--stage-error-mm", "0,0,0"), "--stage-error-mm = '0,0,0': must be 1 or 2 numbers"),
        (("--pixels", 100), "reaches beyond the sensor's"),
        (("--pixels", 1000), "pixels = 1000: must be from 1 to"),
        (("--pixels", "100x300"), "pixels = 100 x 300: must be from 1 x 1 to the sensor's 292 x 219"),
        (("--pixels", "1x2x3"), "--pixels = '1x2x3': must be a whole number"),
        (("--pixels", "-3"), "--pixels = '-3'"),
        (("--exposures", "0,1"), "--exposures = '0,1': must be greater than 0"),
        (("--exposures", "long"), "--exposures = 'long'"),
        (("--object", "star", "--chart-at-mm", "0,0"), "chart_at_mm: requires object = 'usaf', not 'star'"),
        (("--chart-at-mm", "0.01"), "--chart-at-mm = '0.01': must be 2 numbers"),
        (("--chart-at-mm", "0,0"), "chart at 0, 0 mm: even group 9 alone"),
        (("--chart-at-mm", "0.024,0"), "reaches beyond the field stop of 0.05 mm"),
        (("--bits", 20), "bits = 20"),
        (("--full-well-electrons", 0), "full-well-electrons = 0"),
        (("--seed", -1), "--seed = -1"),
        (("--engine", "eiconal"), "engine = 'eiconal': there is no such engine"),
        (("--engine", "eikonal", "--slices", 3), "engine eikonal: slices = 3"),
        (("--tilt-x-deg", "nan"), "tilt-x-deg = nan"),
    ],
)
def test_bad_input_is_one_message_status_two_and_nothing_written(
    wavesim: Command, twin: Path, tmp_path: Path, options: tuple[object, ...], message: str
) -> None:
    folder = tmp_path / "out"
    code, out, err = wavesim("image", twin, "--patch-mm", 0.05, *options, "-o", folder)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert message in err
    assert "Traceback" not in err
    assert not folder.exists()


def test_a_file_in_place_of_the_folder_is_refused_and_kept(
    wavesim: Command, twin: Path, tmp_path: Path
) -> None:
    place = tmp_path / "out"
    place.write_text("mine")
    code, _, err = wavesim("image", twin, *QUICK, "-o", place)
    assert code == 2
    assert "is no folder" in err
    assert place.read_text() == "mine"


def test_exposures_of_each_plane_stand_side_by_side(wavesim: Command, twin: Path, tmp_path: Path) -> None:
    several = (*QUICK, "--exposures", "1000,1", "--seed", 2, "--pixels", "all")
    code, out, err = wavesim("image", twin, *several, "-o", tmp_path / "a", "--json")
    assert (code, err) == (0, "")
    result = json.loads(out)["frames"]
    names = ["frame_1_1.tif", "frame_1_2.tif", "frame_2_1.tif", "frame_2_2.tif"]
    assert [frame["file"] for frame in result] == names
    assert [frame["times"] for frame in result] == [1.0, 1000.0, 1.0, 1000.0]
    assert result[0]["saturated_pixels"] == 0 < result[1]["saturated_pixels"]
    frames = [read_frame(tmp_path / "a" / name) for name in names]
    # The whole sensor, wider than high.
    assert all(frame.counts.shape == (219, 292) for frame in frames)
    assert frames[1].settings.exposure == pytest.approx(1000.0 * frames[0].settings.exposure)
    known = ~frames[1].saturated
    (short, about), (long, more) = (estimate_intensity(frame) for frame in frames[:2])
    error = math.sqrt(float(about[known].sum() + more[known].sum()))
    assert short[known].sum() == pytest.approx(long[known].sum(), abs=4.5 * error)
    # One exposure has the names and the noise that it would have without the option; a long one says nothing.
    for name, options in {"b": (), "c": ("--exposures", 1), "d": ("--exposures", 1000)}.items():
        code, out, err = wavesim("image", twin, *QUICK, *options, "-o", tmp_path / name)
        assert (code, err.count("\n")) == (0, 1)
    assert "1000 x" in out
    plain, one, longer = (read_frame(tmp_path / name / "frame_1.tif").counts for name in "bcd")
    assert np.array_equal(plain, one)
    assert not np.array_equal(plain, longer)


def test_a_state_from_a_file_records_what_its_options_record(
    wavesim: Command, twin: Path, tmp_path: Path
) -> None:
    options = ("--decenter-x-mm", 0.002, "--light-error-deg", "0.2,0.1", "--plane-background", 0.02)
    code, _, err = wavesim("image", twin, *QUICK, *options, "-o", tmp_path / "options")
    assert code == 0, err
    written = json.loads((tmp_path / "options" / "image.json").read_text())["state"]
    path = write_state(state_from_table(written, "image.json", load_design(twin)), tmp_path / "state.json")
    code, _, err = wavesim("image", twin, *QUICK, "--state", path, "-o", tmp_path / "file")
    assert code == 0, err
    one, other = (read_frame(tmp_path / name / "frame_2.tif").counts for name in ("options", "file"))
    assert np.array_equal(one, other)
    code, _, err = wavesim("image", twin, *QUICK, "--state", path, *options, "-o", tmp_path / "both")
    assert code == 2
    assert "--state" in err


def test_a_chart_stands_beside_the_middle_too(wavesim: Command, twin: Path, tmp_path: Path) -> None:
    options = (
        *QUICK[2:],
        "--patch-mm",
        0.09,
        "--plane-distance-mm",
        0.1,
        "--no-noise",
        "--chart-at-mm",
        "0.036,0",
    )
    code, out, err = wavesim("image", twin, *options, "-o", tmp_path, "--json")
    assert (code, err) == (0, "")
    target = make_target(object_patch(load_design(twin), 0.09), "usaf", numerical_aperture=0.5)
    assert json.loads(out)["object"]["elements"] == len(target.elements) + 2
    stored = np.abs(np.load(tmp_path / "object.npz")["values"])
    x = target.transmission.grid.x_mm
    other = (abs(stored - np.abs(target.transmission.values)) > 1e-3).any(axis=0)
    assert 0.028 < x[other].min() < 0.036 < x[other].max() < 0.044


def test_each_wavelength_has_its_folder(wavesim: Command, twin: Path, tmp_path: Path) -> None:
    """The same frames as of each wavelength by itself."""
    lens = load_design(twin)
    save_design(lens.model_copy(update={"wavelengths_um": (0.532, 0.6)}), tmp_path / "two.toml")
    code, out, _ = wavesim(
        "image", tmp_path / "two.toml", *QUICK, "--all-wavelengths", "-o", tmp_path / "both", "--json"
    )
    assert code == 0
    assert [one["wavelength_um"] for one in json.loads(out)["images"]] == [0.532, 0.6]
    code, _, _ = wavesim(
        "image", tmp_path / "two.toml", *QUICK, "--wavelength-um", 0.6, "-o", tmp_path / "one"
    )
    assert code == 0
    alone, together = (
        read_frame(path / "frame_2.tif") for path in (tmp_path / "one", tmp_path / "both/0.6_um")
    )
    assert together.settings == alone.settings
    assert np.array_equal(together.counts, alone.counts)


def test_wavelengths_are_asked_for_in_one_way(wavesim: Command, twin: Path, tmp_path: Path) -> None:
    code, _, err = wavesim(
        "image", twin, *QUICK, "--all-wavelengths", "--wavelength-um", 0.6, "-o", tmp_path / "out"
    )
    assert code == 2
    assert "--all-wavelengths, --wavelength-um: give only one" in err
    assert not (tmp_path / "out").exists()


def test_a_field_stop_beside_the_axis_is_imaged_and_said(
    wavesim: Command, twin: Path, tmp_path: Path
) -> None:
    stop = "--field-stop-mm", 0.03, "--field-stop-at-mm=-0.006,0.008"
    thing = "--object", "phase", *stop
    code, out, err = wavesim("image", twin, *QUICK, *thing, "-o", tmp_path / "out")
    assert code == 0, err
    assert "field stop 0.03 mm at -0.006, 0.008 mm" in out
    said = json.loads((tmp_path / "out" / "image.json").read_text())["object"]
    assert (said["field_stop_mm"], said["field_stop_at_mm"]) == (0.03, [-0.006, 0.008])
    # The row of pads stands in the middle of the stop.
    stored = np.load(tmp_path / "out" / "object.npz")
    dark = np.abs(np.angle(stored["values"])) > 0.1
    axis = 1e-3 * float(stored["pitch_um"]) * (np.arange(len(dark)) - 0.5 * (len(dark) - 1))
    x, y = (float(dark.sum(axis=n) @ axis / dark.sum()) for n in (0, 1))
    assert math.dist((x, y), (-0.006, 0.008)) < 6e-4
    code, _, err = wavesim(
        "image", twin, *QUICK, "--field-stop-mm", 0.03, "--field-stop-at-mm", "0.02,0",
        "-o", tmp_path / "no",
    )  # fmt: skip
    assert code == 2
    assert "reaches beyond the patch of 0.05 mm" in err
