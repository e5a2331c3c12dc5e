"""What a bench is like, from frames with and without an object."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from quick_verdicts import judge_quickly

from benchmarks.calibration_errors import normalized_errors
from lensdesign import Pose, load_design, scaled
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from wavesim import image
from wavesim.calibration import calibrate_empty, calibrate_frames, frame_calibration, read_calibration
from wavesim.calibration.calibration_result import Calibrated
from wavesim.calibration.joint.pixels import SparsePixels
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.metrics.displacement import displacement_samples
from wavesim.reconstruction.field_stop import FieldStop, StopSearch
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.reconstruction.source_search import FoundSource, SourceWarning
from wavesim.scene.light_errors import LightErrors
from wavesim.scene.settings import CalibrationSettings, ReconstructionSettings
from wavesim.scene.source import Source
from wavesim.scene.system_state import SystemState
from wavesim.sensor.colour_filters import ColourFilters
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.frames import Frame
from wavesim.targets.patch import object_patch

TRUE = {
    "light_tilt_x_deg": 0.5,
    "light_tilt_y_deg": -0.3,
    "light_phase_20_waves": 0.05,
    "light_phase_11_waves": -0.03,
    "light_amplitude_10": -0.06,
    "light_amplitude_02": 0.04,
}
BENCH = SystemState(
    light=LightErrors((0.5, -0.3), {(1, 0): -0.06, (0, 2): 0.04}, {(2, 0): 0.05, (1, 1): -0.03})
)
SETTINGS = CalibrationSettings(patch_mm=0.04, error=0.1, parameters="light", kind="amplitude")


@pytest.fixture(scope="module")
def lens() -> Lens:
    return scaled(load_design("designs/paper_singlet.toml"), 1 / 48)


def frames_of(lens: Lens, thing: str) -> tuple[Frame, ...]:
    made = image(lens, thing, state=BENCH, patch_mm=0.04, exposures=(1.0, 30.0), engine="eikonal", error=0.1)
    return made.frames


@pytest.fixture(scope="module")
def empty(lens: Lens) -> tuple[Frame, ...]:
    return frames_of(lens, "empty")


@pytest.fixture(scope="module")
def star(lens: Lens) -> tuple[Frame, ...]:
    return frames_of(lens, "star")


@pytest.fixture(scope="module")
def measured(lens: Lens, empty: tuple[Frame, ...]) -> Calibrated:
    return calibrate_empty(lens, empty, SETTINGS)


def test_frames_without_an_object_tell_the_light(measured: Calibrated) -> None:
    assert measured.explained
    assert measured.deviations is not None
    for name, value, deviation in zip(measured.parameters, measured.values, measured.deviations, strict=True):
        assert abs(value - TRUE.get(name, 0.0)) < 4.0 * deviation, (name, value, deviation)
    by_name = dict(zip(measured.parameters, measured.values, strict=True))
    assert by_name["light_tilt_x_deg"] == pytest.approx(0.5, rel=0.05)
    assert by_name["light_tilt_y_deg"] == pytest.approx(-0.3, rel=0.05)


def test_a_verdict_on_a_known_object_names_planes_and_no_held_out_pixels(
    measured: Calibrated, empty: tuple[Frame, ...]
) -> None:
    assert measured.verdict is not None
    stated = sorted({frame.settings.plane_distance_mm for frame in empty})
    assert [plane.distance_mm for plane in measured.verdict.planes] == stated
    assert measured.verdict.held_out_over_noise is None


def test_their_light_holds_while_the_rest_is_sought(
    lens: Lens, empty: tuple[Frame, ...], star: tuple[Frame, ...], measured: Calibrated, tmp_path: Path
) -> None:
    quick = {"parameters": "plane_2_background", "iterations": 6, "most_mountings": 12, "kind": "complex"}
    found = calibrate_frames(lens, star, SETTINGS, empty=empty, **quick)
    by_name = dict(zip(found.parameters, found.values, strict=True))
    assert [name for name in found.parameters if name.startswith("light")] == list(measured.parameters)
    assert by_name["plane_2_background"] < 5e-3
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(found.as_dict()))
    light = read_calibration(path, lens).light
    assert light == found.state.light
    assert light.tilt_deg == pytest.approx((0.5, -0.3), rel=0.05)


def test_empty_frames_suffice_for_the_light_alone(
    lens: Lens, empty: tuple[Frame, ...], star: tuple[Frame, ...]
) -> None:
    """The group of the light may be requested for frames of an object, too, alone or with others."""
    quick: dict[str, Any] = {"most_mountings": 2, "verdict": "none", "kind": "amplitude"}
    alone = calibrate_frames(lens, star, SETTINGS, empty=empty, parameters="light", **quick)
    both = calibrate_frames(lens, star, SETTINGS, empty=empty, parameters="light,decenter_x_mm", **quick)
    assert {parameter.group for parameter in alone.sought} == {"light"}
    assert set(both.parameters) == {*alone.parameters, "decenter_x_mm"}


def test_frames_that_saw_an_object_are_refused(lens: Lens, star: tuple[Frame, ...]) -> None:
    with pytest.raises(InputError, match=r"empty: .*\d+\.\d times the noise"):
        calibrate_empty(lens, star, SETTINGS, most_mountings=10)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wavelength_um": 0.6}, r"empty: wavelength_um = 0.6; .*0.532"),
        ({"pixel_pitch_um": 3.0}, r"empty: pixel_pitch_um = 3; .*3.2"),
        ({"plane_distance_mm": 0.3}, r"empty: planes at 0.3 mm"),
    ],
)
def test_frames_of_another_light_pitch_or_plane_are_refused(
    lens: Lens, empty: tuple[Frame, ...], star: tuple[Frame, ...], change: dict[str, Any], message: str
) -> None:
    other = [replace(frame, settings=frame.settings.replaced(**change)) for frame in empty]
    with pytest.raises(InputError, match=message):
        calibrate_frames(lens, star, SETTINGS, empty=other)


@pytest.mark.parametrize("filters", ["monochrome", "bayer"])
def test_frames_of_several_wavelengths_are_refused(
    lens: Lens, empty: tuple[Frame, ...], star: tuple[Frame, ...], filters: str
) -> None:
    colours = getattr(ColourFilters, filters)((0.532, 0.635, 0.45))
    several = r"0\.532, 0\.635, 0\.45 .*m were recorded at once"
    empty, coloured = (
        tuple(replace(frame, settings=frame.settings.replaced(colours=colours)) for frame in frames)
        for frames in (empty, star)
    )
    for attempt in (
        lambda: calibrate_frames(lens, coloured, SETTINGS),
        lambda: calibrate_frames(lens, star, SETTINGS, empty=empty),
        lambda: calibrate_empty(lens, empty, SETTINGS),
        lambda: recorded_planes(coloured),
    ):
        with pytest.raises(InputError, match=several):
            attempt()


def test_of_a_small_patch_some_pixels_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames are made with every pixel, through one field behind the lens."""
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    bench = SystemState(plane_shifts_um=((0.0, 0.0), (4.0, -3.0)))
    small: dict[str, Any] = {"patch_mm": 0.024, "engine": "eikonal", "error": 0.1}
    frames = image(lens, "star", state=bench, exposures=(1.0, 30.0), **small).frames
    taken: list[int] = []

    def spied(self: SparsePixels, *given: Any) -> ChannelModel:
        taken.append(self.recorded[0].amplitude.shape[0])
        return model(self, *given)

    model = SparsePixels.model
    monkeypatch.setattr(SparsePixels, "model", spied)
    # All pixels, which a search for the field stop takes, are never modelled.
    monkeypatch.setattr(StopSearch, "estimated_centre", None)
    names = "plane_2_shift_x_um,plane_2_shift_y_um"
    found = calibrate_frames(lens, frames, parameters=names, most_mountings=5, iterations=3, **small)
    assert set(taken) == {taken[0]}
    assert 1.9 < frames[0].counts.shape[0] / taken[0] < 4.5
    assert found.values == pytest.approx((4.0, -3.0), abs=0.3)


