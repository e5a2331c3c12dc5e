"""Distributions: shape, moments, quantiles, scaling, measured values."""

import math
import pickle

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy import stats

from lensdesign import DesignError, InputError
from tolerancing.perturbations.distributions import (
    DISTRIBUTIONS,
    Empirical,
    EndPoint,
    Normal,
    Parabolic,
    Triangular,
    TruncatedNormal,
    Uniform,
)
from tolerancing.perturbations.draws import probabilities

CASES = [
    (Normal(sigma=0.2, mean=1.0), stats.norm(1.0, 0.2)),
    (TruncatedNormal(sigma=0.2, limit=0.3, mean=-1.0), stats.truncnorm(-1.5, 1.5, -1.0, 0.2)),
    (TruncatedNormal(sigma=5.0, limit=0.3), stats.truncnorm(-0.06, 0.06, 0.0, 5.0)),
    (Uniform(half_width=0.3, mean=2.0), stats.uniform(1.7, 0.6)),
    (Triangular(half_width=0.3, mean=2.0), stats.triang(0.5, 1.7, 0.6)),
    (Parabolic(half_width=0.3, mean=2.0), stats.beta(2.0, 2.0, 1.7, 0.6)),
]
BOUNDED = [Uniform, Triangular, Parabolic, EndPoint]
PLAIN = [Normal(sigma=0.2, mean=1.0), *(shape(half_width=0.3, mean=-0.7) for shape in BOUNDED)]
INSIDE = st.floats(2.0**-54, 1.0 - 2.0**-53)


@pytest.mark.parametrize(("distribution", "reference"), CASES)
def test_quantiles_and_deviation_are_those_of_scipy(distribution, reference):
    probability = np.linspace(0.001, 0.999, 301)
    np.testing.assert_allclose(distribution.quantile(probability), reference.ppf(probability), atol=1e-12)
    assert distribution.standard_deviation == pytest.approx(reference.std(), rel=1e-9)
    assert distribution.centre == pytest.approx(reference.mean(), rel=1e-9)


@pytest.mark.parametrize(("distribution", "reference"), CASES)
def test_drawn_values_follow_the_distribution(distribution, reference):
    values = distribution.quantile(probabilities("random", 3, range(4000), 1, 4000)[:, 0])
    assert stats.kstest(values, reference.cdf).pvalue > 0.01
    assert values.mean() == pytest.approx(reference.mean(), abs=4.0 * reference.std() / math.sqrt(4000))


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


@pytest.mark.parametrize("shape", BOUNDED)
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


@pytest.mark.parametrize("distribution", PLAIN)
@given(probability=INSIDE, other=INSIDE)
def test_quantiles_rise(distribution, probability, other):
    a, b = distribution.quantile(np.sort([probability, other]))
    assert a <= b
    assert abs(a - distribution.mean) <= 5.0 * distribution.largest
    if not isinstance(distribution, Normal):
        assert abs(a - distribution.mean) <= distribution.largest * (1.0 + 1e-15)


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
        (1.0, 1e-4, r"limit = 0.0001 is 0.0001 sigma; allowed: 0.001 to 30; beyond, .* is uniform"),
        (1.0, 31.0, r"limit = 31 is 31 sigma; .* is normal"),
        (1e-9, 1.0, r"is 1e\+09 sigma"),
    ],
)
def test_a_limit_far_from_sigma_is_refused(sigma, limit, message):
    with pytest.raises(ValidationError, match=message):
        TruncatedNormal(sigma=sigma, limit=limit)


@pytest.mark.parametrize("name", [name for name in DISTRIBUTIONS if name != "empirical"])
def test_widths_must_be_positive_and_finite(name):
    shape = DISTRIBUTIONS[name]
    keys = [key for key, field in shape.model_fields.items() if field.is_required()]
    assert tuple(keys) == shape.widths
    assert shape(**dict.fromkeys(keys, 1.0)).largest > 0.0
    for key in keys:
        for value in (0.0, -0.1, math.inf, math.nan):
            with pytest.raises(ValidationError, match=key):
                shape(**dict.fromkeys(keys, 1.0) | {key: value})


@pytest.mark.parametrize("distribution", [*PLAIN, TruncatedNormal(sigma=0.1, limit=0.15, mean=0.4)])
@given(factor=st.floats(1e-3, 1e3))
@example(factor=1.0)
def test_scaling_multiplies_the_deviations_alone(distribution, factor):
    scaled, probability = distribution.scaled(factor), np.linspace(0.01, 0.99, 33)
    deviation = distribution.quantile(probability) - distribution.mean
    np.testing.assert_allclose(
        scaled.quantile(probability) - distribution.mean, factor * deviation, rtol=1e-9, atol=1e-14
    )
    assert scaled.mean == distribution.mean
    assert scaled.largest == pytest.approx(factor * distribution.largest)
    assert scaled.standard_deviation == pytest.approx(factor * distribution.standard_deviation)


@pytest.mark.parametrize("factor", [0.0, -1.0, math.inf, math.nan])
def test_scales_must_be_positive(factor):
    with pytest.raises(InputError, match=r"scale = .*: must be a finite number above 0"):
        Uniform(half_width=1.0).scaled(factor)
    with pytest.raises(InputError, match=r"scale = .*: must be a finite number above 0"):
        Empirical(file="a.csv", column="x").scaled(factor)


def test_a_scale_too_large_for_a_width_is_refused():
    with pytest.raises(DesignError, match=r"half_width: must be less than or equal to 1000000000"):
        Uniform(half_width=1e8).scaled(100.0)


