"""Distances of an arrangement: one-dimensional searches, and loads that agree with the check."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import DESIGNS

from lensdesign import InputError, Surface, load_design, load_specification
from lensdesign.optimization.specification_check import check_against
from lensdesign.stock.arrangement import Arrangement, OrientedLens, StockLens
from lensdesign.stock.distances import find_distances, smallest_of

SPECIFICATION = load_specification(DESIGNS / "stock_pair_spec.toml")
LA1131 = StockLens(("LA1131.zmx",), "LA1131", load_design(DESIGNS / "stock_pair.toml").surfaces[2:])


def pair(first: bool, last: bool) -> Arrangement:
    return Arrangement((OrientedLens(LA1131, first), OrientedLens(LA1131, last)))


@given(st.floats(1.0, 50.0), st.floats(-3.0, 55.0))
def test_the_smallest_value_is_found_within_bounds(high: float, best: float) -> None:
    found, value = smallest_of(
        lambda x: np.abs(x - best), np.array([0.0]), np.array([high]), points=9, rounds=8
    )
    nearest = min(max(best, 0.0), high)
    assert found[0] == pytest.approx(nearest, abs=1e-3)
    assert value[0] == pytest.approx(abs(found[0] - best))


def test_loads_are_those_of_the_check() -> None:
    arrangement = pair(True, True)
    found = find_distances(arrangement, SPECIFICATION)
    lens = arrangement.design(SPECIFICATION, found.working_distance_mm, found.spacing_mm)
    report = check_against(lens, SPECIFICATION)
    limit = SPECIFICATION.spread_limit(0.532)
    assert np.sin(np.deg2rad(report.max_spread_deg)) / limit == pytest.approx(found.spread, rel=0.02)
    assert max(report.footprint_radius_mm) / 11.2 == pytest.approx(found.others, rel=1e-3)


def test_a_fixed_working_distance_is_kept() -> None:
    fixed = tuple(v for v in SPECIFICATION.variables if v.parameter != "working_distance_mm")
    specification = SPECIFICATION.model_copy(update={"variables": fixed})
    assert find_distances(pair(True, True), specification).working_distance_mm == pytest.approx(18.0)


def test_the_spacing_is_within_the_bounds_of_the_specification() -> None:
    low, high = pair(True, False).spacings_mm(SPECIFICATION)
    assert (low, high) == (0.5, 15.0)
    assert 0.5 <= find_distances(pair(True, False), SPECIFICATION).spacing_mm <= 15.0


def test_the_air_gap_holds_at_the_edge() -> None:
    inward = Surface(radius_mm=-30.0, thickness_mm=5.0, material="N-BK7", semi_diameter_mm=10.0)
    hollow = StockLens(("h.zmx",), "", (inward, Surface(radius_mm=-20.0, semi_diameter_mm=10.0)))
    limits = SPECIFICATION.constraints.replaced(min_air_gap_mm=0.3)
    specification = SPECIFICATION.model_copy(update={"constraints": limits})
    low, _ = Arrangement((OrientedLens(LA1131), OrientedLens(hollow))).spacings_mm(specification)
    sag = float(-inward.shape.sag(0.0, 11.43))
    assert low == pytest.approx(0.3 + sag, abs=0.01)


def test_lenses_that_break_a_limit_on_glass_are_refused() -> None:
    limits = SPECIFICATION.constraints.replaced(min_center_thickness_mm=6.0)
    with pytest.raises(InputError, match="centre thickness"):
        find_distances(pair(True, True), SPECIFICATION.model_copy(update={"constraints": limits}))