def test_a_camera_s_nonlinearity_and_the_exposures_of_planes_are_found(lens: Lens) -> None:
    tiles: dict[str, Any] = {"patch_mm": 0.03, "engine": "eikonal", "error": 0.3}
    errors: dict[str, Any] = {"plane_exposure_error": (0.0, -0.03), "nonlinearity": 0.04}
    frames = image(lens, "star", exposures=(1.0, 30.0), pixels=140, **tiles, **errors).frames
    names = "plane_2_exposure_error,nonlinearity,plane_2_background"
    found = calibrate_frames(
        lens, frames, kind="amplitude", parameters=names, most_mountings=8, verdict="none", **tiles
    )
    assert found.deviations is not None
    assert found.misfit_of_noise is not None
    assert found.misfit < 1.1 * found.misfit_of_noise < found.misfit_before
    by_name = dict(zip(found.parameters, zip(found.values, found.deviations, strict=True), strict=True))
    for name, true, most in (("plane_2_exposure_error", -0.03, 0.01), ("nonlinearity", 0.04, 0.01)):
        value, deviation = by_name[name]
        assert abs(value - true) < 3.0 * deviation < 3.0 * most


def test_a_grey_object_leaves_the_unevenness_of_the_light_open() -> None:
    """The scale fits an object that is bright everywhere. It clips this one, as if the light were uneven."""
    side_mm = 0.03
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    patch = object_patch(lens, side_mm)
    y, x = 2.0 * patch.grid.y_mm[:, None] / side_mm, 2.0 * patch.grid.x_mm / side_mm
    ripples = 0.7 + 0.3 * np.sin(25.0 * x + 10.0 * y)
    grey = 0.15 + 0.8 * ripples * np.exp(-((x - 0.3) ** 2 + (y - 0.2) ** 2) / 0.15)
    thing = Field(patch.grid, grey.astype(np.complex64), patch.wavelength_um)
    options = {"engine": "eikonal", "error": 0.1, "exposures": (1.0, 30.0)}
    frames = image(lens, thing, field_stop_mm=side_mm, seed=1, **options).frames
    settings = {"kind": "amplitude", "error": 0.1, "parameters": "light,mounting"}
    found = calibrate_frames(lens, frames, verdict="none", patch_mm=side_mm, **settings)
    estimates = zip(found.parameters, found.values, found.deviations, strict=True)
    for name, value, deviation in estimates:
        if name.startswith("light_amplitude"):
            assert abs(value) < 0.02, name
            assert deviation > 0.08, name
        else:
            assert abs(value) < 3.0 * deviation, name
    assert found.object_uncertainty is not None
    left = found.object_uncertainty.summary
    # Five modes of the light, whose expected deviations are 0.1, change the object.
    assert all(0.07 < deviation < 0.13 for deviation in left.amplitude.values()), left.amplitude
    assert "amplitude, which uneven light changes alike" in left.words
    assert left.correlation < 0.99 < left.correlation_without_low_orders


