"""Sensitivities and root sums of squares against closed forms, Monte Carlo, and the steps of a store."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr

from lensdesign.errors import InputError
from tolerancing.merits.base import Merit
from tolerancing.merits.pupil import RmsWaves
from tolerancing.statistics.scorer import StudyScorer
from tolerancing.statistics.sensitivities import (
    StudySensitivity,
    compare_with_trials,
    fit_sensitivity,
    root_sum_square,
    sensitivity,
    study_sensitivities,
)
from tolerancing.study.evaluate import context_of, nominal_scores, score_step
from tolerancing.study.files import load_study
from tolerancing.study.sweep import STEPS

AT_LEAST = Merit(kind="contrast", at_least=0.7)
AT_MOST = Merit(kind="spread", at_most=5.0)


def measure(scorer, tolerance, deviation, **more):
    d = len(tolerance)
    points = np.array([step * row for row in np.diag(tolerance) for step in STEPS])
    scores = scorer(points).reshape(d, len(STEPS), -1)
    return fit_sensitivity(scorer(np.zeros((1, d)))[0], scores, tolerance, deviation, **more)


@given(
    c1=st.floats(-3.0, 3.0),
    c2=st.floats(-3.0, 3.0),
    tolerance=st.floats(0.01, 50.0),
    mean=st.floats(-0.5, 0.5),
)
def test_parabola_is_fitted_exactly(c1, c2, tolerance, mean):
    s = measure(lambda x: 0.9 + c1 * x + c2 * x**2, [tolerance], [tolerance / 3.0], mean=mean)
    scale = 1.0 + abs(c1) * tolerance + abs(c2) * tolerance**2
    assert s.derivative[0, 0] * tolerance == pytest.approx(c1 * tolerance, abs=1e-12 * scale)
    assert s.coefficients[0, 2, 0] * tolerance**2 == pytest.approx(c2 * tolerance**2, abs=1e-12 * scale)
    assert s.residual[0, 0] < 1e-12 * scale
    ends = [-c1 * tolerance + c2 * tolerance**2, c1 * tolerance + c2 * tolerance**2]
    np.testing.assert_allclose(s.change[0, [0, 3], 0], ends, atol=1e-12 * scale)
    shift = c1 * mean + c2 * (mean**2 + (tolerance / 3.0) ** 2)
    assert s.mean_shift[0, 0] == pytest.approx(shift, abs=1e-11 * scale)


def test_derivative_is_of_fourth_order():
    errors = [abs(measure(np.sin, [t], [t]).derivative[0, 0] - 1.0) for t in (0.4, 0.2)]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.05)
    # For x^4 the parabola through 0, 1/16 (twice) and 1 (twice) leaves a known residual.
    s = measure(lambda x: x**4, [1.0], [1.0])
    np.testing.assert_allclose(s.coefficients[0, :, 0], [-0.9 / 7.0, 0.0, 7.75 / 7.0], atol=1e-12)
    u = np.array([*STEPS, 0.0])
    left = u**4 - (-0.9 / 7.0 + 7.75 / 7.0 * u**2)
    assert s.residual[0, 0] == pytest.approx(math.sqrt(np.mean(left**2)))


@pytest.mark.parametrize("kurtosis", [3.0, 1.8])
def test_moments_are_those_of_the_distribution(kurtosis):
    """Normal and uniform, with a mean, for an even and a mixed merit."""
    rng = np.random.default_rng(0)
    deviation, mean = np.array([0.2, 0.1]), np.array([0.1, -0.05])
    unit = rng.normal(size=(400_000, 2)) if kurtosis == 3.0 else rng.uniform(-1, 1, (400_000, 2)) * 3**0.5

    def scorer(x):
        return np.column_stack(
            [0.9 - x[:, 0] ** 2 - 2 * x[:, 1] ** 2, 4 + x[:, 0] - 3 * x[:, 1] + x[:, 1] ** 2]
        )

    s = measure(scorer, 3.0 * deviation, deviation, mean=mean, kurtosis=kurtosis)
    prediction = root_sum_square(s, [AT_LEAST, AT_MOST])
    scores = scorer(mean + deviation * unit)
    np.testing.assert_allclose(prediction.mean, scores.mean(axis=0), atol=2e-3)
    np.testing.assert_allclose(prediction.standard_deviation, scores.std(axis=0), rtol=1e-2)
    rows = compare_with_trials(prediction, scores)
    for row in rows:
        assert abs(row.mean - row.predicted_mean) < 4.0 * row.standard_error
    assert rows[1].predicted_yield == pytest.approx(rows[1].good.fraction, abs=0.02)


def test_yield_is_exact_for_linear_merits_of_normal_perturbations():
    slopes, deviation = np.array([3.0, -4.0]), np.array([0.1, 0.1])
    s = measure(lambda x: 4.5 + (x @ slopes)[:, None], 3.0 * deviation, deviation)
    prediction = root_sum_square(s, [AT_MOST])
    assert prediction.yield_fraction[0] == pytest.approx(ndtr(0.5 / 0.5))
    sure = root_sum_square(measure(lambda x: 4.5 + 0.0 * x[:, :1], deviation, deviation), [AT_MOST])
    assert sure.yield_fraction[0] == 1.0


def test_even_merit_is_ranked_though_its_derivative_is_zero():
    s = measure(lambda x: (1.0 - x @ [0.0, 1.0] - 3.0 * x[:, 0] ** 2)[:, None], [1.0, 1.0], [0.3, 0.3])
    assert s.derivative[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert s.mean_shift[0, 0] == pytest.approx(-3.0 * 0.09)
    np.testing.assert_array_equal(s.ranking([AT_LEAST]), [[0, 1]])
    np.testing.assert_allclose(s.worst_change([AT_LEAST])[:, 0], [-3.0, -1.0])
    np.testing.assert_array_equal(s.ranking([AT_MOST]), [[1, 0]])


def test_steps_without_a_score():
    def scorer(x):
        return np.where(x > 0.8, np.nan, 1.0 - 2.0 * x - x**2)

    s = measure(scorer, [1.0], [0.3])
    assert s.derivative[0, 0] == pytest.approx(-2.0)
    np.testing.assert_allclose(s.coefficients[0, :, 0], [0.0, -2.0, -1.0], atol=1e-12)
    assert s.worst_change([AT_LEAST])[0, 0] == -math.inf
    lost = measure(lambda x: np.where(x == 0.0, 1.0, np.nan), [1.0], [0.3])
    assert np.isnan(lost.derivative[0, 0])
    assert np.isnan(lost.coefficients).all()
    assert np.isnan(root_sum_square(lost, [AT_LEAST]).yield_fraction[0])


def test_trials_without_a_score_count_as_bad():
    s = measure(lambda x: 0.8 + 0.1 * x, [1.0], [0.3])
    (row,) = compare_with_trials(root_sum_square(s, [AT_LEAST]), [[0.8], [np.nan], [0.75], [0.9]])
    assert (row.good.passed, row.good.total) == (3, 4)
    assert row.mean == pytest.approx(2.45 / 3.0)
    (none,) = compare_with_trials(root_sum_square(s, [AT_LEAST]), np.zeros((0, 1)))
    assert none.good is None
    assert math.isnan(none.mean)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_tolerances_must_be_above_zero(value):
    with pytest.raises(InputError, match="perturbation 2"):
        fit_sensitivity([0.0], np.zeros((2, len(STEPS), 1)), [1.0, value], [1.0, 1.0])


def test_a_root_mean_square_adds_in_squares():
    """Of independent normal deviations: its square is the sum of theirs, nearly gamma distributed."""
    rng = np.random.default_rng(1)
    slopes, deviation = np.array([1.0, 0.7, 0.5]), np.array([0.05, 0.06, 0.04])
    merit = RmsWaves(kind="rms_waves", at_most=0.08)
    s = measure(lambda x: np.sqrt(np.sum((slopes * x) ** 2, axis=1))[:, None], 2.0 * deviation, deviation)
    prediction = root_sum_square(s, [merit])
    scores = np.sqrt(np.sum((slopes * deviation * rng.normal(size=(200_000, 3))) ** 2, axis=1))
    assert prediction.mean[0] == pytest.approx(scores.mean(), rel=0.01)
    assert prediction.standard_deviation[0] == pytest.approx(scores.std(), rel=0.05)
    assert prediction.yield_fraction[0] == pytest.approx(np.mean(scores <= 0.08), abs=0.01)


def test_nothing_but_an_offset_has_no_spread():
    merit = RmsWaves(kind="rms_waves", at_most=0.08)
    s = measure(lambda x: np.full((len(x), 1), 0.05), [1.0], [0.3])
    prediction = root_sum_square(s, [merit])
    assert prediction.mean[0] == pytest.approx(0.05)
    assert prediction.standard_deviation[0] == 0.0
    assert prediction.yield_fraction[0] == 1.0


@pytest.fixture
def loaded(write_study, full_study):
    return load_study(write_study(full_study))


def test_sensitivities_are_those_of_the_steps(loaded):
    study, context = loaded.study, context_of(loaded.lens, loaded.study)
    number = len(study.series) - 1
    steps = [score_step(context, study, number, step) for step in range(8)]
    nominal = nominal_scores(context, study)
    found = study_sensitivities(study, nominal, steps)
    scorer = StudyScorer(context, study)
    (far,) = scorer(np.array([[0.04, 0.0]]))
    assert found.change[0, -1] == pytest.approx(far - list(nominal.values()), abs=1e-14)
    small = 1e-4
    ends = scorer(np.array([[0.0, small], [0.0, -small]]))
    assert found.derivative[1, 0] == pytest.approx((ends[0, 0] - ends[1, 0]) / (2.0 * small), rel=0.03)
    with pytest.raises(InputError, match="holds 7 of 8 steps"):
        study_sensitivities(study, nominal, steps[:-1])
    with pytest.raises(InputError, match="sensitivity = false"):
        study_sensitivities(study.model_copy(update={"sensitivity": False}), nominal, steps)


@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_values_that_need_a_lost_step_are_null(small_store, lost):
    steps = small_store.steps()
    for step in steps:
        step.scores["strehl"] = lost
    nominal = small_store.nominal() | {"strehl": lost}
    found = study_sensitivities(small_store.study, nominal, steps)
    result = StudySensitivity(small_store.study, found, ())
    assert all(row["derivative"] is None for row in result.as_dict()["strehl"])
    json.dumps(result.as_dict(), allow_nan=False)


def test_sensitivities_of_a_store(small_store):
    result = sensitivity(small_store)
    assert np.array_equal(
        result.found.change,
        study_sensitivities(result.study, small_store.nominal(), small_store.steps()).change,
    )
    rows = result.as_dict()["strehl"]
    assert [row["perturbation"] for row in rows] == ["lens_decenter_y_mm", "shop_radius_mm"]
    assert result.compared[1].mean == pytest.approx(small_store.trials().scores[:, 1].mean())
