"""Tables that users hand in: numbers with a decimal point, cells that columns claim, and nothing guessed."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import InputError
from lensdesign.common.tables import read_list, read_number, read_table, validate_no_comma_pairs


@given(st.floats(allow_infinity=True, allow_nan=False))
def test_numbers_as_python_writes_them(value):
    assert read_number(f" {value!r} ", "a.csv, line 1") == value


@pytest.mark.parametrize(
    ("text", "value"),
    [("+.5", 0.5), ("5.", 5.0), ("1E+3", 1000.0), ("0", 0.0), ("-0.0", 0.0), ("00.5", None)],
)
def test_ways_to_write_a_number(text, value):
    if value is None:
        with pytest.raises(InputError, match="begins with a zero"):
            read_number(text, "a")
    else:
        assert read_number(text, "a") == value
    assert math.isnan(read_number("NaN", "a"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,5", r"a, line 2: r = '0,5' is not a number: .*write a decimal point, 0.5"),
        ("1,234", r"is not a number: .* decimal comma or a thousands separator"),
        ("1,234,567", "thousands separators are not read"),
        ("1.234.567", "thousands separators are not read"),
        ("1 234", "thousands separators are not read"),
        ("1\u00a0234,5", "thousands separators are not read"),
        ("1\u202f234", "thousands separators are not read"),
        ("1\u2019234.5", "thousands separators are not read"),
        ("012", "begins with a zero"),
        ("\u22121.5", "its sign is a dash"),
        ("\uff11", "is not a number"),
        ("\u0661", "is not a number"),
        ("1.5mm", "is not a number"),
        ("1_5", "is not a number"),
        ("1.5D+02", "is not a number"),
        ("0x10", "is not a number"),
        ("=1/2", "is not a number"),
        ("", "is not a number"),
    ],
)
def test_cells_that_are_not_plain_numbers(text, message):
    with pytest.raises(InputError, match=message):
        read_number(text, "a, line 2", "r")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2,3\n", r"line 2: 3 cells.* 2"),
        ("a,b\n1,2,\n", "line 2: 3 cells"),
        ("a,b\n1\n", "line 2: no value in column 'b'"),
        ("a\n0,5\n", r"line 2: 2 cells.* 1 column.*'0,5'"),
        ("a;b\n0,5;1,5;2\n", "line 2: 3 cells"),
        ("", "is empty"),
        (",,\n\n", "is empty"),
    ],
)
def test_tables_that_do_not_fit_their_header(tmp_path, text, message):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_table(tmp_path / "t.csv")


def test_columns_know_their_lines(tmp_path):
    (tmp_path / "t.csv").write_text('\n"a; b";c\n\n1;2\n 3 ; x \n')
    table = read_table(tmp_path / "t.csv")
    assert table.names == ("a; b", "c")
    assert [cell for cell, _ in table.column("c")] == ["2", "x"]
    assert table.column("c")[1][1].endswith("t.csv, line 5")


def test_lists_take_remarks_but_no_second_number(tmp_path):
    (tmp_path / "l.txt").write_text("# in mm\n37.5, shop A\n-12 # pair\n5; No. 7\n")
    assert [value for value, _ in read_list(tmp_path / "l.txt", "radius")] == [37.5, -12.0, 5.0]
    for text in ("37,5", "37, 5", "37;5", "37 ,5 mm", "1.5; -2", "1, .5"):
        (tmp_path / "l.txt").write_text(text)
        with pytest.raises(InputError, match=r"l\.txt, line 1: .*decimal comma"):
            read_list(tmp_path / "l.txt", "radius")


@pytest.mark.parametrize(
    ("rows", "is_refused"),
    [
        (["0,1,0,2", "0,3,0,4"], True),
        (["-1,5,2,25,0,1"], True),
        (["1,2,3,4"], False),
        (["1,2,3", "4,5,6"], False),
        (["1,-2,3,4", "1,2,3,4"], False),
        (["0.1,2,3,4", "1,2,3,4"], False),
        (["nan,1,2,3", "1,2,3,4"], False),
    ],
)
def test_grids_of_decimal_commas(rows, is_refused):
    lines = [(text, f"g.csv, line {n}") for n, text in enumerate(rows, start=1)]
    if is_refused:
        with pytest.raises(InputError, match=r"g\.csv, line 1: .*decimal comma"):
            validate_no_comma_pairs(lines)
    else:
        validate_no_comma_pairs(lines)
