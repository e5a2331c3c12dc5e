"""Study files: what is read, and every fault with its place and what is allowed."""

import shutil
import tomllib

import pytest
from places import DESIGNS

from lensdesign import DesignError
from tolerancing.perturbations import draws
from tolerancing.study.files import load_from_files, load_study, save_study, start_study


def test_study_is_read_with_its_design(write_study, full_study):
    path = write_study(full_study)
    loaded = load_study(path)
    study = loaded.study
    assert (study.title, study.trials, study.seed, study.sampling.arms) == ("a study", 40, 7, 6)
    assert [p.column for p in study.perturbations] == ["lens_decenter_y_mm", "shop_radius_mm"]
    assert [(m.kind, m.limit, m.column) for m in study.merits] == [
        ("largest_spread_deg", 4.83, "largest_spread_deg"),
        ("strehl", 0.5, "strehl"),
    ]
    assert [m.label for m in study.sweeps[0].scored(study.merits)] == [
        "largest_spread_deg",
        "contrast_1um_refocused",
        "contrast_1um",
    ]
    assert loaded.lens.surfaces[1].radius_mm == -12.0
    assert loaded.study_text == full_study


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seed = 7", "sed = 7", r"study.toml: sed: .*did you mean seed"),
        ("sigma = 0.02", "sgma = 0.02", r"perturbation 1: sgma: .*did you mean sigma"),
        ('design = "design.toml"', 'design = "a\\u0000"', r"cannot read .*null byte"),
        ("trials = 40", "trials = 0", r"trials = 0.* 1"),
        ("trials = 40", "", r"trials: missing key"),
        ("sigma = 0.02", "sigma = -0.02", r"study.toml: perturbation 1: sigma = -0.02"),
        ('"normal"', '"gauss"', r"perturbation 1: distribution = 'gauss'.*allowed: normal, truncated_normal"),
        ('"surface 2"', '"surface 9"', r"perturbation 2: target = 'surface 9'.*allowed: lens, surface 1"),
        (
            'kind = "largest_spread_deg"',
            'kind = "largest"',
            r"merit 1: kind = 'largest'.*allowed: largest_sp",
        ),
        ("at_most = 4.83", "", r"merit 1: .*at_least or at_most.*missing"),
        ("at_most = 4.83", "at_most = 5.0\nat_least = 1.0", r"merit 1: .*both are given"),
        ("at_most = 4.83", "at_most = 5.0\nfield_points_mm = [[0.0, 2.0]]", r"lies 2 mm from the axis"),
        ("at_most = 4.83", "at_most = 5.0\nline_width_um = 1.0", r"merit 1: line_width_um: unknown key"),
        ("trials = 40", 'trials = 40\ndraws = "halton"', r"draws = 'halton'.*'latin_hypercube'"),
        ("sigma = 0.02", 'sigma = 0.02\ngroup = "cell"', r"group 'cell': has one member"),
        (
            "at_most = 4.83",
            'at_most = 5.0\n[[correlation]]\nnames = ["lens_decenter_y", "shop_radus"]\ncoefficient = 0.5',
            r"correlation 1: .*'shop_radus'.*did you mean shop_radius",
        ),
        (
            "at_most = 4.83",
            'at_most = 5.0\n[[correlation]]\nnames = ["lens_decenter_y", "shop_radius"]\n'
            "matrix = [[1.0, 0.5], [0.4, 1.0]]",
            r"correlation 1: matrix: lens_decenter_y with shop_radius is 0.5",
        ),
        (
            "at_most = 4.83",
            'at_most = 5.0\n[[compensator]]\ntarget = "light"\nparameter = "wavelength_um"\nlimit = 1.0',
            r"compensator 1: .*cannot adapt",
        ),
        (
            "at_most = 4.83",
            'at_most = 5.0\n[[compensator]]\ntarget = "surface 7"\nparameter = "conic"\nlimit = 1.0',
            r"compensator 1: target = 'surface 7'",
        ),
        (
            "at_most = 4.83",
            'at_most = 5.0\n[[merit]]\nkind = "strehl"\nname = "s"\nat_least = 0.5\npredicted_by = "speed"',
            r"merit 's': predicted_by: .*'speed'.*largest_spread_deg",
        ),
        (
            "at_most = 4.83",
            'at_most = 5.0\n[[merit]]\nkind = "python"\nfunction = "mine.txt:f"\nat_least = 0.5',
            r"merit 2: function: 'mine.txt:f'.*file.py:name",
        ),
        (
            "at_most = 4.83",
            'at_most = 5.0\n[[merit]]\nkind = "python"\nfunction = "mine.py:f"\nat_least = 0.5',
            r"merit 2: cannot read .*mine.py",
        ),
        (
            "at_most = 4.83",
            'at_most = 5.0\n[[grid]]\nname = "g"\nmerits = ["strehl"]\n'
            '[grid.x]\ntarget = "lens"\nparameter = "tilt_x_deg"\nvalues = [0.0]\n'
            '[grid.y]\ntarget = "lens"\nparameter = "tilt_x_deg"\nvalues = [0.0]',
            r"grid 1: .*x and y .*lens_tilt_x_deg",
        ),
        (
            "at_most = 4.83",
            "at_most = 5.0\n[[slice_count]]\nslices = [10, 10]\nline_widths_um = [1.0]",
            r"slice_count 1: .*must be different from each other",
        ),
        ("arms = 6", "arms = 1", r"sampling, arms = 1"),
        ('design = "design.toml"', 'design = "none.toml"', r"cannot read .*none.toml"),
        ('merits = ["largest_spread_deg"]', 'merits = ["speed"]', r"no merit 'speed'.*larg"),
        (
            "picture_values = [0.04]",
            "picture_values = [0.05]",
            r"sweep 1: picture_values = \[0.05\]: allowed",
        ),
        ("line_widths_um = [1.0]", "line_widths_um = [-1.0]", r"sweep 1: line_widths_um 1 = -1.0"),
        ('name = "shop_radius"', 'name = "lens_decenter_y"', r"both called 'lens_decenter_y_mm'"),
    ],
)
def test_faults_name_their_place(write_study, full_study, old, new, message):
    assert old in full_study
    path = write_study(full_study.replace(old, new, 1))
    with pytest.raises(DesignError, match=message):
        load_study(path)


