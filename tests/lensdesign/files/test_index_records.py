"""Index records of lens files: they show whose data an import uses, and how far they differ."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from places import GOLDEN
from supplements import SENSOR

from lensdesign.files.draft import LossyImportError
from lensdesign.files.index_records import IndexRecord, index_difference
from lensdesign.files.zemax import read_zmx
from lensdesign.lens.glass import get_material

IMPORTS = GOLDEN / "imports"


def edited(tmp_path: Path, name: str, *changes: tuple[str, str]) -> Path:
    text = (IMPORTS / name).read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "lens.zmx"
    path.write_text(text)
    return path


def numbers(remarks: tuple[str, ...], word: str) -> list[float]:
    """All decimal numbers of the remarks that contain a word."""
    found = " ".join(r for r in remarks if word in r)
    return [float(n) for n in re.findall(r"[-+]?\d+\.\d+", found)]


@pytest.mark.parametrize(
    ("name", "nd", "difference", "efl_mm"),
    [("pmma_misc.zmx", 1.491756, 0.000771, 51.346), ("e48r_zeon.zmx", 1.53116, -0.000644, 47.5618)],
)
def test_a_plastic_of_another_catalogue_is_said_with_its_difference(
    name: str, nd: float, difference: float, efl_mm: float
) -> None:
    """The focal lengths by the file's own record are those of the lensmaker's equation."""
    thickness, radius = 3.0, 50.0
    power = (nd - 1.0) * (2.0 / radius - (nd - 1.0) * thickness / (nd * radius**2))
    assert 1.0 / power == pytest.approx(efl_mm, rel=1e-5)
    imported = read_zmx(IMPORTS / name, SENSOR)
    assert any("refractiveindex.info" in r and name[-8:-4].upper() in r for r in imported.remarks)
    found = numbers(imported.remarks, "index record ")
    assert nd in found
    assert difference in found
    assert any(abs(n - efl_mm) < 1e-3 for n in numbers(imported.remarks, "focal length"))


@pytest.mark.parametrize("glass", ["POLYCARB", "POLYSTYR", "CAF2", "SILICA"])
def test_data_of_a_catalogue_that_a_file_does_not_name_are_always_said(tmp_path: Path, glass: str) -> None:
    path = edited(tmp_path, "pmma_misc.zmx", ("PMMA 0 0 1.491756 57.440791", f"{glass} 0 0 1.5 40"))
    assert any("refractiveindex.info" in r and "MISC" in r for r in read_zmx(path, SENSOR).remarks)


def test_an_index_record_of_another_glass_is_a_loss(tmp_path: Path) -> None:
    """CDGM's F2 has nd 1.61293, Schott's 1.62004."""
    glass = ("PMMA 0 0 1.491756 57.440791", "F2 0 0 1.61293 36.99")
    path = edited(tmp_path, "pmma_misc.zmx", ("GCAT SCHOTT MISC", "GCAT SCHOTT CDGM"), glass)
    with pytest.raises(LossyImportError, match=r"1\.620040.*1\.612930"):
        read_zmx(path, SENSOR)
    remarks = read_zmx(path, SENSOR, lossy=True).remarks
    assert any("CDGM has 1.612929" in r for r in remarks)
    path = edited(tmp_path, "pmma_misc.zmx", ("GCAT SCHOTT MISC", "GCAT CDGM SCHOTT"), glass)
    imported = read_zmx(path, SENSOR)
    assert imported.lens.surfaces[0].material == "CDGM:F2"
    assert not numbers(imported.remarks, "index record ")


@pytest.mark.parametrize("record", ["1.5 40", "0 0", "1 0", ""])
def test_placeholders_are_no_record(tmp_path: Path, record: str) -> None:
    glass = ("PMMA 0 0 1.491756 57.440791", f"N-BK7 0 0 {record}" if record else "N-BK7")
    path = edited(tmp_path, "pmma_misc.zmx", (f"{glass[0]} 0 0 0 0 0 0", glass[1]))
    imported = read_zmx(path, SENSOR)
    assert not numbers(imported.remarks, "index record")
    assert not any("MISC" in r for r in imported.remarks)


def test_a_short_name_may_be_that_of_a_catalogue_that_comes_first(tmp_path: Path) -> None:
    glass = ("PMMA 0 0 1.491756 57.440791", "F2 0 0 1.5 40")
    first = edited(tmp_path, "pmma_misc.zmx", ("GCAT SCHOTT MISC", "GCAT MISC SCHOTT"), glass)
    assert any("also names MISC" in r for r in read_zmx(first, SENSOR).remarks)
    last = edited(tmp_path, "pmma_misc.zmx", glass)
    assert not any("also names" in r for r in read_zmx(last, SENSOR).remarks)


def test_the_index_of_a_record_at_another_wavelength() -> None:
    """The record of N-BK7 itself gives its index; that of N-PK52A beside it gives that glass within 1e-3."""
    own = IndexRecord(1.5168, 64.17)
    assert own.index("N-BK7", 0.486, ()) == pytest.approx(get_material("N-BK7").index(0.486), abs=2e-6)
    other = IndexRecord(1.497, 81.61)
    for wavelength_um in (0.4358, 0.6328, 0.852):
        expected = get_material("N-PK52A").index(wavelength_um)
        assert other.index("N-BK7", wavelength_um, ()) == pytest.approx(expected, abs=1e-3)


def test_the_difference_at_the_design_wavelength_is_said() -> None:
    found = index_difference("PMMA", IndexRecord(1.491756, 57.440791), 0.4861, ())
    assert found is not None
    assert found.nd == pytest.approx(7.71e-4, abs=1e-6)
    assert "at 0.4861" in found.text


@pytest.mark.parametrize(("wavelength", "index"), [("0.5876", 1.6), ("0.55", 1.6032), ("0.6562725", 1.5955)])
def test_a_model_glass_is_exact_at_the_d_line_alone(tmp_path: Path, wavelength: str, index: float) -> None:
    """By Cauchy's formula through nd = 1.6 and an Abbe number of 40."""
    glass = ("PMMA 0 0 1.491756 57.440791", "___BLANK 1 0 1.6 40")
    path = edited(tmp_path, "pmma_misc.zmx", ("0.5875618", wavelength), glass)
    if index == 1.6:
        assert read_zmx(path, SENSOR).dropped == ()
        return
    with pytest.raises(LossyImportError, match="Abbe number 40"):
        read_zmx(path, SENSOR)
    (loss,) = read_zmx(path, SENSOR, lossy=True).dropped
    assert float(loss.split()[-1]) == pytest.approx(index, abs=1.01e-4)


def test_a_tabulated_index_is_said(tmp_path: Path) -> None:
    glass = ("PMMA 0 0 1.491756 57.440791", "B270 0 0 1.5 40")
    remarks = read_zmx(edited(tmp_path, "pmma_misc.zmx", glass), SENSOR).remarks
    assert any("B270" in remark and "linearly" in remark for remark in remarks)


def test_a_record_of_the_e_line_is_no_other_glass(tmp_path: Path) -> None:
    """N-SF5 has nd 1.67271 and ne 1.67763 by its data sheet."""
    glass = ("PMMA 0 0 1.491756 57.440791", "N-SF5 0 0 1.67763 32.00")
    imported = read_zmx(edited(tmp_path, "pmma_misc.zmx", glass), SENSOR)
    assert imported.dropped == ()
    assert not numbers(imported.remarks, "focal length")
    other = (glass[0], "N-SF5 0 0 1.6752 32.00")
    with pytest.raises(LossyImportError, match="N-SF5"):
        read_zmx(edited(tmp_path, "pmma_misc.zmx", other), SENSOR)
