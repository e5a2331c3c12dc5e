"""Tolerance budgets against the optimum that Lagrange multipliers give."""

import numpy as np
import pytest
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

from lensdesign.errors import InputError
from tolerancing.analysis.tolerance_search import loosest_tolerances
from tolerancing.analysis.yields import yield_of
from tolerancing.merits.base import Merit

LIMIT = Merit(kind="error", at_most=1.0)


def normal_draws(d, power=12):
    return ndtri(qmc.Sobol(d, seed=5).random_base2(power))


def linear_scorer(slopes):
    return lambda x: (x @ slopes)[:, None]


@pytest.mark.parametrize("weights", [[1.0, 1.0, 1.0, 1.0], [1.0, 10.0, 0.1, 3.0]])
def test_linear_gaussian_optimum_is_that_of_lagrange(weights):
    """Yield depends on sum (a s sigma)^2 alone; then s^3 is proportional to w / (a sigma)^2."""
    slopes, sigma = np.array([2.0, 0.5, 1.0, 4.0]), np.array([0.1, 0.3, 0.2, 0.02])
    w, required = np.array(weights), 0.9
    shape = (w / (slopes * sigma) ** 2) ** (1.0 / 3.0)
    allowed = 1.0 / ndtri(required)
    best = shape * allowed / np.linalg.norm(slopes * sigma * shape)
    found = loosest_tolerances(
        linear_scorer(slopes), [LIMIT], 0.0, sigma * normal_draws(4), required,
        low=0.02, high=50.0, weights=w, bound="share",
    )  # fmt: skip
    assert found.cost == pytest.approx(np.sum(w / best), rel=0.02)
    np.testing.assert_allclose(found.scales, best, rtol=0.15)
    assert found.good.share >= required
    assert found.cost_before == pytest.approx(w.sum())


def test_a_dozen_perturbations_reach_the_optimum_within_2_percent():
    rng = np.random.default_rng(2)
    slopes, w = 10.0 ** rng.uniform(-0.7, 0.7, 12), 10.0 ** rng.uniform(-1.0, 1.0, 12)
    sigma = 0.1 / slopes * 10.0 ** rng.uniform(-0.5, 0.5, 12)
    shape = (w / (slopes * sigma) ** 2) ** (1.0 / 3.0)
    best = shape / ndtri(0.9) / np.linalg.norm(slopes * sigma * shape)
    found = loosest_tolerances(
        linear_scorer(slopes), [LIMIT], 0.0, sigma * normal_draws(12), 0.9,
        low=0.01, high=100.0, weights=w, bound="share",
    )  # fmt: skip
    assert found.cost == pytest.approx(np.sum(w / best), rel=0.02)
    assert ndtr(1.0 / np.linalg.norm(slopes * sigma * found.scales)) == pytest.approx(0.9, abs=0.005)


def test_the_interval_begins_at_the_requirement():
    slopes, sigma = np.array([1.0, 2.0]), np.array([0.4, 0.2])
    draws = sigma * normal_draws(2, 9)
    found = loosest_tolerances(linear_scorer(slopes), [LIMIT], 0.0, draws, 0.9)
    assert 0.9 <= found.good.low < 0.905
    scores = draws * found.scales @ slopes
    assert found.good == yield_of(LIMIT.passed(scores))
    assert found.before == yield_of(LIMIT.passed(draws @ slopes))
    assert found.evaluations > 10


def test_several_limits_a_mean_and_a_scorer_that_fails():
    """Even and mixed merits; far out there is no score, which counts as bad."""

    def scorer(x):
        first = 0.9 - 4.0 * x[:, 0] ** 2 - x[:, 1] ** 2
        first[np.abs(x[:, 1]) > 2.0] = np.nan
        return np.column_stack([first, 0.5 + x[:, 0] - x[:, 2]])

    merits = [Merit(kind="contrast", at_least=0.7), LIMIT]
    draws = 0.1 * normal_draws(3, 10)
    found = loosest_tolerances(scorer, merits, [0.02, 0.0, 0.0], draws, 0.9)
    scores = scorer(np.array([0.02, 0.0, 0.0]) + found.scales * draws)
    kept = merits[0].passed(scores[:, 0]) & merits[1].passed(scores[:, 1])
    assert found.good == yield_of(kept)
    assert found.good.low >= 0.9
    assert found.cost < found.cost_before
    # The second does a quarter of the harm that the first does.
    assert found.scales[1] > 1.3 * found.scales[0]
    for index in range(3):
        looser = found.scales.copy()
        looser[index] *= 1.1
        worse = scorer(np.array([0.02, 0.0, 0.0]) + looser * draws)
        both = merits[0].passed(worse[:, 0]) & merits[1].passed(worse[:, 1])
        assert yield_of(both).low < 0.9


