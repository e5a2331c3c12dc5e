"""The index of a folder: every file once, faults with their reasons, continued after an interrupt."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from vendor_folder import LA1509, write_vendors, zmx_text

from lensdesign import InputError, index_stock
from lensdesign.stock import index as module


@pytest.fixture
def vendors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "vendors"
    write_vendors(folder)
    return folder


def test_every_file_has_a_lens_or_a_reason(vendors: Path) -> None:
    index = index_stock(vendors)
    assert index.read_count == len(index.files) == 9
    assert [file.name for file in index.lenses] == [
        "biconvex.seq",
        "plano/LA1131-A.ZMX",
        "plano/LA1131.zmx",
        "plano/LA1509.zmx",
    ]
    assert {file.name for file in index.refused} == {
        f"bad/{name}.zmx" for name in ("cut", "noise", "mirror", "two", "glass")
    }
    assert all(file.reason and "\n" not in file.reason for file in index.refused)


def test_files_without_changes_are_not_read_again(vendors: Path) -> None:
    first = index_stock(vendors)
    again = index_stock(vendors)
    assert again.read_count == 0
    assert again.files == first.files


def test_changed_new_and_removed_files_are_noticed(vendors: Path) -> None:
    index_stock(vendors)
    path = vendors / "plano" / "LA1509.zmx"
    path.write_bytes(zmx_text("LA1509", [(60.0, 3.6, "N-BK7"), LA1509[1]], 11.43).encode())
    (vendors / "new.zmx").write_text(zmx_text("NEW", LA1509, 5.0))
    (vendors / "biconvex.seq").unlink()
    index = index_stock(vendors)
    assert index.read_count == 2
    lenses = {file.name: file for file in index.lenses}
    assert lenses["plano/LA1509.zmx"].surfaces[0]["radius_mm"] == pytest.approx(60.0)
    assert "new.zmx" in lenses
    assert "biconvex.seq" not in lenses


def test_a_touched_file_is_not_read_again_but_one_of_the_same_size_and_time_is(vendors: Path) -> None:
    """The contents count."""
    first = index_stock(vendors)
    path = vendors / "plano" / "LA1509.zmx"
    os.utime(path, ns=(1, 1))
    assert index_stock(vendors).read_count == 0
    content = path.read_bytes()
    changed = content.replace(b"DISZ 3.6", b"DISZ 3.7")
    assert len(changed) == len(content)
    assert changed != content
    path.write_bytes(changed)
    os.utime(path, ns=(1, 1))
    again = index_stock(vendors)
    assert again.read_count == 1
    thick = [{f.name: f for f in found.lenses}["plano/LA1509.zmx"].surfaces[0] for found in (first, again)]
    assert [one["thickness_mm"] for one in thick] == [3.6, 3.7]


def test_nothing_is_written_beside_the_files_of_vendors(vendors: Path, tmp_path: Path) -> None:
    before = sorted(vendors.rglob("*"))
    path = index_stock(vendors).path
    assert sorted(vendors.rglob("*")) == before
    assert path.is_relative_to(tmp_path / "cache" / "transferlens" / "stock")
    assert (path.parents[1] / "key").stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize(
    "change",
    [
        lambda row: {**row, "surfaces": []},
        lambda row: {**row, "surfaces": [row["surfaces"][0]]},
        lambda row: {**row, "surfaces": [{**row["surfaces"][0], "thickness_mm": 5.35}, row["surfaces"][1]]},
        lambda row: {**row, "surfaces": [{"radius_mm": "x"}]},
        lambda row: {**row, "surfaces": 3},
        lambda row: {**row, "title": 3},
        lambda row: {**row, "reason": "not for you"},
        lambda row: {**row, "more": 1},
        lambda row: {**row, "code": 5},
        lambda row: {k: v for k, v in row.items() if k != "code"},
        lambda row: [],
    ],
)
def test_a_line_that_was_changed_is_read_again(vendors: Path, change: Callable[[Any], Any]) -> None:
    first = index_stock(vendors)
    header, *lines = first.path.read_text().splitlines()
    rows = [json.loads(line) for line in lines]
    changed = [change(row) if row["name"] == "plano/LA1131.zmx" else row for row in rows]
    first.path.write_text("\n".join([header, *map(json.dumps, changed), ""]))
    again = index_stock(vendors)
    assert again.read_count == 1
    assert again.files == first.files


def test_the_index_of_another_user_is_not_believed(
    vendors: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither one that lies in the vendor's folder, nor one that is named."""
    foreign = vendors / ".transferlens-stock.jsonl"
    index_stock(vendors, foreign)
    foreign.write_text(foreign.read_text().replace('"thickness_mm": 3.6', '"thickness_mm": 9.6'))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "mine"))
    for index in (None, foreign):
        found = index_stock(vendors, index)
        assert found.read_count == 9
        assert {f.name: f for f in found.lenses}["plano/LA1509.zmx"].surfaces[0]["thickness_mm"] == 3.6


