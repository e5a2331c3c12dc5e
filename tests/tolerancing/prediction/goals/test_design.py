"""Perturbations of a search's lens are those of the finished lens."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign.optimization.problem import DesignProblem
from tolerancing import load_study
from tolerancing.prediction import predict
from tolerancing.prediction.goals.design import Scatter


def test_irregularities_are_scaled_on_the_stop_that_rays_fill(specified, best_lens) -> None:
    """A stop that follows the numerical aperture has another size than the file gives its surface."""
    asked = specified()
    assert asked.surfaces[0].stop
    assert asked.surfaces[0].semi_diameter_mm > 1.9 * best_lens.surfaces[0].semi_diameter_mm
    problem = DesignProblem(asked, asked.lens)
    found = problem.as_built(problem.to_unit(best_lens), False)
    predicted = predict(best_lens, load_study(asked.tolerances.study).study)
    first_order = [point.first_order_rms_waves for point in predicted.points]
    np.testing.assert_allclose(found.rms_waves, first_order, rtol=0.01)


def test_compensators_stand_behind_the_perturbations(specified) -> None:
    more = '\n[[compensator]]\ntarget = "lens"\nparameter = "tilt_x_deg"\nlimit = 0.02\n'
    study = load_study(specified(more).tolerances.study).study
    scatter = Scatter(study, lambda _: 1.0)
    assert [p.parameter for p in scatter.parameters][-1] == "tilt_x_deg"
    assert scatter.limits == pytest.approx([0.02])
    assert scatter.amounts.shape[1] > len(study.perturbations)