def test_a_model_that_errs_is_corrected_by_the_scorer_that_verifies():
    """The model takes every slope for four fifths of what it is."""
    slopes, draws = np.array([1.0, 2.0, 0.7]), 0.3 * normal_draws(3, 10)
    full = linear_scorer(slopes)
    right = loosest_tolerances(full, [LIMIT], 0.0, draws, 0.9)
    found = loosest_tolerances(linear_scorer(0.8 * slopes), [LIMIT], 0.0, draws, 0.9, verify=full)
    alone = loosest_tolerances(linear_scorer(0.8 * slopes), [LIMIT], 0.0, draws, 0.9)
    assert found.good == yield_of(LIMIT.passed(full(draws * found.scales)[:, 0]))
    assert found.good.low >= 0.9 > yield_of(LIMIT.passed(full(draws * alone.scales)[:, 0])).low
    assert found.cost == pytest.approx(right.cost, rel=0.02)


def test_ranges_are_kept():
    slopes, draws = np.array([1.0, 1.0, 1.0]), 0.3 * normal_draws(3, 10)
    low, high = np.array([0.2, 1.0, 0.2]), np.array([0.5, 1.0, 9.0])
    found = loosest_tolerances(linear_scorer(slopes), [LIMIT], 0.0, draws, 0.95, low=low, high=high)
    assert np.all((found.scales >= low) & (found.scales <= high))
    assert found.scales[1] == 1.0
    easy = loosest_tolerances(linear_scorer(0.01 * slopes), [LIMIT], 0.0, draws, 0.95, low=low, high=high)
    np.testing.assert_array_equal(easy.scales, high)
    fixed = loosest_tolerances(linear_scorer(slopes), [LIMIT], 0.0, draws, 0.5, low=1.0, high=1.0)
    np.testing.assert_array_equal(fixed.scales, np.ones(3))


def test_a_yield_out_of_reach_is_told():
    draws = normal_draws(2, 10)
    with pytest.raises(InputError, match=r"out of reach; even the smallest scales give 0\.\d+ \(\d+ of 1024"):
        loosest_tolerances(linear_scorer(np.ones(2)), [LIMIT], 0.0, draws, 0.99, low=0.5, bound="share")
    with pytest.raises(InputError, match="20 draws cannot show it"):
        loosest_tolerances(linear_scorer(np.ones(2)), [LIMIT], 0.0, draws[:20], 0.9)


@pytest.mark.parametrize("required", [0.5, 0.8, 0.95])
def test_the_draws_needed_are_the_fewest_whose_interval_begins_there(required):
    from tolerancing.analysis.tolerance_search import draws_needed

    for n in (100, 1000):
        needed = draws_needed(n, required, "low")
        assert yield_of(np.arange(n) < needed).low >= required - 1e-12
        assert yield_of(np.arange(n) < needed - 1).low < required


@pytest.mark.parametrize(
    ("more", "named"),
    [
        ({"required": 1.0}, "required"),
        ({"weights": [1.0, 0.0]}, "weights"),
        ({"low": 0.0}, "low"),
        ({"high": 0.1}, "high"),
        ({"bound": "high"}, "bound"),
    ],
)
def test_what_is_out_of_range_is_refused(more, named):
    arguments = {"required": 0.5} | more
    with pytest.raises(InputError, match=named):
        loosest_tolerances(linear_scorer(np.ones(2)), [LIMIT], 0.0, normal_draws(2, 6), **arguments)
