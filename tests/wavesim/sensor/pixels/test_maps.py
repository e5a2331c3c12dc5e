"""Maps of pixels: read, applied, and refused where they cannot be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lensdesign.errors import InputError
from lensdesign.lens.lens import Sensor
from wavesim.sensor.camera_noise import Electronics
from wavesim.sensor.frame_sets import BadPixelWarning, ExposureWarning, read_frames
from wavesim.sensor.frames import write_frame
from wavesim.sensor.merged_exposures import estimate_intensity
from wavesim.sensor.pixels.maps import read_map
from wavesim.sensor.pixels.non_uniformity import PixelErrors
from wavesim.sensor.sensor import Camera

SHAPE = (60, 80)
SENSOR = Sensor(pixel_pitch_um=3.0, pixels=SHAPE[::-1], plane_distances_mm=(1.0,))
ERRORS = PixelErrors(prnu=0.1, dsnu_electrons=30.0, seed=2)
LIGHT = np.linspace(0.3, 1.0, SHAPE[1]) * np.ones(SHAPE)


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """Frames of a ramp by pixels that are not alike; a flat and a dark frame of them."""
    pattern = ERRORS.pattern(SHAPE, 1e4)
    electronics = Electronics(bits=16)
    for number, (intensity, times) in enumerate(((LIGHT, (0.5, 1.0)), (np.ones(SHAPE), (1.0,)))):
        camera = Camera(SENSOR, electronics, times, 0.5, pixel_errors=ERRORS)
        frames = camera.frames(intensity, 1.0, 0.5, None)
        for place, frame in enumerate(frames):
            write_frame(frame, tmp_path / f"{('frame', 'flat')[number]}_{place}.tif")
    assert pattern is not None
    np.save(tmp_path / "dark.npy", 64.0 + pattern.dark_electrons / electronics.gain)
    return tmp_path


def frames_of(lab: Path) -> list[Path]:
    return [lab / "frame_0.tif", lab / "frame_1.tif"]


def test_flat_and_dark_take_out_what_pixels_make_of_the_light(lab: Path) -> None:
    plain = read_frames(frames_of(lab))
    mended = read_frames(frames_of(lab), flat=lab / "flat_0.tif", dark=lab / "dark.npy")
    for before, after in zip(plain, mended, strict=True):
        errors = [
            np.std(estimate_intensity(frame)[0] / LIGHT) / np.mean(estimate_intensity(frame)[0] / LIGHT)
            for frame in (before, after)
        ]
        assert errors[0] > 0.08
        assert errors[1] < 1e-3


def test_bad_pixels_tell_nothing(lab: Path) -> None:
    bad = np.zeros(SHAPE, np.uint8)
    bad[10, 20] = 255
    Image.fromarray(bad).save(lab / "bad.png")
    frame = read_frames(frames_of(lab), bad_pixels=lab / "bad.png")[0]
    variance = estimate_intensity(frame)[1]
    assert np.isinf(variance[10, 20])
    assert np.count_nonzero(np.isinf(variance)) == 1


def test_a_hot_pixel_is_told_and_left_out(lab: Path) -> None:
    for path in frames_of(lab):
        frame = read_frames([path])[0]
        frame.counts[30, 40] = 65_000
        write_frame(frame, path)
    with pytest.warns(BadPixelWarning, match="plane at 1 mm: 1 pixels"):
        frames = read_frames(frames_of(lab), dark=lab / "dark.npy")
    assert all(np.isinf(estimate_intensity(frame)[1][30, 40]) for frame in frames)


def test_an_exposure_that_is_not_as_stated_is_told_and_taken_out(tmp_path: Path) -> None:
    camera = Camera(SENSOR, Electronics(bits=16), (0.05, 1.0), exposure_errors=(0.0, 0.04))
    frames = camera.frames(LIGHT, 1.0, 0.5, 3)
    paths = [tmp_path / "short.tif", tmp_path / "long.tif"]
    for path, frame in zip(paths, frames, strict=True):
        write_frame(frame, path)
    with pytest.warns(ExposureWarning, match=r"long\.tif.*\+(3.9|4|4.1) % brighter"):
        short, long = read_frames(paths)
    assert long.settings.exposure / short.settings.exposure == pytest.approx(20.0 * 1.04, rel=3e-3)


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("flat", np.zeros(SHAPE), "show no light beyond the dark count"),
        ("flat", np.full((60, 81), 1000.0), r"81 x 60 pixels.*80 x 60"),
        ("dark", np.full(SHAPE, 6e4), "must be a picture without light"),
        ("bad_pixels", np.ones(SHAPE), "marks 100 % of the pixels as bad"),
        ("bad_pixels", np.zeros((6, 8)), "must be a map of the same pixels"),
        ("flat", np.full(SHAPE, np.nan), "of finite numbers"),
    ],
)
def test_maps_that_cannot_be_are_refused(lab: Path, name: str, values: np.ndarray, said: str) -> None:
    np.save(lab / "map.npy", values)
    with pytest.raises(InputError, match=said) as refused:
        read_frames(frames_of(lab), **{name: lab / "map.npy"})
    assert "map.npy" in str(refused.value)


def test_a_file_that_is_no_map_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(InputError, match="cannot read the map"):
        read_map(tmp_path / "text.png")
    with pytest.raises(InputError):
        read_map(tmp_path / "none.npy")