def test_an_object_on_a_dark_ground_is_found_where_it_is(lens: Lens) -> None:
    """Only the aberrations of the lens tell where it is; decenter and light tilt follow its displacement."""
    side_mm = 0.05
    patch = object_patch(lens, side_mm)
    y, x = 2.0 * patch.grid.y_mm[:, None] / side_mm, 2.0 * patch.grid.x_mm / side_mm
    stem = (np.abs(x + 0.25) < 0.1) & (np.abs(y) < 0.6)
    bars = [(np.abs(y - at) < 0.1) & (x > -0.35) & (x < end) for at, end in ((0.5, 0.45), (0.0, 0.25))]
    letter = (stem | bars[0] | bars[1]) * (0.9 + 0.1 * np.sin(9.0 * x + 4.0 * y))
    thing = Field(patch.grid, letter.astype(np.complex64), patch.wavelength_um)
    truth = {
        "light_tilt_x_deg": -0.2,
        "light_tilt_y_deg": 0.15,
        "decenter_x_mm": 4e-4,
        "decenter_y_mm": -3e-4,
    }
    bench = SystemState(light=LightErrors((-0.2, 0.15)), pose=Pose(decenter_x_mm=4e-4, decenter_y_mm=-3e-4))
    options = {"engine": "eikonal", "error": 0.1, "exposures": (1.0, 30.0)}
    frames = image(lens, thing, field_stop_mm=side_mm, seed=1, state=bench, **options).frames
    sought = ",".join([*truth, "plane_2_shift_x_um", "plane_2_shift_y_um"])
    settings = {"kind": "amplitude", "error": 0.1, "parameters": sought}
    found = calibrate_frames(lens, frames, verdict="none", patch_mm=side_mm, **settings)
    for name, value, deviation in zip(found.parameters, found.values, found.deviations, strict=True):
        assert abs(value - truth.get(name, 0.0)) < 3.0 * deviation, name
    assert found.object_uncertainty is not None
    moved = displacement_samples(
        found.object_uncertainty.transmission.astype(complex), thing.values, np.ones(thing.values.shape, bool)
    )
    assert moved is not None
    left = found.object_uncertainty.summary
    moved_um = 1e3 * patch.grid.pitch_mm * np.array(moved)
    assert np.all(np.abs(moved_um) < 0.1)
    assert 0.1 < left.position_um["x"] < 3.0
    assert "position of the object" in left.words
    assert left.correlation < 0.9 < left.correlation_without_low_orders


