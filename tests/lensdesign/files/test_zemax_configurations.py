"""Configurations of Zemax files."""

from __future__ import annotations

from pathlib import Path

import pytest

from lensdesign import InputError, Lens, write_zmx
from lensdesign.files import Supplement, read_lens_file, read_zmx
from lensdesign.files.draft import LossyImportError

ROWS = """MNUM 3 2
CRVT 1 1 0.02 0 0 0 1 1 1 0 0 "" 0
CRVT 1 2 {curvature} 0 0 0 1 1 1 0 0 "" 0
CRVT 1 3 0.0 0 0 0 1 1 1 0 0 "" 0
THIC 0 1 20.0 0 0 0 1 1 1 0 0 "" 0
THIC 0 2 {distance} 0 0 0 1 1 1 0 0 "" 0
THIC 0 3 25.0 0 0 0 1 1 1 0 0 "" 0
CONN 1 1 -0.5 0 0 0 1 1 1 0 0 "" 0
CONN 1 2 0.0 0 0 0 1 1 1 0 0 "" 0
CONN 1 3 0.0 0 0 0 1 1 1 0 0 "" 0
"""


@pytest.fixture
def zoomed(paper_lens: Lens, tmp_path: Path) -> Path:
    """The paper's lens as the second of three configurations."""
    path = tmp_path / "zoomed.zmx"
    write_zmx(paper_lens, path)
    front = paper_lens.surfaces[0]
    rows = ROWS.format(curvature=front.curvature, distance=paper_lens.object.working_distance_mm)
    path.write_text(path.read_text(encoding="utf-16") + rows, encoding="utf-16")
    return path


def test_one_configuration_is_read_by_its_number(zoomed: Path, paper_lens: Lens) -> None:
    held = read_zmx(zoomed, Supplement(configuration=2))
    assert held.lens == paper_lens
    first, third = (read_zmx(zoomed, Supplement(configuration=n)).lens for n in (1, 3))
    assert (first.surfaces[0].radius_mm, first.surfaces[0].conic) == (50.0, -0.5)
    assert (first.object.working_distance_mm, third.object.working_distance_mm) == (20.0, 25.0)
    assert third.surfaces[0].radius_mm is None
    assert first.surfaces[1] == third.surfaces[1] == paper_lens.surfaces[1]
    (remark,) = held.remarks
    assert all(part in remark for part in ("configuration 2 of 3", "CRVT 1", "THIC 0", "CONN 1"))


def test_without_a_choice_the_file_is_refused(zoomed: Path) -> None:
    with pytest.raises(LossyImportError, match=r"3 configurations.*--configuration 2"):
        read_zmx(zoomed)


def test_solves_of_another_configuration_are_losses(zoomed: Path) -> None:
    text = zoomed.read_text(encoding="utf-16").replace("SURF 2\n", "SURF 2\n  MAZH 0 0\n")
    zoomed.write_text(text, encoding="utf-16")
    with pytest.raises(LossyImportError, match=r"surface 2: MAZH solve.* configuration 2 is read"):
        read_zmx(zoomed, Supplement(configuration=1))
    assert read_zmx(zoomed, Supplement(configuration=2)).dropped == ()


@pytest.mark.parametrize("number", [-1, 0, 4])
def test_numbers_that_the_file_does_not_have_are_named(zoomed: Path, number: int) -> None:
    with pytest.raises(InputError, match=rf"configuration {number}: the file has 3; allowed: 1 to 3"):
        read_zmx(zoomed, Supplement(configuration=number))


def test_values_that_are_not_applied_are_losses(zoomed: Path) -> None:
    rows = 'YFIE 1 1 0.5 0 0 0 1 1 1 0 0 "" 0\nYFIE 1 2 1.5 0 0 0 1 1 1 0 0 "" 0\n'
    rows += 'PRAM 1 1 1e-6 0 2 0 1 1 1 0 0 "" 0\nPRAM 1 2 0 0 2 0 1 1 1 0 0 "" 0\n'
    zoomed.write_text(zoomed.read_text(encoding="utf-16") + rows, encoding="utf-16")
    with pytest.raises(LossyImportError, match=r"YFIE 1 of '0\.5'.*\n?.*PRAM 2 1 of '1e-6'|PRAM 2 1"):
        read_zmx(zoomed, Supplement(configuration=1))
    assert read_zmx(zoomed, Supplement(configuration=2)).dropped == ()


def test_a_surface_that_is_absent_is_named(zoomed: Path) -> None:
    text = zoomed.read_text(encoding="utf-16") + "THIC 9 1 3.0 0\nTHIC 9 2 4.0 0\n"
    zoomed.write_text(text, encoding="utf-16")
    with pytest.raises(InputError, match=r"configuration 1, THIC: the file has no surface 9"):
        read_zmx(zoomed, Supplement(configuration=1))


def test_a_file_of_one_configuration_has_number_1(paper_lens: Lens, tmp_path: Path) -> None:
    write_zmx(paper_lens, tmp_path / "lens.zmx")
    assert read_zmx(tmp_path / "lens.zmx", Supplement(configuration=1)).lens == paper_lens
    with pytest.raises(InputError, match=r"the file has 1; allowed: 1$"):
        read_zmx(tmp_path / "lens.zmx", Supplement(configuration=2))


def test_other_formats_have_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"configuration = 1: only a \.zmx file"):
        read_lens_file(tmp_path / "lens.seq", Supplement(configuration=1))
