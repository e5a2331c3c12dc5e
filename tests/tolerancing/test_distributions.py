"""Distributions: shape, moments, quantiles."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy import stats

from tolerancing.distributions import DISTRIBUTIONS, Normal, TruncatedNormal, Uniform
from tolerancing.perturbations import Perturbation, realise

CASES = [
    (Normal(sigma=0.2, mean=1.0), stats.norm(1.0, 0.2)),
    (TruncatedNormal(sigma=0.2, limit=0.3, mean=-1.0), stats.truncnorm(-1.5, 1.5, -1.0, 0.2)),
    (TruncatedNormal(sigma=5.0, limit=0.3), stats.truncnorm(-0.06, 0.06, 0.0, 5.0)),
    (Uniform(half_width=0.3, mean=2.0), stats.uniform(1.7, 0.6)),
]


@pytest.mark.parametrize(("distribution", "reference"), CASES)
def test_quantiles_and_deviation_are_those_of_scipy(distribution, reference):
    probability = np.linspace(0.001, 0.999, 301)
    np.testing.assert_allclose(distribution.quantile(probability), reference.ppf(probability), atol=1e-12)
    assert distribution.standard_deviation == pytest.approx(reference.std(), rel=1e-9)


@pytest.mark.parametrize(("distribution", "reference"), CASES)
def test_drawn_values_follow_the_distribution(distribution, reference):
    perturbation = Perturbation(target="lens", parameter="despace_mm", distribution=distribution)
    values = realise([perturbation], seed=3, trials=range(4000)).values[:, 0]
    assert stats.kstest(values, reference.cdf).pvalue > 0.01
    assert values.mean() == pytest.approx(reference.mean(), abs=4.0 * reference.std() / math.sqrt(4000))


@given(
    sigma=st.floats(1e-6, 1e3),
    ratio=st.floats(1e-3, 30.0),
    probability=st.floats(2.0**-54, 1.0 - 2.0**-53),
)
def test_truncated_normal_keeps_its_limit(sigma, ratio, probability):
    distribution = TruncatedNormal(sigma=sigma, limit=ratio * sigma)
    value = float(distribution.quantile(np.array([probability]))[0])
    assert abs(value) <= distribution.limit
    assert 0.0 < distribution.standard_deviation <= min(sigma, distribution.limit)


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_widths_must_be_positive_and_finite(name):
    shape = DISTRIBUTIONS[name]
    keys = [key for key, field in shape.model_fields.items() if field.is_required()]
    assert keys
    for key in keys:
        for value in (0.0, -0.1, math.inf, math.nan):
            with pytest.raises(ValidationError):
                shape(**dict.fromkeys(keys, 1.0) | {key: value})
