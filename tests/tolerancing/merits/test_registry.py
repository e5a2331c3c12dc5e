"""Merits: scores against independent computations, limits, failures as data."""

import re

import numpy as np
import pytest

from lensdesign import DesignError, Pose, SurfacePerturbation
from lensdesign.errors import InputError
from lensdesign.raytrace.bundles import launch, pupil_rings
from lensdesign.raytrace.rays import trace
from tolerancing.merits.base import Merit
from tolerancing.merits.context import Context, Sampling
from tolerancing.merits.registry import MERITS, merit_from_table
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.study.evaluate import context_of, decide_levels, score_trials
from tolerancing.study.files import load_study
from tolerancing.study.scoring import score_batch
from wavesim.scene.system_state import SystemState

SAMPLING = Sampling(rings=3, arms=8, pupil_samples=64)
PARAMETERS = (
    PerturbedParameter(target="lens", parameter="decenter_y_mm"),
    PerturbedParameter(target="lens", parameter="tilt_x_deg"),
    PerturbedParameter(target="surface 2", parameter="radius_mm"),
)
VALUES = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.2, 0], [0.02, -0.1, 0.003], [0, 0, -0.004]])


@pytest.fixture(scope="module")
def context(paper_lens):
    return Context(paper_lens, SAMPLING)


@pytest.fixture(scope="module")
def batch():
    return PerturbationBatch(PARAMETERS, VALUES)


def merit(kind, **keys):
    limit = {} if {"at_least", "at_most"} & set(keys) else {"at_least": 0.0}
    return merit_from_table({"kind": kind} | limit | keys, "here")


REQUIRED = {
    "line_pair_contrast": {"line_width_um": 1.55},
    "mtf": {"frequency_lp_per_mm": 300.0},
    "reconstruction_loss": {"patch_mm": 0.02},
    "reconstruction": {"line_widths_um": [0.775], "region_mm": 0.03},
}


@pytest.mark.parametrize("kind", sorted(MERITS.keys() - {"python", "reconstructed_contrast"}))
def test_scores_do_not_depend_on_the_batch(context, batch, kind):
    one = merit(kind, **REQUIRED.get(kind, {}))
    together = one.scores(context, batch)
    assert together.shape == (len(VALUES),)
    assert np.all(np.isfinite(together))
    alone = [one.scores(context, single)[0] for single in batch.single_trials()]
    assert together.tolist() == alone


@pytest.mark.parametrize("kind", sorted(MERITS))
def test_what_a_merit_was_asked_for_is_told_in_words(kind):
    keys = REQUIRED.get(kind, {})
    if kind == "python":
        keys = {"function": "file.py:name"}
    if kind == "reconstructed_contrast":
        keys = {"line_width_um": 1.55, "patch_mm": 0.1}
    meaning = merit(kind, **keys, wavelength_um=0.6).meaning
    assert not re.search(r"=|_|\b(True|False|None)\b|[{}\[\]]", meaning)
    assert "ight of 0.6 µm" in meaning
    assert meaning.endswith(".")


def test_words_tell_what_counts_at_the_level():
    lines = {"line_width_um": 0.775, "orientation": "y", "refocus": False}
    asked = merit("line_pair_contrast", level="pupil", **lines).meaning.partition("exchanged. ")[2]
    assert asked == "Lines of 0.775 µm, along y, at (0, 0) mm in the object, not refocused."
    waves = merit("line_pair_contrast", level="wave", line=True, electrons=5000.0, **lines).meaning
    assert waves.endswith("not refocused, on a meridional line, 5000 electrons in the brightest pixel.")


def test_ray_merits_match_rays_traced_one_lens_at_a_time(paper_lens, context, batch):
    points = ((0.0, 0.0), (0.0, -1.5))
    planes = (*paper_lens.sensor.plane_distances_mm, 9.0)
    pupil = context.extreme_samples(points, None, planes)
    assert len(pupil_rings(3, 8, edge=True).points) < len(pupil.points)
    spread = merit("largest_spread_deg", field_points_mm=points).scores(context, batch)
    footprint = merit("footprint_radius_mm", field_points_mm=points, plane_distance_mm=9.0)
    radius = footprint.scores(context, batch)
    for trial, (decenter, tilt, bend) in enumerate(VALUES):
        pose = Pose(decenter_y_mm=decenter, tilt_x_deg=tilt)
        change = {1: SurfacePerturbation(radius_mm=bend)}
        rays = launch(paper_lens, points, pupil.points, 0.532, pose, change)
        plane = paper_lens.exit_vertex_z_mm + 9.0
        result = trace(paper_lens, *rays, 0.532, pose, plane, surface_perturbations=change)
        assert np.all(result.ok)
        angle = np.rad2deg(np.arccos(result.direction[:, 2]))
        assert spread[trial] == pytest.approx(angle.max(), rel=1e-9)
        distance = np.hypot(result.position[:, 0], result.position[:, 1])
        assert radius[trial] == pytest.approx(distance.max(), rel=1e-12)


def test_spread_of_the_nominal_lens_is_the_known_one(paper_lens, batch):
    context = Context(paper_lens, Sampling())
    assert merit("largest_spread_deg").scores(context, batch)[0] == pytest.approx(4.810, abs=1e-3)