def test_all_faults_are_told_at_once(write_study, full_study):
    text = full_study.replace("sigma = 0.02", "sigma = -1.0").replace("at_most = 4.83", "")
    with pytest.raises(DesignError) as error:
        load_study(write_study(text))
    assert len(str(error.value).splitlines()) == 2


def test_names_must_differ(write_study, full_study):
    path = write_study(
        full_study.replace('name = "shop_radius"', 'name = "strehl"').replace("radius_mm", "conic")
    )
    with pytest.raises(DesignError, match="both called 'strehl'"):
        load_study(path)


def test_sections_must_be_arrays_of_tables(write_study, full_study):
    path = write_study(full_study.replace("[[merit]]", "[merit]", 1).replace("[[merit]]", "[other]"))
    with pytest.raises(DesignError, match=r"merit: .*\[\[merit\]\]"):
        load_study(path)


def test_fingerprint_follows_how_trials_are_drawn(write_study, full_study, monkeypatch):
    """A store whose trials were drawn by other designs is not gone on with."""
    assert "draws" not in full_study
    plain = full_study.replace("seed = 7", 'seed = 7\ndraws = "random"')
    designed = plain.replace('"random"', '"sobol"')
    before = [load_study(write_study(text)).fingerprint for text in (plain, designed)]
    monkeypatch.setattr(draws, "REPLICATES", 8)
    after = [load_study(write_study(text)).fingerprint for text in (plain, designed)]
    assert after[0] == before[0]
    assert after[1] != before[1]


