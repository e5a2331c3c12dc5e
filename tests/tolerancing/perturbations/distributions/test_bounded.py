"""Bounded distributions: their ends, tails and shares."""

import numpy as np
import pytest

from lensdesign import DesignError
from tolerancing.perturbations.distributions import EndPoint, Parabolic, Triangular, Uniform


@pytest.mark.parametrize(
    ("shape", "share_below"),
    [
        (Triangular, lambda t: np.where(t < 0.0, 0.5 * (1 + t) ** 2, 1.0 - 0.5 * (1 - t) ** 2)),
        (Parabolic, lambda t: (2.0 + 3.0 * t - t**3) / 4.0),
        (Uniform, lambda t: 0.5 + 0.5 * t),
    ],
)
def test_quantiles_invert_the_share_below(shape, share_below):
    probability = np.linspace(0.0, 1.0, 10_001)
    assert np.abs(share_below(shape(half_width=1.0).quantile(probability)) - probability).max() < 1e-15


@pytest.mark.parametrize("shape", [Uniform, Triangular, Parabolic, EndPoint])
def test_the_ends_are_exact(shape):
    distribution = shape(half_width=0.3, mean=0.25)
    assert distribution.quantile(np.array([0.0, 1.0])).tolist() == [0.25 - 0.3, 0.25 + 0.3]


def test_tails_keep_their_accuracy():
    probability = np.array([1e-17, 1e-14, 1e-9])
    lower = Triangular(half_width=1.0).quantile(probability) + 1.0
    np.testing.assert_allclose(lower, np.sqrt(2.0 * probability), atol=2e-16)
    lower = Parabolic(half_width=1.0).quantile(probability) + 1.0
    np.testing.assert_allclose(lower, np.sqrt(4.0 / 3.0 * probability), rtol=1e-4, atol=2e-16)


def test_end_point_has_half_of_the_parts_at_each_end():
    values = EndPoint(half_width=0.3, mean=1.0).quantile(np.linspace(0.0005, 0.9995, 1000))
    assert np.count_nonzero(values == 0.7) == np.count_nonzero(values == 1.3) == 500
    assert values.std() == pytest.approx(EndPoint(half_width=0.3).standard_deviation, rel=1e-12)


def test_a_scale_too_large_for_a_width_is_refused():
    with pytest.raises(DesignError, match=r"half_width.*1000000000"):
        Uniform(half_width=1e8).scaled(100.0)
