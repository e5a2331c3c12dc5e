"""Indices in heat against the makers' tables, and against air's index of other formulas."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign.errors import MaterialError
from lensdesign.lens.catalogues.agf import parse_agf
from lensdesign.lens.catalogues.thermal import air_index, at_temperature, split_temperature
from lensdesign.lens.glass import get_material

# Schott's data sheet of N-BK7: temperatures; relative and absolute dn/dT in 1e-6/K at 1060.0 nm, e and g.
N_BK7 = [
    (-40.0, -20.0, (2.4, 2.9, 3.3), (0.3, 0.8, 1.2)),
    (20.0, 40.0, (2.4, 3.0, 3.5), (1.1, 1.6, 2.1)),
    (60.0, 80.0, (2.5, 3.1, 3.7), (1.5, 2.1, 2.7)),
]
LINES_UM = (1.060, 0.546074, 0.435834)


@pytest.mark.parametrize(("cold", "hot", "relative", "absolute"), N_BK7)
def test_n_bk7_is_that_of_schotts_data_sheet(cold, hot, relative, absolute):
    """To the digits that are printed."""
    glass = get_material("N-BK7")
    for wavelength, rel, ab in zip(LINES_UM, relative, absolute, strict=True):
        ends = [get_material(f"N-BK7@{t:g}C").index(wavelength) for t in (cold, hot)]
        assert 1e6 * (ends[1] - ends[0]) / 20.0 == pytest.approx(rel, abs=0.051)
        changes = [glass.thermal.absolute_change(glass.index(wavelength), wavelength, t) for t in (cold, hot)]
        assert 1e6 * (changes[1] - changes[0]) / 20.0 == pytest.approx(ab, abs=0.051)


def test_air_is_that_of_ciddor():
    """Dry air of 450 ppm CO2 at 15 C and 101,325 Pa, 633 nm: 1.0002765 (Ciddor 1996); 20 C: 1.0002718."""
    assert air_index(0.633, 15.0) == pytest.approx(1.00027653, abs=2e-7)
    assert air_index(0.633, 20.0) == pytest.approx(1.0002718, abs=2e-7)


@pytest.mark.parametrize("name", ["N-BK7", "S-BSL7", "OHARA:S-LAH79", "PMMA", "POLYCARB", "E48R"])
def test_a_design_holds_at_20_degrees(name):
    assert get_material(f"{name}@20C").index(0.55) == get_material(name).index(0.55)


def test_plastics_change_by_their_coefficient_and_by_airs():
    change = get_material("PMMA@50C").index(0.55) - get_material("PMMA").index(0.55)
    air = air_index(0.55, 20.0) - air_index(0.55, 50.0)
    assert change == pytest.approx(-8.5e-5 * 30.0 + 1.49 * air, abs=1e-6)


@given(st.floats(-100.0, 140.0))
def test_names_with_temperatures_are_taken_apart_again(temperature):
    name, found = split_temperature(at_temperature("SCHOTT:N-BK7", temperature))
    assert (name, found) == ("SCHOTT:N-BK7", pytest.approx(temperature, rel=1e-11, abs=1e-300))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("N-BK7@warm", "a temperature must be given as in 'N-BK7@50C'"),
        ("N-BK7@900C", "must be from -100 to 140 C"),
        ("SILICA@50C", r"SILICA .*change of its index with temperature is not known"),
        ("1.5@50C", "a constant index is a number"),
    ],
)
def test_what_is_not_known_is_refused(name, message):
    with pytest.raises(MaterialError, match=message):
        get_material(name)


RECORDS = """NM X1 2 517642 1.5168 64.17 0 1 -1
ED {ed} 8.3 2.51 -0.0009 0
CD 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653
TD {td} 20
LD 0.3 2.5
"""


def test_a_catalogue_file_says_what_heat_does(tmp_path):
    text = RECORDS.format(ed="7.1", td="1.86e-06 1.31e-08 -1.37e-11 4.34e-07 6.27e-10 0.17")
    (tmp_path / "own.agf").write_text(text)
    own, schott = (get_material(n, [tmp_path / "own.agf"]) for n in ("X1@50C", "SCHOTT:N-BK7@50C"))
    assert own.index(0.55) == pytest.approx(schott.index(0.55), abs=1e-12)
    assert own.thermal.expansion_per_k == pytest.approx(7.1e-6)


def test_zeros_in_a_catalogue_file_are_no_data():
    (glass,) = parse_agf(RECORDS.format(ed="0", td="0 0 0 0 0 0"), "own.agf")
    assert glass.schott is None
    assert glass.expansion_per_k is None


def test_a_faulty_expansion_is_refused():
    with pytest.raises(MaterialError, match=r"line 2: ED record.*'x'"):
        parse_agf(RECORDS.format(ed="x", td="0"), "own.agf")
