"""Estimates without rays, against first-order optics, traced rays and each other."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import DESIGNS

from lensdesign import Surface, get_material, load_specification
from lensdesign.analysis.paraxial import cardinal_points
from lensdesign.files.marginal_ray import MeridionalSystem
from lensdesign.stock.arrangement import Arrangement, OrientedLens, StockLens
from lensdesign.stock.distances import COARSE, find_distances
from lensdesign.stock.estimates import (
    EstimateLimits,
    best_pairs,
    lens_table,
    pair_ranks,
    single_ranks,
)

SPECIFICATION = load_specification(DESIGNS / "stock_pair_spec.toml")
LIMITS = EstimateLimits.of(SPECIFICATION)


def plano(
    radius_mm: float, thickness_mm: float = 5.0, semi_mm: float = 11.43, conic: float = 0.0
) -> StockLens:
    front = Surface(
        radius_mm=radius_mm,
        conic=conic,
        thickness_mm=thickness_mm,
        material="N-BK7",
        semi_diameter_mm=semi_mm,
    )
    return StockLens((f"r{radius_mm:g}.zmx",), "", (front, Surface(semi_diameter_mm=semi_mm)))


@given(st.floats(20.0, 200.0), st.floats(1.0, 8.0), st.booleans())
def test_the_matrix_gives_the_cardinal_points(
    radius_mm: float, thickness_mm: float, is_reversed: bool
) -> None:
    part = OrientedLens(plano(radius_mm, thickness_mm), is_reversed)
    a, _, c, d = lens_table([part], 0.5876, ())[0, :4]
    curvatures = [surface.curvature for surface in part.surfaces]
    exact = cardinal_points(curvatures, [thickness_mm], [1.0, 1.5168003, 1.0])
    assert -1.0 / c == pytest.approx(exact.efl_mm, rel=1e-5)
    assert -a / c == pytest.approx(exact.bfl_mm, rel=1e-5)
    assert d / c == pytest.approx(exact.ffl_mm, rel=1e-5)


@pytest.mark.parametrize("is_reversed", [False, True])
@pytest.mark.parametrize("conic", [0.0, -0.8])
def test_third_order_aberration_is_that_of_traced_rays(is_reversed: bool, conic: float) -> None:
    """A ray parallel to the axis misses the paraxial focus by S_I / (2 u')."""
    part = OrientedLens(plano(40.0, conic=conic), is_reversed)
    row = lens_table([part], 0.5876, ())[0]
    height, thickness = 1.0, part.surfaces[0].thickness_mm or 0.0
    index = get_material("N-BK7").index(0.5876)
    system = MeridionalSystem(tuple(s.shape for s in part.surfaces), (thickness,), (1.0, index, 1.0))
    ray = system.trace(height, -1.0, 0.0)
    assert ray is not None
    a, _, c, _ = row[:4]
    missed = ray.height_at(thickness - a / c)
    assert missed == pytest.approx(row[4] * height**4 / (2.0 * c * height), rel=0.02)


def test_the_order_of_pairs_is_that_of_traced_rays() -> None:
    lens = plano(25.75, 5.34)
    parts = [OrientedLens(lens), OrientedLens(lens, True)]
    table = lens_table(parts, 0.532, ())
    pairs, ranks, estimated = best_pairs(table, table, LIMITS, 4)
    assert estimated == 4
    traced = [
        find_distances(Arrangement((parts[i], parts[j])), SPECIFICATION, (), COARSE).rank for i, j in pairs
    ]
    assert traced[0] < min(traced) + 0.02
    assert np.argmax(traced) == 3
    assert np.argmax(ranks) == 3
    assert ranks[0] == pytest.approx(traced[0], rel=0.3)


@given(st.lists(st.floats(15.0, 300.0), min_size=2, max_size=6))
def test_the_best_pairs_are_those_of_all(radii_mm: list[float]) -> None:
    parts = [OrientedLens(plano(r, semi_mm=min(11.43, 0.8 * r)), k % 2 == 1) for k, r in enumerate(radii_mm)]
    table = lens_table(parts, 0.532, ())
    everything = np.array([pair_ranks(table[i : i + 1], table, LIMITS) for i in range(len(table))])
    pairs, ranks, _ = best_pairs(table, table, LIMITS, 3)
    assert np.all(np.diff(ranks) >= 0.0)
    assert [everything[i, j] for i, j in pairs] == pytest.approx(list(ranks))
    if len(ranks):
        assert ranks[0] == pytest.approx(float(np.min(everything)))


def test_weak_and_diverging_lenses_are_no_single_lenses() -> None:
    table = lens_table([OrientedLens(plano(-50.0)), OrientedLens(plano(2000.0))], 0.532, ())
    diverging, weak = single_ranks(table, LIMITS)
    assert math.isinf(diverging)
    assert weak > 2.0
