"""The analysis of the workbench agrees with what the commands print."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from places import DESIGNS

from lensdesign import Lens, Pose, check_design, load_design
from studio.model.analysis import AnalysisRequest, built_of, patch_of, rays_of, waves_of
from studio.model.built import manufacturing_quality
from studio.model.whatif import WhatIf
from tolerancing import load_study
from tolerancing.prediction import predict_study
from wavesim import PupilSampler, line_pair_contrast, refocus, rms_waves, strehl

OFF = WhatIf({"lens.decenter_y_mm": 0.01, "lens.tilt_x_deg": 0.05})
STUDY = str(DESIGNS / "as_built_tolerances.toml")


def asked(lens: Lens, what_if: WhatIf = OFF, grade: str = STUDY) -> AnalysisRequest:
    return AnalysisRequest(lens, what_if, manufacturing_quality(grade, lens), 0.0)


def test_settled_rays_are_those_of_the_check(paper_lens: Lens) -> None:
    assert rays_of(asked(paper_lens), settled=True).check == check_design(paper_lens)


def test_settled_waves_are_those_of_the_commands(paper_lens: Lens) -> None:
    found = waves_of(asked(paper_lens), settled=True)
    assert not found.refused
    for figures in found.pupils:
        pupil = refocus(
            PupilSampler(paper_lens, (0.0, figures.field_mm)).pupil(Pose(decenter_y_mm=0.01, tilt_x_deg=0.05))
        ).pupil
        assert figures.strehl == pytest.approx(strehl(pupil), abs=1e-12)
        assert figures.rms_waves == pytest.approx(rms_waves(pupil), abs=1e-12)
        both = [line_pair_contrast(pupil, figures.widths_um[1], axis) for axis in ("x", "y")]
        assert figures.contrast[1] == pytest.approx(min(both), abs=1e-12)


def test_a_settled_prediction_is_that_of_the_command(paper_lens: Lens) -> None:
    found = built_of(asked(paper_lens), settled=True)
    assert found.built is not None
    own = predict_study(paper_lens, load_study(STUDY).study)
    assert found.built.prediction.yield_fraction == own.yield_fraction
    for a, b in zip(found.built.prediction.wavefronts.points, own.wavefronts.points, strict=True):
        assert a.rms_waves == pytest.approx(b.rms_waves, rel=1e-12)


def test_a_grade_judges_as_its_starting_study_does(paper_lens: Lens, tmp_path: Path) -> None:
    from tolerancing import start_study

    start_study(DESIGNS / "paper_singlet.toml", tmp_path / "study.toml", "high_precision")
    study = load_study(tmp_path / "study.toml").study
    assert manufacturing_quality("high_precision", paper_lens).study.merits == study.merits
    found = built_of(asked(paper_lens, grade="high_precision"), settled=False).built
    assert found is not None
    # While values move, merits that are scored draw by draw have no prediction, so there is no yield.
    assert found.prediction.joint is None
    shown = [one.merit.label for one in found.prediction.limits]
    assert sorted((*shown, *found.prediction.not_predicted)) == sorted(m.label for m in study.merits)


def test_a_prediction_ends_when_the_design_changes(paper_lens: Lens) -> None:
    class Changed(Exception):
        pass

    def changed() -> None:
        raise Changed

    request = replace(asked(paper_lens, grade="high_precision"), proceed=changed)
    with pytest.raises(Changed):
        built_of(request, settled=True)


def test_moving_figures_are_near_the_settled_ones(paper_lens: Lens) -> None:
    one = asked(paper_lens)
    near, exact = (waves_of(one, settled=settled) for settled in (False, True))
    for a, b in zip(near.pupils, exact.pupils, strict=True):
        assert a.strehl == pytest.approx(b.strehl, abs=0.03)
    near, exact = (built_of(one, settled=settled) for settled in (False, True))
    assert near.built is not None
    assert exact.built is not None
    assert near.built.prediction.yield_fraction == pytest.approx(
        exact.built.prediction.yield_fraction, abs=0.02
    )


def test_a_lens_as_designed_brings_the_chart_back(paper_lens: Lens) -> None:
    found = patch_of(asked(paper_lens, WhatIf()), settled=True).patch
    assert found is not None
    assert found.actual == pytest.approx(found.nominal)
    off = patch_of(asked(paper_lens, WhatIf({"lens.tilt_x_deg": 0.4})), settled=True).patch
    assert off is not None
    assert abs(off.actual - off.nominal).max() > 0.1


@pytest.mark.parametrize("name", ["moulded_pair", "rectangular_sensor"])
def test_other_lenses_have_figures(name: str) -> None:
    lens = load_design(DESIGNS / f"{name}.toml")
    one = asked(lens, WhatIf({"environment.temperature_c": 5.0}), "precision")
    for stage in (rays_of, waves_of, patch_of, built_of):
        assert stage(one, settled=False).refused == ()


def test_what_cannot_be_had_is_said(paper_lens: Lens) -> None:
    dark = paper_lens.with_surface(1, semi_diameter_mm=0.01)
    found = rays_of(AnalysisRequest(dark, WhatIf(), None, 0.0), settled=False)
    assert found.check is None
    assert "no ray" in found.refused[0]
