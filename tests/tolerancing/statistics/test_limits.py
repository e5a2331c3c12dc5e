"""Inverse limits and increments against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign.errors import InputError
from tolerancing.merits.base import Merit
from tolerancing.statistics.limits import PRECISION, SHAPES, inverse, inverse_limits
from tolerancing.statistics.scorer import StudyScorer
from tolerancing.study.evaluate import context_of
from tolerancing.study.files import load_study

CONTRAST = Merit(kind="contrast", at_least=0.7)
SPREAD = Merit(kind="spread_deg", at_most=5.0)


class Counted:
    """A scorer that counts its calls."""

    def __init__(self, function):
        self.function, self.calls = function, 0

    def __call__(self, deltas):
        self.calls += 1
        return self.function(deltas)


@given(
    ends=st.lists(st.tuples(st.floats(0.05, 60.0), st.floats(0.05, 60.0)), min_size=1, max_size=5),
    power=st.sampled_from([0.5, 1.0, 2.0, 6.0]),
)
def test_limits_are_found_on_both_sides(ends, power):
    """A merit that falls by 0.2 at a magnitude of its own on either side of each perturbation."""
    below, above = np.transpose(ends)

    def score(x):
        magnitude = np.where(x < 0.0, -x / below, x / above)
        return (0.9 - 0.2 * np.max(magnitude**power, axis=1))[:, None]

    scorer = Counted(score)
    limits = inverse_limits(scorer, [0.9], np.ones(len(ends)), CONTRAST, 0)
    assert scorer.calls <= 20
    for limit, lower, upper in zip(limits, below, above, strict=True):
        for found, true in ((limit.below, lower), (limit.above, upper)):
            assert true * (1.0 - 1.01 * PRECISION) <= found <= true * (1.0 + 1e-9)
        assert limit.tightest == min(limit.below, limit.above)


def test_smooth_merits_take_few_calls():
    scorer = Counted(lambda x: np.exp(-np.sum(x**2, axis=1))[:, None])
    (limit,) = inverse_limits(scorer, [1.0], [0.4], CONTRAST, 0)
    assert limit.above == pytest.approx(math.sqrt(-math.log(0.7)), rel=1e-3)
    assert scorer.calls <= 10


def test_increments_go_for_the_worse():
    def score(x):
        return np.column_stack([np.zeros(len(x)), 4.0 + 0.1 * x[:, 0]])

    (limit,) = inverse_limits(score, [0.0, 4.0], [1.0], SPREAD, 1, change=0.5)
    assert limit.above == pytest.approx(5.0, rel=1e-3)
    assert limit.below is None
    # A lens that misses its limit still has increments.
    strict = Merit(kind="spread_deg", at_most=3.0)
    (limit,) = inverse_limits(score, [0.0, 4.0], [1.0], strict, 1, change=0.25)
    assert limit.above == pytest.approx(2.5, rel=1e-3)


def test_a_limit_beyond_the_search_is_none():
    def score(x):
        return 1.0 - 0.3 * np.abs(x[:, :1]) / 65.0

    assert inverse_limits(score, [1.0], [1.0], CONTRAST, 0)[0].tightest is None
    assert inverse_limits(score, [1.0], [1.0], CONTRAST, 0, largest=80.0)[0].above == pytest.approx(
        65, rel=1e-3
    )
    nearer = inverse_limits(lambda x: 1.0 - 0.1 * np.abs(x), [1.0], [1.0], CONTRAST, 0, largest=3.1)
    assert nearer[0].above == pytest.approx(3.0, rel=1e-3)


def test_missing_scores_lie_beyond_the_limit():
    (limit,) = inverse_limits(lambda x: np.where(x > 0.3, np.nan, 0.9 + 0 * x), [0.9], [1.0], CONTRAST, 0)
    assert limit.above == pytest.approx(0.3, rel=1e-3)
    assert limit.below is None
    (always,) = inverse_limits(lambda x: np.full((len(x), 1), np.nan), [0.9], [1.0], CONTRAST, 0)
    assert always.below == always.above == 0.0


def test_a_nominal_lens_that_misses_its_limit_is_refused():
    with pytest.raises(InputError, match=r"5\.2.*at most 5"):
        inverse_limits(lambda x: 5.2 + x, [5.2], [1.0], SPREAD, 0)
    with pytest.raises(InputError, match="no score"):
        inverse_limits(lambda x: x, [math.nan], [1.0], SPREAD, 0, change=1.0)


@pytest.mark.parametrize(
    "more", [{"change": 0.0}, {"change": math.nan}, {"largest": 0.5}, {"largest": math.inf}]
)
def test_what_is_out_of_range_is_refused(more):
    with pytest.raises(InputError, match=next(iter(more))):
        inverse_limits(lambda x: x, [0.0], [1.0], SPREAD, 0, **more)


def test_limits_of_a_study_are_where_its_merits_are(write_study, ray_study):
    loaded = load_study(write_study(ray_study))
    counted = []
    found = inverse(loaded, "largest_spread_deg", progress=counted.append)
    (limits,) = found.limits.values()
    scorer = StudyScorer(context_of(loaded.lens, loaded.study), loaded.study)
    score = scorer(np.array([[limits[0].above, 0.0], [limits[0].above * (1.0 + 2.0 * PRECISION), 0.0]]))[:, 0]
    assert score[0] <= 4.83 < score[1]
    assert found.as_dict()["largest_spread_deg"]["lens_decenter_y_mm"]["above"] == limits[0].above
    assert sum(counted) > 4
    tighter = inverse(loaded, change=1e-3).limits["largest_spread_deg"]
    assert tighter[0].above < limits[0].above


def test_an_irregularity_goes_as_far_as_no_shape_misses_the_limit(write_study, full_study):
    rough = (
        '[[perturbation]]\ntarget = "surface 1"\nparameter = "irregularity_pv_waves"\n'
        'distribution = "uniform"\nmean = 0.3\nhalf_width = 0.3\n'
    )
    loaded = load_study(write_study(full_study.replace("[[merit]]", f"{rough}\n[[merit]]", 1)))
    study = loaded.study
    size = inverse(loaded, "strehl").limits["strehl"][2].above
    scorer = StudyScorer(context_of(loaded.lens, study), study)
    for factor, least in ((1.0, SHAPES), (1.0 + 2.0 * PRECISION, SHAPES - 1)):
        deltas = np.tile([0.0, 0.0, factor * size], (SHAPES, 1))
        scores = scorer(deltas, range(SHAPES))[:, 1]
        assert np.ptp(scores) > 0.01
        assert np.count_nonzero(scores >= 0.5) == least


def test_what_a_study_does_not_have_is_refused(write_study, full_study):
    loaded = load_study(write_study(full_study))
    with pytest.raises(InputError, match=r"merit = 'speed'.*largest_spread"):
        inverse(loaded, "speed")
    with pytest.raises(InputError, match=r"change = 0\.1.*largest_s"):
        inverse(loaded, change=0.1)


DEAR = """
[[merit]]
name = "refined"
kind = "strehl"
refocus = false
at_least = 0.5
predicted_by = "strehl"
"""


def test_limits_of_a_dear_merit_are_its_own(write_study, full_study):
    loaded = load_study(write_study(full_study + DEAR))
    dear, cheap = (inverse(loaded, name).limits[name][1] for name in ("refined", "strehl"))
    assert dear.above < 0.9 * cheap.above
    context = context_of(loaded.lens, loaded.study)
    (merit,) = loaded.study.high_fidelity_merits
    for factor, passes in ((1.0, True), (1.0 + 2.0 * PRECISION, False)):
        batch = context.perturbed(loaded.study.perturbations[1:], np.array([[factor * dear.above]]))
        assert merit.passed(merit.scores(context, batch))[0] == passes


SLICED = """
[[perturbation]]
target = "reconstruction"
parameter = "slices"
distribution = "discrete"
values = [10, 20]

[[merit]]
name = "chain"
kind = "reconstruction"
reconstruction_engine = "slices"
line_widths_um = [0.775]
region_mm = 0.03
at_least = 0.5
"""


def test_a_number_of_slices_has_no_limit(write_study, ray_study):
    loaded = load_study(write_study("sensitivity = false\n" + ray_study + SLICED))
    with pytest.raises(InputError, match=r"reconstruction_slices: .*slices"):
        inverse(loaded, "largest_spread_deg")
