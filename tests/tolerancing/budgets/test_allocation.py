"""Tolerance budgets against the optimum that Lagrange multipliers give."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

from lensdesign.errors import InputError
from tolerancing.budgets import allocation
from tolerancing.budgets.allocation import allocate_tolerances
from tolerancing.merits.base import Merit

LIMIT = Merit(kind="error", at_most=1.0)


def normal_draws(d, power=12):
    return ndtri(qmc.Sobol(d, seed=5).random_base2(power))


class Model:
    """Scores by a function of the deltas mean + scale * deviation; derivatives by differences."""

    def __init__(self, scorer, deviations, mean=0.0):
        self.scorer, self.deviations, self.mean = scorer, deviations, np.asarray(mean)

    def scores(self, scales):
        return self.scorer(self.mean + scales * self.deviations)

    def slopes(self, scales):
        steps = 1e-6 * np.eye(len(scales))
        ends = [(self.scores(scales + step), self.scores(scales - step)) for step in steps]
        return self.scores(scales), np.stack([(high - low) / 2e-6 for high, low in ends], axis=-1)


def linear(slopes, draws):
    return Model(lambda x: (x @ slopes)[:, None], draws)


def wide(d):
    return {"low": np.full(d, 0.1), "high": np.full(d, 10.0)}


@pytest.mark.parametrize("weights", [[1.0, 1.0, 1.0, 1.0], [1.0, 10.0, 0.1, 3.0]])
def test_linear_gaussian_optimum_is_that_of_lagrange(weights):
    """Yield depends on sum (a s sigma)^2 alone; then s^3 is proportional to w / (a sigma)^2."""
    slopes, sigma = np.array([2.0, 0.5, 1.0, 4.0]), np.array([0.1, 0.3, 0.2, 0.02])
    w, required = np.array(weights), 0.9
    shape = (w / (slopes * sigma) ** 2) ** (1.0 / 3.0)
    allowed = 1.0 / ndtri(required)
    best = shape * allowed / np.linalg.norm(slopes * sigma * shape)
    found = allocate_tolerances(
        linear(slopes, sigma * normal_draws(4)), [LIMIT], required,
        low=np.full(4, 0.02), high=50.0, weights=w,
    )  # fmt: skip
    assert found.cost == pytest.approx(np.sum(w / best), rel=0.02)
    np.testing.assert_allclose(found.scales, best, rtol=0.15)
    assert found.predicted_yield >= required
    assert found.cost_before == pytest.approx(w.sum())


def test_a_dozen_perturbations_reach_the_optimum_within_2_percent():
    rng = np.random.default_rng(2)
    slopes, w = 10.0 ** rng.uniform(-0.7, 0.7, 12), 10.0 ** rng.uniform(-1.0, 1.0, 12)
    sigma = 0.1 / slopes * 10.0 ** rng.uniform(-0.5, 0.5, 12)
    shape = (w / (slopes * sigma) ** 2) ** (1.0 / 3.0)
    best = shape / ndtri(0.9) / np.linalg.norm(slopes * sigma * shape)
    found = allocate_tolerances(
        linear(slopes, sigma * normal_draws(12)), [LIMIT], 0.9, low=np.full(12, 0.01), high=100.0, weights=w
    )
    assert found.cost == pytest.approx(np.sum(w / best), rel=0.02)
    assert ndtr(1.0 / np.linalg.norm(slopes * sigma * found.scales)) == pytest.approx(0.9, abs=0.005)


def test_looser_tolerances_are_found_where_the_yield_is_near_one():
    """Nearly all lenses are good at the start, so pass and fail tell nothing about which to loosen."""
    slopes, draws = np.array([1.0, 0.2, 2.0]), 0.2 * normal_draws(3, 13)
    model = linear(slopes, draws)
    found = allocate_tolerances(model, [LIMIT], 0.9, **wide(3))
    assert found.predicted_yield_before > 0.98
    assert found.cost < found.uniform_cost < found.cost_before
    assert found.predicted_yield == pytest.approx(0.9, abs=1e-3)
    uniform = model.scores(np.full(3, found.uniform_scale))
    assert np.mean(LIMIT.passed(uniform[:, 0])) == pytest.approx(0.9, abs=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_never_dearer_than_the_start_or_the_best_common_scale(seed):
    rng = np.random.default_rng(seed)
    slopes = rng.uniform(0.1, 1.0, 5)
    draws = 0.3 * normal_draws(5, 10)
    weights = 10.0 ** rng.uniform(-1.0, 1.0, 5)
    found = allocate_tolerances(linear(slopes, draws), [LIMIT], 0.8, **wide(5), weights=weights)
    assert found.cost <= found.uniform_cost + 1e-12
    if found.predicted_yield_before >= 0.8:
        assert found.cost <= found.cost_before


def test_several_limits_a_mean_and_a_scorer_that_fails():
    """Even and mixed merits; far out there is no score, which counts as bad."""

    def scorer(x):
        first = 0.9 - 4.0 * x[:, 0] ** 2 - x[:, 1] ** 2
        first[np.abs(x[:, 1]) > 2.0] = np.nan
        return np.column_stack([first, 0.5 + x[:, 0] - x[:, 2]])

    merits = [Merit(kind="contrast", at_least=0.7), LIMIT]
    model = Model(scorer, 0.1 * normal_draws(3, 10), [0.02, 0.0, 0.0])
    found = allocate_tolerances(model, merits, 0.9, **wide(3))

    def good(scales):
        scores = model.scores(scales)
        return np.mean(merits[0].passed(scores[:, 0]) & merits[1].passed(scores[:, 1]))

    assert found.predicted_yield == good(found.scales) >= 0.9
    assert found.cost < found.cost_before
    # The second does a quarter of the harm that the first does.
    assert found.scales[1] > 1.3 * found.scales[0]
    for index in range(3):
        looser = found.scales.copy()
        looser[index] *= 1.1
        assert good(looser) < 0.9


def test_ranges_are_kept():
    slopes, draws = np.array([1.0, 1.0, 1.0]), 0.3 * normal_draws(3, 10)
    low, high = np.array([0.2, 1.0, 0.2]), np.array([0.5, 1.0, 9.0])
    found = allocate_tolerances(linear(slopes, draws), [LIMIT], 0.95, low=low, high=high)
    assert np.all((found.scales >= low) & (found.scales <= high))
    assert found.scales[1] == 1.0
    easy = allocate_tolerances(linear(0.01 * slopes, draws), [LIMIT], 0.95, low=low, high=high)
    np.testing.assert_array_equal(easy.scales, high)
    ones = np.ones(3)
    fixed = allocate_tolerances(linear(slopes, draws), [LIMIT], 0.5, low=ones, high=ones)
    np.testing.assert_array_equal(fixed.scales, ones)


def test_a_yield_out_of_reach_is_refused():
    model = linear(np.ones(2), normal_draws(2, 10))
    with pytest.raises(InputError, match=r"required yield = .* 0\.\d+"):
        allocate_tolerances(model, [LIMIT], 0.99, low=np.full(2, 0.5), high=4.0)


@pytest.mark.parametrize(
    ("more", "named"),
    [
        ({"required": 1.0}, "required"),
        ({"weights": [1.0, 0.0]}, "weights"),
        ({"low": [0.0, 0.1]}, "low"),
        ({"high": [0.01, 4.0]}, "high"),
    ],
)
def test_arguments_out_of_range_are_refused(more, named):
    arguments = {"required": 0.5, **wide(2)} | more
    with pytest.raises(InputError, match=named):
        allocate_tolerances(linear(np.ones(2), normal_draws(2, 6)), [LIMIT], **arguments)


def test_what_has_no_effect_is_loosened_to_its_limit():
    """The optimum within ranges is min(high, factor / slope^(2/3)), with the factor that gives the yield."""
    slopes = np.array([1.0] * 4 + [0.3] * 4 + [0.02] * 4 + [0.0] * 10)
    found = allocate_tolerances(
        linear(slopes, normal_draws(22)), [LIMIT], 0.9, low=np.full(22, 0.1), high=np.full(22, 4.0)
    )
    factors = np.linspace(0.1, 1.0, 2000)
    best = np.minimum(4.0, factors[:, None] / np.maximum(slopes, 1e-9) ** (2.0 / 3.0))
    best = best[np.argmin(np.abs(np.linalg.norm(slopes * best, axis=1) - 1.0 / ndtri(0.9)))]
    assert found.cost == pytest.approx(np.sum(1.0 / best), rel=0.02)
    assert np.min(found.scales[12:]) > 3.9


@pytest.mark.parametrize("seed", range(3))
def test_fewer_lenses_in_the_first_step_and_a_start_found_before_lead_to_the_same_optimum(seed):
    """The last step has all lenses: their yield is met, at the cost of a search with all from the start."""
    rng = np.random.default_rng(seed)
    slopes, draws = rng.uniform(0.2, 2.0, 6), 0.2 * normal_draws(6, 13)
    weights = 10.0 ** rng.uniform(-1.0, 1.0, 6)
    model, few = linear(slopes, draws), linear(slopes, draws[:1024])
    whole = allocate_tolerances(model, [LIMIT], 0.9, **wide(6), weights=weights)
    coarse = allocate_tolerances(model, [LIMIT], 0.9, **wide(6), weights=weights, coarse=few)
    again = allocate_tolerances(model, [LIMIT], 0.9, **wide(6), weights=weights, start=coarse.scales)
    for found in (coarse, again):
        assert found.predicted_yield >= 0.9
        assert found.predicted_yield == pytest.approx(0.9, abs=1e-3)
        assert found.cost == pytest.approx(whole.cost, rel=0.005)
    assert again.evaluations < coarse.evaluations


@given(start=st.floats(0.1, 10.0), spread=st.floats(0.01, 20.0))
def test_the_common_scale_is_the_largest_that_meets_the_yield(start, spread):
    """Wherever its search starts, and where all scales or none within the range meet the yield."""
    model = linear(np.array([1.0]), spread * normal_draws(1, 9))
    search = allocation._Search(
        model, model, [LIMIT], 0.9, np.array([0.1]), np.array([10.0]), np.array([1.0])
    )
    found = search.largest_factor(np.array([start]))[0]
    largest = 1.0 / np.quantile(model.deviations[:, 0], 0.9, method="inverted_cdf")
    assert found == pytest.approx(np.clip(largest, 0.1, 10.0), rel=2e-5)