@pytest.mark.parametrize("kind", ["amplitude", "complex"])
def test_a_bench_as_designed_stays_so_and_its_verdict_is_that_of_the_reconstruction(
    lens: Lens, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: Literal["amplitude", "complex"]
) -> None:
    tiles: dict[str, Any] = {"patch_mm": 0.03, "engine": "eikonal", "error": 0.3}
    frames = image(lens, "star", exposures=(1.0, 30.0), pixels=140, **tiles).frames
    found = calibrate_frames(lens, frames, kind=kind, most_mountings=6, **tiles)
    assert found.explained
    assert found.nominal == found.parameters
    assert set(found.undetermined) == (set() if kind == "amplitude" else LIGHT)
    assert found.applied is not None
    assert not any(found.applied.values())
    assert found.deviations is not None
    assert found.covariance is not None
    assert found.typical is not None
    errors = normalized_errors(np.array(found.values), found.covariance, np.array(found.typical))
    assert 0.5 < np.sqrt(np.mean(errors**2)) < 1.6
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(found.as_dict()))
    bench = read_calibration(path, lens)
    judge_quickly(monkeypatch)  # the score test and causes are not compared
    again = reconstruct_frames(lens, frames, kind=kind, calibration=bench, **tiles)
    assert found.over_noise == again.verdict.over_noise


LIGHT = {
    *(f"light_tilt_{axis}_deg" for axis in "xy"),
    *(f"light_phase_{orders}_waves" for orders in ("20", "11", "02")),
    *(f"light_amplitude_{orders}" for orders in ("10", "01", "20", "11", "02")),
}


def test_calibration_and_reconstruction_take_one_kind_of_object_by_default() -> None:
    assert CalibrationSettings().kind == ReconstructionSettings().kind