def test_fingerprint_follows_study_design_and_indices(write_study, full_study):
    first = load_study(write_study(full_study)).fingerprint
    assert load_study(write_study(full_study)).fingerprint == first
    assert load_study(write_study(full_study.replace("seed = 7", "seed = 8"))).fingerprint != first
    path = write_study(full_study)
    design = path.parent / "design.toml"
    design.write_text(design.read_text().replace("42.3", "42.4"))
    assert load_study(path).fingerprint != first


def test_no_perturbation_is_too_few(write_study, ray_study):
    head, _, rest = ray_study.partition("[[perturbation]]")
    path = write_study("perturbation = []\n" + head + "[[merit]]" + rest.partition("[[merit]]")[2])
    with pytest.raises(DesignError, match=r"perturbation = \[\].*at least 1"):
        load_study(path)


def test_byte_order_marks_are_passed_over(write_study, full_study):
    plain = load_study(write_study(full_study))
    path = write_study("\ufeff" + full_study)
    design = path.parent / "design.toml"
    design.write_text("\ufeff" + design.read_text(encoding="utf-8"), encoding="utf-8")
    again = load_study(path)
    assert again.study == plain.study
    assert again.lens == plain.lens


def test_a_study_is_read_again_from_its_files(write_study, full_study, tmp_path):
    deviations = tmp_path / "measured.csv"
    deviations.write_text("part,radius\n1,0.001\n2,-0.002\n3,0.004\n")
    (tmp_path / "mine.py").write_text("def tilt(trial):\n    return trial.state.pose.tilt_x_deg\n")
    text = full_study.replace(
        'distribution = "truncated_normal"\nsigma = 0.01\nlimit = 0.02',
        'distribution = "empirical"\nfile = "measured.csv"\ncolumn = "radius"',
    )
    text += '\n[[merit]]\nkind = "python"\nfunction = "mine.py:tilt"\nat_most = 1.0\n'
    loaded = load_study(write_study(text))
    assert set(loaded.files) == {"study.toml", "design.toml", "measured.csv", "mine.py"}
    again = load_from_files(loaded.name, loaded.files, make(tmp_path / "elsewhere"))
    assert again.study == loaded.study
    assert again.fingerprint == loaded.fingerprint
    assert again.study.perturbations[1].distribution.standard_deviation > 0.0
    deviations.write_text("part,radius\n1,0.001\n2,-0.002\n3,0.005\n")
    assert load_study(tmp_path / "study.toml").fingerprint != loaded.fingerprint


def test_files_that_lead_out_of_the_folder_are_refused(write_study, ray_study, tmp_path):
    loaded = load_study(write_study(ray_study))
    folder = make(tmp_path / "elsewhere")
    with pytest.raises(DesignError, match="out of the study's folder"):
        load_from_files(loaded.name, {**loaded.files, "../outside.txt": b"x"}, folder)
    assert not (tmp_path / "outside.txt").exists()


def make(folder):
    folder.mkdir()
    return folder


@pytest.mark.parametrize("name", ["paper_tolerances.toml", "paper_figure_7.toml"])
def test_a_study_that_was_saved_is_the_same(name, tmp_path):
    study = load_study(DESIGNS / name).study
    shutil.copy(DESIGNS / study.design, tmp_path)
    save_study(study, tmp_path / "again.toml")
    assert load_study(tmp_path / "again.toml").study == study
    assert tomllib.loads((tmp_path / "again.toml").read_text()) == tomllib.loads((DESIGNS / name).read_text())


def test_a_study_changed_in_memory_is_saved(write_study, full_study):
    path = write_study(full_study)
    study = load_study(path).study
    save_study(study.replaced(trials=7), path)
    assert load_study(path).study == study.replaced(trials=7)


def test_a_started_study_is_one_of_its_design(paper_design, paper_lens, tmp_path):
    (tmp_path / "studies").mkdir()
    path = tmp_path / "studies" / "first.toml"
    start_study(paper_design, path, "commercial")
    loaded = load_study(path)
    assert loaded.lens == paper_lens
    assert "commercial" in loaded.study.title
