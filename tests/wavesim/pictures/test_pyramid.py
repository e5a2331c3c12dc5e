"""Pictures in tiles with halvings: what they hold, and that viewers' readers take them."""

from __future__ import annotations

import json
import tracemalloc
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from lensdesign.errors import InputError
from wavesim import Field, Grid, write_pyramid
from wavesim.pictures import pyramid
from wavesim.pictures.field_files import read_field, write_field, write_tiff
from wavesim.pictures.pyramid import KEY, STRIP, halved, picture_levels

OME = "{http://www.openmicroscopy.org/Schemas/OME/2016-06}"


def some_field(rows: int, columns: int, seed: int = 0) -> Any:
    """Complex values of all phases."""
    rng = np.random.default_rng(seed)
    parts = rng.standard_normal((2, rows, columns)).astype(np.float32)
    return (parts[0] + 1j * parts[1]).astype(np.complex64)


def means(values: Any) -> Any:
    """Means over 2 x 2, one by one."""
    rows, columns = values.shape
    return np.array(
        [[values[y : y + 2, x : x + 2].mean() for x in range(0, columns, 2)] for y in range(0, rows, 2)]
    )


@given(rows=st.integers(1, 9), columns=st.integers(1, 9), seed=st.integers(0, 99))
def test_halves_are_means_of_what_is_there(rows: int, columns: int, seed: int) -> None:
    values = some_field(rows, columns, seed)
    assert halved(values) == pytest.approx(means(values), rel=1e-5, abs=1e-6)
    assert halved(values, np.abs) == pytest.approx(means(np.abs(values)), rel=1e-5)
    assert (halved(values).dtype, halved(values, np.abs).dtype) == (np.complex64, np.float32)


@pytest.mark.parametrize("rows", [2 * STRIP - 1, 2 * STRIP, 2 * STRIP + 1])
def test_strips_leave_no_trace(rows: int) -> None:
    values = some_field(rows, 3)
    assert halved(values) == pytest.approx(means(values), rel=1e-5, abs=1e-6)


def test_phases_are_halved_as_complex_numbers() -> None:
    turn = np.where(np.indices((4, 4)).sum(axis=0) % 2, 3.0, -3.0)
    for values in (np.exp(1j * turn), turn):
        level = picture_levels(values, "phase_rad", least=2)[1]
        assert np.abs(level.shown(level.kept)) == pytest.approx(np.pi, abs=1e-5)
    # A dark sample's phase does not count.
    half_dark = np.array([[1e-9j, 1e-9j], [1.0, 1.0]])
    level = picture_levels(half_dark, "phase_rad", least=1)[1]
    assert level.shown(level.kept) == pytest.approx(0.0, abs=1e-6)
    # The moduli of opposite phases do not cancel.
    level = picture_levels(np.exp(1j * np.array([[0.0, np.pi]] * 2)), "amplitude", least=1)[1]
    assert level.shown(level.kept) == pytest.approx(1.0)


@pytest.mark.parametrize("shape", [(1, 1), (512, 512), (700, 1301)])
def test_a_file_holds_the_field_and_its_halvings(shape: tuple[int, int], tmp_path: Path) -> None:
    values = some_field(*shape)
    path = tmp_path / "new" / "field.ome.tif"
    write_pyramid(path, values, 0.425, wavelength_um=0.532)
    assert [p.name for p in path.parent.iterdir()] == ["field.ome.tif"]
    with tifffile.TiffFile(path) as file:
        series = file.series[0]
        assert file.is_ome
        assert not file.is_bigtiff
        assert np.array_equal(series.asarray().reshape(2, *shape), [np.abs(values), np.angle(values)])
        amplitude, field = np.abs(values), values
        for level in series.levels[1:]:
            amplitude, field = halved(amplitude), halved(field)
            found = level.asarray()
            assert found[0] == pytest.approx(amplitude)
            assert found[1] == pytest.approx(np.angle(field))
        assert max(amplitude.shape) <= 512
        page: Any = file.pages[0]
        assert (page.is_tiled, page.tile, page.compression.name) == (True, (512, 512), "ADOBE_DEFLATE")
        description = page.description
    tree = ElementTree.fromstring(description)
    pixels = tree.find(f"{OME}Image/{OME}Pixels")
    assert pixels is not None
    assert [pixels.attrib[f"PhysicalSize{axis}"] for axis in "XY"] == ["0.425", "0.425"]
    assert pixels.attrib["PhysicalSizeXUnit"] == "µm"
    names = [channel.attrib["Name"] for channel in pixels.iter(f"{OME}Channel")]
    assert names == ["amplitude", "phase_rad"]
    said = json.loads(tree.findtext(f"{OME}Image/{OME}Description") or "")[KEY]
    assert said == {"quantities": names, "pitch_um": 0.425, "wavelength_um": 0.532}


def test_pillow_reads_one_quantity(tmp_path: Path) -> None:
    values = np.abs(some_field(600, 531))
    write_tiff(tmp_path / "amplitude.tif", values, 0.4, quantity="amplitude")
    with Image.open(tmp_path / "amplitude.tif") as picture:
        assert (picture.mode, picture.size, picture.n_frames) == ("F", (531, 600), 1)  # type: ignore[attr-defined]
        assert np.array_equal(np.array(picture), values)
        assert float(picture.info["dpi"][0]) == pytest.approx(2.54 * 1e4 / 0.4)