def test_throughput_is_the_share_of_rays_that_pass(paper_lens, batch):
    narrow = paper_lens.with_surface(1, semi_diameter_mm=8.0)
    context = Context(narrow, Sampling(rings=40, arms=60))
    share = merit("throughput", field_points_mm=[[0.0, 0.0]]).scores(context, batch)[0]
    # On the axis rays within one height pass: the share is that height's square over the stop's.
    heights = np.linspace(0.0, 1.0, 4001)
    fan = np.column_stack([np.zeros_like(heights), heights])
    origins, directions = launch(narrow, [[0.0, 0.0]], fan, 0.532)
    passed = trace(narrow, origins, directions, 0.532).ok
    assert 0.5 < share < 0.9
    assert share == pytest.approx(heights[passed].max() ** 2, abs=0.03)
    full = merit("throughput").scores(Context(paper_lens, SAMPLING), batch)
    np.testing.assert_allclose(full, 1.0, atol=1e-12)


def test_pupil_merits_of_the_nominal_lens_are_perfect(context, batch):
    assert merit("strehl").scores(context, batch)[0] == pytest.approx(1.0, abs=1e-9)
    assert merit("rms_waves").scores(context, batch)[0] == pytest.approx(0.0, abs=1e-6)
    cutoff = 2.0 * 0.5 / 0.532e-3
    v = 400.0 / cutoff
    expected = 2.0 / np.pi * (np.arccos(v) - v * np.sqrt(1.0 - v * v))
    score = merit("mtf", frequency_lp_per_mm=400.0).scores(context, batch)[0]
    assert score == pytest.approx(expected, abs=0.01)


def test_perturbed_lens_is_worse_and_refocusing_helps_a_wrong_radius(context, batch):
    sharp = merit("strehl").scores(context, batch)
    blurred = merit("strehl", refocus=False).scores(context, batch)
    assert np.all(sharp[1:4] < 0.95)
    assert sharp[4] > blurred[4] + 0.05


def test_worse_orientation_is_the_lower_of_both(context, batch):
    scores = {
        axis: merit("line_pair_contrast", line_width_um=0.7, orientation=axis).scores(context, batch)
        for axis in ("x", "y", "worse")
    }
    assert np.any(scores["x"] != scores["y"])
    assert scores["worse"].tolist() == np.minimum(scores["x"], scores["y"]).tolist()


def test_the_worst_of_several_field_points_counts(context, batch):
    points = [[0.0, 0.0], [0.0, 1.0], [1.0, 0.5]]
    for kind, limit in (("strehl", {"at_least": 0.5}), ("rms_waves", {"at_most": 0.2})):
        scores = [merit(kind, field_mm=point, **limit).scores(context, batch) for point in points]
        together = merit(kind, field_points_mm=points, **limit).scores(context, batch)
        worst = np.min if "at_least" in limit else np.max
        assert together.tolist() == worst(scores, axis=0).tolist()


def test_image_shift_is_that_of_the_object(context):
    parameters = [PerturbedParameter(target="object", parameter=f"decenter_{axis}_mm") for axis in ("x", "y")]
    moved = PerturbationBatch(tuple(parameters), np.array([[0.0, 0.0], [0.003, -0.004]]))
    shift = merit("image_shift_um", at_most=1.0).scores(context, moved)
    assert shift == pytest.approx([0.0, 5.0], abs=1e-3)


def test_smallest_resolved_line_is_where_contrast_meets_the_limit(context, batch):
    width = merit("smallest_resolved_line_um", contrast=0.3, orientation="y", at_most=1.0)
    widths = width.scores(context, batch)
    for trial, found in enumerate(widths):
        at = merit("line_pair_contrast", line_width_um=float(found), orientation="y")
        finer = merit("line_pair_contrast", line_width_um=float(found) * 0.98, orientation="y")
        assert at.scores(context, batch)[trial] >= 0.3 > finer.scores(context, batch)[trial]


def test_a_longer_wave_is_a_lens_of_other_indices_and_scaled_path(context):
    light = PerturbedParameter(target="light", parameter="wavelength_um")
    batch = PerturbationBatch((light,), np.array([[0.0], [1e-4], [1e-3]]))
    waves = merit("rms_waves", at_most=1.0).scores(context, batch)
    assert waves[0] == pytest.approx(0.0, abs=1e-6)
    assert 5.0 < waves[2] / waves[1] < 15.0
    # Without dispersion and lens a longer wave is the same path in fewer waves.
    sampler = context.sampler((0.0, 0.0), 0.532)
    longer = sampler.pupil(SystemState(wavelength_um=0.5325))
    path = sampler.nominal.path_mm * (0.532 / 0.5325 - 1.0)
    assert longer.opd_mm == pytest.approx(path, abs=1e-9)


def test_merits_tell_what_compensation_does(context, batch):
    strehl = merit("strehl")
    assert strehl.is_compensated(compensators=False)
    plain = merit("strehl", refocus=False)
    assert not plain.is_compensated(compensators=False)
    assert strehl.uncompensated(context, batch).tolist() == plain.scores(context, batch).tolist()
    assert not merit("throughput").is_compensated(compensators=True)


