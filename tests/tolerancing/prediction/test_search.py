"""Searches for lenses as built: exact gradients, what they find, and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from places import DESIGNS
from typer.testing import CliRunner

from lensdesign import load_design
from lensdesign.cli.commands import app
from lensdesign.errors import DesignError, InputError
from lensdesign.exploration import Exploration, axes_of
from lensdesign.optimization import check_against, load_specification
from lensdesign.optimization.as_built import read_as_built
from lensdesign.optimization.problem import DesignProblem
from lensdesign.optimization.specification.sections import Tolerances
from tolerancing import load_study
from tolerancing.prediction import predict_study

CONIC = """
[[variable]]
surface = 1
parameter = "conic"
bounds = [-20.0, 20.0]

[[variable]]
parameter = "working_distance_mm"
bounds = [12.0, 14.0]
"""
WEDGE = """
[[perturbation]]
name = "figure"
target = "surface 1"
parameter = "irregularity_pv_waves"
distribution = "normal"
sigma = 0.1
"""


def specified(study: Path, name: str, more: str = "", **changes: str) -> Path:
    """The thinnest lens's specification with other lines, beside a study."""
    text = (DESIGNS / "thinnest_singlet_spec.toml").read_text(encoding="utf-8")
    text = text.replace(
        "[constraints]", f'[tolerances]\nstudy = "{study.name}"\ntrials = 100\n\n[constraints]'
    )
    for old, new in {"bounds = [2.0, 20.0]": "bounds = [2.0, 9.7]", **changes}.items():
        assert old in text, old
        text = text.replace(old, new)
    path = study.parent / name
    path.write_text(text + more, encoding="utf-8")
    return path