def test_the_same_values_give_the_same_file(tmp_path: Path) -> None:
    for name in "ab":
        write_pyramid(tmp_path / name, some_field(80, 90), 0.4)
    write_pyramid(tmp_path / "c", some_field(80, 90, seed=1), 0.4)
    first, again, other = ((tmp_path / name).read_bytes() for name in "abc")
    assert first == again
    assert first != other


def test_many_samples_make_a_big_tiff(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = some_field(700, 600)
    samples = 700 * 600 + 350 * 300
    for most, big in ((8 * samples, False), (8 * samples - 1, True)):
        monkeypatch.setattr(pyramid, "CLASSIC_BYTES", most)
        write_pyramid(tmp_path / "field.tif", values, 0.4)
        with tifffile.TiffFile(tmp_path / "field.tif") as file:
            assert file.is_bigtiff is big
            assert np.array_equal(file.series[0].asarray()[0], np.abs(values))


def test_writing_takes_less_than_the_field_itself(tmp_path: Path) -> None:
    values = np.zeros((5000, 4000), np.complex64)
    tracemalloc.start()
    write_pyramid(tmp_path / "field.tif", values, 0.4)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < values.nbytes


@pytest.mark.parametrize(
    ("values", "pitch_um", "quantities", "words"),
    [
        (np.zeros(3), 1.0, ["amplitude"], r"shape \(3,\): must be real or complex \(ny, nx\)"),
        (np.zeros((0, 3)), 1.0, ["amplitude"], "must be real or complex"),
        (np.array([["a"]]), 1.0, ["amplitude"], "must be real or complex"),
        (np.zeros((3, 3)), 0.0, ["amplitude"], r"pitch_um = 0\.0: must be finite"),
        (np.zeros((3, 3)), np.nan, ["amplitude"], "pitch_um = nan"),
        (np.zeros((3, 3)), 1.0, [], "must be one or more"),
        (np.zeros((3, 3)), 1.0, ["a", "a"], "and differ"),
        (np.zeros((3, 3), complex), 1.0, ["electrons"], "allowed: amplitude, phase_rad"),
    ],
)
def test_what_is_no_picture_is_refused(
    values: Any, pitch_um: float, quantities: list[str], words: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=words):
        write_pyramid(tmp_path / "field.tif", values, pitch_um, quantities)
    assert not list(tmp_path.iterdir())


def test_a_failure_leaves_what_stood_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "field.tif"
    path.write_text("before")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tifffile.TiffWriter, "write", full)
    with pytest.raises(InputError, match=r"cannot write .*field\.tif: No space left"):
        write_pyramid(path, np.ones((3, 3)), 1.0, ["amplitude"])
    assert [p.name for p in tmp_path.iterdir()] == ["field.tif"]
    assert path.read_text() == "before"


@settings(max_examples=20)
@given(rows=st.integers(1, 20), columns=st.integers(1, 20))
def test_fields_come_back_as_written(
    tmp_path_factory: pytest.TempPathFactory, rows: int, columns: int
) -> None:
    path, values = tmp_path_factory.mktemp("field") / "field.npz", some_field(rows, columns)
    write_field(path, Field(Grid((rows, columns), 4e-4, 0.0), values, 0.532), field_stop_mm=0.1)
    found, pitch_um = read_field(path)
    assert np.array_equal(found, values)
    assert pitch_um == pytest.approx(0.4)


def test_files_that_hold_no_field_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "field.npz"
    good = {"values": np.ones((4, 4), np.complex64), "pitch_um": 0.4}
    for change, words in (
        ({"values": np.ones(4)}, r"shape \(4,\): must be complex or real, \(ny, nx\)"),
        ({"values": np.array([["a"]])}, "must be complex or real"),
        ({"values": np.full((4, 4), np.nan)}, "not finite"),
        ({"pitch_um": 0.0}, "`pitch_um` must be one number"),
        ({"pitch_um": [1.0, 2.0]}, "`pitch_um` must be one number"),
        ({"pitch_um": "wide"}, "`pitch_um` must be one number"),
    ):
        np.savez(path, **{**good, **change})  # type: ignore[arg-type]
        with pytest.raises(InputError, match=rf"field .*field\.npz.*{words}"):
            read_field(path)
    np.savez(path, values=good["values"])  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"has no pitch_um; it holds \['values'\]"):
        read_field(path)
    np.savez(path, **good)  # type: ignore[arg-type]
    data = path.read_bytes()
    for cut in (0, 10, len(data) // 2, len(data) - 10):
        path.write_bytes(data[:cut])
        with pytest.raises(InputError, match=r"cannot read the field .*field\.npz"):
            read_field(path)
    path.write_bytes(data[:70] + bytes(40) + data[110:])
    with pytest.raises(InputError, match=r"cannot read the field .*field\.npz"):
        read_field(path)
