"""Starting studies: files that read back, fit their lens, and hold the grade's numbers."""

import math
import tomllib

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from places import DESIGNS
from random_lenses import lenses
from typer.testing import CliRunner

import lensdesign
from lensdesign import DesignError, InputError, Lens, load_design
from lensdesign.analysis.exit_beam import largest_spread_angle
from lensdesign.manufacture.drawing.tolerances import GENERAL
from tolerancing.cost.table import load_costs
from tolerancing.merits.registry import merit_from_table
from tolerancing.perturbations.distributions import DISTRIBUTIONS
from tolerancing.perturbations.grades import COMMENT_COLUMN, GRADES, starting_study
from tolerancing.perturbations.parameters import perturbation_from_table
from tolerancing.study.files import study_from_tables


def paper() -> Lens:
    return load_design(DESIGNS / "paper_singlet.toml")


def found(study, target, parameter):
    """The one perturbation of a target's parameter, or None."""
    tables = [t for t in study["perturbation"] if (t["target"], t["parameter"]) == (target, parameter)]
    assert len(tables) <= 1
    return tables[0] if tables else None


def read(lens, grade, design_name="design.toml"):
    """A starting study whose tables were checked one by one against the lens."""
    study = tomllib.loads(starting_study(lens, design_name, grade))
    columns = []
    for table in study["perturbation"]:
        perturbation = perturbation_from_table(table, "here")
        perturbation.check(lens)
        assert 0.0 < perturbation.distribution.largest < math.inf
        columns.append(perturbation.column)
    assert len(set(columns)) == len(columns)
    for table in study["merit"]:
        merit_from_table(table, "here").check(lens)
    return study


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("file", ["paper_singlet.toml"])
def test_studies_of_the_designs_load(tmp_path, grade, file):
    from tolerancing.study.files import load_study

    (tmp_path / file).write_bytes((DESIGNS / file).read_bytes())
    (tmp_path / "study.toml").write_text(starting_study(load_design(DESIGNS / file), file, grade))
    loaded = load_study(tmp_path / "study.toml")
    assert loaded.study.trials == 1000
    assert len(loaded.study.perturbations) > 15


def test_a_biconic_gets_tolerances_along_both_axes():
    lens = load_design(DESIGNS / "rectangular_sensor.toml")
    study = read(lens, "precision")
    for axis in ("", "_x"):
        assert found(study, "surface 1", f"radius{axis}_percent")["limit"] == 0.1
        radius = abs(getattr(lens.surfaces[1], f"radius{axis}_mm"))
        allowed = 32.0 * 0.25 * 632.8e-6 * radius**3 / lens.surfaces[1].semi_diameter_mm ** 4
        assert found(study, "surface 2", f"conic{axis}")["limit"] == pytest.approx(allowed, rel=1e-3)
    assert len([t for t in study["perturbation"] if t["parameter"] == "decenter_x_mm"]) == 3


def test_a_qbfs_has_no_tolerance_of_a_conic():
    keys = {"conic": 0.0, "normalization_radius_mm": 10.0, "q_mm": (0.02,)}
    lens = load_design(DESIGNS / "paper_singlet.toml").with_surface(1, shape="Qbfs", **keys)
    study = read(lens, "precision")
    assert not [t for t in study["perturbation"] if t["parameter"].startswith("conic")]
    assert found(study, "surface 2", "decenter_x_mm")


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(lens=lenses(), grade=st.sampled_from(list(GRADES)))
def test_studies_of_random_lenses_read_back(lens, grade):
    try:
        study = read(lens, grade)
    except DesignError as error:
        if "no ray" not in str(error):
            raise
        assume(False)
    assert study["title"].startswith(lens.title or "design.toml")
    for number, surface in enumerate(lens.surfaces, start=1):
        target, last = f"surface {number}", number == len(lens.surfaces)
        radii = [found(study, target, f"radius_{unit}") for unit in ("mm", "percent", "fringes")]
        assert sum(radius is not None for radius in radii) == (surface.radius_mm is not None)
        assert (found(study, target, "thickness_mm") is None) == last
        if last or surface.material in (None, 1.0):
            assert found(study, target, "index") is None
        bent = surface.kind in ("conic", "even asphere")
        assert (found(study, target, "decenter_x_mm") is not None) == bent
        assert (found(study, target, "conic") is not None) == (bent and surface.radius_mm is not None)
        around = lens.surfaces[:-1][max(number - 2, 0) : number]
        of_glass = any(s.material not in (None, 1.0) for s in around)
        assert (found(study, target, "tilt_y_deg") is not None) == of_glass
        figured = surface.semi_diameter_mm is not None
        assert (found(study, target, "irregularity_pv_waves") is not None) == figured


