"""Ghosts as goal and constraint of a search."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import CoverGlass, DesignError, load_specification, optimize
from lensdesign.analysis import ghost_paths
from lensdesign.optimization.operands.ghosts import GHOST_MARGIN
from lensdesign.optimization.problem import DesignProblem, finished_lens
from lensdesign.optimization.specification_check import check_against

PATH = "designs/smallest_spread_spec.toml"


def singlet(goal="smallest spread", distance_mm=0.0, **limits):
    found = load_specification(PATH)
    glass = CoverGlass(thickness_mm=0.7, material=1.52, distance_mm=distance_mm)
    return found.replaced(
        sensor=found.sensor.replaced(cover_glass=glass),
        optimize=found.optimize.replaced(goal=goal, starts=1),
        constraints=found.constraints.replaced(**limits),
    )


def path_of(lens, first, second):
    return next(p for p in ghost_paths(lens).paths if (p.first, p.second) == (first, second))


def test_a_search_with_a_limit_moves_a_focused_ghost_of_the_cover_glass_away():
    free = optimize(singlet()).lens
    focused = path_of(free, "cover glass front", "surface 1")
    assert abs(focused.focus_mm) < 1.0
    assert focused.relative_irradiance > 0.1
    limit = 0.85 * ghost_paths(free).total()
    result = optimize(singlet(max_ghost_fraction=limit))
    assert result.feasible, result.violations
    assert "ghost fraction on sensor plane 1" in result.binding
    assert 0.9 * limit < ghost_paths(result.lens).total() <= limit
    moved = path_of(result.lens, "cover glass front", "surface 1")
    assert abs(moved.focus_mm) > 2.0 * abs(focused.focus_mm)
    assert moved.relative_irradiance < 0.5 * focused.relative_irradiance
    (row,) = (c for c in result.check.constraints if c.name == "ghost fraction")
    assert (row.value, row.limit, row.met) == (ghost_paths(result.lens).total(), limit, True)


def test_a_missed_limit_is_a_sentence():
    specification = singlet(max_ghost_fraction=1e-4)
    report = check_against(optimize(singlet()).lens, specification)
    (sentence,) = (v for v in report.violations if v.startswith("ghost fraction"))
    assert "exceeds the limit of 0.0001" in sentence


def test_ghosts_can_be_the_goal():
    specification = singlet("smallest ghost fraction", max_spread_deg=6.0)
    result = optimize(specification)
    assert result.goal_unit == ""
    assert result.goal_value == ghost_paths(result.lens).total()
    assert result.goal_value < 0.7 * ghost_paths(optimize(singlet()).lens).total()


def test_the_search_has_the_ghosts_of_the_finished_lens_and_their_derivatives():
    specification = singlet(distance_mm=0.5, max_ghost_fraction=0.01)
    problem = DesignProblem(specification, specification.lens)
    point, rays = np.array([0.5, 0.2, 0.5]), problem.sample_rays(3, 5, 2)
    values = problem.ghosts(point)

    def full(point):
        lens = finished_lens(problem, point, rays)
        return np.array(list(ghost_paths(lens).totals.values()))

    assert values.fractions == pytest.approx(full(point), rel=GHOST_MARGIN)
    step = 0.02  # of the box; on it, the noise of rays at edges and the steps of apertures are small
    for k in range(3):
        move = step * np.eye(3)[k]
        expected = (full(point + move) - full(point - move)) / (2.0 * step)
        assert values.fractions_by[:, k] * problem.width[k] == pytest.approx(expected, rel=0.4, abs=5e-3)
    rows = [row for row in problem.rows(point, rays)[1] if row.name.startswith("ghost fraction")]
    found = [float(row.values[0]) for row in rows]
    assert found == pytest.approx(values.fractions / (0.01 * (1.0 - GHOST_MARGIN)) - 1.0)


def test_a_lens_that_passes_no_light_has_no_ghosts_to_limit(monkeypatch):
    specification = singlet(max_ghost_fraction=0.01)
    problem = DesignProblem(specification, specification.lens)

    def dark(*_, **__):
        raise DesignError("no ray passes")

    monkeypatch.setattr("lensdesign.optimization.operands.ghosts.ghost_paths", dark)
    point = np.full(3, 0.6)
    values = problem.ghosts(point)
    assert np.isnan(values.fractions).all()
    rows = [row for row in problem.rows(point, problem.sample_rays(3, 5, 1))[1] if "ghost" in row.name]
    assert all(row.values[0] > 1.0 and not np.any(row.by) for row in rows)
    assert len(rows) == 2


def test_specifications_without_ghosts_do_not_compute_them():
    specification = load_specification(PATH)
    problem = DesignProblem(specification, specification.lens)
    assert not specification.asks_ghosts
    assert problem.ghosts(np.full(3, 0.5)) is None


@pytest.mark.parametrize("value", ["0.0", "1.5", '"sensor"'])
def test_impossible_limits_are_refused(tmp_path, value):
    path = tmp_path / "spec.toml"
    with open(PATH, encoding="utf-8") as file:
        path.write_text(file.read().replace("[constraints]", f"[constraints]\nmax_ghost_fraction = {value}"))
    with pytest.raises(DesignError, match=r"spec\.toml: constraints, max_ghost_fraction = "):
        load_specification(path)