def written(folder, text, name="shop.csv"):
    (folder / name).write_text(text, encoding="utf-8")
    return Empirical(file=name, column="radius_mm", mean=0.5)


@given(
    values=st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30).filter(lambda v: max(v) - min(v) > 1e-6)
)
def test_measured_values_are_the_quantiles_at_even_ranks(tmp_path_factory, values):
    folder = tmp_path_factory.mktemp("measured")
    text = "part,radius_mm\n" + "".join(f"{i},{v!r}\n" for i, v in enumerate(values))
    shape = written(folder, text).loaded(folder)
    at_ranks = shape.quantile(np.linspace(0.0, 1.0, len(values)))
    np.testing.assert_array_equal(at_ranks, 0.5 + np.sort(values))
    probability = np.linspace(0.0, 1.0, 77)
    np.testing.assert_allclose(shape.quantile(probability), 0.5 + np.quantile(values, probability), atol=1e-9)
    fine = shape.quantile((np.arange(200_000) + 0.5) / 200_000)
    assert fine.mean() == pytest.approx(shape.centre, abs=1e-3 * shape.largest)
    assert fine.std() == pytest.approx(shape.standard_deviation, rel=1e-3)
    assert np.abs(fine - shape.centre).max() == pytest.approx(shape.largest, rel=1e-3)


def test_measured_values_scale_about_their_own_centre(tmp_path):
    shape = written(tmp_path, "radius_mm\n1.0\n2.0\n4.0\n").loaded(tmp_path)
    doubled, probability = shape.scaled(2.0), np.linspace(0.0, 1.0, 9)
    assert doubled.centre == pytest.approx(shape.centre) == 0.5 + 2.25
    assert doubled.largest == pytest.approx(2.0 * shape.largest) == 3.5
    np.testing.assert_allclose(
        doubled.quantile(probability) - shape.centre, 2.0 * (shape.quantile(probability) - shape.centre)
    )
    assert doubled != shape


def test_measured_values_are_known_by_their_digest(tmp_path):
    first = written(tmp_path, "radius_mm\n1.0\n2.0\n").loaded(tmp_path)
    text = '\ufeff# lot, "radius_mm" , note\n\nA,2,\n\nB, 1e0 ,"late, but in"\n'
    same = written(tmp_path, text, "other.csv").loaded(tmp_path)
    other = written(tmp_path, "radius_mm\n1.0\n2.5\n", "third.csv").loaded(tmp_path)
    assert first.digest == same.digest != other.digest
    assert pickle.loads(pickle.dumps(first)) == first
    assert first.digest == pickle.loads(pickle.dumps(first)).digest


def test_values_that_were_not_read_cannot_be_drawn(tmp_path):
    unread = written(tmp_path, "radius_mm\n1.0\n2.0\n")
    assert unread.loaded(tmp_path) != unread
    for use in (lambda: unread.digest, lambda: unread.quantile(np.array([0.5])), lambda: unread.largest):
        with pytest.raises(InputError, match=r"shop.csv: column 'radius_mm' has not been read"):
            use()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "radius_m,thickness_mm\n1,2\n",
            r"no column 'radius_mm'; .*did you mean radius_m",
        ),
        ("1.0\n2.0\n", r"there is no column 'radius_mm'; allowed: 1.0"),
        ("radius_mm,radius_mm\n1,2\n", r"2 columns are called 'radius_mm'"),
        ("", r"shop.csv: holds nothing"),
        ("\n\n", r"shop.csv: holds nothing"),
        ("radius_mm\n1.0\n", r"holds 1 values: must be at least 2"),
        ("radius_mm\n1.0\n1.0\n", r"holds nothing but 1: it must scatter"),
        ("radius_mm\n1.0\n\nabc\n", r"shop.csv, line 4: radius_mm = 'abc' is not a number"),
        ("radius_mm\n1.0\nnan\n", r"line 3: radius_mm = nan: must be a finite number"),
        ("radius_mm\n1.0\n-inf\n", r"line 3: radius_mm = -inf: must be a finite number"),
        ("radius_mm\n1.0\n1e300\n", r"line 3: radius_mm = 1e\+300: must be a finite number"),
        ("radius_mm\n1,0\n1_0\n", r"line 3: radius_mm = '1_0' is not a number"),
        ("part,radius_mm\n1,1.0\n2\n", r"line 3: no value in column 'radius_mm'"),
        ("part,radius_mm\n1,1.0\n2,\n", r"line 3: radius_mm = '' is not a number"),
        ("radius_mm\n" + "1" * 200_000, r"line 2: not a CSV file: field larger"),
        ("radius_mm\n" + "1.0\n" * 2_500_001, r"10.0 MB; allowed: up to 10 MB"),
    ],
)
def test_faulty_measured_values_are_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        written(tmp_path, text).loaded(tmp_path)


def test_files_that_are_none_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"cannot read .*absent.csv: No such file"):
        Empirical(file="absent.csv", column="x").loaded(tmp_path)
    with pytest.raises(InputError, match=r"cannot read .*: it is no regular file"):
        Empirical(file=".", column="x").loaded(tmp_path)
    (tmp_path / "raw.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"raw.csv: not a text file in UTF-8"):
        Empirical(file="raw.csv", column="x").loaded(tmp_path)
    with pytest.raises(ValidationError, match=r"cannot hold a NUL character"):
        Empirical(file="a\0b", column="x")