def test_bench_and_bandwidth_are_found_in_turn() -> None:
    """Light whose band shifts the steepest part of the picture by two speckles, through a decentered lens."""
    lens, patch = scaled(load_design("designs/paper_singlet.toml"), 1 / 64), {"patch_mm": 0.024, "error": 0.1}
    truth = {"decenter_x_mm": 0.004, "bandwidth_nm": 30.0}
    taken = image(
        lens, "star", planes_mm=(0.03, 0.3), exposures=(1.0, 30.0), engine="eikonal", **patch, **truth
    )
    search = {"parameters": "decenter_x_mm", "kind": "amplitude", "iterations": 3, "most_mountings": 6}
    found = calibrate_frames(lens, taken.frames, bandwidth_nm="find", verdict="none", **patch, **search)
    assert found.state.source.bandwidth_nm == pytest.approx(30.0, rel=0.1)
    assert found.state.pose.decenter_x_mm == pytest.approx(0.004, abs=5e-4)
    assert 0.0 < found.source_deviations["bandwidth_nm"] < 3.0
    assert found.as_dict()["state"]["source"] == {"bandwidth_nm": found.state.source.bandwidth_nm}
    settings = {"kind": "amplitude", "iterations": 3, **patch}
    again = reconstruct_frames(lens, taken.frames, calibration=found.state, **settings)
    assert again.of_method["bandwidth_nm"] == found.state.source.bandwidth_nm
    known = taken.target.transmission
    with pytest.raises(InputError, match="known"):
        calibrate_frames(lens, taken.frames, known=known, bandwidth_nm=30.0, **patch)
    with pytest.raises(InputError, match="decenter_z_mm': unknown; allowed"):
        calibrate_frames(lens, taken.frames, known=known, parameters="decenter_z_mm", **patch)
    other = Field(replace(known.grid, pitch_mm=1e-3), known.values, known.wavelength_um)
    with pytest.raises(InputError, match="known object: its grid"):
        calibrate_frames(lens, taken.frames, known=other, **patch)


def test_a_field_stop_is_sought_in_the_light_of_the_source(monkeypatch: pytest.MonkeyPatch) -> None:
    """Light of the width that is coherent over about half of the stop."""
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    patch: dict[str, Any] = {"patch_mm": 0.03, "field_stop_mm": 0.024, "engine": "eikonal", "error": 0.1}
    taken = image(lens, "star", planes_mm=(0.03,), source_deg=1.3, exposures=(1.0, 30.0, 1000.0), **patch)
    misfits: list[float] = []

    def run(self: StopSearch, *given: Any) -> FieldStop:
        stop = FieldStop(0.024, (0.0, 0.0))
        misfits.extend(replace(self, modes=modes).misfit(stop, 25) for modes in (self.modes, ()))
        return stop

    monkeypatch.setattr(StopSearch, "run", run)
    search = {"parameters": "decenter_x_mm", "kind": "amplitude", "iterations": 1, "most_mountings": 1}
    calibrate_frames(lens, taken.frames, source_deg=1.3, field_stop="find", verdict="none", **patch, **search)
    in_its_light, in_coherent_light = misfits
    assert in_its_light < 0.8 * in_coherent_light


QUICK_SEARCH: dict[str, Any] = {
    "parameters": "decenter_x_mm",
    "kind": "amplitude",
    "iterations": 1,
    "most_mountings": 2,
    "patch_mm": 0.03,
    "error": 0.1,
    "verdict": "none",
}


@pytest.fixture(scope="module")
def one_frame() -> tuple[Lens, tuple[Frame, ...]]:
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    return lens, image(lens, "star", patch_mm=0.03, planes_mm=(0.03,), engine="eikonal", error=0.1).frames


def estimating(monkeypatch: pytest.MonkeyPatch, estimates: list[tuple[float, float]]) -> list[Source]:
    """Let searches for the source find widths and deviations in turn; return the sources where they start."""
    starts: list[Source] = []

    def find(engine: Any, light: Field, *given: Any, known: Source) -> FoundSource:
        width_deg, deviation = estimates[len(starts)]
        starts.append(known)
        return FoundSource(Source(width_deg), {"width_deg": deviation}, light)

    monkeypatch.setattr(frame_calibration, "find_source", find)
    return starts


