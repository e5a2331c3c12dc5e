"""Groups and correlations: shapes kept, correlations met, and what cannot be refused."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy import stats

from lensdesign import DesignError
from lensdesign.common.toml_files import validate
from tolerancing.perturbations.dependence import Correlation, Dependence, lower_factor, study_dependence
from tolerancing.perturbations.draws import probabilities

COLUMNS = ("a_mm", "b_mm", "c_deg", "d", "e_um")
MATRIX = ((1.0, 0.8, -0.3), (0.8, 1.0, 0.1), (-0.3, 0.1, 1.0))


def independent(trials=20_000, method="random"):
    return probabilities(method, 8, range(trials), len(COLUMNS), trials)


def rank_correlation(coefficient):
    """Rank correlation of two normal variables (Kendall and Gibbons, Rank Correlation Methods, 1990)."""
    return 6.0 / math.pi * math.asin(0.5 * coefficient)


@pytest.mark.parametrize("method", ["random", "latin_hypercube", "sobol"])
def test_correlated_columns_stay_uniform_and_have_the_rank_correlation_asked_for(method):
    correlation = Correlation(names=("d", "a_mm", "e_um"), matrix=MATRIX)
    drawn = study_dependence(COLUMNS, [correlation], {}).apply(independent(method=method))
    for column in drawn.T:
        assert stats.kstest(column, "uniform").pvalue > 0.001
    assert drawn.min() > 0.0
    assert drawn.max() < 1.0
    found = stats.spearmanr(drawn[:, [3, 0, 4]]).statistic
    expected = [[rank_correlation(r) for r in row] for row in MATRIX]
    assert np.abs(found - expected).max() < 4.0 / math.sqrt(len(drawn))


def test_columns_that_are_not_named_stay_as_they_were():
    before = independent(50)
    kept = before.copy()
    correlation = Correlation(names=("c_deg", "a_mm"), coefficient=0.5)
    after = study_dependence(COLUMNS, [correlation], {"pair": ["e_um", "d"]}).apply(before)
    assert np.array_equal(before, kept)
    assert np.array_equal(after[:, [1, 4]], before[:, [1, 4]])
    np.testing.assert_allclose(after[:, 2], before[:, 2], rtol=1e-12)
    assert not np.any(after[:, [0, 3]] == before[:, [0, 3]])
    assert np.array_equal(Dependence().apply(before), before)
    assert np.array_equal(study_dependence(COLUMNS, [], {}).apply(before), before)


def test_members_of_a_group_move_with_the_first():
    before = independent(50)
    after = study_dependence(COLUMNS, [], {"cell": ["d", "b_mm", "a_mm"]}).apply(before)
    for place in (0, 1, 3):
        assert np.array_equal(after[:, place], before[:, 3])


@pytest.mark.parametrize(
    ("coefficient", "expected"), [(1.0, lambda u: u), (-1.0, lambda u: 1.0 - u)], ids=["with", "against"]
)
def test_perfectly_correlated_columns_follow_the_first(coefficient, expected):
    before = independent(2000)
    correlation = Correlation(names=("a_mm", "b_mm"), coefficient=coefficient)
    after = study_dependence(COLUMNS, [correlation], {}).apply(before)
    np.testing.assert_allclose(after[:, 1], expected(before[:, 0]), atol=1e-14)


def test_three_columns_can_add_up_to_nothing():
    """A coefficient of -1/2 among three is as low as it can be: the normal scores then add up to 0."""
    correlation = Correlation(names=COLUMNS[:3], coefficient=-0.5)
    after = study_dependence(COLUMNS, [correlation], {}).apply(independent(2000))
    assert np.abs(stats.norm.ppf(after[:, :3]).sum(axis=1)).max() < 1e-6


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 7), rank=st.integers(1, 7))
def test_factors_give_their_matrix_back_even_if_it_is_singular(seed, count, rank):
    directions = np.random.default_rng(seed).normal(size=(count, rank))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    matrix = directions @ directions.T
    factor = lower_factor(matrix)
    assert np.array_equal(factor, np.tril(factor))
    assert np.abs(factor @ factor.T - matrix).max() < 1e-5
    matrix[np.diag_indices(count)] = 1.0
    matrix = np.clip(0.5 * (matrix + matrix.T), -1.0, 1.0)
    names = tuple(f"n{i}" for i in range(count))
    assert Correlation(names=names, matrix=tuple(map(tuple, matrix.tolist()))).coefficient is None


@settings(max_examples=20)
@given(cut=st.integers(0, 64))
def test_a_trial_depends_on_its_own_row_alone(cut):
    dependence = study_dependence(
        COLUMNS, [Correlation(names=("d", "a_mm", "e_um"), matrix=MATRIX)], {"pair": ["b", "c"]}
    )
    before = independent(64)
    parts = [dependence.apply(before[:cut]), dependence.apply(before[cut:])]
    assert np.array_equal(np.vstack(parts), dependence.apply(before))


def test_probabilities_stay_within_the_ends():
    extreme = np.tile([[2.0**-54], [1.0 - 2.0**-53]], (1, 5))
    correlation = Correlation(names=COLUMNS, coefficient=0.5)
    after = study_dependence(COLUMNS, [correlation], {}).apply(extreme)
    assert after.min() > 0.0
    assert after.max() < 1.0


def test_a_table_is_read():
    table = {"names": ["a", "b"], "matrix": [[1, 0.25], [0.25, 1]]}
    read = validate(Correlation, table, "study.toml: correlation 1")
    assert read == Correlation(names=("a", "b"), matrix=((1.0, 0.25), (0.25, 1.0)))
    assert validate(Correlation, {"names": ["a", "b"], "coefficient": 1}, "here").full_matrix().tolist() == [
        [1.0, 1.0],
        [1.0, 1.0],
    ]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"coefficient": 0.5}, r"here: names: missing key"),
        ({"names": ["a"], "coefficient": 0.5}, r"names = \['a'\]: .*at least 2"),
        ({"names": ["a", "b", "a"], "coefficient": 0.5}, r"names: 'a' is given twice"),
        ({"names": ["a", "b"]}, r"give one of coefficient and matrix; both are missing"),
        (
            {"names": ["a", "b"], "coefficient": 0.5, "matrix": [[1, 0.5], [0.5, 1]]},
            r"coefficient and matrix.*given",
        ),
        ({"names": ["a", "b"], "coefficient": 1.01}, r"coefficient = 1.01.* 1"),
        ({"names": ["a", "b"], "coefficient": float("nan")}, r"coefficient = nan"),
        (
            {"names": ["a", "b", "c"], "coefficient": -0.6},
            r"coefficient = -0.6: .* 3 perturbations; allowed: -0.5 to 1",
        ),
        ({"names": ["a", "b"], "matrix": [[1, 0.5]]}, r"1 rows.* 2 names"),
        ({"names": ["a", "b"], "matrix": [[1, 0.5], [0.5]]}, r"matrix, row 2: holds 1 numbers"),
        ({"names": ["a", "b"], "matrix": [[1, 0.5], [0.4, 1]]}, r"a with b is 0.5.*b with a is 0.4"),
        ({"names": ["a", "b"], "matrix": [[1, 0.5], [0.5, 0.9]]}, r"b with itself is 0.9"),
        ({"names": ["a", "b"], "matrix": [[1, 1.5], [1.5, 1]]}, r"matrix 1 2 = 1.5: must be less than"),
        ({"names": ["a", "b"], "matrix": "none"}, r"matrix = 'none': must be a (valid tuple|list)"),
        (
            {"names": ["a", "b", "c"], "matrix": [[1, 0.9, 0.9], [0.9, 1, -0.9], [0.9, -0.9, 1]]},
            r"smallest eigenvalue is -0.8: must not be negative; multiply .* by 0.5555",
        ),
    ],
)
def test_what_is_no_correlation_is_refused(table, message):
    with pytest.raises(DesignError, match=message):
        validate(Correlation, table, "here")


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(3, 6))
def test_the_scaling_that_is_suggested_works(seed, count):
    values = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, count))
    matrix = np.clip(values + values.T, -1.0, 1.0)
    np.fill_diagonal(matrix, 1.0)
    names = tuple(f"n{i}" for i in range(count))
    try:
        Correlation(names=names, matrix=tuple(map(tuple, matrix.tolist())))
    except ValidationError as error:
        share = float(str(error).split("multiply all entries off the diagonal by ")[1].split()[0])
        matrix *= share
        np.fill_diagonal(matrix, 1.0)
        Correlation(names=names, matrix=tuple(map(tuple, matrix.tolist())))
    assert np.linalg.eigvalsh(matrix)[0] > -1e-9


def pair(*names):
    return Correlation(names=names, coefficient=0.5)


@pytest.mark.parametrize(
    ("correlations", "groups", "message"),
    [
        ([pair("a", "x")], {}, r"correlation 1: .*'x'.*a_mm, b_mm"),
        ([pair("a_mn", "b")], {}, r"no perturbation 'a_mn'.*did you mean a_mm"),
        ([], {"g": ["a", "q"]}, r"group 'g': there is no perturbation 'q'"),
        ([], {"g": ["a"]}, r"group 'g': has one member, 'a': must be at least 2"),
        ([], {"g": ["a", "a_mm"]}, r"'a_mm' is given twice in group 'g'"),
        ([], {"g": ["a", "b"], "h": ["c", "b"]}, r"'b' is given in group 'g' and in group 'h'"),
        ([pair("a", "b"), pair("c", "a")], {}, r"'a' is given in correlation 1 and in correlation 2"),
        ([pair("a", "b")], {"g": ["c", "b_mm"]}, r"'b' is given in group 'g' and in correlation 1"),
        ([pair("a", "a_mm")], {}, r"'a_mm' is given twice in correlation 1"),
    ],
)
def test_names_that_do_not_fit_are_refused(correlations, groups, message):
    with pytest.raises(DesignError, match=message):
        study_dependence(COLUMNS, correlations, groups)


def test_a_name_that_may_be_two_columns_needs_its_unit():
    columns = ("a_mm", "a_um", "b")
    with pytest.raises(DesignError, match=r"'a' .*a_mm or a_um"):
        study_dependence(columns, [pair("a", "b")], {})
    assert study_dependence(columns, [pair("a_um", "b")], {}).mixtures[0][0] == (1, 2)


def test_an_empty_group_is_refused():
    with pytest.raises(DesignError, match=r"group 'g': .*at least 2"):
        study_dependence(COLUMNS, [], {"g": []})
