"""Measured values: quantiles, scaling, and files that hold none."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from lensdesign import InputError
from tolerancing.perturbations.distributions import Empirical


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


def test_values_are_read_at_their_first_use(tmp_path, monkeypatch):
    unread = written(tmp_path, "radius_mm\n1.0\n2.0\n")
    for use in (lambda: unread.digest, lambda: unread.quantile(np.array([0.5])), lambda: unread.largest):
        with pytest.raises(InputError, match=r"shop\.csv.*No such file"):
            use()
    monkeypatch.chdir(tmp_path)
    assert unread.quantile(np.array([0.5]))[0] == 0.5 + 1.5
    assert unread == unread.loaded(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("radius_m,thickness_mm\n1,2\n", r"no column 'radius_mm'; .*did you mean radius_m"),
        ("1.0\n2.0\n", r"there is no column 'radius_mm'.*1.0"),
        ("radius_mm,radius_mm\n1,2\n", r"2 columns are called 'radius_mm'"),
        ("", r"shop.csv: is empty"),
        ("\n\n", r"shop.csv: is empty"),
        ("radius_mm\n1.0\n", r"has 1 values: must be at least 2"),
        ("radius_mm\n1.0\n1.0\n", r"has only the value 1"),
        ("radius_mm\n1.0\n\nabc\n", r"shop.csv, line 4: radius_mm = 'abc' is not a number"),
        ("radius_mm\n1.0\nnan\n", "line 3: radius_mm = nan"),
        ("radius_mm\n1.0\n-inf\n", "line 3: radius_mm = -inf"),
        ("radius_mm\n1.0\n1e300\n", r"line 3: radius_mm = 1e\+300"),
        ("part;radius_mm\n1;0,012\n", r"line 2: radius_mm = '0,012'.*comma"),
        ("part\tradius_mm\n1\t0,012\n", r"line 2: radius_mm = '0,012'.*comma"),
        ("part;radius_mm\n1;1.234,5\n", r"line 2: radius_mm = '1.234,5'.*thousands"),
        ("part radius_mm\n1 0.5\n", r"no column 'radius_mm'.*part radius_mm"),
        ("part,radius_mm\n1,1.0\n2,\n", r"line 3: radius_mm = '' is not a number"),
        ("radius_mm\n" + "1" * 200_000, r"line 2: not a CSV file: field larger"),
        ("radius_mm\n" + "1.0\n" * 2_500_001, r"at most 10000000 are read"),
    ],
)
def test_faulty_measured_values_are_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        written(tmp_path, text).loaded(tmp_path)


def test_files_that_are_none_are_refused(tmp_path):
    with pytest.raises(InputError, match="Is a directory"):
        Empirical(file=".", column="x").loaded(tmp_path)
    (tmp_path / "raw.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"raw\.csv.*UTF-8"):
        Empirical(file="raw.csv", column="x").loaded(tmp_path)
    with pytest.raises(ValidationError, match=r"must not contain a NUL character"):
        Empirical(file="a\0b", column="x")


def test_columns_may_be_separated_by_semicolons_and_tabs(tmp_path):
    expected = written(tmp_path, "part,radius_mm\n1,1.5\n2,-2\n").loaded(tmp_path)
    for text in ("part;radius_mm\n1;1.5\n2;-2\n", "part\tradius_mm\n1\t1.5\n\t-2\n"):
        assert written(tmp_path, text).loaded(tmp_path) == expected
