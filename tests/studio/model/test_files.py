"""Folders and recent files of the picker."""

from __future__ import annotations

from pathlib import Path

import pytest

from lensdesign import InputError
from studio.model.files import MAX_RECENT, listing, recent, remember, typed_path


def test_a_folder_lists_folders_and_files_of_a_suffix(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    for name in ("b.toml", "A.TOML", "c.json", ".hidden.toml"):
        (tmp_path / name).touch()
    found = listing(str(tmp_path), [".toml"])
    assert found["folder"] == str(tmp_path)
    assert found["parent"] == str(tmp_path.parent)
    assert found["entries"] == [["sub", True], ["A.TOML", False], ["b.toml", False]]
    assert listing(str(tmp_path / "b.toml"))["folder"] == str(tmp_path)
    assert listing(str(tmp_path / "none" / "x"))["folder"] == str(tmp_path)
    assert listing("/")["parent"] == ""


def test_recent_files_are_few_and_exist(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert recent("designs") == []
    files = [tmp_path / f"{k}.toml" for k in range(MAX_RECENT + 2)]
    for file in files:
        file.touch()
        remember("designs", file)
    remember("designs", files[-2])
    files[-3].unlink()
    found = recent("designs")
    assert found[:2] == [str(files[-2]), str(files[-1])]
    assert len(found) == MAX_RECENT - 1
    assert recent("states") == []


def test_a_damaged_list_of_recent_files_is_ignored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    remember("designs", tmp_path)
    for text in ("[]", "{", '{"designs": 3}', '{"designs": [3, null]}'):
        (tmp_path / "transferlens" / "studio" / "recent.json").write_text(text)
        assert recent("designs") == []
    remember("designs", tmp_path)
    assert recent("designs") == [str(tmp_path)]


@pytest.mark.parametrize(
    "name", ["~nosuchuser/lens.toml", "a" * 256, f"folder/{'b' * 300}/lens.toml", "a\0b"]
)
def test_what_cannot_be_a_path_has_a_message(name: str) -> None:
    with pytest.raises(InputError, match="give another path"):
        typed_path(name)
    assert "give another path" in listing(name)["error"]


def test_typed_paths_may_exist_or_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert typed_path(" ~/lens.toml ") == tmp_path / "lens.toml"
    assert typed_path(str(tmp_path)) == tmp_path
