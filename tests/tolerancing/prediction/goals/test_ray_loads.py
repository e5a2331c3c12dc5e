"""Searches with limits on wavefronts and rays, and with compensators."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import CoverGlass
from lensdesign.optimization.problem import DesignProblem
from tolerancing import load_study
from tolerancing.prediction import predict_study

RAYS = """
[[merit]]
kind = "largest_spread_deg"
at_most = 7.65

[[merit]]
kind = "footprint_radius_mm"
at_most = 4.392
"""
FEW = """
[[merit]]
name = "rim"
kind = "footprint_radius_mm"
field_points_mm = [[0.0, 0.95], [0.6, 0.0]]
plane_distance_mm = 4.0
at_least = 3.2

[sampling]
rings = 2
arms = 8
"""
COMPENSATORS = """
[[compensator]]
target = "lens"
parameter = "decenter_x_mm"
limit = 0.004

[[compensator]]
target = "lens"
parameter = "tilt_x_deg"
limit = 0.02
"""
WARM = {"[constraints]": "[environment]\ntemperatures_c = [45]\n\n[constraints]"}
GLASS = CoverGlass(thickness_mm=0.7, material="N-BK7", distance_mm=0.2)
COVERED = {
    "[constraints]": "[sensor.cover_glass]\nthickness_mm = 0.7\nmaterial = 'N-BK7'\ndistance_mm = 0.2\n\n"
    "[constraints]"
}


@pytest.mark.parametrize(
    ("more", "limit", "changes"),
    [
        (RAYS, 0.045, {}),
        (RAYS + COMPENSATORS, 0.033, {}),
        (FEW, 0.045, {}),
        (RAYS, 0.045, WARM),
        (RAYS, 0.045, COVERED),
        (RAYS, 0.045, {"trials = 500": "trials = 500\ncost = 9.0"}),
    ],
    ids=["rays", "compensators", "one plane, smallest allowed", "warm", "cover glass", "cost"],
)
def test_gradients_are_those_of_differences(specified, best_lens, more, limit, changes) -> None:
    asked = specified(more, limit, **changes)
    problem = DesignProblem(asked, asked.lens)
    problem = problem.heated[0] if changes is WARM else problem
    point = problem.to_unit(best_lens)
    here, step = problem.as_built(point), 2e-7  # the outermost ray changes with the design
    assert 0.01 < here.failing < 0.99
    slack = 2e-3 * np.max(np.abs(here.failing_by * problem.width))
    for k, axis in enumerate(np.eye(len(point))):
        high, low = (problem.as_built(point + sign * step * axis, False) for sign in (1.0, -1.0))
        width = 2.0 * step * problem.width[k]
        by, rms_by = (high.failing - low.failing) / width, (high.rms_waves - low.rms_waves) / width
        assert here.failing_by[k] == pytest.approx(by, rel=5e-3, abs=slack / problem.width[k])
        np.testing.assert_allclose(here.rms_by[:, k], rms_by, rtol=1e-3, atol=1e-3 * np.max(np.abs(rms_by)))


@pytest.mark.parametrize("covered", [False, True])
def test_the_searched_yield_is_near_what_is_shown(specified, best_lens, covered) -> None:
    asked = specified(RAYS, 0.045, **(COVERED if covered else {}))
    problem = DesignProblem(asked, asked.lens)
    found = problem.as_built(problem.to_unit(best_lens), False)
    glass = GLASS if covered else None
    best = best_lens.replaced(sensor=best_lens.sensor.replaced(cover_glass=glass))
    shown = predict_study(best, load_study(asked.tolerances.study).study)
    assert 0.1 < shown.yield_fraction < 0.9
    assert 1.0 - found.failing == pytest.approx(shown.yield_fraction, abs=0.03)
