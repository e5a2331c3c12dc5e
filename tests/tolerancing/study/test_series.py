"""Sweeps, grids, slice counts and sensitivities: what is varied, and what each step scores."""

import numpy as np
import pytest

from lensdesign import DesignError, Pose
from lensdesign.common.toml_files import validate
from lensdesign.lens.scaling import scaled
from tolerancing.merits.context import Context, Sampling
from tolerancing.study.evaluate import context_of, nominal_scores, score_step
from tolerancing.study.files import load_study
from tolerancing.study.slice_counts import SliceCounts
from tolerancing.study.sweep import STEPS, ParameterGrid
from wavesim import PupilSampler, line_pair_contrast, refocus, resolve
from wavesim.pupil import best_focus

GRID = """
[[grid]]
name = "decenter_tilt"
merits = ["strehl"]
line_widths_um = [1.0]
[grid.x]
target = "lens"
parameter = "decenter_y_mm"
values = [0.0, 0.02, 0.04]
[grid.y]
target = "lens"
parameter = "tilt_x_deg"
values = [0.0, 0.1]
"""


@pytest.fixture
def loaded(write_study, full_study):
    return load_study(write_study(full_study + GRID))


def series(loaded, kind):
    (found,) = [k for k, part in enumerate(loaded.study.series) if type(part).__name__ == kind]
    return found, loaded.study.series[found]


def test_a_sweep_scores_its_merits_and_lines(loaded):
    number, sweep = series(loaded, "Sweep")
    context = context_of(loaded.lens, loaded.study)
    steps = [score_step(context, loaded.study, number, step) for step in range(len(sweep))]
    assert [step.coordinates for step in steps] == [{"decenter_y_mm": v} for v in (0.0, 0.02, 0.04)]
    assert set(steps[1].scores) == {"largest_spread_deg", "contrast_1um_refocused", "contrast_1um"}
    pupil = PupilSampler(loaded.lens, samples=64).pupil(Pose(decenter_y_mm=0.04))
    flat = refocus(pupil).pupil

    def contrast(seen, axis):
        return line_pair_contrast(seen, 1.0, axis)

    expected = min(
        contrast(best_focus(flat, lambda seen, axis=axis: contrast(seen, axis)).pupil, axis) for axis in "xy"
    )
    assert expected > min(contrast(flat, axis) for axis in "xy")
    assert steps[2].scores["contrast_1um_refocused"] == pytest.approx(expected, abs=1e-12)
    assert [len(step.pictures) for step in steps] == [0, 0, 2]


def test_a_grid_takes_all_pairs(loaded):
    number, grid = series(loaded, "ParameterGrid")
    context = context_of(loaded.lens, loaded.study)
    steps = [score_step(context, loaded.study, number, step) for step in range(len(grid))]
    assert [tuple(step.coordinates.values()) for step in steps] == [
        (x, y) for y in (0.0, 0.1) for x in (0.0, 0.02, 0.04)
    ]
    assert list(steps[0].coordinates) == ["lens_decenter_y_mm", "lens_tilt_x_deg"]
    pupil = PupilSampler(loaded.lens, samples=64).pupil(Pose(decenter_y_mm=0.04, tilt_x_deg=0.1))
    from wavesim import strehl

    assert steps[-1].scores["strehl"] == pytest.approx(strehl(refocus(pupil).pupil), abs=1e-12)


def test_sensitivities_take_one_perturbation_at_a_time(loaded):
    number, alone = series(loaded, "OneAtATime")
    assert len(alone) == 2 * len(STEPS)
    assert [alone.coordinates(step)["deviation"] for step in range(len(STEPS))] == pytest.approx(
        [0.04 * share for share in STEPS]
    )
    assert alone.coordinates(len(STEPS))["perturbation"] == "shop_radius_mm"
    context = context_of(loaded.lens, loaded.study)
    step = score_step(context, loaded.study, number, len(STEPS) - 1)
    assert step.series == "sensitivity"
    assert set(step.scores) == {"largest_spread_deg", "strehl"}
    pupil = PupilSampler(loaded.lens, samples=64).pupil(Pose(decenter_y_mm=0.04))
    from wavesim import strehl

    assert step.scores["strehl"] == pytest.approx(strehl(refocus(pupil).pupil), abs=1e-12)


def test_sensitivities_can_be_left_out(write_study, full_study):
    study = load_study(write_study("sensitivity = false\n" + full_study)).study
    assert [part.label for part in study.series] == ["decenter"]


