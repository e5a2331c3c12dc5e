"""The largest field and aperture that can be met, where a specification cannot."""

from __future__ import annotations

import pytest
from small_searches import singlet_from_plate

from lensdesign.errors import DesignError
from lensdesign.optimization import result
from lensdesign.optimization.limits.feasible_limits import feasibility_limit
from lensdesign.optimization.problem import DesignProblem
from lensdesign.optimization.search import optimize
from lensdesign.optimization.specification.specification import Specification

ASKED = singlet_from_plate()


def with_object(**changes: float) -> Specification:
    return ASKED.replaced(object=ASKED.object.replaced(**changes))


@pytest.mark.usefixtures("few_searches")
def test_the_largest_field_and_aperture_can_be_met_and_a_little_more_cannot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Held against searches of their own; both lie within the etendue bound, which the whole does, too."""
    found = optimize(ASKED)
    assert not found.feasible
    assert found.starts_at_best >= 3
    reach = found.reach
    assert reach is not None
    bound = 5472 * 2.4e-3 * 0.532 / (2.0 * 2.4)
    assert reach.field_diameter_mm * 0.4 < bound
    assert 3.0 * reach.numerical_aperture < 3.0 * 0.4 < bound
    monkeypatch.setattr(result, "feasibility_limit", lambda *_: None)  # once is enough
    for key in ("field_diameter_mm", "numerical_aperture"):
        value = getattr(reach, key)
        assert optimize(with_object(**{key: 0.999 * value})).feasible
        assert not optimize(with_object(**{key: 1.01 * value})).feasible


def test_a_met_specification_has_no_reach() -> None:
    assert optimize(with_object(field_diameter_mm=1.5)).reach is None


@pytest.mark.usefixtures("few_searches")
def test_nothing_is_told_where_the_size_of_the_object_is_not_what_is_in_the_way() -> None:
    thick = ASKED.constraints.replaced(min_center_thickness_mm=16.0)
    asked = ASKED.replaced(constraints=thick)
    problem = DesignProblem(asked, asked.lens)
    reach = feasibility_limit(asked, problem.base, "N-SF11", problem.to_unit(asked.lens))
    assert (reach.field_diameter_mm, reach.numerical_aperture) == (None, None)


@pytest.mark.usefixtures("few_searches")
def test_where_no_lens_can_be_made_what_can_is_told_all_the_same() -> None:
    """The stop, kept at its size, is wider than the nearest lens; a smaller aperture lets it shrink."""
    *shapes, thickness = ASKED.variables
    fixed = ASKED.replaced(
        optimize=ASKED.optimize.replaced(stop="fixed", max_evaluations=150),
        surfaces=(ASKED.surfaces[0].replaced(thickness_mm=1.2), ASKED.surfaces[1]),
        variables=(*shapes, thickness.replaced(bounds=(1.0, 1.5))),
    )
    with pytest.raises(DesignError, match=r"can be met.*NA 0\.\d+"):
        optimize(fixed)
