"""Fronts: what stands on one, and searches that make one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign.errors import DesignError
from lensdesign.exploration import Axis, Exploration, ExploredPoint, axes_of, front_of
from lensdesign.exploration.objectives import OBJECTIVES
from lensdesign.lens.lens import Lens
from lensdesign.optimization import Specification, check_against

AXES = (Axis(OBJECTIVES["thickness"]), Axis(OBJECTIVES["yield"]))


@given(st.lists(st.tuples(st.floats(1.0, 2.0), st.floats(0.0, 1.0)), min_size=1, max_size=30))
def test_each_lens_is_on_the_front_or_behind_one_that_is(values: list[tuple[float, float]]) -> None:
    lens = Lens.model_construct()
    all_of = [
        ExploredPoint(str(k), "glass", {"thickness_mm": a, "yield": b}, (), lens)
        for k, (a, b) in enumerate(values)
    ]
    front = front_of(all_of, AXES)
    assert front
    slack = 0.01
    for one in all_of:
        a, b = one.values["thickness_mm"], one.values["yield"]
        assert one in front or any(
            f.values["thickness_mm"] <= a + slack and f.values["yield"] >= b - slack for f in front
        )
    for one in front:
        a, b = one.values["thickness_mm"], one.values["yield"]
        better = [o for o in all_of if o.values["thickness_mm"] < a - slack and o.values["yield"] > b + slack]
        assert not better


def test_lenses_that_were_not_found_stand_on_no_front() -> None:
    assert front_of([ExploredPoint("a", "glass", {}, (), None)], AXES) == []


def test_a_thinner_lens_spreads_more(specification: Specification, explored: list[ExploredPoint]) -> None:
    """And each keeps every constraint, by a check of its own."""
    front = front_of(explored, axes_of("thickness,spread", specification))
    assert len(front) >= 3
    thickness = np.array([one.values["thickness_mm"] for one in front])
    spreads = np.array([one.values["spread_deg"] for one in front])
    assert np.all(np.diff(thickness) > 0.0)
    assert np.all(np.diff(spreads) < 0.0)
    for one in front:
        assert one.lens is not None
        assert check_against(one.lens, specification).feasible


def test_what_is_known_is_not_sought_again(
    specification: Specification, explored: list[ExploredPoint]
) -> None:
    known = {one.key: one for one in explored}
    kept: list[ExploredPoint] = []
    axes = axes_of("thickness,spread", specification)
    again = Exploration(specification, axes, 4, known, kept.append).run()
    assert [one.key for one in again] == [one.key for one in explored]
    assert not kept


def test_a_field_is_given_and_the_rest_sought(specification: Specification) -> None:
    axes = axes_of("thickness,field=1.8:2.4", specification)
    assert [axis.objective.name for axis in axes] == ["field", "thickness"]
    found = Exploration(specification, axes, lenses=2).run()
    thickness = {one.values["field_mm"]: one.values["thickness_mm"] for one in found}
    assert thickness[1.8] < thickness[2.4]


def test_a_specification_that_nothing_meets_is_told(specification: Specification) -> None:
    limits = specification.constraints.replaced(max_lens_thickness_mm=3.0)
    nothing = specification.model_copy(update={"constraints": limits})
    with pytest.raises(DesignError, match="no lens meets the specification"):
        Exploration(nothing, axes_of("thickness,spread", nothing), lenses=2).run()