def test_slice_counts_are_judged_against_the_eikonal_engine(paper_lens, loaded):
    twin = scaled(paper_lens, 1.0 / 32.0)
    counts = SliceCounts(slices=(1, 40), line_widths_um=(1.0,), picture_slices=(40,))
    counts.check(twin)
    context = Context(twin, Sampling())
    steps = [counts.score(context, loaded.study.merits, step) for step in range(len(counts))]
    assert [tuple(step.coordinates.values()) for step in steps] == [
        ("vertical", 1.0),
        ("oblique", 1.0),
        ("vertical", 40.0),
        ("oblique", 40.0),
    ]
    direct = resolve(twin, [1.0], 0.0, "slices", slices=40, compensation="oblique").lines[0]
    assert steps[3].scores["contrast_1um"] == direct.contrast
    assert steps[3].scores["contrast_of_eikonal_1um"] == direct.contrast_of_reference
    assert steps[0].scores["contrast_1um"] < steps[3].scores["contrast_1um"]
    assert steps[0].pictures == ()
    (picture,) = steps[3].pictures
    assert picture.half_width_um == 5.0
    assert np.ptp(picture.intensity, axis=1).max() == 0.0
    # Five bars: the profile crosses its middle ten times.
    profile = picture.intensity[:, 0]
    level = 0.5 * (profile.max() + profile.min())
    assert np.count_nonzero(np.diff(np.sign(profile - level))) == 10


@pytest.mark.parametrize(
    ("kind", "keys", "message"),
    [
        (SliceCounts, {"slices": [0], "line_widths_um": [1.0]}, "slices 1 = 0"),
        (SliceCounts, {"slices": [9], "line_widths_um": []}, "line_widths_um"),
        (
            SliceCounts,
            {"slices": [9], "line_widths_um": [1.0], "picture_slices": [8]},
            r"picture_slices = \[8\]: allowed: the values of slices",
        ),
        (SliceCounts, {"slices": [9], "line_widths_um": [1.0], "compensations": ["none"]}, "compensations"),
        (ParameterGrid, {"name": "g", "merits": ["strehl"]}, "x: missing key"),
    ],
)
def test_faulty_series_are_refused(kind, keys, message):
    with pytest.raises(DesignError, match=message):
        validate(kind, keys, "here")


DEAR = """
[[merit]]
name = "refined"
kind = "rms_waves"
refocus = false
at_most = 1.0
predicted_by = "strehl"
"""

SWEEP_OF_DEAR = """
[[sweep]]
name = "of_dear"
target = "lens"
parameter = "decenter_y_mm"
values = [0.0, 0.02]
merits = ["refined"]
"""


def test_a_sweep_scores_the_dear_merit_that_it_names_itself(write_study, full_study):
    loaded = load_study(write_study(full_study + DEAR + SWEEP_OF_DEAR))
    number = [part.label for part in loaded.study.series].index("of_dear")
    context = context_of(loaded.lens, loaded.study)
    steps = [score_step(context, loaded.study, number, step) for step in range(2)]
    (dear,) = loaded.study.high_fidelity_merits
    expected = dear.scores(context, context.perturbed(loaded.study.perturbations[:1], np.array([[0.02]])))
    assert steps[1].scores == {"refined": expected[0]}
    assert steps[1].scores["refined"] > steps[0].scores["refined"] + 0.01


def test_line_pairs_of_a_sweep_take_no_merits_place(write_study, full_study):
    """A merit may share its name with a sweep's own line pairs, which are those of the pupil."""
    named = full_study.replace('kind = "strehl"', 'kind = "strehl"\nname = "contrast_1um"')
    loaded = load_study(write_study(named))
    context = context_of(loaded.lens, loaded.study)
    assert nominal_scores(context, loaded.study)["contrast_1um"] == pytest.approx(1.0, abs=1e-9)
    both = named.replace('merits = ["largest_spread_deg"]', 'merits = ["contrast_1um"]')
    with pytest.raises(DesignError, match=r"'contrast_1um' is also the name of a contrast of line_widths_um"):
        load_study(write_study(both))


SLICED = """
[[merit]]
name = "chain"
kind = "reconstruction"
reconstruction_engine = "slices"
slices = 20
line_widths_um = [0.775]
region_mm = 0.03
at_least = 0.5
"""

SLICES = """
[[perturbation]]
target = "reconstruction"
parameter = "slices"
distribution = "discrete"
values = [10, 20]
"""


def test_settings_are_refused_where_nothing_follows_them(write_study, ray_study):
    with pytest.raises(DesignError, match="no merit of the study depends on the number of slices"):
        load_study(write_study("sensitivity = false\n" + ray_study + SLICES))
    with pytest.raises(DesignError, match=r"sensitivity = false.*sweep"):
        load_study(write_study(ray_study + SLICES + SLICED))
    study = load_study(write_study("sensitivity = false\n" + ray_study + SLICES + SLICED)).study
    assert study.perturbations[-1].is_setting


def test_what_a_line_cannot_show_is_refused_with_the_merits_name(write_study, ray_study):
    aside = ray_study.replace('"decenter_y_mm"', '"decenter_x_mm"')
    with pytest.raises(DesignError, match=r"merit 'chain': lens_decenter_x_mm: .*meridional line"):
        load_study(write_study(aside + SLICED))
