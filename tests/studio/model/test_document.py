"""Saving when asked, never over what changed meanwhile; edits kept aside between sessions."""

from __future__ import annotations

import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from places import DESIGNS

from lensdesign import load_design
from lensdesign.errors import InputError
from studio.model.document import Autosave, opened, tables_text
from studio.model.editing import Editing, with_value


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return Path(shutil.copy(DESIGNS / "paper_singlet.toml", tmp_path / "lens.toml"))


def edited(editing: Editing, radius: float = -12.5) -> Editing:
    return editing.changed(with_value(editing.now.tables, ("surface", 1, "radius_mm"), radius), "radius")


def test_what_is_saved_is_the_lens(file: Path) -> None:
    document, editing = opened(file)
    redo_steps = document.saved(edited(editing))
    assert load_design(file).surfaces[1].radius_mm == -12.5
    redo_steps.saved(editing)  # it knows its own file
    assert load_design(file) == editing.lens


def test_a_file_that_changed_on_disk_is_left_alone(file: Path) -> None:
    document, editing = opened(file)
    file.write_text(file.read_text() + "\n# somebody else\n")
    undo_steps = file.read_bytes()
    with pytest.raises(InputError, match="changed on disk since it was opened"):
        document.saved(edited(editing))
    assert file.read_bytes() == undo_steps
    file.unlink()
    with pytest.raises(InputError, match="removed from the disk"):
        document.saved(edited(editing))


def test_another_name_must_be_free(file: Path, tmp_path: Path) -> None:
    document, editing = opened(file)
    taken = tmp_path / "taken.toml"
    taken.write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        document.saved(edited(editing), taken)
    assert taken.read_text() == "mine"
    assert document.saved(edited(editing), tmp_path / "new.toml").path.name == "new.toml"


def test_edits_of_the_last_session_come_back_and_can_be_undone(file: Path, tmp_path: Path) -> None:
    document, editing = opened(file)
    autosave = Autosave(file, tmp_path / "aside")
    autosave.keep(tables=tables_text(edited(editing).now.tables), digest=document.digest)
    assert autosave.file.stat().st_mode & 0o077 == 0
    back = Autosave(file, tmp_path / "aside").restored(document, editing)
    assert back.lens.surfaces[1].radius_mm == -12.5
    assert back.undone().lens == editing.lens


@pytest.mark.parametrize(
    "content", ["{", "[]", '{"tables": "surface = 3", "digest": "DIGEST"}', '{"tables": 3}']
)
def test_what_cannot_be_used_is_not(file: Path, tmp_path: Path, content: str) -> None:
    document, editing = opened(file)
    autosave = Autosave(file, tmp_path)
    autosave.file.write_text(content.replace("DIGEST", document.digest))
    assert autosave.restored(document, editing) is editing


def test_edits_of_another_file_do_not_come_back(file: Path, tmp_path: Path) -> None:
    document, editing = opened(file)
    autosave = Autosave(file, tmp_path / "aside")
    autosave.keep(tables=tables_text(edited(editing).now.tables), digest="of another")
    assert autosave.restored(document, editing) is editing


def test_two_threads_may_keep_at_one_time(file: Path, tmp_path: Path) -> None:
    autosave = Autosave(file, tmp_path / "aside")
    with ThreadPoolExecutor(4) as threads:
        list(threads.map(lambda k: autosave.keep(**{f"value{k}": k}), range(200)))
    assert len(autosave.read()) == 200
