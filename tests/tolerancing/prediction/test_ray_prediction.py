"""Predicted spreads and footprints, beside trials of the same draws."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tolerancing import load_study
from tolerancing.cli.commands import app
from tolerancing.merits.context import Context
from tolerancing.prediction.ray_prediction import predict_rays
from tolerancing.prediction.wavefront_prediction import drawn_batch
from tolerancing.study.study import Study

RAYS = """
[[merit]]
kind = "largest_spread_deg"
at_most = 4.84

[[merit]]
kind = "footprint_radius_mm"
at_most = 11.19

[sampling]
rings = 2
arms = 12
"""


@pytest.fixture(scope="module")
def ray_study(wavefront_study: Path) -> Path:
    whole = wavefront_study.read_text(encoding="utf-8")
    path = wavefront_study.with_name("rays.toml")
    text = whole[: whole.index("[[merit]]")].replace("[sampling]\npupil_samples = 128\n", "")
    path.write_text(text + RAYS, encoding="utf-8")
    return path


def traced(study: Study, path: Path) -> np.ndarray:
    context, batch = Context(load_study(path).lens, study.sampling), drawn_batch(study)
    return np.stack([merit.scores(context, batch) for merit in study.merits], axis=1)


def test_trials_agree(ray_study: Path) -> None:
    loaded = load_study(ray_study)
    for found, scores in zip(
        predict_rays(loaded.lens, loaded.study), traced(loaded.study, ray_study).T, strict=True
    ):
        assert found.first_order_suffices
        assert found.mean == pytest.approx(np.mean(scores), abs=2e-3 * np.std(scores))
        assert found.deviation == pytest.approx(np.std(scores), rel=3e-3)
        assert found.good == pytest.approx(np.mean(scores <= found.merit.at_most), abs=2e-3)
        assert 0.2 < found.good < 0.95


def test_large_tolerances_are_told_to_be_too_large(ray_study: Path) -> None:
    loaded = load_study(ray_study)
    wide = tuple(p.scaled(40.0) for p in loaded.study.perturbations)
    spread, _ = predict_rays(loaded.lens, loaded.study.model_copy(update={"perturbations": wide}))
    assert not spread.first_order_suffices


def test_what_a_perturbation_does_by_itself_is_told(ray_study: Path) -> None:
    """A sensor that shifts sideways displaces the footprint and turns no ray."""
    loaded = load_study(ray_study)
    table = loaded.study.perturbations[0].model_copy(update={"target": "sensor"})
    study = loaded.study.model_copy(update={"perturbations": (table,)})
    spread, footprint = predict_rays(loaded.lens, study)
    assert spread.deviation == pytest.approx(0.0, abs=1e-12)
    assert spread.first_order_suffices
    assert footprint.alone[0] == pytest.approx(footprint.deviation, rel=0.2)
    assert footprint.deviation > 1e-3


def test_the_command_tells_rays_with_wavefronts_or_without(ray_study: Path) -> None:
    outcome = CliRunner().invoke(app, ["predict", str(ray_study), "--json"])
    assert outcome.exit_code == 0, outcome.output
    found = json.loads(outcome.output)
    assert "points" not in found
    assert [r["merit"] for r in found["rays"]] == ["largest_spread_deg", "footprint_radius_mm"]
    shown = CliRunner().invoke(app, ["predict", str(ray_study)])
    assert "Deviation by each perturbation alone" in shown.output
    assert "lens_decenter_x_mm" in shown.output
