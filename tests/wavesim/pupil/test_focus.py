"""The focus in which a score is best: found again where it was put, and no worse than the flattest phase."""

from dataclasses import replace

import numpy as np
import pytest

from lensdesign.errors import SamplingError
from lensdesign.lens.poses import Pose
from wavesim import line_pair_contrast, refocus, strehl
from wavesim.pupil import (
    FocalPlanes,
    PatchReconstructor,
    PupilSampler,
    best_focus,
    focus,
    patch_bar_contrast,
    remove_shift,
)
from wavesim.pupil.focus import search_range_um

WIDTH_UM = 0.775


@pytest.fixture(scope="module")
def samplers(paper_lens):
    return {y: PupilSampler(paper_lens, (0.0, y), 0.532, samples=128) for y in (0.0, 1.0)}


def contrast(pupil):
    return line_pair_contrast(pupil, WIDTH_UM, "x")


@pytest.mark.parametrize("field_y", [0.0, 1.0])
def test_a_pupil_that_is_out_of_focus_is_brought_back(samplers, field_y):
    """Its path is that of a point 1.3 um off the plane, and nothing else."""
    nominal = samplers[field_y].pupil(Pose())
    off = replace(nominal, opd_mm=nominal.opd_mm - 1.3e-3 * nominal.grid.axial_cosine)
    registered = remove_shift(off)
    found = best_focus(registered.pupil, strehl)
    by_phase = refocus(off)
    assert found.refocus_um == pytest.approx(by_phase.refocus_um, abs=0.02)
    assert found.refocus_um == pytest.approx(1.3, abs=0.02)
    assert registered.shift_um + found.shift_um == pytest.approx(by_phase.shift_um, abs=0.02)
    assert registered.piston_um + found.piston_um == pytest.approx(by_phase.piston_um, abs=0.02)
    assert strehl(found.pupil) == pytest.approx(1.0, abs=1e-3)


def test_planes_that_scores_share_change_no_score_and_are_kept_of_small_pupils_only(samplers, monkeypatch):
    pupil = refocus(samplers[1.0].pupil(Pose(tilt_x_deg=0.3))).pupil
    shared = FocalPlanes(pupil)
    for score in (contrast, strehl):
        alone = best_focus(pupil, score)
        together = best_focus(shared, score)
        assert together.refocus_um == alone.refocus_um
        assert score(together.pupil) == score(alone.pupil)
    assert shared.at(0.5) is shared.at(0.5)
    monkeypatch.setattr(focus, "KEPT_SAMPLES", pupil.opd_mm.size - 1)
    remade = FocalPlanes(pupil)
    assert remade.at(0.5) is not remade.at(0.5)
    np.testing.assert_array_equal(remade.at(0.5).opd_mm, shared.at(0.5).opd_mm)


def test_contrast_is_best_beside_the_flattest_phase(samplers):
    """On a fine scan nothing within the range is better by more than the parabola's error."""
    pupil = refocus(samplers[0.0].pupil(Pose(tilt_x_deg=0.45))).pupil
    found = best_focus(pupil, contrast)
    reach = search_range_um(pupil.grid)
    assert reach == pytest.approx(1.5 * 0.532 / 0.25, rel=0.02)
    axial = pupil.grid.axial_cosine - pupil.grid.axial_cosine.mean()
    scan = [
        contrast(remove_shift(replace(pupil, opd_mm=pupil.opd_mm + 1e-3 * d * axial)).pupil)
        for d in np.linspace(-reach, reach, 41)
    ]
    assert contrast(found.pupil) >= max(scan) - 2e-3
    assert contrast(found.pupil) > contrast(pupil) + 0.02
    assert abs(found.refocus_um) <= reach


def test_planes_that_cannot_be_held_are_passed_over(samplers):
    pupil = refocus(samplers[0.0].pupil(Pose())).pupil

    def fails_elsewhere(seen):
        if seen is not pupil:
            raise SamplingError("too far")
        return 1.0

    assert best_focus(pupil, fails_elsewhere).refocus_um == 0.0

    def fails(seen):
        raise SamplingError("nowhere")

    with pytest.raises(SamplingError, match="nowhere"):
        best_focus(pupil, fails)


def test_a_patch_of_waves_is_brought_to_the_focus_of_its_pupil(paper_lens, samplers):
    reconstructor = PatchReconstructor(paper_lens, patch_um=20.0)
    trial = reconstructor.perturbed(Pose(tilt_x_deg=0.45))
    by_waves = patch_bar_contrast(trial, WIDTH_UM, "x", best=True)
    assert by_waves > patch_bar_contrast(trial, WIDTH_UM, "x") + 0.02
    by_pupil = contrast(best_focus(refocus(samplers[0.0].pupil(Pose(tilt_x_deg=0.45))).pupil, contrast).pupil)
    assert by_waves == pytest.approx(by_pupil, abs=0.05)
