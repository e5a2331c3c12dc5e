"""Frames on disk: bit-exact round trips, cameras' own files, and files that are damaged or foreign."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

from lensdesign.errors import InputError
from wavesim.sensor.frames import Frame, FrameSettings, read_frame, write_frame

GIVEN: dict[str, Any] = {
    "pixel_pitch_um": 3.2,
    "plane_distance_mm": 3.0,
    "wavelength_um": 0.532,
    "exposure": 0.01,
    "bits": 12,
    "offset_counts": 16.0,
    "gain_electrons_per_count": 2.5,
}
COUNTS = np.arange(35, dtype=np.uint16).reshape(5, 7) * 117


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, exclude_min=True)


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    bits = draw(st.integers(1, 16))
    shape = draw(arrays.array_shapes(min_dims=2, max_dims=2, max_side=9))
    counts = draw(arrays.arrays(np.uint16, shape, elements=st.integers(0, 2**bits - 1)))
    said = FrameSettings(
        pixel_pitch_um=draw(numbers(1e-60, 1e9)),
        plane_distance_mm=draw(st.floats(allow_nan=False, allow_infinity=False)),
        wavelength_um=draw(numbers(1e-60, 1e9)),
        exposure=draw(numbers(1e-150, 1e150)),
        bits=bits,
        offset_counts=draw(st.floats(0.0, 2**bits - 1)),
        gain_electrons_per_count=draw(numbers(1e-60, 1e9)),
        read_noise_electrons=draw(st.floats(0.0, 1e9)),
        saturation_counts=draw(st.none() | st.integers(1, 2**bits - 1)),
        title=draw(st.text(st.characters(codec="utf-8"))),
    )
    return Frame(counts, said)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("frames") / "frame.tif"


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(frame=frames())
def test_a_frame_comes_back_bit_for_bit(place: Path, frame: Frame) -> None:
    write_frame(frame, place)
    back = read_frame(place)
    np.testing.assert_array_equal(back.counts, frame.counts)
    assert back.counts.dtype == np.uint16
    assert back.settings == frame.settings


def test_other_programs_see_a_16_bit_grey_picture_with_its_pitch(place: Path) -> None:
    write_frame(Frame(COUNTS, FrameSettings(**GIVEN)), place)
    with Image.open(place) as image:
        tags: Any = image.tag_v2  # type: ignore[attr-defined]
        assert (image.mode, image.size, tags[258], tags[262]) == ("I;16", (7, 5), (16,), 1)
        assert (tags[296], float(tags[282])) == (3, pytest.approx(1e4 / 3.2))
        assert json.loads(tags[270])["transferlens_frame"]["bits"] == 12


def test_writing_replaces_whole_files_or_nothing(tmp_path: Path) -> None:
    frame = Frame(COUNTS, FrameSettings(**GIVEN))
    path = tmp_path / "new" / "frame.tiff"
    write_frame(frame, path)
    write_frame(frame, path)
    assert [p.name for p in path.parent.iterdir()] == ["frame.tiff"]
    with pytest.raises(InputError, match="it is a folder"):
        write_frame(frame, path.parent)


@pytest.mark.parametrize("kind", ["<u2", ">u2", "u1"])
@pytest.mark.parametrize("compression", [None, "tiff_adobe_deflate", "tiff_lzw"])
def test_a_camera_file_needs_its_settings_given(tmp_path: Path, kind: str, compression: str | None) -> None:
    path = tmp_path / "camera.tif"
    counts = (COUNTS % 250).astype(kind)
    Image.fromarray(counts).save(path, compression=compression, description="Camera 12 {not ours}")
    with pytest.raises(InputError, match=r"camera\.tif.*: .*plane_distance_mm, wavelength_um, exposure"):
        read_frame(path, bits=12, pixel_pitch_um=3.2, offset_counts=0.0, gain_electrons_per_count=1.0)
    frame = read_frame(path, **GIVEN)
    np.testing.assert_array_equal(frame.counts, counts)
    assert frame.settings == FrameSettings(**GIVEN)


def test_settings_that_are_given_come_before_the_file(place: Path) -> None:
    write_frame(Frame(COUNTS, FrameSettings(**GIVEN)), place)
    assert read_frame(place, plane_distance_mm=23.0).settings.plane_distance_mm == 23.0


def test_counts_in_the_upper_bits_are_told_from_wrong_ones(tmp_path: Path) -> None:
    path = tmp_path / "shifted.tif"
    Image.fromarray(COUNTS * 16).save(path)
    with pytest.raises(InputError, match=r"shifted\.tif: .*bits = 12.*4095.*multiples of 16"):
        read_frame(path, **GIVEN)
    Image.fromarray(COUNTS * 15).save(path)
    with pytest.raises(InputError, match=r"bits = 12 allows 4095$"):
        read_frame(path, **GIVEN)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"bits": 17}, "bits"),
        ({"bits": 2, "offset_counts": 4.0}, "offset_counts = 4: .* 3 at 2 bits"),
        ({"saturation_counts": 4096}, "saturation_counts = 4096: .* 4095 at 12 bits"),
        ({"wavelength_um": -1.0}, "wavelength_um"),
        ({"exposure": float("nan")}, "exposure"),
        ({"wavelenght_um": 0.5}, "wavelenght_um: .*did you mean wavelength_um"),
    ],
)
def test_settings_that_are_not_allowed_are_named(place: Path, changes: dict[str, Any], words: str) -> None:
    write_frame(Frame(COUNTS, FrameSettings(**GIVEN)), place)
    with pytest.raises(InputError, match=rf"frame\.tif: .*{words}"):
        read_frame(place, **changes)


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        (COUNTS.astype(float), "float64"),
        (COUNTS[0], "shape"),
        (COUNTS[:0], "shape"),
        (COUNTS + np.uint16(4095), "bits = 12 allows 4095"),
    ],
)
def test_counts_that_are_no_frame_are_refused(counts: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        Frame(counts, FrameSettings(**GIVEN))


def foreign(path: Path, kind: str) -> None:
    grey = Image.fromarray(COUNTS)
    if kind == "colour":
        Image.new("RGB", (4, 4)).save(path)
    elif kind == "float":
        Image.fromarray(COUNTS.astype(np.float32)).save(path)
    elif kind == "signed":
        Image.fromarray(COUNTS.astype(np.int32)).save(path)
    elif kind == "stack":
        grey.save(path, save_all=True, append_images=[grey])
    elif kind == "negative":
        grey.save(path, tiffinfo={262: 0})
    elif kind == "jpeg":
        Image.new("L", (4, 4)).save(path, format="JPEG")
    elif kind == "colour png":
        Image.new("RGB", (4, 4)).save(path, format="PNG")
    else:
        path.write_bytes(b"" if kind == "empty" else b"no picture at all")


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("colour", "a TIFF, colours, samples of 8 bits: must be grey"),
        ("float", "floating-point numbers: must be grey"),
        ("signed", "numbers with a sign: must be grey"),
        ("stack", "contains 2 pictures"),
        ("negative", "white is zero"),
        ("jpeg", "not a TIFF or PNG picture"),
        ("empty", "not a TIFF or PNG picture"),
        ("text", "not a TIFF or PNG picture"),
        ("colour png", "a PNG, colours, samples of 8 bits: must be grey"),
    ],
)
def test_foreign_files_are_refused_by_what_they_are(tmp_path: Path, kind: str, words: str) -> None:
    path = tmp_path / "foreign.tif"
    foreign(path, kind)
    with pytest.raises(InputError, match=rf"foreign\.tif: .*{words}"):
        read_frame(path, **GIVEN)


def test_a_png_is_read_as_it_stands(tmp_path: Path) -> None:
    Image.fromarray(COUNTS).save(tmp_path / "frame.png")
    read = read_frame(tmp_path / "frame.png", **GIVEN)
    np.testing.assert_array_equal(read.counts, COUNTS)


def written(path: Path) -> bytes:
    write_frame(Frame(COUNTS, FrameSettings(**GIVEN, title="a title")), path)
    return path.read_bytes()


def test_a_file_cut_short_anywhere_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cut.tif"
    whole = written(path)
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"cut\.tif"):
            read_frame(path)


def test_a_byte_changed_anywhere_gives_a_frame_or_one_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "changed.tif"
    whole = written(path)
    random = np.random.default_rng(0)
    refused = []
    for place in range(len(whole)):
        for value in {0, 255, int(random.integers(256))}:
            path.write_bytes(whole[:place] + bytes([value]) + whole[place + 1 :])
            try:
                read_frame(path)
            except InputError as error:
                refused.append(str(error))
    assert len(refused) > 100
    assert all("changed.tif" in message for message in refused)


def test_damaged_settings_are_told_from_absent_ones(tmp_path: Path) -> None:
    path = tmp_path / "damaged.tif"
    for text in ('{"transferlens_frame": {', '{"transferlens_frame": 3}', '["transferlens_frame"]'):
        Image.fromarray(COUNTS).save(path, description=text)
        with pytest.raises(InputError, match=r"damaged\.tif: .*ImageDescription"):
            read_frame(path, **GIVEN)
