"""All registered distributions alike: quantiles, moments, bounds, files; and one more is one line."""

import math
import tomllib

import numpy as np
import pytest
import tomli_w
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy import stats

from lensdesign import InputError
from lensdesign.common.frozen_model import Positive
from tolerancing.perturbations.distributions import (
    DISTRIBUTIONS,
    Discrete,
    Distribution,
    Empirical,
    Normal,
    Parabolic,
    Triangular,
    TruncatedNormal,
    Uniform,
)
from tolerancing.perturbations.draws import probabilities
from tolerancing.perturbations.parameters import perturbation_from_table
from tolerancing.report.sections.tolerances import distribution_text
from tolerancing.study.evaluate import sample_perturbations
from tolerancing.study.files import load_study

CASES = [
    (Normal(sigma=0.2, mean=1.0), stats.norm(1.0, 0.2)),
    (TruncatedNormal(sigma=0.2, limit=0.3, mean=-1.0), stats.truncnorm(-1.5, 1.5, -1.0, 0.2)),
    (TruncatedNormal(sigma=5.0, limit=0.3), stats.truncnorm(-0.06, 0.06, 0.0, 5.0)),
    (Uniform(half_width=0.3, mean=2.0), stats.uniform(1.7, 0.6)),
    (Triangular(half_width=0.3, mean=2.0), stats.triang(0.5, 1.7, 0.6)),
    (Parabolic(half_width=0.3, mean=2.0), stats.beta(2.0, 2.0, 1.7, 0.6)),
]

INSIDE = st.floats(2.0**-54, 1.0 - 2.0**-53)
MEASURED = (0.1, -0.3, 0.25, 0.7, 0.0, 0.2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("measured")
    (place / "shop.csv").write_text("x\n" + "".join(f"{value!r}\n" for value in MEASURED))
    return place


def table_of(kind):
    """A table of a study file that asks for a distribution; widths are 0.2, 0.3, ..."""
    shape = DISTRIBUTIONS[kind]
    widths = {name: 0.2 + 0.1 * k for k, name in enumerate(shape.widths)}
    files = {"file": "shop.csv", "column": "x"} if issubclass(shape, Empirical) else {}
    files |= {"values": [0.1, 0.4, 0.5]} if issubclass(shape, Discrete) else {}
    named = {"target": "lens", "parameter": "decenter_y_mm", "distribution": kind}
    return named | {"mean": -0.7} | widths | files


@pytest.fixture
def made(folder):
    return lambda kind: perturbation_from_table(table_of(kind), "here").loaded(folder).distribution


every = pytest.mark.parametrize("kind", DISTRIBUTIONS)


@every
def test_quantiles_rise_within_the_bounds(kind, made):
    distribution = made(kind)

    @given(probability=INSIDE, other=INSIDE)
    def check(probability, other):
        a, b = distribution.quantile(np.sort([probability, other]))
        assert a <= b
        # Of a normal distribution alone the tolerance, two sigma, is no bound.
        bound = 5.0 if type(distribution) is Normal else 1.0 + 1e-12
        assert max(abs(a - distribution.centre), abs(b - distribution.centre)) <= bound * distribution.largest

    check()


@every
def test_moments_are_those_of_the_quantiles(kind, made):
    distribution = made(kind)
    values = distribution.quantile((np.arange(200_000) + 0.5) / 200_000)
    assert values.mean() == pytest.approx(distribution.centre, abs=1e-5)
    assert values.std() == pytest.approx(distribution.standard_deviation, rel=1e-4)
    assert 0.0 < distribution.standard_deviation <= distribution.largest


@every
def test_scaling_multiplies_the_deviations_alone(kind, made):
    distribution, probability = made(kind), np.linspace(0.01, 0.99, 33)
    deviation = distribution.quantile(probability) - distribution.centre

    @given(factor=st.floats(1e-3, 1e3))
    @example(factor=1.0)
    def check(factor):
        scaled = distribution.scaled(factor)
        np.testing.assert_allclose(
            scaled.quantile(probability) - distribution.centre,
            factor * deviation,
            rtol=1e-9,
            atol=1e-14 * max(factor, 1.0),
        )
        assert scaled.centre == pytest.approx(distribution.centre, rel=1e-12)
        assert scaled.largest == pytest.approx(factor * distribution.largest)
        assert scaled.standard_deviation == pytest.approx(factor * distribution.standard_deviation)

    check()


@every
@pytest.mark.parametrize("factor", [0.0, -1.0, math.inf, math.nan])
def test_scales_must_be_positive(kind, factor, made):
    with pytest.raises(InputError, match=r"scale = .*above 0"):
        made(kind).scaled(factor)


@every
def test_files_keep_a_distribution(kind, folder, made):
    """Out of a table, into one, and through TOML."""
    distribution = made(kind)
    again = table_of(kind) | {name: getattr(distribution, name) for name in distribution.widths}
    text = tomli_w.dumps(again)
    read = perturbation_from_table(tomllib.loads(text), "here").loaded(folder)
    assert read.distribution == distribution
    assert distribution_text(read).startswith(kind.replace("_", " ") + ", mean -0.7 mm")


@pytest.mark.parametrize("kind", [kind for kind in DISTRIBUTIONS if kind not in ("empirical", "discrete")])
def test_widths_must_be_positive_and_finite(kind):
    shape = DISTRIBUTIONS[kind]
    keys = [key for key, field in shape.model_fields.items() if field.is_required()]
    assert tuple(keys) == shape.widths
    assert shape(**dict.fromkeys(keys, 1.0)).largest > 0.0
    for key in keys:
        for value in (0.0, -0.1, math.inf, math.nan):
            with pytest.raises(ValidationError, match=key):
                shape(**dict.fromkeys(keys, 1.0) | {key: value})


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


class Cosine(Distribution):
    """Density proportional to 1 + cos(pi deviation / half_width)."""

    kind = "cosine"
    widths = ("half_width",)

    half_width: Positive

    def quantile(self, probability):
        x = np.linspace(-1.0, 1.0, 1001)
        share = 0.5 * (1.0 + x + np.sin(np.pi * x) / np.pi)
        return self.mean + self.half_width * np.interp(probability, share, x)

    @property
    def standard_deviation(self):
        return self.half_width * math.sqrt(1.0 / 3.0 - 2.0 / math.pi**2)

    @property
    def largest(self):
        return self.half_width


def test_a_distribution_is_one_class_and_one_line(monkeypatch, made, write_study, ray_study, folder):
    monkeypatch.setitem(DISTRIBUTIONS, Cosine.kind, Cosine)
    test_quantiles_rise_within_the_bounds(Cosine.kind, made)
    test_moments_are_those_of_the_quantiles(Cosine.kind, made)
    test_scaling_multiplies_the_deviations_alone(Cosine.kind, made)
    test_files_keep_a_distribution(Cosine.kind, folder, made)
    text = ray_study.replace('"normal"\nsigma = 0.02', '"cosine"\nhalf_width = 0.03')
    study = load_study(write_study(text)).study
    assert study.perturbations[0].distribution == Cosine(half_width=0.03)
    values = sample_perturbations(study, range(2000)).values[:, 0]
    assert values.std() == pytest.approx(Cosine(half_width=0.03).standard_deviation, rel=0.05)
