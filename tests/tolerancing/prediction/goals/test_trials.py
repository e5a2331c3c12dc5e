"""Final trials of searches: all limits of the study, by the code of a run."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner

from lensdesign.cli.commands import app
from lensdesign.errors import DesignError
from lensdesign.optimization.as_built import read_as_built
from tolerancing import load_study
from tolerancing.prediction import predict_study
from tolerancing.run import run_study
from tolerancing.statistics.summary import summarize
from tolerancing.store.store import open_store

SPREAD = """
[[merit]]
kind = "largest_spread_deg"
at_most = 7.68
"""
CONTRAST = """
[[merit]]
name = "contrast"
kind = "line_pair_contrast"
line_width_um = 0.9
level = "pupil"
at_least = 0.977
"""
COARSE = """
[sampling]
rings = 2
arms = 6
pupil_samples = 32
"""
LIMITS = SPREAD + CONTRAST + COARSE


def test_a_run_with_the_same_seed_has_the_same_yields(specified, best_lens, tmp_path: Path) -> None:
    """Jointly, and merit by merit; what is predicted is what `tolerancing predict` prints."""
    asked = specified(LIMITS, 0.04)
    study = read_as_built(asked.tolerances)
    report = study.trials([("", best_lens)], 120)
    (row,) = report.rows
    loaded = load_study(asked.tolerances.study)
    text = Path(asked.tolerances.study).read_text(encoding="utf-8")
    text = text.replace("seed = 1", f"seed = {report.seed}\nsensitivity = false")
    text = text.replace("trials = 400", "trials = 120")
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    run_study(load_study(tmp_path / "run.toml"), tmp_path / "run.db", workers=1)
    with closing(open_store(tmp_path / "run.db")) as store:
        summary = summarize(store)
    assert row.good == summary.good.fraction
    assert (row.low, row.high) == (summary.good.low, summary.good.high)
    for own, known in zip(row.merits, summary.merits, strict=True):
        assert (own.merit, own.good) == (known.merit.label, known.good.fraction)
        assert 0.2 < own.good < 0.995
    assert row.good < min(own.good for own in row.merits)
    shown = predict_study(best_lens, loaded.study)
    assert row.predicted_good == shown.yield_fraction
    assert row.predicted_rms_waves == tuple(p.rms_waves for p in shown.wavefronts.points)
    assert report.trials_only == ("contrast",)
    assert [own.predicted for own in row.merits] == [one.yield_fraction for one in shown.limits]


def test_yield_is_printed_jointly_and_by_its_parts(specified) -> None:
    """Of whatever a search ends with: here a plate, although the study perturbs its radii."""
    start = {
        'start = "plate"': 'start = "design"\nstarts = 1\nmax_evaluations = 1',
        "trials = 500": "trials = 100",
    }
    asked = specified(LIMITS, 0.04, **start)
    folder = Path(asked.tolerances.study).parent
    output = folder / "found.toml"
    shown = CliRunner().invoke(app, ["optimize", str(folder / "spec.toml"), "-o", str(output)])
    assert "Yield of 100 trials each (seed 2)" in shown.output
    assert "a good lens keeps all limits of the study:" in shown.output
    assert "rms_waves at most 0.04 waves: at (0, 0), (0, 0.7), (0, 0.95) mm in the object" in shown.output
    assert "largest_spread_deg at most 7.68°: over the whole field" in shown.output
    assert "in the trials: contrast" in shown.output


def test_what_cannot_be_predicted_is_no_goal(specified) -> None:
    with pytest.raises(DesignError, match=r"knows none of the merits \(rms_waves, contrast\)"):
        specified("refocus = false\n" + CONTRAST)
    with pytest.raises(DesignError, match="refocused wavefront"):
        specified("refocus = false\n" + SPREAD, **{'goal = "yield"': 'goal = "as-built rms"'})
