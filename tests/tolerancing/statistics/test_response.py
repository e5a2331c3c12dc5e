"""Response models: recovery of polynomials, cross-validation, missing scores."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign.errors import InputError
from tolerancing.statistics.response import fit_response


def polynomial(rng, d):
    """A random second-order polynomial of d variables."""
    linear, square = rng.normal(size=d), rng.normal(size=(d, d))
    return lambda x: 1.5 + x @ linear + np.einsum("ni,ij,nj->n", x, square, x)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), d=st.integers(1, 6))
def test_second_order_polynomials_are_recovered(seed, d):
    rng = np.random.default_rng(seed)
    scale, mean = 10.0 ** rng.uniform(-4, 2, d), rng.normal(size=d)
    n = 4 * (1 + 2 * d + d * (d - 1) // 2)
    truth = polynomial(rng, d)
    x, new = rng.normal(size=(n, d)) + mean, rng.normal(size=(50, d)) + mean
    model = fit_response(x * scale, truth(x)[:, None])
    assert model.order == 3
    assert model.cross_validated_r_squared[0] > 1.0 - 1e-6
    spread = np.std(truth(x))
    np.testing.assert_allclose(model.predict(new * scale)[:, 0], truth(new), atol=2e-3 * spread)


def test_leave_one_out_is_what_refitting_gives(monkeypatch):
    monkeypatch.setattr("tolerancing.statistics.response.PENALTIES", (1e-8,))
    rng = np.random.default_rng(1)
    x = rng.normal(size=(40, 2))
    y = np.sin(2.0 * x[:, 0]) + x[:, 1] + 0.3 * rng.normal(size=40)
    errors, about_mean = [], []
    for k in range(40):
        rest = np.arange(40) != k
        errors.append(fit_response(x[rest], y[rest]).predict(x[k : k + 1])[0, 0] - y[k])
        about_mean.append(y[rest].mean() - y[k])
    expected = 1.0 - np.sum(np.square(errors)) / np.sum(np.square(about_mean))
    assert fit_response(x, y).cross_validated_r_squared[0] == pytest.approx(expected, abs=1e-5)


def test_noise_is_not_taken_for_signal():
    rng = np.random.default_rng(2)
    x = rng.normal(size=(150, 5))
    model = fit_response(x, np.column_stack([rng.normal(size=150), x[:, 0] + rng.normal(size=150)]))
    noise, half = model.cross_validated_r_squared
    assert -0.1 < noise < 0.1
    assert half == pytest.approx(0.5, abs=0.15)
    assert np.all(model.r_squared >= model.cross_validated_r_squared)


@pytest.mark.parametrize(("n", "order"), [(12, 1), (20, 1), (21, 2), (29, 2), (30, 3)])
def test_terms_are_as_many_as_the_trials_bear(n, order):
    x = np.random.default_rng(3).normal(size=(n, 3))
    assert fit_response(x, x[:, 0]).order == order


def test_trials_without_a_score_are_left_out_and_counted():
    rng = np.random.default_rng(4)
    x = rng.normal(size=(60, 2))
    scores = np.column_stack([x[:, 0] ** 2, x[:, 1]])
    scores[:7, 0] = np.nan
    model = fit_response(x, scores)
    np.testing.assert_array_equal(model.left_out, [7, 0])
    np.testing.assert_array_equal(model.used, [53, 60])
    np.testing.assert_allclose(model.predict(x)[:, 0], x[:, 0] ** 2, atol=1e-4)


def test_a_perturbation_or_a_merit_that_does_not_vary():
    x = np.column_stack([np.random.default_rng(5).normal(size=40), np.full(40, 0.3)])
    model = fit_response(x, np.column_stack([2.0 * x[:, 0], np.full(40, 0.1)]))
    np.testing.assert_allclose(
        model.predict(x), np.column_stack([2.0 * x[:, 0], np.full(40, 0.1)]), atol=1e-6
    )
    np.testing.assert_allclose(model.r_squared, 1.0)
    assert model.predict(np.zeros((9000, 2))).shape == (9000, 2)


def test_too_few_trials_are_refused():
    x = np.random.default_rng(6).normal(size=(11, 3))
    with pytest.raises(InputError, match=r"merit 1 .*11 .*12"):
        fit_response(x, x[:, 0])
    with pytest.raises(InputError, match="finite"):
        fit_response(np.full((20, 1), np.nan), np.zeros(20))


@pytest.mark.parametrize("n", [12, 30, 60])
def test_slopes_and_sizes_have_the_derivatives_that_differences_have(n):
    rng = np.random.default_rng(2)
    x, new = rng.normal(size=(n, 3)) * [1.0, 10.0, 0.1], rng.normal(size=(5, 3))
    scores = np.stack([polynomial(rng, 3)(x), x[:, 1] ** 2], axis=1)
    model = fit_response(x, scores)
    for k, step in enumerate(1e-5 * np.eye(3)):
        change = (model.predict(new + step) - model.predict(new - step)) / 2e-5
        np.testing.assert_allclose(model.slopes(new)[:, :, k], change, rtol=1e-5, atol=1e-5)
        change = (model.sizes(new + step)[0] - model.sizes(new - step)[0]) / 2e-5
        np.testing.assert_allclose(model.sizes(new)[1][:, :, k], change, rtol=1e-5, atol=1e-7)


def test_only_deviations_on_which_a_merit_depends_have_a_size():
    x = np.random.default_rng(3).normal(size=(60, 2))
    model = fit_response(x, (x[:, 0] ** 2)[:, None])
    small, large = model.sizes([[0.1, 5.0], [2.0, 0.0]])[0][:, 0]
    assert small < 0.1 < 3.0 < large
