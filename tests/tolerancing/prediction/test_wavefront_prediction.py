"""Predicted wavefronts and yields, beside trials."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from places import GOLDEN
from typer.testing import CliRunner

from lensdesign.errors import InputError
from tolerancing import load_study
from tolerancing.cli.commands import app
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.context import Sampling
from tolerancing.prediction.system import amounts_of
from tolerancing.prediction.wavefront_prediction import (
    WavefrontLimit,
    drawn_batch,
    judged_points,
    mean_squares,
    predict,
    study_derivatives,
)
from tolerancing.study.evaluate import context_of, sample_perturbations
from tolerancing.study.files import LoadedStudy


@pytest.fixture(scope="module")
def loaded(wavefront_study: Path) -> LoadedStudy:
    return load_study(wavefront_study)


def test_trials_agree(loaded: LoadedStudy) -> None:
    """Within three standard errors of 200 trials, and what their coarser pupils add."""
    found = predict(loaded.lens, loaded.study)
    study = loaded.study.model_copy(
        update={"sampling": Sampling(pupil_samples=40), "draws": "sobol", "trials": 200}
    )
    (merit,), batch = study.merits, sample_perturbations(study, range(200))
    context = context_of(loaded.lens, study)
    scores = np.stack([merit.scores_at(p, context, batch, True) for p in merit.points], axis=1)  # type: ignore[attr-defined]
    for k, point in enumerate(found.points):
        squares = scores[:, k] ** 2
        error = np.std(squares) / np.sqrt(200) / (2.0 * point.rms_waves)
        assert point.rms_waves == pytest.approx(np.sqrt(np.mean(squares)), abs=3.0 * error)
        assert point.good == pytest.approx(np.mean(scores[:, k] <= 0.12), abs=0.1)
    assert found.good == pytest.approx(np.mean(np.all(scores <= 0.12, axis=1)), abs=0.1)
    assert found.second_order_suffices
    assert found.relative_error < 0.02
    # As 2,000 trials at 48 samples have it.
    np.testing.assert_allclose([p.rms_waves for p in found.points], [0.103, 0.122, 0.138], rtol=0.01)


def test_shares_of_independent_perturbations_add_up(loaded: LoadedStudy) -> None:
    for point in predict(loaded.lens, loaded.study).points:
        assert np.sum(point.shares) == pytest.approx(1.0, abs=0.01)
        assert np.all(point.shares >= 0.0)


def test_a_second_order_of_a_per_cent_is_no_reason_to_doubt() -> None:
    """The error is measured with traced draws, and not guessed from the size of the second order."""
    loaded = load_study(GOLDEN / "designer_b" / "study_best.toml")
    wide = tuple(p.scaled(2.5) for p in loaded.study.perturbations)
    study = loaded.study.model_copy(update={"perturbations": wide})
    batch = drawn_batch(study, 64)
    found = predict(loaded.lens, study, batch=batch)
    changes = [abs(p.rms_waves / p.first_order_rms_waves - 1.0) for p in found.points]
    assert 0.004 < max(changes) < 0.01
    (merit, *_), traced = study.merits, batch.subset(slice(0, 16))
    true = merit.scores(context_of(loaded.lens, study), traced)
    worst = np.max([p.rms_of_draws[:16] for p in found.points], axis=0)
    assert np.linalg.norm(worst - true) < 0.05 * np.linalg.norm(true)
    assert 0.0 < found.relative_error < 0.05
    assert found.second_order_suffices


def test_large_tolerances_are_told_to_be_too_large(loaded: LoadedStudy) -> None:
    wide = tuple(p.scaled(30.0) for p in loaded.study.perturbations)
    found = predict(loaded.lens, loaded.study.model_copy(update={"perturbations": wide}))
    assert not found.second_order_suffices


def test_strehl_ratios_are_judged_by_the_wavefront_they_stand_for(loaded: LoadedStudy) -> None:
    (merit,) = loaded.study.merits
    from tolerancing.merits.pupil import Strehl

    strehl = Strehl(kind="strehl", field_mm=(0.0, 0.5), at_least=float(np.exp(-((2.0 * np.pi * 0.1) ** 2))))
    study = loaded.study.model_copy(update={"all_merits": (merit, strehl)})
    *_, last = judged_points(study)
    assert last == WavefrontLimit((0.0, 0.5), None, pytest.approx(0.1))


@pytest.mark.parametrize("limit", [0.05, 0.006])
def test_trials_with_compensators_agree(loaded: LoadedStudy, limit: float) -> None:
    """Of limits that are not met, and of some that mostly are: trial by trial."""
    compensators = tuple(
        Compensator(target="lens", parameter=name, limit=limit) for name in ("decenter_x_mm", "decenter_y_mm")
    )
    sampling = Sampling(pupil_samples=40)
    study = loaded.study.model_copy(update={"compensators": compensators, "sampling": sampling})
    found, bare = predict(loaded.lens, study), predict(loaded.lens, loaded.study)
    drawn = study.model_copy(update={"draws": "sobol", "trials": 60})
    (merit,), batch = study.merits, sample_perturbations(drawn, range(60))
    context = context_of(loaded.lens, study)
    for point, alone in zip(found.points, bare.points, strict=True):
        assert point.rms_waves < alone.rms_waves
        assert 0.6 < np.sum(point.shares) < 1.4
    known = study_derivatives(loaded.lens, study, judged_points(study), second=True)
    amounts = amounts_of(batch)
    values = known.compensation.values(amounts)
    np.testing.assert_allclose(values, context.compensator_values(batch), atol=0.01 * limit + 3e-4)
    together = np.concatenate([amounts, values], axis=1)
    for field, point in zip(known.fields, merit.points, strict=True):  # type: ignore[attr-defined]
        traced = merit.scores_at(point, context, batch, True)  # type: ignore[attr-defined]
        np.testing.assert_allclose(np.sqrt(mean_squares(field, together)), traced, rtol=0.03, atol=1e-3)


def test_what_cannot_be_predicted_is_refused(loaded: LoadedStudy) -> None:
    from tolerancing.merits.pupil import ModulationTransfer

    transfer = ModulationTransfer(kind="mtf", frequency_lp_per_mm=100.0, at_least=0.5)
    with pytest.raises(InputError, match="rms_waves"):
        predict(loaded.lens, loaded.study.model_copy(update={"all_merits": (transfer,)}))


def test_the_command_prints_a_table_or_json(wavefront_study: Path) -> None:
    shown = CliRunner().invoke(app, ["predict", str(wavefront_study)])
    assert shown.exit_code == 0, shown.output
    assert "lens_tilt_x_deg" in shown.output
    assert "no trial was run" in shown.output
    outcome = CliRunner().invoke(app, ["predict", str(wavefront_study), "--json"])
    found = json.loads(outcome.output)
    assert [p["field_mm"] for p in found["points"]] == [[0.0, 0.0], [0.0, 1.0], [0.0, 1.4]]
    assert 0.4 < found["yield"] < 0.6