@pytest.mark.parametrize(
    ("grade", "numbers"),
    [
        ("commercial", (0.2, 0.15, 1.0, 0.05, 0.001, 0.8, 0.1, 0.2, 0.1, 0.5)),
        ("precision", (0.1, 0.05, 0.25, 0.01667, 0.0005, 0.5, 0.05, 0.1, 0.05, 0.2)),
        ("high_precision", (0.025, 0.01, 0.1, 0.008333, 0.0002, 0.2, 0.01, 0.03, 0.02, 0.1)),
    ],
)
def test_grades_hold_their_numbers(grade, numbers):
    study = read(paper(), grade)
    places = [
        ("surface 1", "radius_percent"),
        ("surface 1", "thickness_mm"),
        ("surface 1", "irregularity_pv_waves"),
        ("surface 2", "tilt_x_deg"),
        ("surface 1", "index"),
        ("surface 1", "abbe_percent"),
        ("lens", "decenter_x_mm"),
        ("lens", "tilt_y_deg"),
        ("sensor", "distance_mm"),
        ("sensor", "tilt_x_deg"),
    ]
    for place, number in zip(places, numbers, strict=True):
        table = found(study, *place)
        if place[1].startswith("irregularity"):
            assert table["mean"] + table["half_width"] == pytest.approx(number, rel=1e-3)
            assert table["mean"] == table["half_width"]
        else:
            assert table["limit"] == pytest.approx(number, rel=1e-3)
            assert table["sigma"] == pytest.approx(0.5 * number, rel=1e-3)


@pytest.mark.parametrize(
    ("scale", "thickness", "tilt_arcmin", "sagitta", "irregularity"),
    [
        (0.4, 0.1, 30.0, 5.0, 1.0),
        (1.0, 0.2, 20.0, 10.0, 2.0),
        (4.0, 0.4, 10.0, 10.0, 2.0),
        (6.0, 0.8, 10.0, 10.0, 2.0),
    ],
)
def test_general_tolerances_go_by_the_size_of_the_part(scale, thickness, tilt_arcmin, sagitta, irregularity):
    study = read(scaled(paper(), scale), "iso10110")
    assert found(study, "surface 1", "thickness_mm")["limit"] == thickness
    assert found(study, "surface 2", "tilt_x_deg")["limit"] == pytest.approx(tilt_arcmin / 60.0, rel=1e-3)
    waves = found(study, "surface 2", "irregularity_pv_waves")["half_width"] * 2.0
    assert waves * 632.8 == pytest.approx(irregularity * 546.07 / 2.0, rel=1e-3)
    tested = {4.0: 30.0, 6.0: 60.0}.get(scale, 20.0 * scale)
    # Fringes over the test area become more over the aperture, as its square.
    fringes = found(study, "surface 2", "radius_fringes")["limit"]
    assert fringes * 632.8 == pytest.approx(sagitta * 546.07 * (20.0 * scale / tested) ** 2, rel=1e-3)


def scaled(lens, factor):
    """All lengths of the lens, though not of the sensor's pixels, multiplied."""
    surfaces = tuple(
        s.replaced(
            **{
                key: None if getattr(s, key) is None else factor * getattr(s, key)
                for key in ("radius_mm", "thickness_mm", "semi_diameter_mm")
            }
        )
        for s in lens.surfaces
    )
    target = lens.object.replaced(
        field_diameter_mm=factor * lens.object.field_diameter_mm,
        working_distance_mm=factor * lens.object.working_distance_mm,
    )
    return lens.replaced(surfaces=surfaces, object=target)


def test_a_part_beyond_the_table_is_refused():
    with pytest.raises(InputError, match=r"surface 1: .*320 mm.*300 mm"):
        starting_study(scaled(paper(), 16.0), "a.toml", "iso10110")


def test_a_weak_surface_has_no_fringes_beyond_a_tenth_of_its_radius():
    weak = paper().with_surface(0, radius_mm=4e4)
    table = found(read(weak, "iso10110"), "surface 1", "radius_percent")
    assert table["limit"] == 10.0
    assert "reduced; 3/10(2)" in starting_study(weak, "a.toml", "iso10110")


def test_merits_follow_from_the_design():
    lens = paper()
    merits = {m.get("name", m["kind"]): m for m in read(lens, "precision")["merit"]}
    assert merits["fine_contrast_axis"]["line_width_um"] == pytest.approx(1.5 * 0.532)
    assert merits["fine_contrast_field"]["field_mm"] == [0.0, 1.05]
    assert merits["reconstruction_loss"]["patch_mm"] == pytest.approx(0.0532)
    assert merits["reconstruction_loss"]["field_points_mm"] == [[0.0, 0.0], [0.0, 1.05]]
    twin = lensdesign.scaled(lens, 1 / 64)  # its sensor planes are nearer as well
    small = {m["kind"]: m for m in read(twin, "precision")["merit"]}
    assert small["reconstruction_loss"]["patch_mm"] == pytest.approx(3.0 / 64, rel=1e-3)
    assert merits["largest_spread_deg"]["at_most"] == pytest.approx(1.02 * 4.7682, rel=1e-3)
    wide = lens.replaced(sensor=lens.sensor.replaced(pixel_pitch_um=6.4))
    merits = {m["kind"]: m for m in read(wide, "precision")["merit"]}
    assert merits["largest_spread_deg"]["at_most"] == pytest.approx(
        1.01 * largest_spread_angle(lens).spread_deg, rel=1e-3
    )
    fine = lens.replaced(sensor=lens.sensor.replaced(pixel_pitch_um=0.2))
    text = starting_study(fine, "a.toml", "precision")
    assert "largest_spread_deg" not in text
    assert "the pixels resolve every angle" in text


