"""Arrays in files of a folder: what is kept, what is not, and disks that are full."""

from __future__ import annotations

import errno
from collections import namedtuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.engines.eikonal import tile_store
from wavesim.engines.eikonal.tile_store import TileStore


def values(number: int) -> np.ndarray[Any, Any]:
    return np.full((3, 4), number + 1j, np.complex64)


def test_what_is_kept_is_found_under_the_same_key(tmp_path: Path) -> None:
    kept = TileStore(tmp_path / "a" / "parts", "one")
    for number in (0, 7, 30_000):
        kept[number] = values(number)
    again = TileStore(tmp_path / "a" / "parts", "one")
    assert list(again) == [0, 7, 30_000]
    assert np.array_equal(again[7], values(7))
    assert 7 in again
    assert 1 not in again
    assert "7" not in again
    del again[7]
    with pytest.raises(KeyError):
        del again[7]
    assert list(kept) == [0, 30_000]
    kept.drop()
    assert not (tmp_path / "a" / "parts").exists()


def test_another_key_or_a_lost_one_begins_anew(tmp_path: Path) -> None:
    TileStore(tmp_path / "parts", "one")[3] = values(3)
    assert not list(TileStore(tmp_path / "parts", "two"))
    TileStore(tmp_path / "parts", "two")[3] = values(3)
    (tmp_path / "parts" / "key.txt").write_bytes(b"\xff\xfe")
    assert not list(TileStore(tmp_path / "parts", "two"))


@pytest.mark.parametrize("damage", [b"", b"nonsense", None])
def test_damaged_parts_are_done_again(tmp_path: Path, damage: bytes | None) -> None:
    kept = TileStore(tmp_path, "one")
    kept[3] = values(3)
    path = tmp_path / "00003.npy"
    path.write_bytes(path.read_bytes()[:-5] if damage is None else damage)
    assert 3 not in kept
    with pytest.raises(KeyError):
        kept[3]


def test_a_full_disk_keeps_what_was_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = TileStore(tmp_path, "one")
    kept[0] = values(0)

    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tile_store.np, "save", full)
    with pytest.raises(InputError, match=r"full\. Parts stored so far: 1\."):
        kept[1] = values(1)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["00000.npy", "key.txt"]
    assert np.array_equal(kept[0], values(0))


def test_a_disk_without_room_is_refused_beforehand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = TileStore(tmp_path, "one")
    kept[0] = values(0)
    usage = namedtuple("usage", "free")
    monkeypatch.setattr(tile_store.shutil, "disk_usage", lambda _: usage(3_000_000_000))
    kept.check_free_space(2_900_000_000)
    with pytest.raises(InputError, match=r"3 GB free.* 3\.1 GB"):
        kept.check_free_space(3_000_000_000)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write to the folder"):
        TileStore(tmp_path / "file" / "parts", "one")
