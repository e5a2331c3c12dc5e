"""The joint yield of a study's limits: the same lenses for all of them, and what trials find."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lensdesign.errors import InputError
from tolerancing.merits.line_pairs import LinePairContrast
from tolerancing.merits.pupil import RmsWaves
from tolerancing.merits.rays import FootprintRadius, LargestSpread
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


def test_merits_that_need_trials_are_named_and_never_passed_over_in_silence():
    loaded = load_study(STUDY)
    contrast = LinePairContrast(kind="line_pair_contrast", line_width_um=1.0, at_least=0.5)
    study = loaded.study.model_copy(update={"all_merits": (*LIMITS[:1], contrast)})
    assert predict_study(loaded.lens, study, drawn_batch(study, 64), quick=True).not_predicted == (
        "line_pair_contrast",
    )
    with pytest.raises(InputError, match="line_pair_contrast"):
        predict_study(loaded.lens, study.model_copy(update={"all_merits": (contrast,)}))
