"""Mean reconstruction losses in searches: derivatives, the constraint, what is shown in the end."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from places import DESIGNS
from typer.testing import CliRunner

from lensdesign import load_design
from lensdesign.cli.commands import app
from lensdesign.errors import DesignError
from lensdesign.optimization import check_against, load_specification
from lensdesign.optimization.problem import DesignProblem
from lensdesign.optimization.search import bases_of

LOSS = """
[[merit]]
name = "loss"
kind = "reconstruction_loss"
patch_mm = 0.02
field_mm = [0.0, 1.2]
at_most = 0.05
"""
MOUNTING = """
[[compensator]]
target = "lens"
parameter = "decenter_x_mm"
limit = 0.05

[[compensator]]
target = "lens"
parameter = "decenter_y_mm"
limit = 0.05
"""
GOAL = "as-built reconstruction loss"


def specified(folder: Path, merits: str = LOSS, goal: str = GOAL, limit: float | None = None) -> Path:
    """The specification of lenses as built, with another goal and another study."""
    study = (DESIGNS / "as_built_tolerances.toml").read_text(encoding="utf-8")
    study = study[: study.index("# What a good lens is")] + merits
    (folder / "study.toml").write_text(study, encoding="utf-8")
    (folder / "paper_singlet.toml").write_bytes((DESIGNS / "paper_singlet.toml").read_bytes())
    text = (DESIGNS / "as_built_spec.toml").read_text(encoding="utf-8")
    text = text.replace('goal = "yield"', f'goal = "{goal}"\nstarts = 1\nmax_evaluations = 6')
    text = text.replace('"as_built_tolerances.toml"', '"study.toml"\ntrials = 100')
    if limit is not None:
        text = text.replace("[constraints]", f"[constraints]\nmax_as_built_reconstruction_loss = {limit}")
    text = text[: text.rindex("[[variable]]")]  # the stop stays where it is
    path = folder / "spec.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("merits", [LOSS, MOUNTING + LOSS], ids=["nominal", "calibrated"])
def test_derivatives_are_those_of_differences(tmp_path: Path, merits: str) -> None:
    specification = load_specification(specified(tmp_path, merits))
    problem = DesignProblem(specification, next(bases_of(specification))[1])
    point = problem.to_unit(load_design(DESIGNS / "paper_singlet.toml"))
    found = problem.losses(point)
    assert found is not None
    assert problem.as_built(point) is None
    for k in (1, 2):
        step = 1e-3 * np.eye(len(point))[k]
        high, low = (problem.losses(point + sign * step, False) for sign in (1.0, -1.0))
        assert high is not None
        assert low is not None
        slope = (high.losses - low.losses) / (2e-3 * problem.width[k])
        assert slope == pytest.approx(found.losses_by[:, k], rel=0.03)


def test_a_search_shows_losses_of_fresh_trials_and_predicted(tmp_path: Path) -> None:
    path = specified(tmp_path)
    done = CliRunner().invoke(app, ["optimize", str(path), "-o", str(tmp_path / "found.toml")])
    shown = re.sub(r"\s+", " ", done.output)
    assert "Mean reconstruction loss of the same trials" in shown
    assert "loss, nominal model" in shown
    rows = re.findall(r"(lens of the study|result) . ([\d.e-]+) \+- ([\d.e-]+) \(([\d.e-]+)\)", shown)
    assert [row[0] for row in rows] == ["lens of the study", "result"]
    for _, mean, twice_error, predicted in rows:
        assert float(predicted) == pytest.approx(float(mean), abs=2.0 * float(twice_error))


def test_a_limit_is_judged_by_trials(tmp_path: Path) -> None:
    lens = load_design(DESIGNS / "paper_singlet.toml")
    specification = load_specification(specified(tmp_path, goal="thinnest lens", limit=1e-6))
    assert specification.as_built is not None
    built = specification.as_built.trials([("lens", lens)], 40)
    violations = check_against(lens, specification, built).violations
    (violation,) = (one for one in violations if "reconstruction loss" in one)
    assert re.search(r"as-built reconstruction loss, loss: .* exceeds the limit of 1e-06", violation)
    wide = load_specification(specified(tmp_path, goal="thinnest lens", limit=0.5))
    assert not any("reconstruction loss" in one for one in check_against(lens, wide, built).violations)


def test_a_limit_bounds_the_search(tmp_path: Path) -> None:
    """Of a lens that exceeds it the constraint is above 0, of one that keeps it below."""
    point, values = None, []
    for limit in (1e-6, 0.5):
        specification = load_specification(specified(tmp_path, goal="thinnest lens", limit=limit))
        problem = DesignProblem(specification, next(bases_of(specification))[1])
        point = problem.to_unit(load_design(DESIGNS / "paper_singlet.toml"))
        _, constraints = problem.rows(point, problem.sample_rays(2, 3, 1), derivatives=False)
        (row,) = (row for row in constraints if row.name == GOAL)
        values.append(float(np.max(row.values)))
    assert values[0] > 0.0 > values[1]


def test_a_study_without_such_a_merit_is_refused(tmp_path: Path) -> None:
    merits = LOSS.replace("reconstruction_loss", "rms_waves").replace("patch_mm = 0.02\n", "")
    with pytest.raises(DesignError, match="no merit of kind reconstruction_loss"):
        load_specification(specified(tmp_path, merits))


def test_a_study_whose_lens_cannot_stand_for_the_search_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DesignError, match=r"patch_mm = 4: .*field"):
        load_specification(specified(tmp_path, LOSS.replace("0.02", "4.0")))


def test_a_yield_needs_a_limit_that_can_be_predicted(tmp_path: Path) -> None:
    with pytest.raises(DesignError, match="a search knows none of the merits"):
        load_specification(specified(tmp_path, goal="yield"))
