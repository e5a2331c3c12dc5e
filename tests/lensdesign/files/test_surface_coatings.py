"""Coatings in design files, and tables of measured amplitudes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import (
    Coating,
    CoatingLayer,
    DesignError,
    InputError,
    launch,
    load_design,
    save_design,
    trace_polarized,
)
from lensdesign.files.surface_coatings import coating_table, compile_coatings
from lensdesign.lens.coatings.thin_films import film_coefficients

PAPER = load_design("designs/paper_singlet.toml")
TEXT = Path("designs/paper_singlet.toml").read_text(encoding="utf-8")
N = float(PAPER.indices(0.532)[1])

layers = st.builds(
    CoatingLayer,
    index=st.floats(1.0, 4.0),
    extinction=st.floats(0.0, 5.0),
    thickness_nm=st.floats(0.1, 1000.0),
)
coatings = st.one_of(
    st.sampled_from(["ideal", "bare", "mgf2"]),
    st.builds(Coating, layers=st.lists(layers, min_size=1, max_size=4).map(tuple)),
)


def with_coating(tmp_path, text, front="", name="lens.toml"):
    """Path of the paper's design with the coating of its last surface, and of its first."""
    path = tmp_path / name
    path.write_text(TEXT.replace("stop = true", f"stop = true\n{front}") + f"\ncoating = {text}\n")
    return path


def table_text(incidences_deg=(0, 20, 40, 50), wavelengths_um=(0.5, 0.532, 0.6), turned=False, n_glass=N):
    """A table of bare glass from the air, computed; or from the glass to the air."""
    lines = ["wavelength_um,incidence_deg,ts_amplitude,ts_phase_deg,tp_amplitude,tp_phase_deg"]
    for wavelength in wavelengths_um:
        for angle in incidences_deg:
            media = (n_glass, 1.0) if turned else (1.0, n_glass)
            found = film_coefficients(*media, [], [], np.cos(np.radians(angle)), wavelength)
            lines.append(f"{wavelength},{angle},{abs(found.ts):.9f},0,{abs(found.tp):.9f},0")
    return "\n".join(lines) + "\n"


@given(coatings, coatings)
def test_a_design_file_keeps_its_coatings(tmp_path_factory, front, back):
    lens = PAPER.with_surface(0, coating=front).with_surface(1, coating=back)
    path = tmp_path_factory.mktemp("designs") / "lens.toml"
    save_design(lens, path)
    assert load_design(path).surfaces == lens.surfaces
    if front == back == "ideal":
        assert "coating" not in path.read_text()


def test_layers_begin_at_the_air_on_both_sides():
    stack = Coating(
        layers=(CoatingLayer(index=1.38, thickness_nm=90.0), CoatingLayer(index=2.0, thickness_nm=50.0))
    )
    lens = PAPER.with_surface(0, coating=stack).with_surface(1, coating=stack)
    front, back = compile_coatings(lens, 0.532)
    assert (front.indices, back.indices) == ((1.38 + 0j, 2.0 + 0j), (2.0 + 0j, 1.38 + 0j))
    cosine = np.cos(np.radians(20.0))
    inside = np.sqrt(1.0 - (1.0 - cosine**2) / N**2)
    into, out = front.coefficients(1.0, N, cosine), back.coefficients(N, 1.0, inside)
    # The same light, with the direction of time reversed.
    assert np.abs(np.subtract(into[:2], out[:2])).max() < 1e-14
    turned = back.turned().coefficients(1.0, N, cosine)
    assert np.abs(np.subtract(into, turned)).max() < 1e-14


def test_a_film_of_the_index_of_air_changes_nothing_but_its_absence():
    air = Coating(layers=(CoatingLayer(index=1.0, thickness_nm=700.0),))
    for surface, (n1, n2) in ((0, (1.0, N)), (1, (N, 1.0))):
        one, two = (
            compile_coatings(PAPER.with_surface(surface, coating=coating), 0.532)[surface]
            for coating in (air, "bare")
        )
        cosine = np.cos(np.radians(25.0))
        with_air, without = (coating.coefficients(n1, n2, cosine) for coating in (one, two))
        assert np.abs(np.subtract(with_air[:2], without[:2])).max() < 1e-14


def test_a_table_gives_what_it_was_made_of(tmp_path):
    (tmp_path / "glass.csv").write_text(table_text(incidences_deg=range(0, 51, 5)))
    lens = load_design(with_coating(tmp_path, '"bare"', 'coating = { file = "glass.csv" }'))
    bare = lens.with_surface(0, coating="bare")
    rays = launch(lens, [(0.0, 1.0)], [(0.0, 0.9), (0.5, -0.3)], 0.532)
    expected = trace_polarized(bare, *rays, 0.532).jones
    assert np.abs(trace_polarized(lens, *rays, 0.532).jones - expected).max() < 2e-6
    save_design(lens, tmp_path / "again.toml")
    assert load_design(tmp_path / "again.toml").surfaces[0].coating == lens.surfaces[0].coating


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('"silver"', "coating = 'silver': must be 'ideal', 'bare' or 'mgf2'"),
        ("{}", "nothing given: must be one of layers and file"),
        ("{ layers = [{ index = 1.38 }] }", "layers 1: no thickness given"),
        ("{ layers = [{ thickness_nm = 90 }] }", "either a material or an index"),
        ("{ layers = [{ index = 1.38, quarter_waves = 1 }] }", "need a design_wavelength_um"),
        ("{ layers = [{ index = 1.38, thickness_nm = -2 }] }", "greater than 0"),
        ("{ layers = [{ material = 'ZrO2', thickness_nm = 90 }] }", "ZrO2: no absorption data"),
        ("{ layers = [{ material = 'MgF', thickness_nm = 90 }] }", "did you mean MgF2"),
        ("{ layers = [{ index = 1.5, extinction = -1, thickness_nm = 9 }] }", "extinction"),
        ("{ layers = [{ index = 1.5, thickness_nm = 9, colour = 2 }] }", "unknown key"),
        ('{ file = "missing.csv" }', "missing.csv: No such file"),
        ('{ file = "../outside.csv" }', "outside"),
    ],
)
def test_a_coating_that_is_none_is_named(tmp_path, text, words):
    with pytest.raises(InputError) as raised:
        load_design(with_coating(tmp_path, text))
    assert words in str(raised.value)
    assert "surface 2" in str(raised.value)


