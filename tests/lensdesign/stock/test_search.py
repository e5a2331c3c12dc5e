"""Search in a folder of vendors' files: single lenses and pairs in both orientations, checked as designs."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import DESIGNS
from vendor_folder import write_vendors, zmx_text

from lensdesign import (
    InputError,
    Specification,
    StockIndex,
    StockResult,
    StockSettings,
    find_stock_lenses,
    index_stock,
    load_design,
    load_specification,
    write_zmx,
)
from lensdesign.optimization.specification_check import check_against
from lensdesign.stock import search as module
from lensdesign.stock.results import write_stock_files


@pytest.fixture(scope="module")
def specification() -> Specification:
    """4 mm at NA 0.35: two LA1131 meet it, one does not."""
    return load_specification(DESIGNS / "stock_pair_spec.toml")


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> StockIndex:
    folder = tmp_path_factory.mktemp("stock") / "vendors"
    write_vendors(folder)
    return index_stock(folder)


@pytest.fixture(scope="module")
def found(index: StockIndex, specification: Specification) -> StockResult:
    return find_stock_lenses(index, specification)


def test_pairs_meet_the_specification_as_their_files_do(
    found: StockResult, specification: Specification, tmp_path: Path
) -> None:
    assert len(found.matches) >= 3
    files = write_stock_files(found, tmp_path / "found")
    for match, path in zip(found.matches, files.designs, strict=True):
        report = check_against(load_design(path), specification)
        assert report.feasible
        assert report.max_spread_deg == pytest.approx(match.report.max_spread_deg, abs=1e-9)


def test_lenses_are_ordered_by_spread(found: StockResult) -> None:
    spreads = [match.report.max_spread_deg for match in found.matches]
    assert spreads == sorted(spreads)


def test_the_pair_of_the_gallery_is_found_with_its_distances(found: StockResult) -> None:
    """An optimization finds 4.668 degrees at 18.18 and 6.29 mm for LA1131 with the flat sides outside."""
    outside = next(m for m in found.matches if m.arrangement.name == "LA1131-A reversed + LA1131-A")
    assert outside.report.max_spread_deg == pytest.approx(4.668, abs=0.015)
    assert outside.lens.object.working_distance_mm == pytest.approx(18.18, abs=0.1)
    assert outside.spacing_mm == pytest.approx(6.29, abs=0.4)


def test_equal_lenses_are_searched_once(found: StockResult) -> None:
    part = found.matches[0].arrangement.parts[0]
    assert part.lens.files == ("plano/LA1131-A.ZMX", "plano/LA1131.zmx")
    assert found.lenses == 3
    assert found.singles == 5  # the biconvex lens is symmetric


def test_a_single_lens_is_turned_around_if_that_is_better(tmp_path: Path) -> None:
    lens = load_design(DESIGNS / "feasible_singlet.toml")
    specification = load_specification(DESIGNS / "feasible_singlet_spec.toml")
    write_zmx(lens, tmp_path / "forward.zmx")
    result = find_stock_lenses(index_stock(tmp_path), specification)
    (match,) = [m for m in result.matches if len(m.arrangement.parts) == 1]
    assert not match.arrangement.parts[0].is_reversed
    assert match.report.max_spread_deg == pytest.approx(4.643, abs=0.002)
    turned = [*lens.surfaces][::-1]
    surfaces = [
        (-(s.radius_mm or np.inf), thickness, glass)
        for s, thickness, glass in zip(
            turned, (lens.surfaces[0].thickness_mm, 20.0), ("N-BK7", ""), strict=True
        )
    ]
    text = zmx_text("TURNED", surfaces, 8.4).replace("DIAM 8.4", "DIAM 10.0")
    text = text.replace("  GLAS", f"  CONI {turned[0].conic}\r\n  GLAS")
    shutil.rmtree(tmp_path)
    tmp_path.mkdir()
    (tmp_path / "turned.zmx").write_text(text)
    result = find_stock_lenses(index_stock(tmp_path), specification)
    (match,) = [m for m in result.matches if len(m.arrangement.parts) == 1]
    assert match.arrangement.parts[0].is_reversed
    assert match.report.max_spread_deg == pytest.approx(4.643, abs=0.002)


def test_without_a_match_the_nearest_is_returned(index: StockIndex, specification: Specification) -> None:
    limits = specification.constraints.replaced(max_spread_deg=4.0)
    strict = specification.model_copy(update={"constraints": limits})
    result = find_stock_lenses(index, strict)
    assert result.matches == ()
    assert result.nearest is not None
    assert not result.nearest.report.feasible
    assert 0.0 < result.nearest.excess < 0.3


def test_files_that_cannot_be_used_are_listed(found: StockResult, tmp_path: Path) -> None:
    files = write_stock_files(found, tmp_path)
    assert files.left_out is not None
    rows = list(csv.DictReader(files.left_out.open()))
    assert {row["file"] for row in rows} >= {"bad/cut.zmx", "bad/noise.zmx", "bad/two.zmx"}
    assert all(row["reason"] for row in rows)
    table = list(csv.DictReader(files.table.open()))
    assert [row["design"] for row in table] == [path.name for path in files.designs]


def test_results_of_an_earlier_search_are_replaced(found: StockResult, tmp_path: Path) -> None:
    write_stock_files(found, tmp_path)
    (tmp_path / "mine.toml").write_text("kept")
    write_stock_files(replace(found, matches=found.matches[:1], left_out={}), tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.toml", "stock.csv", "stock_01.toml"]


def test_a_narrow_lens_is_left_out_with_the_reason(tmp_path: Path, specification: Specification) -> None:
    narrow = [(25.75, 5.34, "N-BK7"), (None, 46.5, "")]
    (tmp_path / "narrow.zmx").write_text(zmx_text("NARROW", narrow, 2.0))
    result = find_stock_lenses(index_stock(tmp_path), specification)
    assert list(result.left_out) == ["narrow.zmx"]
    assert "narrow" in result.left_out["narrow.zmx"]
    assert (result.matches, result.nearest) == ((), None)


def test_the_clear_fraction_narrows_lenses(index: StockIndex, specification: Specification) -> None:
    result = find_stock_lenses(index, specification, StockSettings(keep=1, clear_fraction=0.97))
    lens = result.matches[0].lens
    assert max(s.semi_diameter_mm or 0.0 for s in lens.surfaces) == pytest.approx(0.97 * 11.43)
    assert all(edge.semi_diameter_mm > 11.3 for edge in lens.edges)


def test_glass_unknown_at_the_wavelength_is_a_reason(index: StockIndex, specification: Specification) -> None:
    infrared = specification.model_copy(update={"wavelengths_um": (10.6,)})
    result = find_stock_lenses(index, infrared)
    assert result.lenses == 0
    assert "10.6" in result.left_out["plano/LA1509.zmx"]


def test_processes_find_the_same(
    index: StockIndex, specification: Specification, found: StockResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_BATCH", 2)
    result = find_stock_lenses(index, specification, workers=2)
    assert [m.lens for m in result.matches] == [m.lens for m in found.matches]


def test_a_catalogue_goes_with_the_design(tmp_path: Path, specification: Specification) -> None:
    catalog = tmp_path / "own.agf"
    catalog.write_text("CC own\nNM OWN-GLASS 2 0 1.5168 64 0\nCD 1.3007 0 0 0.01 0 100\nLD 0.3 2.5\n")
    vendors = tmp_path / "vendors"
    vendors.mkdir()
    own = [(25.75, 5.34, "OWN-GLASS"), (None, 46.5, "")]
    (vendors / "own.zmx").write_text(zmx_text("OWN", own, 11.43))
    result = find_stock_lenses(index_stock(vendors, glass_catalogs=[catalog]), specification)
    files = write_stock_files(result, tmp_path / "found")
    assert check_against(load_design(files.designs[0]), specification).feasible


def test_constraints_of_lenses_as_built_are_refused(index: StockIndex, specification: Specification) -> None:
    limits = specification.constraints.replaced(min_yield=0.5)
    with pytest.raises(InputError, match="min_yield"):
        find_stock_lenses(index, specification.model_copy(update={"constraints": limits}))


@pytest.mark.parametrize(
    "values", [{"keep": 0}, {"traced": 0}, {"clear_fraction": 1.1}, {"yield_trials": 5}, {"yield_trials": -1}]
)
def test_settings_out_of_range_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(values))):
        StockSettings(**values)