def test_limits_work_both_ways_and_a_missing_score_keeps_none():
    scores = [0.4, 0.5, 0.6, np.nan]
    assert merit("strehl", at_least=0.5).passed(scores).tolist() == [False, True, True, False]
    assert merit("strehl", at_most=0.5).passed(scores).tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"kind": "line_pair_contrast", "at_least": 0.1}, "line_width_um: missing key"),
        (
            {"kind": "mtf", "at_least": 0.1, "frequency_lp_per_mm": 0.0},
            "frequency_lp_per_mm = 0.0: must be gr",
        ),
        ({"kind": "strehl", "at_least": float("nan")}, "at_least = nan: must be a finite number"),
        ({"kind": "strehl", "at_least": 0.5, "field_mm": [0.0]}, "field_mm"),
        ({"kind": "line_pair_contrast", "at_least": 0.1, "line_width_um": 1.0, "orientation": "z"}, "orient"),
        ({"kind": "strehl", "at_least": 0.5, "level": "wave"}, "level = 'wave': allowed: auto, pupil"),
        (
            {"kind": "strehl", "at_least": 0.5, "field_mm": [0.0, 0.0], "field_points_mm": [[0.0, 0.0]]},
            "give field_mm or field_points_mm",
        ),
        ({"at_least": 0.5}, "kind: missing key; allowed values: largest_spread_deg"),
    ],
)
def test_faulty_merits_are_refused(keys, message):
    with pytest.raises(DesignError, match=f"here: {message}"):
        merit_from_table(keys, "here")


class Fussy(MERITS["strehl"]):
    """Fails on some trials, as a merit with a fault in it would."""

    def scores(self, context, batch):
        if np.any(batch.values[:, 0] == 0.02):
            raise InputError("too much")
        if np.any(batch.values[:, 1] == 0.2):
            raise ZeroDivisionError("a fault")
        return batch.values[:, 0] + 1.0


def test_a_failing_trial_says_why_and_spoils_no_other(context, batch):
    good = merit("largest_spread_deg")
    merits = [good, Fussy(kind="strehl", name="fussy", at_least=0.0)]
    scores, messages = score_batch(merits, context, batch)
    assert messages == ("", "", "fussy: ZeroDivisionError: a fault", "fussy: too much", "")
    assert np.isnan(scores[:, 1]).tolist() == [False, False, True, True, False]
    assert scores[:, 0].tolist() == good.scores(context, batch).tolist()


def test_trials_scored_singly_share_what_the_batch_has_traced(context, batch, monkeypatch):
    context.raw_pupils(batch, (0.0, 0.0), None)
    monkeypatch.setattr("wavesim.PupilSampler.pupil", None)
    alone = [context.raw_pupils(one, (0.0, 0.0), None)[0] for one in batch.single_trials()]
    assert alone == context.raw_pupils(batch, (0.0, 0.0), None)


def test_lost_rays_are_a_message_not_a_score(paper_lens):
    parameter = PerturbedParameter(target="lens", parameter="decenter_y_mm")
    context = Context(paper_lens.with_surface(1, semi_diameter_mm=0.2), SAMPLING)
    far = PerturbationBatch((parameter,), np.array([[0.0], [6.0]]))
    spread = merit("largest_spread_deg", field_points_mm=[[0.0, 0.0]])
    sampled = Context(paper_lens, SAMPLING)
    scores, messages = score_batch([spread], context, far)
    assert np.isnan(scores[1, 0])
    assert messages[1] == "largest_spread_deg: no ray arrives"
    assert score_batch([spread], sampled, far)[1] == ("", "")


def test_one_impossible_lens_in_a_batch_fails_alone(context):
    parameter = PerturbedParameter(target="surface 2", parameter="radius_mm")
    batch = PerturbationBatch((parameter,), np.array([[0.0], [13.0], [0.01]]))
    scores, messages = score_batch([merit("largest_spread_deg"), merit("strehl")], context, batch)
    assert messages[0] == messages[2] == ""
    assert "surface 2" in messages[1]
    assert np.all(np.isnan(scores[1]))
    assert np.all(np.isfinite(scores[[0, 2]]))


class Distance(Merit):
    """How far the first perturbation is from nominal."""

    kind_unit = "mm"
    levels = ("ray",)

    def scores(self, context, batch):
        return np.abs(batch.values[:, 0])


def test_a_merit_is_one_class_and_one_line(monkeypatch, write_study, ray_study):
    monkeypatch.setitem(MERITS, "distance", Distance)
    loaded = load_study(write_study(ray_study + '\n[[merit]]\nkind = "distance"\nat_most = 0.03\n'))
    study = loaded.study.with_levels(decide_levels(loaded.lens, loaded.study))
    assert study.merits[1].column == "distance_mm"
    found = score_trials(context_of(loaded.lens, study), study, range(20))
    assert found.scores[:, 1].tolist() == np.abs(found.values[:, 0]).tolist()
    assert not np.any(found.passed[found.scores[:, 1] > 0.03])
