"""The folder of an exploration: it goes on, is refused to others, and survives a writer's death."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from lensdesign import load_design
from lensdesign.errors import InputError
from lensdesign.exploration import ExploredPoint, axes_of
from lensdesign.exploration.folder import ENDS, FRONT, folder_for
from lensdesign.optimization import Specification

OVER = "thickness,spread"


@pytest.fixture
def filled(tmp_path: Path, specification: Specification, explored: list[ExploredPoint]) -> Path:
    folder = folder_for(tmp_path / "front", specification, axes_of(OVER, specification), 4)
    assert folder.begin() == {}
    for one in explored:
        folder.keep(one)
    return folder.path


def test_ends_come_back_as_they_were(filled: Path, specification: Specification, explored: list) -> None:
    known = folder_for(filled, specification, axes_of(OVER, specification), 4).begin()
    assert list(known) == [one.key for one in explored]
    for one in explored:
        assert known[one.key].values == one.values
        assert known[one.key].point == one.point


def test_a_line_that_was_cut_is_sought_again(
    filled: Path, specification: Specification, explored: list
) -> None:
    ends = filled / ENDS
    text = ends.read_text(encoding="utf-8")
    ends.write_text(text[:-40], encoding="utf-8")
    known = folder_for(filled, specification, axes_of(OVER, specification), 4).begin()
    assert list(known) == [one.key for one in explored[:-1]]


def test_a_lens_file_that_is_gone_is_made_again(
    filled: Path, specification: Specification, explored: list
) -> None:
    rows = [json.loads(line) for line in (filled / ENDS).read_text(encoding="utf-8").splitlines()[1:]]
    (filled / rows[0]["design"]).unlink()
    known = folder_for(filled, specification, axes_of(OVER, specification), 4).begin()
    assert list(known) == [one.key for one in explored[1:]]


def test_other_explorations_and_other_files_are_refused(
    filled: Path, specification: Specification, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="another specification, study or objectives"):
        folder_for(filled, specification, axes_of(OVER, specification), 5).begin()
    assert folder_for(filled, specification, axes_of(OVER, specification), 5).begin(fresh=True) == {}
    other = tmp_path / "other"
    other.mkdir()
    (other / "letter.txt").write_text("dear", encoding="utf-8")
    with pytest.raises(InputError, match=r"holds other files, but no searches\.jsonl"):
        folder_for(other, specification, axes_of(OVER, specification), 4).begin()
    assert (other / "letter.txt").read_text(encoding="utf-8") == "dear"


def test_the_table_names_files_that_hold_the_lenses(
    filled: Path, specification: Specification, explored: list
) -> None:
    axes = axes_of(OVER, specification)
    folder_for(filled, specification, axes, 4).write_front(explored, axes)
    with (filled / FRONT).open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len([one for one in explored if one.lens is not None])
    assert {row["on_front"] for row in rows} <= {"0", "1"}
    for row in rows:
        lens = load_design(filled / row["design"])
        assert lens.exit_vertex_z_mm == pytest.approx(float(row["thickness_mm"]))