def test_a_source_that_does_not_stay_has_a_warning_and_a_bench_of_its_own(
    one_frame: tuple[Lens, tuple[Frame, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    estimating(monkeypatch, [(0.3, 0.01), (0.6, 0.01), (0.9, 0.01)])
    with pytest.warns(SourceWarning, match=r"from .*0.6° to .*0.9°"):
        found = calibrate_frames(*one_frame, source_deg="find", **QUICK_SEARCH)
    assert found.state.source == Source(0.9)
    assert found.source_deviations == {}
    stated = calibrate_frames(*one_frame, source_deg=0.9, **QUICK_SEARCH)
    assert (found.misfit, found.values) == (stated.misfit, stated.values)


@pytest.mark.parametrize(("bound_deg", "searches"), [(0.2, 3), (0.35, 2)])
def test_a_point_source_stays_where_the_width_before_is_possible(
    one_frame: tuple[Lens, tuple[Frame, ...]],
    monkeypatch: pytest.MonkeyPatch,
    bound_deg: float,
    searches: int,
) -> None:
    """A source of 0.3 deg first, then a point, with the largest width that is still possible."""
    starts = estimating(monkeypatch, [(0.3, 0.01), (0.0, bound_deg), (0.0, bound_deg)])
    found = calibrate_frames(*one_frame, source_deg="find", **QUICK_SEARCH)
    assert found.state.source == Source()
    assert found.source_deviations == {"width_deg": bound_deg}
    assert len(starts) == searches


def test_an_interrupted_search_in_light_of_a_found_source_continues_there(
    one_frame: tuple[Lens, tuple[Frame, ...]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    starts = estimating(monkeypatch, [(0.3, 0.01), (0.3, 0.01)])
    settings = {**QUICK_SEARCH, "source_deg": "find", "folder": tmp_path}
    whole = calibrate_frames(*one_frame, **settings | {"folder": None})
    assert starts == [Source(), Source(0.3)]
    starts.clear()

    def interrupt(what: str, done: int, count: int) -> None:
        if starts and done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match=r"after search 1 .* run the same command"):
        calibrate_frames(*one_frame, progress=interrupt, **settings)
    assert starts == [Source()]
    again = calibrate_frames(*one_frame, **settings)
    assert starts == [Source(), Source(0.3)]
    assert (again.misfit, again.values) == (whole.misfit, whole.values)


def test_the_light_of_empty_frames_has_each_width_of_the_source_that_is_known(
    lens: Lens, empty: tuple[Frame, ...]
) -> None:
    start = SystemState(source=Source(0.1, 0.5))
    found = calibrate_empty(lens, empty, SETTINGS, start=start, bandwidth_nm=0.0)
    assert found.state.source == Source(0.1, 0.0)
    with pytest.raises(InputError, match="bandwidth_nm find: cannot be used with frames without an object"):
        calibrate_empty(lens, empty, SETTINGS, bandwidth_nm="find")


@pytest.mark.usefixtures("quick_verdicts")
def test_the_frames_of_a_phase_object_determine_the_bench_better_than_those_of_a_complex_one(
    lens: Lens,
) -> None:
    true = {"decenter_x_mm": 8e-4, "decenter_y_mm": -5e-4}
    common: dict[str, Any] = {"patch_mm": 0.03, "error": 0.1}
    bench = SystemState(Pose(**true))
    taken = image(lens, "phase", state=bench, exposures=(1.0, 30.0), engine="eikonal", **common)
    settings = CalibrationSettings(parameters=",".join(true), kind="phase", iterations=10, **common)
    found = calibrate_frames(lens, taken.frames, settings)
    assert found.deviations is not None
    for name, value, deviation in zip(found.parameters, found.values, found.deviations, strict=True):
        assert abs(value - true[name]) < 4.0 * deviation, (name, value, deviation)
        assert deviation < 2.5e-5  # 3.3e-5 with a complex object, whose amplitude imitates more of the change
