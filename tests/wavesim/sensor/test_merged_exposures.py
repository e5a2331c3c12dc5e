"""Several exposures of one plane: what they become together, how sure that is, and what is refused."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens, Sensor
from wavesim.fields.field import Field
from wavesim.runtime.threads import BLOCK
from wavesim.sensor.camera_noise import Electronics, SaturationWarning, expose, exposure_seeds
from wavesim.sensor.frame_sets import planes_of_frames, read_frames, recorded_planes
from wavesim.sensor.frames import AssumedWarning, Frame, FrameSettings, write_frame
from wavesim.sensor.merged_exposures import estimate_intensity, fraction_per_intensity, merged_intensity
from wavesim.sensor.sensor import Camera, light_on_pixels, sensor_grid

CAMERA = Electronics(full_well_electrons=10_000.0, read_noise_electrons=2.0, bits=12)
BRACKET = (1.0, 30.0, 1000.0)
# Light over six decades, as of a bright spot on faint light; in electrons of the shortest exposure.
LIGHT = np.tile(np.logspace(-2.0, math.log10(8000.0), 200), (BLOCK + 200, 1))


def frame_of(light: np.ndarray, exposure: float, seed: int | None, distance_mm: float = 2.0) -> Frame:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SaturationWarning)
        counts = expose(light, exposure, CAMERA, seed)
    settings = FrameSettings(
        pixel_pitch_um=3.2,
        plane_distance_mm=distance_mm,
        wavelength_um=0.532,
        exposure=exposure,
        bits=CAMERA.bits,
        offset_counts=CAMERA.offset_counts,
        gain_electrons_per_count=CAMERA.gain,
        read_noise_electrons=CAMERA.read_noise_electrons,
        saturation_counts=CAMERA.saturation_counts,
    )
    return Frame(counts, settings)


def bracket(seed: int | None, times: Sequence[float] = BRACKET) -> list[Frame]:
    return [
        frame_of(LIGHT, time, None if seed is None else seed + number) for number, time in enumerate(times)
    ]


def test_the_merged_intensity_is_unbiased_and_its_variance_that_of_its_error() -> None:
    """Column by column, from a hundredth of an electron to near full well."""
    intensity, variance = merged_intensity(bracket(1))
    known = np.isfinite(variance)
    assert known.all()
    error = (intensity - LIGHT) / np.sqrt(variance.mean(axis=0))
    # Where a long exposure just clips, its low counts alone are kept: away from there all is normal noise.
    expected = LIGHT[0] * np.asarray(BRACKET)[:, None]
    clear = np.all(abs(expected - 10_000.0) > 6.0 * np.sqrt(10_000.0), axis=0)
    assert clear.sum() > 190
    assert np.abs(error.mean(axis=0)[clear]).max() < 4.5 / math.sqrt(len(LIGHT))
    assert np.mean(error[:, clear] ** 2) == pytest.approx(1.0, abs=0.02)
    assert np.abs(error.mean(axis=0)).max() < 1.0


def test_together_exposures_tell_more_than_each_alone() -> None:
    frames = bracket(None)
    _, together = merged_intensity(frames)
    for frame in frames:
        _, alone = estimate_intensity(frame)
        # Rounded counts differ from frame to frame, and variances follow from them.
        assert np.all(together <= 1.1 * alone)
    _, short = estimate_intensity(frames[0])
    assert np.all(short[:, :20] / together[:, :20] > 1e4)


def test_weights_by_each_frame_s_own_counts_would_be_biased() -> None:
    """Repeats of a few electrons: the plain inverse-variance mean comes out too dark, this one does not."""
    light = np.full((400, 400), 9.0)
    repeats = [frame_of(light, 1.0, seed) for seed in range(4)]
    merged, variance = merged_intensity(repeats)
    estimates = [estimate_intensity(frame) for frame in repeats]
    plain = sum(i / v for i, v in estimates) / sum(1.0 / v for _, v in estimates)
    error = math.sqrt(float(variance.mean()) / light.size)
    assert abs(merged.mean() - 9.0) < 4.5 * error
    assert plain.mean() < 9.0 - 30.0 * error


@given(
    st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=4),
    st.lists(st.floats(0.0, 1e5), min_size=1, max_size=12),
)
def test_without_noise_all_is_right_but_for_rounding(times: list[float], levels: list[float]) -> None:
    light = np.asarray([levels])
    frames = [frame_of(light, time, None) for time in times]
    intensity, variance = merged_intensity(frames)
    clipped = np.logical_and.reduce([frame.saturated for frame in frames])
    assert np.array_equal(np.isinf(variance), clipped)
    largest = max(0.5 * CAMERA.gain / time for time in times)
    assert np.all(abs(intensity - light)[~clipped] <= largest * (1.0 + 1e-9))
    # Clipped in all frames: more than is said.
    assert np.all(intensity[clipped] <= light[clipped] + largest)
    for other in (merged_intensity(frames[::-1]), merged_intensity(frames, slice(0, 1))):
        np.testing.assert_allclose(other[0], intensity, rtol=1e-12)
        np.testing.assert_allclose(other[1], variance, rtol=1e-12)


def test_exposures_of_any_unit_do() -> None:
    light = np.array([[100.0, 3000.0]])
    for unit in (1e-100, 1e100):
        frames = [frame_of(light / unit, unit * time, None) for time in (1.0, 3.0)]
        intensity, variance = merged_intensity(frames)
        np.testing.assert_allclose(intensity * unit, light, atol=2.0)
        np.testing.assert_allclose(variance * unit**2, light / 4.0, rtol=0.05)


def test_the_signal_per_intensity_is_that_of_the_longest_exposure_that_is_not_clipped() -> None:
    electrons = CAMERA.top_electrons
    light = np.array([[0.5, 3.0, 100.0, 20_000.0]])
    frames = [frame_of(light, time, None) for time in (1.0, 1000.0)]
    fractions = fraction_per_intensity(frames)[0] * light[0]
    assert fractions[:2] == pytest.approx(1000.0 * light[0, :2] / electrons, rel=0.002)
    assert fractions[2] == pytest.approx(light[0, 2] / electrons)
    assert fractions[3] == 0.0


def test_frames_that_do_not_lie_on_each_other_are_no_plane() -> None:
    with pytest.raises(InputError, match="same size"):
        merged_intensity([frame_of(LIGHT[:10], 1.0, 0), frame_of(LIGHT[:9], 1.0, 0)])
    with pytest.raises(InputError, match="one at least"):
        merged_intensity([])


def test_seeds_of_exposures_differ_and_a_single_one_keeps_the_plane_s() -> None:
    assert exposure_seeds(None, 3) == [None] * 3
    assert exposure_seeds(5, 1) == [5]
    first, second = (expose(LIGHT, 1.0, CAMERA, seed) for seed in exposure_seeds(5, 2))
    assert not np.array_equal(first, second)
    with pytest.raises(InputError, match="seed = -1"):
        exposure_seeds(-1, 2)


def test_recording_several_exposures_is_recording_each_and_long_ones_clip_without_a_word() -> None:
    sensor = Sensor(pixel_pitch_um=3.2, pixels=(40, 32), plane_distances_mm=(2.0,))
    grid = sensor_grid(sensor, 10.0, 2)
    field = Field(grid, np.exp(-((grid.x_mm / 0.02) ** 2 + (grid.y_mm[:, None] / 0.02) ** 2)) + 0j, 0.532)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        light = light_on_pixels(field, sensor, fill_factor=CAMERA.fill_factor)
        frames = Camera(sensor, CAMERA, (1.0, 50.0)).frames(light, 2.0, 0.532, None)
    least = frames[0].settings.exposure
    assert frames[1].settings.exposure == pytest.approx(50.0 * least)
    assert frames[0].saturated.sum() == 0 < frames[1].saturated.sum()
    (one,) = Camera(sensor, CAMERA).frames(light, 2.0, 0.532, 3)
    assert np.array_equal(one.counts, expose(light, least, CAMERA, 3))
    with pytest.warns(SaturationWarning):
        Camera(sensor, CAMERA, peak_fill=2.0).frames(light, 2.0, 0.532, None)
    for exposures in ((), (0.0,), (math.inf,)):
        with pytest.raises(InputError, match="exposures = "):
            Camera(sensor, CAMERA, exposures)
    # In single precision, the light is that of double.
    light = light_on_pixels(field.with_values(field.values.astype(np.complex64)), sensor)
    (single,) = Camera(sensor, CAMERA).frames(light, 2.0, 0.532, None)
    assert abs(single.counts.astype(int) - frames[0].counts).max() <= 1


def write(folder: Path, frames: Sequence[Frame]) -> list[Path]:
    paths = [folder / f"{number}.tif" for number in range(len(frames))]
    for path, frame in zip(paths, frames, strict=True):
        write_frame(frame, path)
    return paths


def read(paths: Sequence[Path]) -> tuple[Frame, ...]:
    return read_frames(paths)


def test_frames_of_a_plane_are_read_together(tmp_path: Path) -> None:
    planes = [frame_of(LIGHT, time, 3, distance) for distance in (6.0, 2.0) for time in (30.0, 1.0)]
    frames = read(write(tmp_path, planes))
    planes = planes_of_frames(frames)
    assert [(plane.distance_mm, plane.exposures) for plane in planes] == [
        (2.0, (1.0, 30.0)),
        (6.0, (1.0, 30.0)),
    ]
    assert all(plane.saturated_share == 0.0 for plane in planes)
    recorded = recorded_planes(frames)
    assert [plane.distance_mm for plane in recorded] == [0.0, 4.0]
    intensity, _ = merged_intensity(frames[:2])
    np.testing.assert_allclose(recorded[0].amplitude, np.sqrt(np.maximum(intensity, 0.0)), rtol=1e-6)
    assert recorded[0].amplitude.dtype == np.float32
    # Faint light is known far better than from the short exposure alone.
    (alone,) = recorded_planes(frames[:1])
    assert alone.sigma is not None
    assert recorded[0].sigma is not None
    assert np.median(alone.sigma[:, :80] / recorded[0].sigma[:, :80]) > 3.0


def test_what_a_lab_s_frames_do_not_say_is_taken_of_the_design_and_told(
    tmp_path: Path, paper_lens: Lens
) -> None:
    paths = [tmp_path / "near.tif", tmp_path / "far.tif"]
    for path in paths:
        Image.fromarray(frame_of(LIGHT, 1.0, 0).counts).save(path)
    asked = {"bits": 16, "offset_counts": 64.0, "gain_electrons_per_count": 1.0, "exposure": (1.0, 1.0)}
    with pytest.raises(InputError, match=r"near\.tif: .*give exposure, bits,"):
        read_frames(paths, lens=paper_lens)
    with pytest.warns(AssumedWarning) as caught:
        frames = read_frames(paths, lens=paper_lens, **asked)
    near, far = paper_lens.sensor.plane_distances_mm
    assert [frame.settings.plane_distance_mm for frame in frames] == [near, far]
    assert {frame.settings.wavelength_um for frame in frames} == {paper_lens.wavelengths_um[0]}
    assert f"plane_distance_mm = {far:g}" in str(caught[1].message)
    assert "far.tif" in str(caught[1].message)
    with pytest.raises(InputError, match=r"near\.tif: .* plane_distance_mm$"):
        read_frames(paths[:1], lens=paper_lens, **asked | {"exposure": (1.0,)})
    colours = paper_lens.model_copy(update={"wavelengths_um": (0.5, 0.6)})
    with pytest.raises(InputError, match=r"give wavelength_um$"):
        read_frames(paths, lens=colours, **asked)


def test_other_pictures_and_wrong_exposures_of_a_plane_are_refused(tmp_path: Path) -> None:
    frame = frame_of(LIGHT, 1.0, 0)
    for other in (
        frame_of(LIGHT[:, ::-1], 1.0, 1),
        frame_of(LIGHT[:, ::-1], 1000.0, 1),
        Frame(frame_of(LIGHT, 0.5, 1).counts, frame.settings),
    ):
        with pytest.raises(InputError, match=r"1\.tif.*plane_distance_mm = 2, .*different"):
            read(write(tmp_path, [frame, other]))
    for same in (frame_of(LIGHT, 1.0, 1), frame_of(1.03 * LIGHT, 30.0, 1), frame_of(LIGHT, 1e3, 1)):
        assert len(read(write(tmp_path, [frame, same]))) == 2
    paths = write(tmp_path, [frame])
    with pytest.raises(InputError, match=r"0\.tif: .*twice"):
        read([*paths, *paths])


def test_saturation_counts_where_all_frames_of_a_plane_are_clipped(tmp_path: Path) -> None:
    spot = np.full((100, 100), 5.0)
    spot[:10, :10] = 4000.0
    short, long = frame_of(spot, 1.0, 0), frame_of(spot, 100.0, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(write(tmp_path, [short, long]))
    with pytest.warns(SaturationWarning, match="1 % of the pixels"):
        read(write(tmp_path, [long]))
    spot[:20, :20] = 4000.0
    longer = [frame_of(spot, time, 2) for time in (50.0, 100.0)]
    with pytest.raises(InputError, match=r"4 % of the pixels .*each"):
        read(write(tmp_path, longer))
