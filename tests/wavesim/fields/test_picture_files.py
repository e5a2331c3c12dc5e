"""Pictures in files: orientation, white that is zero, several pages, files that hold less than they state."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from lensdesign.errors import InputError
from wavesim.fields.picture_files import PictureFile, upright
from wavesim.sensor.frames import read_frame
from wavesim.sensor.pixels.maps import read_map
from wavesim.targets.patterns import read_grey

GOLDEN = Path("tests/golden/files")
STATED = {
    "plane_distance_mm": 1.0,
    "exposure": 1.0,
    "pixel_pitch_um": 3.2,
    "wavelength_um": 0.532,
    "bits": 16,
    "offset_counts": 0.0,
    "gain_electrons_per_count": 1.0,
    "read_noise_electrons": 1.0,
}


def random_picture(dtype: type = np.uint16) -> np.ndarray:
    return np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (24, 37)).astype(dtype)


def test_a_tiff_that_lies_on_its_side_is_turned() -> None:
    stored = np.load(GOLDEN / "tiff_orientation_grey" / "ref.npy")
    grey = read_grey(GOLDEN / "tiff_orientation_grey" / "orient6.tif")
    np.testing.assert_allclose(grey, np.rot90(stored, -1) / 65535.0)


def test_a_map_that_is_transposed_is_turned() -> None:
    stored = np.load(GOLDEN / "tiff_orientation_map" / "ref.npy")
    np.testing.assert_array_equal(read_map(GOLDEN / "tiff_orientation_map" / "orient5.tif"), stored.T)


def test_exif_turns_a_png() -> None:
    turned, plain = (read_grey(GOLDEN / "exif_object" / f"L_{name}.png") for name in ("exif6", "plain"))
    np.testing.assert_allclose(turned, plain)


def test_white_that_is_zero_looks_as_in_a_viewer() -> None:
    folder = GOLDEN / "white_is_zero_object"
    black = read_grey(folder / "L_black0.tif")
    np.testing.assert_allclose(read_grey(folder / "L_white0.tif"), black)
    np.testing.assert_allclose(read_grey(folder / "L8_white0.tif"), black, atol=1 / 255)


def test_a_stack_of_darks_is_averaged_and_one_of_frames_refused() -> None:
    path = GOLDEN / "dark_stack" / "pages.tif"
    np.testing.assert_allclose(read_map(path), tifffile.imread(path).mean(axis=0))
    with pytest.raises(InputError, match="contains 3 pictures"):
        read_map(path, several=False)
    with pytest.raises(InputError, match="contains 3 pictures"):
        read_frame(path, **STATED)


@pytest.mark.parametrize("name", ["imagej_trunc.tif", "imagej_full.tif"])
def test_a_stack_of_imagej_with_one_directory_is_a_stack(name: str) -> None:
    with pytest.raises(InputError, match="contains 3 pictures"):
        read_frame(GOLDEN / "imagej_one_ifd" / name, **STATED)


def test_a_stack_that_states_more_pictures_than_it_contains_is_refused(tmp_path: Path) -> None:
    one = random_picture()
    text = "ImageJ=1.11a\nimages=3\nslices=3\n"
    tifffile.imwrite(tmp_path / "a.tif", one, description=text, metadata=None)
    with pytest.raises(InputError, match=r"a\.tif: is damaged: its metadata contradict its pictures"):
        read_map(tmp_path / "a.tif")


def test_a_volume_is_a_stack(tmp_path: Path) -> None:
    stack = np.stack([random_picture(), random_picture()[::-1]])
    layout = {"volumetric": True, "tile": (16, 16, 16), "photometric": "minisblack"}
    tifffile.imwrite(tmp_path / "a.tif", stack, compression="zlib", **layout)
    np.testing.assert_allclose(read_map(tmp_path / "a.tif"), stack.mean(axis=0))


def test_a_shaped_file_of_three_pictures_is_a_stack(tmp_path: Path) -> None:
    stack = np.stack([random_picture()] * 3)
    tifffile.imwrite(tmp_path / "a.tif", stack, photometric="minisblack")
    assert PictureFile(tmp_path / "a.tif").count == 3
    np.testing.assert_allclose(read_map(tmp_path / "a.tif"), stack.mean(axis=0))


@pytest.mark.filterwarnings("ignore:<tifffile")
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("metadata", [{}, None])
def test_a_stack_is_the_same_stack_for_any_number_of_pictures(
    tmp_path: Path, count: int, dtype: type, metadata: dict[str, str] | None
) -> None:
    """tifffile stores three or four pictures as planes of colours, and other numbers as pages."""
    stack = np.stack([random_picture(np.uint8) + np.uint8(n) for n in range(count)]).astype(dtype)
    tifffile.imwrite(tmp_path / "a.tif", stack, metadata=metadata)
    assert PictureFile(tmp_path / "a.tif").count == count
    np.testing.assert_allclose(read_map(tmp_path / "a.tif"), stack.mean(axis=0), rtol=1e-6)
    for index in range(count):
        np.testing.assert_array_equal(PictureFile(tmp_path / "a.tif").picture(index).values, stack[index])
    if count > 1:
        for read in (
            read_grey,
            lambda path: read_map(path, several=False),
            lambda path: read_frame(path, **STATED),
        ):
            with pytest.raises(InputError, match=f"contains {count} pictures"):
                read(tmp_path / "a.tif")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("planarconfig", ["contig", "separate"])
@pytest.mark.parametrize("alpha", [False, True])
def test_colours_of_other_programs_are_one_picture(
    tmp_path: Path, dtype: type, planarconfig: str, alpha: bool
) -> None:
    full_scale = np.iinfo(dtype).max
    colours = np.stack([random_picture(dtype), random_picture(dtype)[::-1], random_picture(dtype)[:, ::-1]])
    stored = np.concatenate([colours, np.full((1, 24, 37), full_scale, dtype)]) if alpha else colours
    tifffile.imwrite(
        tmp_path / "a.tif",
        stored if planarconfig == "separate" else np.moveaxis(stored, 0, -1),
        photometric="rgb",
        planarconfig=planarconfig,
        extrasamples=["unassalpha"] if alpha else None,
        metadata=None,
        software="camera 1.0",
    )
    luma = np.tensordot([0.299, 0.587, 0.114], colours.astype(float), 1) / full_scale
    np.testing.assert_allclose(read_grey(tmp_path / "a.tif"), luma, atol=1.0 / full_scale)
    for channel in range(3):
        np.testing.assert_array_equal(read_grey(tmp_path / "a.tif", channel), colours[channel] / full_scale)
    with pytest.raises(InputError, match="must be one grey picture"):
        read_map(tmp_path / "a.tif")


@pytest.mark.parametrize("compression", ["zlib", "lzw", "packbits", "lzma", "zstd"])
@pytest.mark.parametrize("byteorder", ["<", ">"])
@pytest.mark.parametrize("predictor", [False, True])
def test_compressed_tiffs_in_both_byte_orders(
    tmp_path: Path, compression: str, byteorder: str, predictor: bool
) -> None:
    stored = random_picture()
    predictor = predictor and compression != "packbits"
    layout = {"byteorder": byteorder, "predictor": predictor, "rowsperstrip": 7, "metadata": None}
    tifffile.imwrite(tmp_path / "a.tif", stored, compression=compression, **layout)
    np.testing.assert_array_equal(read_map(tmp_path / "a.tif"), stored)


def test_twelve_bits_and_palettes_and_jpegs_in_tiffs(tmp_path: Path) -> None:
    stored = random_picture(np.uint16) >> 4
    tifffile.imwrite(tmp_path / "a.tif", stored, bitspersample=12, metadata=None)
    np.testing.assert_allclose(read_grey(tmp_path / "a.tif"), stored / 4095.0)
    image = Image.fromarray(random_picture(np.uint8))
    image.convert("P").save(tmp_path / "p.tif")
    np.testing.assert_allclose(read_grey(tmp_path / "p.tif"), np.asarray(image) / 255.0, atol=0.5 / 255)
    image.save(tmp_path / "j.tif", compression="jpeg")
    with Image.open(tmp_path / "j.tif") as seen:
        np.testing.assert_allclose(read_grey(tmp_path / "j.tif"), np.asarray(seen) / 255.0, atol=2.5 / 255)


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
def test_pictures_with_too_many_pixels_are_refused_before_they_are_decoded(tmp_path: Path, name: str) -> None:
    Image.new("1", (20_000, 8_400)).save(
        tmp_path / name, **({"compression": "group4"} if name == "a.tif" else {})
    )
    assert (tmp_path / name).stat().st_size < 200_000
    with pytest.raises(InputError, match="states 20000 x 8400 pixels; at most 134217728 pixels are read"):
        read_grey(tmp_path / name)


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_a_tiff_that_is_cut_short_is_refused(tmp_path: Path, compression: str | None) -> None:
    tifffile.imwrite(tmp_path / "a.tif", random_picture(), compression=compression, metadata=None)
    content = (tmp_path / "a.tif").read_bytes()
    for kept in (len(content) - 1, len(content) - 400, 300, 9):
        (tmp_path / "a.tif").write_bytes(content[:kept])
        with pytest.raises(InputError, match=r"a\.tif: "):
            read_map(tmp_path / "a.tif")


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("photometric", ["minisblack", "miniswhite"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_tiffs_of_all_orientations(tmp_path: Path, orientation: int, photometric: str, dtype: type) -> None:
    stored, path = random_picture(dtype), tmp_path / "a.tif"
    for tile, compression in ((None, None), ((16, 16), "zlib")):
        tags = [(274, "H", 1, orientation, True)]
        layout = {"tile": tile, "compression": compression, "extratags": tags}
        tifffile.imwrite(path, stored, photometric=photometric, metadata=None, **layout)
        grey = upright(stored, orientation) / np.iinfo(dtype).max
        np.testing.assert_allclose(read_grey(path), grey if photometric == "minisblack" else 1.0 - grey)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["png", "jpg"])
def test_exif_of_all_orientations_as_another_library_reads_it(
    tmp_path: Path, orientation: int, kind: str
) -> None:
    exif, path = Image.Exif(), tmp_path / f"a.{kind}"
    exif[274] = orientation
    Image.fromarray(random_picture(np.uint8)).save(path, exif=exif)
    with Image.open(path) as image:
        seen = np.asarray(ImageOps.exif_transpose(image)) / 255.0
    np.testing.assert_allclose(read_grey(path), seen)


def test_a_frame_in_which_white_is_zero_is_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", random_picture(), photometric="miniswhite", metadata=None)
    with pytest.raises(InputError, match="white is zero"):
        read_frame(tmp_path / "a.tif", **STATED)


def test_palette_indices_are_no_counts(tmp_path: Path) -> None:
    image = Image.fromarray(random_picture(np.uint8)).convert("P")
    image.save(tmp_path / "a.png")
    with pytest.raises(InputError, match="must be grey"):
        read_frame(tmp_path / "a.png", **STATED)
    with pytest.raises(InputError, match="grey"):
        read_map(tmp_path / "a.png")
