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
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from lensdesign.errors import InputError
from wavesim import write_pyramid
from wavesim.plots import pyramid
from wavesim.plots.pyramid import KEY, STRIP, halved, picture_levels

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
        assert np.abs(level.shown(level.stored)) == pytest.approx(np.pi, abs=1e-5)
    # A dark sample's phase does not count.
    half_dark = np.array([[1e-9j, 1e-9j], [1.0, 1.0]])
    level = picture_levels(half_dark, "phase_rad", least=1)[1]
    assert level.shown(level.stored) == pytest.approx(0.0, abs=1e-6)
    # The moduli of opposite phases do not cancel.
    level = picture_levels(np.exp(1j * np.array([[0.0, np.pi]] * 2)), "amplitude", least=1)[1]
    assert level.shown(level.stored) == pytest.approx(1.0)


@pytest.mark.parametrize("shape", [(1, 1), (512, 512), (700, 1301)])
def test_a_file_holds_the_field_and_its_halvings(shape: tuple[int, int], tmp_path: Path) -> None:
    values = some_field(*shape)
    path = tmp_path / "new" / "field.ome.tif"
    write_pyramid(values, path, 0.425, wavelength_um=0.532)
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
    write_pyramid(values, tmp_path / "amplitude.tif", 0.4, ["amplitude"])
    with Image.open(tmp_path / "amplitude.tif") as picture:
        assert (picture.mode, picture.size, picture.n_frames) == ("F", (531, 600), 1)  # type: ignore[attr-defined]
        assert np.array_equal(np.array(picture), values)
        assert float(picture.info["dpi"][0]) == pytest.approx(2.54 * 1e4 / 0.4)


def test_the_same_values_give_the_same_file(tmp_path: Path) -> None:
    for name in "ab":
        write_pyramid(some_field(80, 90), tmp_path / name, 0.4)
    write_pyramid(some_field(80, 90, seed=1), tmp_path / "c", 0.4)
    first, again, other = ((tmp_path / name).read_bytes() for name in "abc")
    assert first == again
    assert first != other


def test_many_samples_make_a_big_tiff(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = some_field(700, 600)
    samples = 700 * 600 + 350 * 300
    for most, big in ((8 * samples, False), (8 * samples - 1, True)):
        monkeypatch.setattr(pyramid, "CLASSIC_BYTES", most)
        write_pyramid(values, tmp_path / "field.tif", 0.4)
        with tifffile.TiffFile(tmp_path / "field.tif") as file:
            assert file.is_bigtiff is big
            assert np.array_equal(file.series[0].asarray()[0], np.abs(values))


def test_writing_takes_less_than_the_field_itself(tmp_path: Path) -> None:
    values = np.zeros((5000, 4000), np.complex64)
    tracemalloc.start()
    write_pyramid(values, tmp_path / "field.tif", 0.4)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < values.nbytes


@pytest.mark.parametrize(
    ("values", "pitch_um", "quantities", "words"),
    [
        (np.zeros(3), 1.0, ["amplitude"], r"shape \(3,\):.*real or complex \(ny, nx\)"),
        (np.zeros((0, 3)), 1.0, ["amplitude"], "real or complex"),
        (np.array([["a"]]), 1.0, ["amplitude"], "real or complex"),
        (np.zeros((3, 3)), 0.0, ["amplitude"], r"pitch_um = 0\.0"),
        (np.zeros((3, 3)), np.nan, ["amplitude"], "pitch_um = nan"),
        (np.zeros((3, 3)), 1.0, [], "must be one or more"),
        (np.zeros((3, 3)), 1.0, ["a", "a"], r"quantities = \['a', 'a'\]"),
        (np.zeros((3, 3), complex), 1.0, ["electrons"], r"quantities = \['electrons'\]: allowed"),
    ],
)
def test_what_is_no_picture_is_refused(
    values: Any, pitch_um: float, quantities: list[str], words: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=words):
        write_pyramid(values, tmp_path / "field.tif", pitch_um, quantities)
    assert not list(tmp_path.iterdir())


def test_a_failure_leaves_what_stood_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "field.tif"
    path.write_text("before")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tifffile.TiffWriter, "write", full)
    with pytest.raises(InputError, match=r"field\.tif.*No space left"):
        write_pyramid(np.ones((3, 3)), path, 1.0, ["amplitude"])
    assert [p.name for p in tmp_path.iterdir()] == ["field.tif"]
    assert path.read_text() == "before"
