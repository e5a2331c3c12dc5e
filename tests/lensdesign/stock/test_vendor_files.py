"""One vendor's file: its only glass, whatever light the vendor assumed."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest
from places import DESIGNS
from vendor_folder import LA1131, seq_text, write_vendors, zmx_text

from lensdesign import InputError, load_design, write_zmx
from lensdesign.files.draft import LossyImportError
from lensdesign.stock.vendor_files import find_vendor_files, read_stock_lens


def read(tmp_path: Path, text: str, suffix: str = ".zmx"):
    path = tmp_path / f"lens{suffix}"
    path.write_text(text)
    return read_stock_lens(path)


@pytest.mark.parametrize("stop_plane", [False, True])
def test_the_glass_is_read_with_its_clear_apertures(tmp_path: Path, stop_plane: bool) -> None:
    title, (front, back) = read(tmp_path, zmx_text("LA1131", LA1131, 11.43, stop_plane))
    assert title == "LA1131"
    assert (front.radius_mm, front.thickness_mm, front.material) == (pytest.approx(25.75), 5.34, "N-BK7")
    assert (back.radius_mm, back.thickness_mm, back.material) == (None, None, None)
    assert front.semi_diameter_mm == back.semi_diameter_mm == 11.43
    assert not front.stop


def test_automatic_semi_diameters_count_as_clear(tmp_path: Path) -> None:
    text = zmx_text("LA1131", LA1131, 11.43).replace("DIAM 11.43 1", "DIAM 11.43 0")
    assert [s.semi_diameter_mm for s in read(tmp_path, text)[1]] == [11.43, 11.43]


def test_a_code_v_file_and_a_cemented_group(tmp_path: Path) -> None:
    _, (front, back) = read(tmp_path, seq_text([51.0, -51.0], 6.0, "NBK7_SCHOTT", 11.4), ".seq")
    assert (front.radius_mm, back.radius_mm, back.semi_diameter_mm) == (51.0, -51.0, 11.4)
    doublet = [(33.3, 9.0, "N-BAF10"), (-22.3, 2.5, "N-SF10"), (-291.1, 43.4, "")]
    _, surfaces = read(tmp_path, zmx_text("AC254", doublet, 12.0))
    assert [s.material for s in surfaces] == ["N-BAF10", "N-SF10", None]


def test_a_file_of_our_exporter_is_read(tmp_path: Path) -> None:
    lens = load_design(DESIGNS / "feasible_singlet.toml")
    write_zmx(lens, tmp_path / "lens.zmx")
    title, surfaces = read_stock_lens(tmp_path / "lens.zmx")
    assert title == lens.title
    assert surfaces == tuple(s.replaced(stop=False) for s in lens.surfaces)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (("  GLAS N-BK7", "  GLAS N-XX99"), "N-XX99"),
        (("  GLAS N-BK7", ""), "no glass"),
        (("  DIAM 11.43 1 0 0 1", "  DIAM 0 0 0 0 1"), "semi-diameter"),
        (("MODE SEQ", "MODE NSC"), "NSC"),
        (("UNIT MM", "UNIT FEET"), "FEET"),
    ],
)
def test_what_is_not_understood_is_refused(tmp_path: Path, change: tuple[str, str], word: str) -> None:
    with pytest.raises(InputError, match=word):
        read(tmp_path, zmx_text("LA1131", LA1131, 11.43).replace(*change))


def test_losses_of_the_glass_are_refused_and_coatings_are_not(tmp_path: Path) -> None:
    text = zmx_text("LA1131", LA1131, 11.43)
    assert "COAT" in text
    with pytest.raises(LossyImportError):
        read(
            tmp_path,
            text.replace("  CURV 0.0\r\n  DISZ 46.5", "  TYPE FZERNSAG\r\n  CURV 0.0\r\n  DISZ 46.5"),
        )


def test_a_mirror_is_named_before_the_distance_behind_it(tmp_path: Path) -> None:
    text = (
        zmx_text("LA1131", LA1131, 11.43)
        .replace("GLAS N-BK7", "GLAS MIRROR")
        .replace("DISZ 5.34", "DISZ -5.34")
    )
    with pytest.raises(LossyImportError, match="surface 1: mirror"):
        read(tmp_path, text)


def test_a_stop_plane_at_the_vertex_does_not_change_the_glass(tmp_path: Path) -> None:
    text = zmx_text("LA1131", LA1131, 11.43, stop_plane=True).replace("DISZ 5.0", "DISZ 0.0")
    name, surfaces = read(tmp_path, text)
    assert name == "LA1131"
    assert [surface.radius_mm for surface in surfaces] == [25.75, None]


def test_a_smaller_stop_plane_at_the_vertex_is_not_the_size_of_the_glass(tmp_path: Path) -> None:
    text = zmx_text("LA1131", LA1131, 11.43, True)
    touching = text.replace("  DISZ 5.0", "  DISZ 0.0").replace("DIAM 11.43 0 0 0 1", "DIAM 3.0 1 0 0 1")
    _, surfaces = read(tmp_path, touching)
    assert [surface.semi_diameter_mm for surface in surfaces] == [11.43, 11.43]


def test_all_lens_files_below_the_folder_are_found(tmp_path: Path) -> None:
    write_vendors(tmp_path)
    (tmp_path / "again").symlink_to(tmp_path)
    found, faults = find_vendor_files(tmp_path)
    assert len(found) == 9
    assert faults == []


def test_folders_may_lie_deep_in_each_other(tmp_path: Path) -> None:
    here = os.open(tmp_path, os.O_RDONLY)
    try:
        for _ in range(1500):
            os.mkdir("a", dir_fd=here)
            here, old = os.open("a", os.O_RDONLY, dir_fd=here), here
            os.close(old)
        with open(os.open("deep.zmx", os.O_CREAT | os.O_WRONLY, dir_fd=here), "w") as file:
            file.write(zmx_text("LA1131", LA1131, 11.43))
    finally:
        os.close(here)
    try:
        (found,), faults = find_vendor_files(tmp_path)
    finally:
        subprocess.run(["rm", "-rf", tmp_path / "a"], check=True)  # pytest's own removal is recursive
    assert (found.name, faults) == ("deep.zmx", [])


def test_names_that_are_not_utf_8_are_listed(tmp_path: Path) -> None:
    (tmp_path / os.fsdecode(b"caf\xe9.zmx")).write_text(zmx_text("LA1131", LA1131, 11.43))
    (tmp_path / "plain.zmx").write_text(zmx_text("LA1131", LA1131, 11.43))
    found, ((name, reason),) = find_vendor_files(tmp_path)
    assert [path.name for path in found] == ["plain.zmx"]
    assert name == "caf\\xe9.zmx"
    assert "UTF-8" in reason