@pytest.fixture
def figured_study(wavefront_study: Path, tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(wavefront_study.read_text(encoding="utf-8") + WEDGE, encoding="utf-8")
    (tmp_path / "paper_singlet.toml").write_bytes((DESIGNS / "paper_singlet.toml").read_bytes())
    return path


SECOND_WAVELENGTH = """
[[merit]]
name = "red"
kind = "rms_waves"
field_points_mm = [[0.0, 0.0], [0.0, 1.2]]
wavelength_um = 0.6328
at_most = 0.1
"""


@pytest.mark.parametrize(
    ("wavelengths", "tolerances"), [("[0.532]", ""), ("[0.6328, 0.532]", ""), ("[0.532]", "cost = 10.0\n")]
)
def test_gradients_are_those_of_differences(figured_study: Path, wavelengths: str, tolerances: str) -> None:
    """Of all variables at once, a figure on a surface of open size among the perturbations."""
    asked = {
        '"thinnest lens"': '"yield"',
        "wavelengths_um = [0.532]": f"wavelengths_um = {wavelengths}",
        "[tolerances]\n": f"[tolerances]\n{tolerances}",
    }
    if "0.6328" in wavelengths:
        whole = figured_study.read_text(encoding="utf-8")
        both = whole.replace('kind = "rms_waves"\n', 'kind = "rms_waves"\nwavelength_um = 0.532\n')
        figured_study.write_text(both + SECOND_WAVELENGTH, encoding="utf-8")
    path = specified(figured_study, "spec.toml", CONIC, **asked)
    problem = DesignProblem(specification := load_specification(path), specification.lens)
    point = problem.to_unit(load_design(DESIGNS / "thinnest_singlet.toml"))
    here = problem.as_built(point)
    assert here is not None
    step = 1e-5
    slack = 1e-4 * np.max(np.abs(here.failing_by * problem.width))
    for k, axis in enumerate(np.eye(len(point))):
        ends = [problem.as_built(point + sign * step * axis, False) for sign in (1.0, -1.0)]
        high, low = (end for end in ends if end is not None)
        width = 2.0 * step * problem.width[k]
        np.testing.assert_allclose(here.rms_by[:, k], (high.rms_waves - low.rms_waves) / width, rtol=2e-4)
        failing_by = (high.failing - low.failing) / width
        assert here.failing_by[k] == pytest.approx(failing_by, rel=2e-3, abs=slack / problem.width[k])


def test_goal_is_met_from_a_plate_and_told_beside_the_studys_lens(wavefront_study: Path) -> None:
    """With the stop on the back surface, twice as many lenses are good as of the paper's."""
    path = specified(
        wavefront_study,
        "yield.toml",
        **{
            '"thinnest lens"': '"as-built rms"',
            "semi_diameter_mm = 8.26\nstop = true\n\n[[surface]]": "\n[[surface]]\nsemi_diameter_mm = 8.26\n"
            "stop = true",
        },
    )
    output = path.with_suffix(".out.toml")
    shown = CliRunner().invoke(app, ["optimize", str(path), "-o", str(output), "--starts", "1", "--json"])
    assert shown.exit_code == 0, shown.output
    found = json.loads(shown.stdout)
    before, after = found["as_built"]["rows"]
    assert (before["name"], after["name"]) == ("lens of the study", "result")
    assert after["good"] > before["good"] + 0.2
    np.testing.assert_allclose(after["rms_waves"], after["predicted_rms_waves"], rtol=0.15)
    assert max(after["predicted_rms_waves"]) == pytest.approx(found["goal_value"], rel=1e-2)


COMPENSATORS = """
[[compensator]]
target = "lens"
parameter = "decenter_x_mm"
limit = 0.01

[[compensator]]
target = "lens"
parameter = "decenter_y_mm"
limit = 0.05
"""


def test_compensators_are_searched_and_predicted_as_trials_take_them(
    wavefront_study: Path, tmp_path: Path
) -> None:
    """More lenses are good than without; what is predicted lies in the interval of the trials."""
    (tmp_path / "paper_singlet.toml").write_bytes((DESIGNS / "paper_singlet.toml").read_bytes())
    study = tmp_path / "study.toml"
    text = wavefront_study.read_text(encoding="utf-8").replace("at_most = 0.12", "at_most = 0.09")
    study.write_text(text + COMPENSATORS, encoding="utf-8")
    path = specified(study, "spec.toml", **{'"thinnest lens"': '"yield"', "trials = 100": "trials = 200"})
    output = tmp_path / "found.toml"
    shown = CliRunner().invoke(app, ["optimize", str(path), "-o", str(output), "--starts", "1", "--json"])
    assert shown.exit_code == 0, shown.output
    found = json.loads(shown.stdout)
    before, after = found["as_built"]["rows"]
    assert before["good"] < after["good"] < 0.99
    for row in (before, after):
        assert row["low"] <= row["predicted_good"] <= row["high"]
        np.testing.assert_allclose(row["rms_waves"], row["predicted_rms_waves"], rtol=0.1)
    assert found["goal_value"] == pytest.approx(100.0 * after["predicted_good"])
    again = predict_study(load_design(output), load_study(study).study)
    assert after["predicted_good"] == pytest.approx(again.yield_fraction, abs=1e-3)


def test_a_yield_that_no_lens_reaches_ends_with_the_best(wavefront_study: Path) -> None:
    path = specified(wavefront_study, "most.toml", **{"[constraints]\n": "[constraints]\nmin_yield = 0.99\n"})
    output = path.with_suffix(".out.toml")
    shown = CliRunner().invoke(app, ["optimize", str(path), "-o", str(output), "--starts", "1"])
    assert shown.exit_code == 1
    assert "not met: yield: 0." in shown.output
    assert "can be met: a predicted yield of 0.7" in shown.output
    assert load_design(output).surfaces[0].material == "N-BK7"


def test_what_a_search_cannot_use_is_refused(wavefront_study: Path, tmp_path: Path) -> None:
    study = wavefront_study.read_text(encoding="utf-8")
    (tmp_path / "paper_singlet.toml").write_bytes((DESIGNS / "paper_singlet.toml").read_bytes())
    with pytest.raises(DesignError, match="no such file"):
        load_specification(specified(tmp_path / "none.toml", "a.toml", **{'"thinnest lens"': '"yield"'}))
    far = tmp_path / "far.toml"
    far.write_text(study.replace("[0.0, 1.4]", "[0.0, 1.45]"), encoding="utf-8")
    smaller = {'"thinnest lens"': '"yield"', "field_diameter_mm = 3.0": "field_diameter_mm = 2.0"}
    with pytest.raises(DesignError, match=r"1\.45 mm from the axis"):
        load_specification(specified(far, "b.toml", **smaller))
    text = specified(wavefront_study, "c.toml", **{'"thinnest lens"': '"yield"'}).read_text(encoding="utf-8")
    lone = tmp_path / "d.toml"
    lone.write_text(text.replace("[tolerances]\n", "").replace('study = "study.toml"\ntrials = 100\n', ""))
    with pytest.raises(DesignError, match=r"\[tolerances\] study"):
        load_specification(lone)


def test_each_wavelength_is_judged_as_by_itself(wavefront_study: Path, tmp_path: Path) -> None:
    (tmp_path / "paper_singlet.toml").write_bytes((DESIGNS / "paper_singlet.toml").read_bytes())
    green = wavefront_study.read_text(encoding="utf-8")
    found = []
    for name, study, wavelengths in (
        ("both", green + SECOND_WAVELENGTH, "[0.532, 0.6328]"),
        ("green", green, "[0.532]"),
        ("red", green[: green.index("[[merit]]")] + SECOND_WAVELENGTH, "[0.6328]"),
    ):
        own = tmp_path / f"{name}.toml"
        own.write_text(study, encoding="utf-8")
        asked = {'"thinnest lens"': '"yield"', "wavelengths_um = [0.532]": f"wavelengths_um = {wavelengths}"}
        specification = load_specification(specified(own, f"{name}_spec.toml", **asked))
        problem = DesignProblem(specification, specification.lens)
        values = problem.as_built(problem.to_unit(load_design(DESIGNS / "thinnest_singlet.toml")))
        assert values is not None
        found.append(values)
    both, one, other = found
    np.testing.assert_allclose(both.rms_waves, [*one.rms_waves, *other.rms_waves])
    np.testing.assert_allclose(both.rms_by, np.concatenate([one.rms_by, other.rms_by]))
    assert both.failing > one.failing


def test_a_wavelength_that_the_specification_does_not_have_is_refused(figured_study: Path) -> None:
    with figured_study.open("a", encoding="utf-8") as more:
        more.write(SECOND_WAVELENGTH)
    study = read_as_built(Tolerances(study=str(figured_study)))
    with pytest.raises(DesignError, match=r"0\.6328 µm.*allowed.*0\.532 µm"):
        study.check(load_design(DESIGNS / "paper_singlet.toml"))


def test_tolerances_of_surfaces_that_are_not_there_are_refused(wavefront_study: Path) -> None:
    study = read_as_built(Tolerances(study=str(wavefront_study)))
    lens = load_design(DESIGNS / "thinnest_singlet.toml")
    one = lens.model_copy(update={"surfaces": lens.surfaces[1:]})
    with pytest.raises(DesignError, match="surface 2"):
        study.check(one)


HEAT = """
[[perturbation]]
target = "environment"
parameter = "temperature_c"
distribution = "normal"
sigma = 2.0
"""


def test_lenses_as_built_are_asked_for_at_temperatures(wavefront_study: Path) -> None:
    """Exact gradients there too, and a table of each constraint at each temperature in the end."""
    warm = {"[constraints]\n": "[environment]\ntemperatures_c = [50]\n\n[constraints]\nmin_yield = 0.6\n"}
    asked = load_specification(path := specified(wavefront_study, "warm.toml", **warm))
    problem = DesignProblem(asked, asked.lens).heated[0]
    point = problem.to_unit(load_design(DESIGNS / "thinnest_singlet.toml"))
    here, step = problem.as_built(point), 1e-5
    assert here is not None
    for k, axis in enumerate(np.eye(len(point))):
        ends = [problem.as_built(point + sign * step * axis, False) for sign in (1.0, -1.0)]
        high, low = (end for end in ends if end is not None)
        width = 2.0 * step * problem.width[k]
        np.testing.assert_allclose(here.rms_by[:, k], (high.rms_waves - low.rms_waves) / width, rtol=1e-5)
    command = ["optimize", str(path), "-o", str(path.with_suffix(".out.toml")), "--max-evaluations", "2"]
    shown = CliRunner().invoke(app, command)
    assert "max_evaluations = 2 ended the search" in shown.output
    assert re.search(r"constraint +┃ +limit ┃ 20 C +┃ 50 C", shown.output)
    assert re.search(r"│ yield +│ +≥ 0\.6 │ [01](\.\d+)? +│ [01](\.\d+)? ", shown.output)


def test_a_study_that_perturbs_the_temperature_is_none_of_a_lens_at_one(
    wavefront_study: Path, tmp_path: Path
) -> None:
    (tmp_path / "paper_singlet.toml").write_bytes((DESIGNS / "paper_singlet.toml").read_bytes())
    study = tmp_path / "heat.toml"
    study.write_text(wavefront_study.read_text(encoding="utf-8") + HEAT, encoding="utf-8")
    warm = {"[constraints]\n": "[environment]\ntemperatures_c = [50]\n\n[constraints]\nmin_yield = 0.6\n"}
    with pytest.raises(DesignError, match=r"environment.*N-BK7@50C"):
        load_specification(specified(study, "spec.toml", **warm))


def test_a_cost_scales_the_tolerances_of_each_lens(wavefront_study: Path) -> None:
    """Costs beyond the elements' are reciprocals of tolerances, and wavefronts grow with them."""
    lens, found = load_design(DESIGNS / "thinnest_singlet.toml"), {}
    own = read_as_built(Tolerances(study=str(wavefront_study))).cost(lens)
    for cost in (None, 5.0, 9.0):
        asked = load_specification(specified(wavefront_study, "cost.toml"))
        asked = asked.replaced(
            optimize=asked.optimize.replaced(goal="as-built rms"),
            tolerances=asked.tolerances.replaced(cost=cost),
        )
        problem = DesignProblem(asked, asked.lens)
        found[cost] = problem.as_built(problem.to_unit(lens), False).rms_waves
    np.testing.assert_allclose(found[5.0], 2.0 * found[9.0], rtol=1e-12)
    np.testing.assert_allclose(found[9.0], (own - 1.0) / 8.0 * found[None], rtol=1e-3)
    tried = read_as_built(Tolerances(study=str(wavefront_study), cost=9.0)).trials([("", lens)], 400)
    np.testing.assert_allclose(tried.rows[0].rms_waves, found[9.0], rtol=0.1)


GAPS = """
default = "shop"
mount = "shop"
[process.shop]
source = "quotation"
decenter_mm = { reference = 0.05, share = 0.2 }
tilt_deg = { reference = 0.05, share = 0.2 }
"""


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ('cost = 9.0\ncosts = "gaps.toml"\n', "process.shop has no radius_percent, for surface_1_radius_mm"),
        ("cost = 0.5\n", "cost = 0.5: must be above 1"),
        ("cost = 9.0\nfactor = 2.0\n", "cost = 9 and factor = 2: give one of them"),
        ('cost = 9.0\ncosts = "none.toml"\n', "none.toml"),
    ],
)
def test_costs_that_are_none_are_refused(wavefront_study: Path, lines: str, said: str) -> None:
    (wavefront_study.parent / "gaps.toml").write_text(GAPS, encoding="utf-8")
    path = specified(
        wavefront_study,
        "priced.toml",
        **{'"thinnest lens"': '"yield"', "[tolerances]\n": f"[tolerances]\n{lines}"},
    )
    output = path.with_suffix(".out.toml")
    shown = CliRunner().invoke(app, ["optimize", str(path), "-o", str(output)])
    assert shown.exit_code != 0
    assert said in str(shown.exception)
    assert not output.exists()