@pytest.mark.parametrize(
    "name", ['a "b" \\ c.toml', "tab\t.toml", "\u2028line\x85.toml", "# no comment = 1", "été.toml"]
)
def test_names_and_titles_are_escaped(name):
    study = read(paper().replaced(title=name), "precision", name)
    assert study["design"] == name
    assert study["title"] == f"{name}: precision grade"


@pytest.mark.parametrize("grade", GRADES)
def test_comments_are_aligned_and_lines_short(grade):
    text = starting_study(paper(), "paper_singlet.toml", grade)
    assert "\n\n\n" not in text
    assert text.endswith("\n")
    commented = [line for line in text.splitlines() if "#" in line and not line.startswith("#")]
    assert len(commented) > 20
    assert {line.index("#") for line in commented} == {COMMENT_COLUMN}
    assert max(len(line) for line in text.splitlines()) <= 110
    assert {t["distribution"] for t in tomllib.loads(text)["perturbation"]} <= set(DISTRIBUTIONS)


@pytest.mark.parametrize("process", ["moulded_glass", "moulded_plastic"])
def test_moulded_grades_are_the_references_of_costs(process):
    costs = load_costs(None).processes[process].prices
    grade = GRADES[process]
    assert grade is not None
    for quantity, value in {
        "radius_percent": grade.radius_percent,
        "thickness_mm": grade.thickness_mm,
        "irregularity_pv_waves": grade.irregularity_pv_waves,
        "tilt_deg": grade.wedge_deg,
        "decenter_mm": grade.asphere_decenter_mm,
        "index": grade.index,
        "abbe_percent": grade.abbe_percent,
    }.items():
        assert costs[quantity].reference == value, quantity


def test_an_unknown_grade_is_refused():
    with pytest.raises(InputError, match=r"grade = 'precise'.*commercial.*iso10110.*did you mean precision"):
        starting_study(paper(), "a.toml", "precise")


def test_general_tolerances_loosen_with_size():
    assert sorted(GENERAL) == list(GENERAL) == [10.0, 30.0, 100.0, 300.0]


@pytest.mark.parametrize("grade", ["commercial", "precision", "high_precision"])
def test_a_calibrated_study_adapts_what_its_mount_leaves(grade):
    lens = paper()
    calibrated, nominal = (
        study_from_tables(tomllib.loads(starting_study(lens, "design.toml", grade, one)), "here")
        for one in (True, False)
    )
    assert not nominal.compensators
    assert nominal.replaced(compensators=calibrated.compensators) == calibrated
    limits = {one.column: one.limit for one in calibrated.compensators}
    mount = {p.column: p.tolerance for p in calibrated.perturbations if p.target == "lens"}
    assert limits == {column: pytest.approx(2.0 * tolerance) for column, tolerance in mount.items()}


@pytest.mark.parametrize("name", ["phone_lens", "single_complex", "single_phase"])
def test_starting_studies_of_short_cameras_compare_wavefronts_before_the_caustic(name):
    from tolerancing.study.evaluate import context_of

    lens = load_design(DESIGNS / f"{name}.toml")
    study = study_from_tables(read(lens, "high_precision"), "here")
    assert 0.0 < study.sampling.plane_distance_mm <= min(lens.sensor.plane_distances_mm)
    context = context_of(lens, study)
    for field_mm in ((0.0, 0.0), (0.0, lens.half_field_mm)):
        determinants = context.sampler(field_mm, lens.wavelengths_um[0]).nominal.determinant_mm2
        assert determinants.min() > 0.0


@pytest.mark.parametrize(
    ("name", "expected"), [("phone_lens", True), ("single_complex", False), ("single_phase", False)]
)
def test_starting_studies_judge_losses_only_where_rays_do_not_cross(name, expected):
    lens = load_design(DESIGNS / f"{name}.toml")
    kinds = {merit["kind"] for merit in read(lens, "precision")["merit"]}
    assert ("reconstruction_loss" in kinds) == expected
    assert {"line_pair_contrast", "rms_waves"} <= kinds


def test_starting_studies_compare_wavefronts_on_the_first_plane():
    assert read(paper(), "precision")["sampling"]["plane_distance_mm"] == 2.0


def test_starting_studies_are_calibrated_unless_asked_otherwise(tmp_path):
    from tolerancing.cli.commands import app

    for option, expected in (("--calibrated", 4), ("--nominal-mounting", 0), (None, 4)):
        path = tmp_path / f"{option}.toml"
        words = ["start", str(DESIGNS / "paper_singlet.toml"), "-o", str(path), *([option] if option else [])]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
        assert len(tables.get("compensator", [])) == expected
        assert tables["scaled_trials"] == {"factors": [0.5, 2.0], "trials": 100}