def test_a_film_without_data_at_a_wavelength_is_named(tmp_path):
    path = with_coating(tmp_path, '{ layers = [{ material = "Ta2O5", thickness_nm = 90 }] }')
    path.write_text(path.read_text().replace("[0.532]", "[2.2]"))
    with pytest.raises(InputError, match=r"surface 2, coating: film material Ta2O5: .*2.2 µm"):
        load_design(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace("ts_phase_deg", "ts_angle"), "ts_angle"),
        (lambda text: text.replace("0.5,0,0", "0.5,5,0", 1), "no rows at 0.5 µm and 0 deg"),
        (lambda text: "\n".join(text.splitlines()[:-1]), "no rows at 0.6 µm and 50 deg"),
        (lambda text: text + text.splitlines()[1], "2 rows at 0.5 µm and 0 deg"),
        (lambda text: text.replace("0.5,0,0.97", "0.5,0,1.97", 1), "ts_amplitude = 1.97"),
        (lambda text: text.replace("0.5,0,0.97", "0.5,0,0.87", 1), "ts and tp differ"),
        (lambda text: text.splitlines()[0], "holds no values"),
        (lambda text: text.replace("0.5,0,0.97", "0.5,0,x", 1), "not a number"),
    ],
)
def test_a_table_that_no_surface_has_is_refused(tmp_path, change, words):
    path = tmp_path / "glass.csv"
    path.write_text(change(table_text()))
    with pytest.raises(InputError) as raised:
        coating_table(path)
    assert words in str(raised.value)
    assert "glass.csv" in str(raised.value)


def test_a_table_that_ends_before_the_largest_angle_is_refused(tmp_path):
    (tmp_path / "glass.csv").write_text(table_text(incidences_deg=(0, 5, 10)))
    lens = load_design(with_coating(tmp_path, '"bare"', 'coating = { file = "glass.csv" }'))
    rays = launch(lens, [(0.0, 1.0)], [(0.0, 0.9)], 0.532)
    with pytest.raises(InputError, match=r"surface 1, coating: .*ends at an angle of incidence of 10 deg"):
        trace_polarized(lens, *rays, 0.532)


def test_a_table_needs_the_wavelength(tmp_path):
    (tmp_path / "glass.csv").write_text(table_text(wavelengths_um=(0.6, 0.7)))
    with pytest.raises(InputError, match=r"surface 1, coating: .* must be from 0.6 to 0.7 µm"):
        load_design(with_coating(tmp_path, '"bare"', 'coating = { file = "glass.csv" }'))


def test_a_layer_is_made_of_one_thing():
    with pytest.raises(ValueError, match="either a material or an index"):
        CoatingLayer(material="MgF2", index=1.38, thickness_nm=10.0)
    with pytest.raises(DesignError, match="coating"):
        PAPER.with_surface(0, coating="silver")


GLASS = '\n[sensor.cover_glass]\nthickness_mm = 0.7\nmaterial = "N-BK7"\ndistance_mm = 0.5\n'


def test_a_table_of_the_cover_glass_lies_beside_the_design(tmp_path):
    (tmp_path / "glass.csv").write_text(table_text())
    path = tmp_path / "lens.toml"
    path.write_text(TEXT + GLASS + 'coating = { file = "glass.csv" }\n')
    lens = load_design(path)
    assert lens.sensor.cover_glass.coating.file == tmp_path / "glass.csv"
    (tmp_path / "other").mkdir()
    save_design(lens, tmp_path / "other" / "lens.toml")
    with pytest.raises(InputError, match="outside"):
        load_design(tmp_path / "other" / "lens.toml")
    save_design(lens, tmp_path / "again.toml")
    assert load_design(tmp_path / "again.toml").sensor == lens.sensor


@pytest.mark.parametrize("text", ['{ file = "missing.csv" }', "{ file = '../glass.csv' }"])
def test_a_missing_table_of_the_cover_glass_is_named(tmp_path, text):
    path = tmp_path / "lens.toml"
    path.write_text(TEXT + GLASS + f"coating = {text}\n")
    with pytest.raises(InputError, match=r"cover.glass, coating"):
        load_design(path)


def test_tables_are_equal_by_their_content(tmp_path):
    for name, turned in (("a.csv", False), ("b.csv", False), ("c.csv", True)):
        (tmp_path / name).write_text(table_text(incidences_deg=(0, 10, 20), turned=turned))
    same, again, other = (coating_table(tmp_path / name).digest for name in ("a.csv", "b.csv", "c.csv"))
    assert same == again != other
