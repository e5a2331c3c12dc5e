"""Losses of reconstructions in a budget: fitted to predictions; what matters little is loosened."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign.lens.lens import Lens
from tolerancing.budgets.allocation import allocate_tolerances
from tolerancing.budgets.loss_surface import fit_loss_surface
from tolerancing.budgets.score_model import StudyScoreModel
from tolerancing.merits.reconstruction_loss import ReconstructionLoss
from tolerancing.prediction.reconstruction_loss import expected_losses
from tolerancing.prediction.system import amounts_of
from tolerancing.prediction.wavefront_prediction import drawn_batch
from tolerancing.study.files import study_from_tables
from tolerancing.study.study import Study

SCATTER = (
    ("lens", "decenter_x_mm", 8e-4),
    ("lens", "decenter_y_mm", 8e-4),
    ("lens", "tilt_x_deg", 0.2),
    ("object", "working_distance_mm", 5e-4),
    ("surface 1", "radius_percent", 0.3),
    ("surface 2", "tilt_y_deg", 0.1),
)
COMPENSATORS = (("lens", "decenter_x_mm", 0.02), ("lens", "decenter_y_mm", 0.02))


def study_of(*compensators: tuple[str, str, float]) -> Study:
    tables = {
        "design": "twin.toml",
        "trials": 60,
        "seed": 4,
        "perturbation": [
            {"target": target, "parameter": name, "distribution": "normal", "sigma": sigma}
            for target, name, sigma in SCATTER
        ],
        "compensator": [
            {"target": target, "parameter": name, "limit": limit} for target, name, limit in compensators
        ],
        "merit": [
            {"kind": "reconstruction_loss", "patch_mm": 0.03, "at_most": 0.05}
            | {"field_points_mm": [[0.0, 0.0], [0.0, 0.011]]}
        ],
    }
    return study_from_tables(tables, "here")


@pytest.mark.parametrize("compensators", [(), COMPENSATORS])
def test_fitted_losses_are_those_predicted(
    twin: Lens, compensators: tuple[tuple[str, str, float], ...]
) -> None:
    study = study_of(*compensators)
    amounts = amounts_of(drawn_batch(study, draws=192))
    fitted, new = 2.0 * amounts[:144], 2.0 * amounts[144:]
    surface = fit_loss_surface(twin, study, study.merits[0], fitted)
    predicted = expected_losses(twin, study, study.merits[0], new)
    found, by = surface.slopes(new)
    assert np.mean((found < 0.05) == (predicted < 0.05)) > 0.9
    near, limit = predicted < 0.1, study.merits[0].limit
    assert np.sqrt(np.mean((found - predicted)[near] ** 2)) < 0.2 * limit
    step = 1e-4 * np.random.default_rng(1).standard_normal(new.shape) * np.abs(new)
    change = surface.scores(new + step) - surface.scores(new - step)
    assert 0.5 * change == pytest.approx(np.sum(by * step, axis=1), rel=1e-3, abs=1e-9)


def test_losses_are_fitted_again_near_the_scales_found(twin: Lens, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tolerancing.budgets.score_model.FITTED_LENSES", 96)
    study, scales = study_of(), np.array([0.2, 0.2, 3.0, 0.4, 3.0, 0.4])
    model = StudyScoreModel(twin, study, np.zeros((0, len(scales))), np.zeros((0, 1)))
    merit = study.merits[0]
    assert isinstance(merit, ReconstructionLoss)
    amounts = amounts_of(drawn_batch(study, draws=64))
    predicted = expected_losses(twin, study, merit, amounts * scales)

    def error() -> float:
        return float(np.sqrt(np.mean((model.scores(scales)[: len(predicted), 0] - predicted) ** 2)))

    before = error()
    assert model.refine(scales)
    assert error() < 0.7 * before


def test_a_budget_loosens_what_matters_little(twin: Lens, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tolerancing.budgets.score_model.FITTED_LENSES", 64)
    study = study_of()
    count = len(study.perturbations)
    model = StudyScoreModel(twin, study, np.zeros((0, count)), np.zeros((0, 1)))
    assert model.not_predicted == []
    found = allocate_tolerances(model, study.merits, 0.9, low=np.full(count, 0.1), high=4.0)
    assert found.predicted_yield == pytest.approx(0.9, abs=0.005)
    assert found.uniform_cost is not None
    assert found.cost < 0.95 * found.uniform_cost
    ones = np.ones(count)
    spread = [np.std(model.scores(np.where(np.arange(count) == k, ones, 1e-6))) for k in range(count)]
    assert int(np.argmax(found.scales)) in np.argsort(spread)[:2]
