"""Files of arrays that declare, or unpack to, more than memory holds."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from engine_checks import peak_bytes
from places import DESIGNS

from lensdesign import InputError, load_design
from lensdesign.common.array_files import FIELD_BYTES, array_names, read_arrays
from wavesim.cli.commands import main
from wavesim.fields.files import read_field
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.sensor.pixels.maps import read_map
from wavesim.targets.illumination import measured_field
from wavesim.targets.patch import object_patch


def header(shape: tuple[int, ...], kind: str = "<c8") -> bytes:
    made = io.BytesIO()
    np.lib.format.write_array_header_1_0(made, {"shape": shape, "fortran_order": False, "descr": kind})
    return made.getvalue()


def bomb(path: Path, side: int, kind: str = "<c8") -> None:
    """An .npz file of a field of zeros, which pack a thousand to one."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("values.npy", "w", force_zip64=True) as member:
            member.write(header((side, side), kind))
            zeros = bytes(2**22)
            left = side * side * np.dtype(kind).itemsize
            while left > 0:
                member.write(zeros[: min(left, len(zeros))])
                left -= len(zeros)
        with archive.open("pitch_um.npy", "w") as member:
            np.lib.format.write_array(member, np.array(1.0))


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A few megabytes that unpack to 4.3 GB."""
    path = tmp_path_factory.mktemp("bomb") / "object.npz"
    bomb(path, 23200)
    assert path.stat().st_size < 25e6
    return path


def declared(path: Path, shape: tuple[int, ...], name: str = "values") -> Path:
    """An .npz file whose array declares more than follows."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(f"{name}.npy", header(shape) + bytes(64))
        small = io.BytesIO()
        np.lib.format.write_array(small, np.array(1.0))
        archive.writestr("pitch_um.npy", small.getvalue())
    return path


PATCH = object_patch(load_design(DESIGNS / "paper_singlet.toml"), 0.05)
READERS: dict[str, Callable[[Path], object]] = {
    "field": read_field,
    "measured field": lambda path: measured_field(path, PATCH.grid, PATCH.wavelength_um),
    "arrays": read_arrays,
}


@pytest.mark.parametrize("name", READERS)
def test_an_archive_that_unpacks_to_gigabytes_is_refused_unpacked(name: str, packed: Path) -> None:
    def refused() -> None:
        with pytest.raises(InputError, match=r"object\.npz.*4\.31 GB.*3\.2 GB"):
            READERS[name](packed)

    refused()  # imports count not
    assert peak_bytes(refused) < 1e7


def test_view_refuses_it_in_a_sentence(
    packed: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for result in (packed, packed.parent):
        monkeypatch.setattr("sys.argv", ["wavesim", "view", str(result)])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2
        assert "unpacks to 4.31 GB" in capsys.readouterr().err
    assert [path.name for path in packed.parent.iterdir()] == ["object.npz"]


@pytest.mark.parametrize("name", READERS)
def test_headers_that_promise_more_than_follows_are_refused(name: str, tmp_path: Path) -> None:
    path = declared(tmp_path / "object.npz", (12_000, 12_000))
    with pytest.raises(InputError, match="1152000000 bytes"):
        READERS[name](path)
    path = declared(tmp_path / "object.npz", (2**31, 2**31))
    with pytest.raises(InputError, match="unpacks to"):
        READERS[name](path)
    (tmp_path / "plain.npy").write_bytes(header((2**20, 2**20)) + bytes(64))
    with pytest.raises(InputError, match=r"plain\.npy"):
        READERS[name](tmp_path / "plain.npy")


def test_memory_that_is_free_bounds_what_is_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lensdesign.common.memory.available_bytes", lambda: 1e6)
    np.savez(tmp_path / "object.npz", values=np.zeros((400, 400), np.complex64), pitch_um=1.0)
    with pytest.raises(InputError, match=r"object\.npz.*0\.00128 GB"):
        read_field(tmp_path / "object.npz")


def test_maps_and_checkpoints_are_bounded_too(tmp_path: Path) -> None:
    (tmp_path / "flat.npy").write_bytes(header((2**16, 2**16)) + bytes(64))
    with pytest.raises(InputError, match=r"flat\.npy.*34\.4 GB"):
        read_map(tmp_path / "flat.npy")
    np.savez_compressed(tmp_path / "kept.npz", key=np.asarray("k"), values=np.zeros(10**7))
    assert Checkpoint(tmp_path / "kept.npz", "k").load() is None  # packed: no checkpoint is
    Checkpoint(tmp_path / "kept.npz", "k").keep(values=np.arange(5.0))
    kept = Checkpoint(tmp_path / "kept.npz", "k").load()
    assert kept is not None
    assert kept["values"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


ODD: dict[str, Callable[[Path], None]] = {
    "objects": lambda path: np.savez(path, values=np.array([{}], object), pitch_um=1.0),
    "empty": lambda path: path.write_bytes(b"") and None,
    "text": lambda path: path.write_text("no array") and None,
    "cut": lambda path: path.write_bytes(struct.pack("<I", 0x04034B50) + bytes(100)) and None,
    "magic alone": lambda path: path.write_bytes(b"\x93NUMPY\x01\x00") and None,
    "version": lambda path: path.write_bytes(b"\x93NUMPY\x09\x00" + bytes(64)) and None,
    "negative": lambda path: path.write_bytes(header((-5, -5)) + bytes(200)) and None,
}


@pytest.mark.parametrize("name", ODD)
def test_damaged_ones_are_one_sentence(name: str, tmp_path: Path) -> None:
    path = tmp_path / "object.npz"
    ODD[name](path)
    with pytest.raises(InputError, match=r"object\.npz") as refused:
        read_field(path)
    assert "\n" not in str(refused.value)


def test_names_twice_and_many_names_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "object.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("values.npy", header((1, 1)) + bytes(8))
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("values.npy", header((1, 1)) + bytes(8))
    with pytest.raises(InputError, match="two arrays of one name"):
        read_arrays(path)
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(1200):
            archive.writestr(f"{number}.npy", b"")
    with pytest.raises(InputError, match="holds 1200 entries"):
        array_names(path)


def test_what_may_be_read_stays_readable(tmp_path: Path) -> None:
    assert FIELD_BYTES >= 8 * 20_000**2
    np.savez_compressed(tmp_path / "dark.npz", values=np.zeros((3000, 3000), np.complex64), pitch_um=0.4)
    assert read_field(tmp_path / "dark.npz")[0].shape == (3000, 3000)
    np.save(tmp_path / "one.npy", np.arange(6.0).reshape(2, 3))
    assert read_arrays(tmp_path / "one.npy")["values"].shape == (2, 3)
