"""Normal distributions: what truncates one, and into what."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from tolerancing.perturbations.distributions import Normal, TruncatedNormal, Uniform

INSIDE = st.floats(2.0**-54, 1.0 - 2.0**-53)


@given(sigma=st.floats(1e-6, 1e3), ratio=st.floats(1.01e-3, 29.9), probability=INSIDE)
def test_truncated_normal_keeps_its_limit(sigma, ratio, probability):
    distribution = TruncatedNormal(sigma=sigma, limit=ratio * sigma)
    value = float(distribution.quantile(np.array([probability]))[0])
    assert abs(value) <= distribution.limit
    assert 0.0 < distribution.standard_deviation <= min(sigma, distribution.limit)


def test_at_the_ends_of_its_limits_truncated_normal_is_another_distribution():
    probability = np.linspace(0.0, 1.0, 1001)
    narrow, uniform = TruncatedNormal(sigma=1.0, limit=0.0011), Uniform(half_width=0.0011)
    np.testing.assert_allclose(narrow.quantile(probability), uniform.quantile(probability), atol=1e-9)
    assert narrow.standard_deviation == pytest.approx(uniform.standard_deviation, rel=1e-6)
    wide, normal = TruncatedNormal(sigma=1.0, limit=29.0), Normal(sigma=1.0)
    inside = probability[1:-1]
    np.testing.assert_allclose(wide.quantile(inside), normal.quantile(inside), rtol=1e-14)


@pytest.mark.parametrize(
    ("sigma", "limit", "message"),
    [
        (1.0, 1e-4, r"limit = 0.0001 is 0.0001 sigma.*0.001 to 30.*uniform"),
        (1.0, 31.0, r"limit = 31 is 31 sigma.*normal"),
        (1e-9, 1.0, r"is 1e\+09 sigma"),
    ],
)
def test_a_limit_far_from_sigma_is_refused(sigma, limit, message):
    with pytest.raises(ValidationError, match=message):
        TruncatedNormal(sigma=sigma, limit=limit)
