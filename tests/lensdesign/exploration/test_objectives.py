"""Objectives by name, and what is refused."""

from __future__ import annotations

import pytest

from lensdesign.errors import InputError
from lensdesign.exploration import axes_of
from lensdesign.exploration.objectives import OBJECTIVES
from lensdesign.optimization import Specification
from lensdesign.optimization.specification.sections import Constraints, Tolerances


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("thickness", "1 named; allowed: two to four"),
        ("thickness,width", "'width' is not an objective; allowed: thickness, track"),
        ("thickness,thickness", "thickness is given twice"),
        ("field,na", "at least one must be a goal of a search: thickness"),
        ("thickness,yield", "yield needs tolerances"),
        ("thickness,cost", "cost needs tolerances"),
        ("field=2,thickness", "bounds must be two numbers"),
        ("field=4:2,thickness", "the smaller first"),
        ("field=nan:2,thickness", "the smaller first"),
    ],
)
def test_what_is_no_trade_off_is_refused(specification: Specification, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        axes_of(text, specification)


def test_each_objective_is_a_goal_or_a_value_of_the_object_and_a_limit(specification: Specification) -> None:
    for objective in OBJECTIVES.values():
        held = specification.object if objective.scanned else Constraints()
        held = Tolerances(study="") if objective.name == "cost" else held
        assert hasattr(held, objective.limit)
    limited = OBJECTIVES["thickness"].limited(specification, 7.0)
    assert limited.constraints.max_lens_thickness_mm == 7.0
    assert OBJECTIVES["field"].limited(specification, 2.0).object.field_diameter_mm == 2.0


def test_a_spread_is_held_no_looser_than_asked(specification: Specification) -> None:
    tight = specification.model_copy(
        update={"constraints": specification.constraints.replaced(max_spread_deg=3.0)}
    )
    assert OBJECTIVES["spread"].limited(tight, 4.0).constraints.max_spread_deg == 3.0
    assert OBJECTIVES["spread"].limited(tight, 2.0).constraints.max_spread_deg == 2.0