def test_an_interrupted_run_continues(vendors: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = module.read_stock_lens
    done: list[Path] = []

    def interrupted(path: Path, catalogs: object) -> object:
        if len(done) == 4:
            raise KeyboardInterrupt
        done.append(path)
        return read(path, ())

    monkeypatch.setattr(module, "_BATCH", 1)
    monkeypatch.setattr(module, "read_stock_lens", interrupted)
    with pytest.raises(KeyboardInterrupt, match="4 of 9"):
        index_stock(vendors)
    monkeypatch.setattr(module, "read_stock_lens", read)
    index = index_stock(vendors)
    assert index.read_count == 5
    assert len(index.lenses) == 4


def test_a_cut_line_is_read_again(vendors: Path) -> None:
    path = index_stock(vendors).path
    text = path.read_text()
    path.write_text(text[:-30])
    index = index_stock(vendors)
    assert index.read_count == 1
    assert len(index.files) == 9


def test_the_index_can_lie_elsewhere(vendors: Path, tmp_path: Path) -> None:
    index = index_stock(vendors, tmp_path / "own.jsonl")
    assert index.path.is_file()
    assert not (tmp_path / "cache" / "transferlens" / "stock" / index.path.name).exists()
    assert index_stock(vendors, tmp_path / "own.jsonl").read_count == 0


def test_another_version_or_catalogue_reads_all_again(vendors: Path, tmp_path: Path) -> None:
    path = index_stock(vendors).path
    first, *others = path.read_text().splitlines()
    path.write_text("\n".join([json.dumps(json.loads(first) | {"version": "0"}), *others, ""]))
    assert index_stock(vendors).read_count == 9
    catalog = tmp_path / "own.agf"
    catalog.write_text("CC own\nNM UNOBTAINIUM 2 0 1.5 60 0\nCD 1.25 0 0 0.01 0 100\nLD 0.3 2.5\n")
    index = index_stock(vendors, glass_catalogs=[catalog])
    assert index.read_count == 9
    assert "bad/glass.zmx" in {file.name for file in index.lenses}


def test_processes_find_the_same(vendors: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = index_stock(vendors)
    alone.path.unlink()
    monkeypatch.setattr(module, "_BATCH", 5)
    assert index_stock(vendors, workers=2).files == alone.files


def test_one_failure_of_the_reader_does_not_end_the_run(
    vendors: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(path: Path, catalogs: object) -> object:
        raise RuntimeError("unforeseen")

    monkeypatch.setattr(module, "read_stock_lens", failing)
    index = index_stock(vendors)
    assert len(index.refused) == 9
    assert "unforeseen" in index.refused[0].reason


def test_bad_folders_and_indices_are_refused(vendors: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="missing"):
        index_stock(tmp_path / "missing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty"):
        index_stock(tmp_path / "empty")
    other = tmp_path / "other.txt"
    other.write_text("precious\n")
    with pytest.raises(InputError, match="--index"):
        index_stock(vendors, other)
    assert other.read_text() == "precious\n"
    other.write_text('{"index": 5}\n')
    with pytest.raises(InputError, match="--index"):
        index_stock(vendors, other)