def test_cost_is_traded_for_what_is_built(wavefront_study: Path) -> None:
    """Each lens of the front costs what it was held to, the dearer the better."""
    design = '"design"\nstarts = 1\nmax_evaluations = 25'
    loose = {'"plate"': design, 'max_spread_deg = "sensor"': "max_spread_deg = 5.5"}
    asked = load_specification(specified(wavefront_study, "dear.toml", **loose))
    lens = load_design(DESIGNS / "thinnest_singlet.toml")
    asked = asked.model_copy(update={"surfaces": lens.surfaces, "object": lens.object})
    axes = axes_of("cost=6:12,as_built_rms", asked)
    found = [one.values for one in Exploration(asked, axes, lenses=2).run()]
    own, cheap, dear = found
    assert (cheap["cost"], dear["cost"]) == (6.0, 12.0)
    assert 6.0 < own["cost"] < 12.0
    assert cheap["as_built_rms_waves"] == pytest.approx(11 / 5 * dear["as_built_rms_waves"], rel=0.1)
    low, high = axes_of("cost,as_built_rms", asked)[0].bounds or (0.0, 0.0)
    assert high - 1.0 == pytest.approx(4.0 * (low - 1.0))
    with pytest.raises(InputError, match="cost has no effect without as_built_rms or yield"):
        axes_of("thickness,cost", asked)


def test_two_elements_on_the_papers_track_are_good_as_built() -> None:
    asked = load_specification(DESIGNS / "as_built_pair_spec.toml")
    lens = load_design(DESIGNS / "as_built_pair.toml")
    assert check_against(lens, asked).feasible
    problem = DesignProblem(asked, asked.lens)
    (found,) = problem.predicted(problem.to_unit(lens))
    assert found.failing < 0.025
