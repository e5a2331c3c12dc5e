"""The joint yield of a study's limits: the same lenses for all of them, and what trials find."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lensdesign.errors import InputError
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.line_pairs import LinePairContrast
from tolerancing.merits.pupil import ImageShift, RmsWaves
from tolerancing.merits.rays import FootprintRadius, LargestSpread, Throughput
from tolerancing.merits.reconstruction_loss import ReconstructionLoss
from tolerancing.prediction import predict_study
from tolerancing.prediction.wavefront_prediction import drawn_batch
from tolerancing.study.evaluate import context_of, sample_perturbations
from tolerancing.study.files import load_study
from tolerancing.study.scoring import score_batch

STUDY = Path(__file__).parents[2] / "golden" / "designer_b" / "study_best.toml"
LIMITS = (
    RmsWaves(kind="rms_waves", field_points_mm=((0.0, 0.0), (0.0, 0.95)), at_most=0.04),
    LargestSpread(kind="largest_spread_deg", at_most=7.69),
    FootprintRadius(kind="footprint_radius_mm", at_most=4.395),
)


def test_joint_yield_is_what_trials_of_all_merits_find():
    loaded = load_study(STUDY)
    coarse = loaded.study.sampling.model_copy(update={"pupil_samples": 32})
    changes = {"all_merits": LIMITS, "draws": "random", "trials": 400, "sampling": coarse}
    study = loaded.study.model_copy(update=changes)
    found = predict_study(loaded.lens, study)
    scores, _ = score_batch(
        study.merits, context_of(loaded.lens, study), sample_perturbations(study, range(400))
    )
    passed = np.stack([m.passed(scores[:, k]) for k, m in enumerate(study.merits)])
    margin = 3.0 * np.sqrt(0.25 / 400)
    for one, own in zip(found.limits, passed, strict=True):
        assert 0.2 < one.yield_fraction < 0.97
        assert one.yield_fraction == pytest.approx(np.mean(own), abs=margin)
    assert found.yield_fraction == pytest.approx(np.mean(np.all(passed, axis=0)), abs=margin)
    # Failures of spread and footprint go together, so a product of yields would be another number.
    assert abs(np.prod([one.yield_fraction for one in found.limits]) - found.yield_fraction) > 0.02


def test_parts_are_those_of_the_same_draws_and_bound_the_joint_yield():
    loaded = load_study(STUDY)
    study = loaded.study.model_copy(update={"all_merits": LIMITS})
    found = predict_study(loaded.lens, study, drawn_batch(study, 8), quick=True)
    parts = [one.yield_fraction for one in found.limits]
    assert sum(parts) - len(parts) + 1 <= found.yield_fraction <= min(parts)
    assert found.draws == 1024
    alone = study.model_copy(update={"all_merits": LIMITS[1:2]})
    assert predict_study(loaded.lens, alone, drawn_batch(alone, 8), quick=True).yield_fraction == parts[1]


def test_there_is_no_yield_without_every_limit():
    loaded = load_study(STUDY)
    throughput = Throughput(kind="throughput", at_least=0.5)
    study = loaded.study.model_copy(update={"all_merits": (*LIMITS[:1], throughput)})
    found = predict_study(loaded.lens, study, drawn_batch(study, 64))
    assert found.not_predicted == ("throughput",)
    assert found.joint is None
    assert found.yield_fraction is None
    assert not found.is_trustworthy
    assert "throughput" in found.reason
    with pytest.raises(InputError, match="throughput"):
        predict_study(loaded.lens, study.model_copy(update={"all_merits": (throughput,)}))


@pytest.mark.parametrize("calibrated", [False, True])
def test_losses_and_contrasts_count_in_the_yield(calibrated):
    """Predicted scores are those of traced trials, and so is the joint yield, also with compensators."""
    loaded = load_study(STUDY)
    lens = loaded.lens
    compensators = tuple(
        Compensator(target="lens", parameter=f"decenter_{axis}_mm", limit=0.05) for axis in "xy"
    )
    merits = (
        ReconstructionLoss(
            kind="reconstruction_loss",
            patch_mm=0.02,
            field_mm=(0.0, 0.5),
            at_most=0.001 if calibrated else 0.04,
        ),
        LinePairContrast(
            kind="line_pair_contrast", line_width_um=1.5, field_mm=(0.0, 0.5), at_least=0.9, level="pupil"
        ),
        ImageShift(kind="image_shift_um", at_most=45.0),
        LargestSpread(kind="largest_spread_deg", at_most=7.9),
    )
    sampling = loaded.study.sampling.model_copy(update={"pupil_samples": 48})
    changes = {
        "all_merits": merits,
        "sampling": sampling,
        "compensators": compensators * calibrated,
        "perturbations": tuple(p.scaled(3.0) for p in loaded.study.perturbations),
    }
    study = loaded.study.model_copy(update=changes)
    draws = drawn_batch(study, 64)
    found = predict_study(lens, study, draws)
    assert found.not_predicted == ()
    batch = draws.subset(slice(40, 80))
    scores, _ = score_batch(study.merits, context_of(lens, study), batch)
    for k, one in enumerate(found.limits):
        # An error matters if the scores scatter as little, or are as close to the limit.
        scale = max(np.std(scores[:, k]), abs(np.mean(one.merit.margin(scores[:, k]))))
        error = np.quantile(np.abs(one.scores[40:80] - scores[:, k]), 0.68)
        assert error <= 0.1 * scale
        assert one.error <= 0.1 * scale
    passed = np.all([m.passed(scores[:, k]) for k, m in enumerate(study.merits)], axis=0)
    assert found.joint is not None
    assert found.joint.draws == len(draws)
    assert 0.05 < found.joint.low < found.joint.fraction < found.joint.high < 0.95
    assert np.mean(found.passed[40:80]) == pytest.approx(np.mean(passed), abs=0.05)


def test_predictions_that_traced_draws_contradict_give_no_yield():
    loaded = load_study(STUDY)
    study = loaded.study.model_copy(update={"all_merits": LIMITS[:1]})
    found = predict_study(loaded.lens, study, drawn_batch(study, 64))
    (limit,) = found.limits
    assert found.joint is not None
    wrong = replace(found, limits=(replace(limit, error=10.0 * float(np.std(limit.scores))),))
    assert wrong.joint is None
    assert "traced draws" in wrong.reason
