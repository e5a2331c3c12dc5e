"""Expected losses without trials, beside the merit's own trials."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign.errors import InputError
from tolerancing.prediction.reconstruction_loss import expected_losses, loss_model, loss_paths
from tolerancing.prediction.system import amounts_of
from tolerancing.study.evaluate import context_of, sample_perturbations
from tolerancing.study.files import study_from_tables

TRIALS = 12
SCATTER = (
    ("lens", "decenter_x_mm", 4e-4),
    ("lens", "decenter_y_mm", 4e-4),
    ("lens", "tilt_x_deg", 0.2),
    ("sensor", "plane_distance_2_mm", 1e-2),
    ("object", "working_distance_mm", 5e-4),
    ("surface 1", "radius_percent", 0.6),
    ("surface 2", "conic", 0.01),
    ("surface 2", "tilt_y_deg", 0.1),
    ("light", "wavelength_um", 1e-3),
)
COMPENSATORS = (("lens", "decenter_x_mm", 0.02), ("lens", "decenter_y_mm", 0.02), ("lens", "tilt_x_deg", 5.0))


def study_of(compensators=(), limits=(), figure=False, **merit):
    """Of the twin's perturbations and one merit."""
    scatter = [
        {"target": target, "parameter": name, "distribution": "normal", "sigma": sigma}
        for target, name, sigma in SCATTER
    ]
    if figure:
        own = {"target": "surface 2", "parameter": "irregularity_rms_waves", "distribution": "normal"}
        scatter.append(own | {"sigma": 0.05})
    tables = {
        "design": "twin.toml",
        "trials": TRIALS,
        "seed": 4,
        "perturbation": scatter,
        "compensator": [
            {"target": target, "parameter": name, "limit": limit} for target, name, limit in compensators
        ],
        "merit": [
            {"kind": "reconstruction_loss", "patch_mm": 0.03, "at_most": 0.05}
            | {"field_points_mm": [[0.0, 0.0], [0.0, 0.011]]}
            | merit
        ],
    }
    return study_from_tables(tables, "here")


@pytest.mark.parametrize(
    ("compensators", "merit"),
    [((), {}), ((), {"object": "complex", "planes_mm": [0.05, 0.2, 0.45]}), (COMPENSATORS, {})],
)
def test_losses_are_those_of_the_merit(twin, compensators, merit):
    study = study_of(compensators, figure=True, **merit)
    context, batch = context_of(twin, study), sample_perturbations(study, range(TRIALS))
    scores = study.merits[0].scores(context, batch)
    found = expected_losses(twin, study, study.merits[0], amounts_of(batch))
    assert np.mean(found) == pytest.approx(np.mean(scores), rel=0.05)
    assert np.corrcoef(found, scores)[0, 1] > 0.99


def test_a_calibration_stays_within_its_limits(twin):
    """Compensators that may hardly move take hardly anything."""
    narrow = tuple((target, name, 1e-7 * limit) for target, name, limit in COMPENSATORS)
    amounts = amounts_of(sample_perturbations(study_of(), range(TRIALS)))
    plain, held, free = (
        np.mean(expected_losses(twin, own, own.merits[0], amounts))
        for own in (study_of(), study_of(narrow), study_of(COMPENSATORS))
    )
    assert held == pytest.approx(plain, rel=1e-3)
    assert free < 0.5 * plain


def test_derivatives_by_coefficients_are_those_of_differences(twin):
    study = study_of()
    model, paths = loss_model(twin, study.merits[0], 2.0), loss_paths(twin, study, study.merits[0])
    middle = model.coefficients(paths, amounts_of(sample_perturbations(study, range(4))))
    step = 1e-3 * np.random.default_rng(1).standard_normal(middle.shape) * np.abs(middle)
    high, low = (model.losses(middle + sign * step)[0] for sign in (1.0, -1.0))
    _, by = model.losses(middle, derivatives=True)
    assert 0.5 * np.sum(high - low, axis=1) == pytest.approx(np.sum(by * step, axis=(1, 2, 3)), rel=0.05)


def test_a_line_that_does_not_pass_is_refused(twin):
    study = study_of(field_points_mm=[[0.0, 5.0]])
    with pytest.raises(InputError, match=r"line of 0\.03 mm.*\(0\.0, 5\.0\) mm"):
        loss_paths(twin, study, study.merits[0])
