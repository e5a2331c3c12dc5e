"""Design files: read back without loss; every fault named; a failed save harms nothing."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from random_lenses import lenses

from lensdesign import DesignError, InputError, Lens, MaterialError, load_design, save_design
from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.input_files import files_from
from lensdesign.files.design import design_text

GOOD = """
title = "A singlet"
wavelengths_um = [0.532]

[object]
field_diameter_mm = 3.0
numerical_aperture = 0.25
working_distance_mm = 13.5

[sensor]
pixel_pitch_um = 3.2
pixels = [9344, 7000]
plane_distances_mm = [2.0, 22.0]

[[surface]]
radius_mm = 42.3
thickness_mm = 9.7
material = "N-BK7"
semi_diameter_mm = 4.0
stop = true

[[surface]]
radius_mm = -12.0
conic = -0.9
semi_diameter_mm = 6.0
"""


@pytest.fixture
def design(tmp_path: Path) -> Path:
    """A good design file."""
    path = tmp_path / "lens.toml"
    path.write_text(GOOD)
    return path


@settings(max_examples=150)
@given(lens=lenses())
def test_a_saved_lens_reads_back_equal(tmp_path_factory: pytest.TempPathFactory, lens: Lens) -> None:
    path = tmp_path_factory.getbasetemp() / "round_trip.toml"
    save_design(lens, path)
    assert load_design(path) == lens


def test_the_paper_lens_holds_table_1(paper_lens: Lens) -> None:
    front, back = paper_lens.surfaces
    assert (front.radius_mm, front.conic, front.thickness_mm, front.material) == (42.3, 0.0, 9.7, "N-BK7")
    assert (back.radius_mm, back.conic, back.thickness_mm, back.material) == (-12.0, -0.89862, None, None)


def test_defaults_stay_out_of_the_file(paper_lens: Lens) -> None:
    text = design_text(paper_lens)
    assert "asphere" not in text
    assert "glass_catalogs" not in text
    assert text.count("conic") == 1


def test_glass_catalogues_are_relative_to_the_file(design: Path, tmp_path: Path) -> None:
    glasses = tmp_path / "glasses" / "own.agf"
    glasses.parent.mkdir()
    glasses.write_text(
        "NM MYGLASS 2 517642 1.5168 64.17\n"
        "CD 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653\nLD 0.4 0.7\n"
    )
    design.write_text('glass_catalogs = ["glasses/own.agf"]\n' + GOOD.replace("N-BK7", "MYGLASS"))
    lens = load_design(design)
    assert lens.indices(0.5875618)[1] == pytest.approx(1.5168, abs=1e-5)
    elsewhere = tmp_path / "other" / "copy.toml"
    save_design(lens, elsewhere)
    assert '"../glasses/own.agf"' in elsewhere.read_text()
    with files_from(tmp_path):
        assert load_design(elsewhere) == lens


FAULTS = [
    ("radius_mm = 42.3", "radius_mm = 0.0", "surface 1, radius_mm: a radius of 0 is not a surface"),
    ("radius_mm = 42.3", 'radius_mm = "42.3"', r"surface 1, radius_mm = '42.3': must be a valid number"),
    ("radius_mm = 42.3", "radius_mm = nan", "surface 1, radius_mm = nan: must be a finite number"),
    ("radius_mm = 42.3", "radius = 42.3", "surface 1, radius: unknown key; allowed: radius_mm, conic, asphe"),
    ("thickness_mm = 9.7", "thickness_mm = -9.7", "surface 1, thickness_mm = -9.7: must be greater than 0"),
    ("thickness_mm = 9.7\n", "", "surface 1: thickness_mm is missing"),
    ("conic = -0.9", "conic = -0.9\nthickness_mm = 1.0", r"surface 2: .*last surface.*thick"),
    ("thickness_mm = 9.7", "thickness_mm = 0.5", "surfaces 1 and 2 cross"),
    ("numerical_aperture = 0.25", "numerical_aperture = 1.0", r"numerical_aperture = 1.0.* 1"),
    ("numerical_aperture = 0.25", "numerical_aperture = 1e-300", "object, numerical_aperture: must be at"),
    ("numerical_aperture = 0.25\n", "", "object, numerical_aperture: missing key"),
    ("numerical_aperture", "na", "object, na: unknown key"),
    ("field_diameter_mm = 3.0", "field_diameter_mm = 0", "field_diameter_mm = 0"),
    ("semi_diameter_mm = 4.0", "semi_diameter_mm = 42.4", "edge of the conic"),
    ("semi_diameter_mm = 4.0\n", "", r"surface 1 .*semi_diameter_mm"),
    ("conic = -0.9", "conic = -0.9\nstop = true", r"surfaces \[1, 2\].*stop"),
    ("stop = true\n", "", r"no surface.*stop.*surface 1"),
    ("pixel_pitch_um = 3.2", "pixel_pitch_um = 0.0032", r"pixel_pitch_um = 0.0032: .*3.2 µm"),
    ("pixel_pitch_um = 3.2", "pixel_pitch_um = 3200.0", r"pixel_pitch_um = 3200: .*3.2 µm"),
    ("wavelengths_um = [0.532]", "wavelengths_um = [532.0]", r"wavelengths_um = 532: .*0.532 µm"),
    ("wavelengths_um = [0.532]", "wavelengths_um = [0.000532]", r"wavelengths_um = 0.000532: .*0.532 µm"),
    ("radius_mm = 42.3", "radius_mm = 0.0423", r"surface 1, radius_mm = 0.0423: .*42.3 mm"),
    ("thickness_mm = 9.7", "thickness_mm = 9700.0", r"surface 1, thickness_mm = 9700: .*9.7 mm"),
    ("thickness_mm = 9.7", "thickness_mm = 0.0097", r"surface 1, thickness_mm = 0.0097: .*9.7 mm"),
    ("meter_mm = 4.0", "meter_mm = 4000.0", r"surface 1, semi_diameter_mm = 4000: .*4 mm"),
    ("meter_mm = 4.0", "meter_mm = 0.004", r"surface 1, semi_diameter_mm = 0.004: .*4 mm"),
    ("meter_mm = 3.0", "meter_mm = 3000.0", r"object, field_diameter_mm = 3000: .*3 mm"),
    ("meter_mm = 3.0", "meter_mm = 0.003", r"object, field_diameter_mm = 0.003: .*3 mm"),
    ("= 13.5", "= 13500.0", r"object, working_distance_mm = 13500: .*13.5 mm"),
    ("= 13.5", "= 0.0135", r"object, working_distance_mm = 0.0135: .*13.5 mm"),
    ("[2.0, 22.0]", "[2000.0, 22.0]", r"sensor, plane_distances_mm 1 = 2000: .*2 mm"),
    ("[2.0, 22.0]", "[2.0, 22000.0]", r"sensor, plane_distances_mm 2 = 22000: .*22 mm"),
    ("[2.0, 22.0]", "[2.0, 0.022]", r"sensor, plane_distances_mm 2 = 0.022: .*22 mm"),
    ("[2.0, 22.0]", "[0.002, 0.022]", r"sensor, plane_distances_mm 1 = 0.002: .*2 mm"),
    ("um = 3.2", "um = 800.0", r"sensor, pixel_pitch_um = 800: .*0.8 µm"),
    ("stop = true", "stop = 1", "surface 1, stop = 1"),
    ('material = "N-BK7"', "material = 0.5", "surface 1, material = 0.5: must be"),
    ('material = "N-BK7"', "material = true", "surface 1, material = True: must be"),
    ("wavelengths_um = [0.532]", "wavelengths_um = []", r"wavelengths_um = .*: .*at least 1 item"),
    ("wavelengths_um = [0.532]", "wavelengths_um = [-0.5]", r"wavelengths_um 1 = -0.5"),
    ("[2.0, 22.0]", "[22.0, 2.0]", "plane_distances_mm: distances must increase"),
    ("[9344, 7000]", "[9344.5, 7000]", r"sensor, pixels 1 = 9344.5"),
    ("[9344, 7000]", "[9344]", "sensor, pixels 2: missing value"),
    ('title = "A singlet"', "lens = 1", "lens: unknown key"),
    ("[object]\n", "[object]\n[", "not valid TOML: .*line"),
    ("[[surface]]", "[[surfaces]]", r"surfaces: .*did you mean surface"),
    ("radius_mm = 42.3", "raduis_mm = 42.3", "raduis_mm: unknown key; .*; did you mean radius_mm"),
    ("wavelengths_um = [0.532]", "wavelengths_um = 0.532", "wavelengths_um = 0.532: must be a list"),
    ("[9344, 7000]", "[9344, 7000, 1]", r"pixels = \[9344, 7000, 1\]: must hold at most 2 items"),
    ("[9344, 7000]", "[9344, 9999999]", "pixels 2 = 9999999: must be less than or equal to 1000000"),
    ("pixel_pitch_um = 3.2", "pixel_pitch_um = 1e300", "pixel_pitch_um = 1e.300: must be less than or equal"),
    ("conic = -0.9", f"asphere = {[0.0] * 21}", "surface 2, asphere = .*: must hold at most 20 items"),
    ('title = "A singlet"', "glass_catalogs = [3]", "glass_catalogs 1 = 3: must be a path"),
    ('title = "A singlet"', 'glass_catalogs = ["a\\u0000"]', "glass_catalogs: a path must not contain a NUL"),
    ('title = "A singlet"', f"title = {'[' * 3000}", "not valid TOML: .*recursion"),
    ('title = "A singlet"', f"title = {'1' * 5000}", "not valid TOML: .*limit"),
    ('"N-BK7"', '"1.5"', r"'1.5'.*number"),
]


@pytest.mark.parametrize(("old", "new", "message"), FAULTS)
def test_a_fault_is_named_with_its_place(design: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    design.write_text(GOOD.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        load_design(design)
    assert str(caught.value).startswith(str(design))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[0.532]", "[0]", "wavelengths_um 1 = 0: must be greater than 0"),
        (
            '"N-BK7"',
            "0.5",
            "surface 1, material = 0.5: must be a valid string or greater than or equal to 0.9992",
        ),
    ],
)
def test_one_value_is_one_fault(design: Path, old: str, new: str, message: str) -> None:
    design.write_text(GOOD.replace(old, new))
    with pytest.raises(DesignError) as caught:
        load_design(design)
    assert str(caught.value) == f"{design}: {message}"


def test_a_byte_order_mark_is_passed_over(design: Path) -> None:
    lens = load_design(design)
    design.write_bytes(b"\xef\xbb\xbf" + design.read_bytes())
    assert load_design(design) == lens


def test_all_faults_come_at_once(design: Path) -> None:
    design.write_text(GOOD.replace("pixel_pitch_um = 3.2", "pixel_pitch_um = 0").replace("stop", "stopp"))
    with pytest.raises(DesignError) as caught:
        load_design(design)
    assert len(str(caught.value).splitlines()) == 2


@pytest.mark.parametrize(
    ("material", "message"), [("N-BK77", "did you mean N-BK7"), ("", "must be the name|must be a name")]
)
def test_an_unknown_glass_is_named(design: Path, material: str, message: str) -> None:
    design.write_text(GOOD.replace("N-BK7", material))
    with pytest.raises(MaterialError, match=message) as caught:
        load_design(design)
    assert str(caught.value).startswith(str(design))


def test_a_wavelength_without_index_is_refused(design: Path) -> None:
    design.write_text(GOOD.replace("[0.532]", "[0.532, 9.0]"))
    with pytest.raises(MaterialError, match=r"9 µm.*0\.3 to 2\.5 µm"):
        load_design(design)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DesignError, match="UTF-8"):
        load_design(binary)


def test_unwritable_paths_are_refused(paper_lens: Lens, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"):
        save_design(paper_lens, tmp_path)
    blocked = tmp_path / "file"
    blocked.write_text("x")
    with pytest.raises(InputError, match="there is a file where a folder is needed"):
        save_design(paper_lens, blocked / "lens.toml")
    assert blocked.read_text() == "x"


def test_folders_are_made_and_nothing_else_stays(paper_lens: Lens, tmp_path: Path) -> None:
    save_design(paper_lens, tmp_path / "new" / "lens.toml")
    assert os.listdir(tmp_path / "new") == ["lens.toml"]


def test_a_failed_save_leaves_the_old_file(
    design: Path, paper_lens: Lens, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(InputError, match="No space left"):
        save_design(paper_lens, design)
    assert design.read_text() == GOOD
    assert os.listdir(design.parent) == ["lens.toml"]


def test_a_writer_that_fails_leaves_the_old_file(design: Path) -> None:
    def fail_half_way() -> None:
        with atomic_path(design) as temporary:
            temporary.write_text("half a file")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_half_way()
    assert design.read_text() == GOOD
    assert os.listdir(design.parent) == ["lens.toml"]


def test_a_written_file_has_the_usual_permissions(tmp_path: Path, paper_lens: Lens) -> None:
    plain = tmp_path / "plain"
    plain.write_text("x")
    save_design(paper_lens, tmp_path / "lens.toml")
    assert (tmp_path / "lens.toml").stat().st_mode == plain.stat().st_mode


def test_a_link_stays_and_what_it_points_to_is_replaced(design: Path, paper_lens: Lens) -> None:
    link = design.with_name("link.toml")
    link.symlink_to(design.name)
    save_design(paper_lens, link)
    assert link.is_symlink()
    assert load_design(design) == paper_lens


def test_what_is_no_file_is_not_replaced(tmp_path: Path, paper_lens: Lens) -> None:
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="not a regular file"):
        save_design(paper_lens, pipe)
    assert pipe.is_fifo()
    assert os.listdir(tmp_path) == ["pipe.toml"]


def test_names_may_be_as_long_as_the_system_allows(tmp_path: Path, paper_lens: Lens) -> None:
    path = tmp_path / ("x" * 250 + ".toml")
    save_design(paper_lens, path)
    assert load_design(path) == paper_lens


def test_a_lens_whose_stop_went_without_saying_is_written_with_it(paper_lens: Lens, tmp_path: Path) -> None:
    """In memory the entrance surface is the stop of a lens without one; in a file exactly one is marked."""
    save_design(paper_lens.with_surface(0, stop=False), tmp_path / "lens.toml")
    assert load_design(tmp_path / "lens.toml") == paper_lens
