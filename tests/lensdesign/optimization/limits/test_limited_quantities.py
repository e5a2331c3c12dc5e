"""How far a specification reaches."""

from __future__ import annotations

import pytest
from places import DESIGNS

from lensdesign.optimization import Specification, load_specification, optimize, result
from lensdesign.optimization.limits.limited_quantities import APERTURE, FIELD, PITCH
from lensdesign.optimization.limits.search import find_limits
from lensdesign.optimization.specification.sections import Settings


@pytest.fixture
def specification() -> Specification:
    """A field that is smaller than the largest."""
    asked = load_specification(DESIGNS / "thinnest_singlet_spec.toml")
    settings = asked.optimize.replaced(max_evaluations=2000)
    return asked.replaced(object=asked.object.replaced(field_diameter_mm=2.4), optimize=settings)


@pytest.mark.usefixtures("few_searches")
def test_limits_can_be_met_and_a_little_more_cannot(
    specification: Specification, monkeypatch: pytest.MonkeyPatch
) -> None:
    limited = specification.model_copy(
        update={
            "optimize": Settings(goal="thinnest lens", start="plate", stop="numerical aperture", starts=3)
        }
    )
    (field,) = find_limits(limited, quantities=(FIELD,))
    aperture, pitch = find_limits(limited, quantities=(APERTURE, PITCH), most=1.15)
    assert field.reached is not None
    assert 3.0 < field.reached < 3.2  # 3 mm can be met, by a lens nearly twice as thick
    assert aperture.reached is not None
    assert aperture.reached > 0.55
    assert pitch.reached is not None
    assert pitch.asked == 3.2 and pitch.reached > 3.5  # noqa: PT018
    monkeypatch.setattr(result, "feasibility_limit", lambda *_: None)  # the limits are found already
    for value, met in ((0.998 * field.reached, True), (1.02 * field.reached, False)):
        scene = limited.object.replaced(field_diameter_mm=value)
        assert optimize(limited.model_copy(update={"object": scene})).feasible is met


def test_a_coarser_pixel_leaves_the_sensor_as_large(specification: Specification) -> None:
    coarse = PITCH.changed(specification, 6.4)
    assert coarse.sensor.size_mm == pytest.approx(specification.sensor.size_mm, abs=6.4e-3)
    assert coarse.spread_limit(0.532) == pytest.approx(0.5 * specification.spread_limit(0.532))


@pytest.mark.usefixtures("few_searches")
def test_a_specification_that_is_not_met_reaches_less_than_asked(specification: Specification) -> None:
    limits = specification.constraints.replaced(max_lens_thickness_mm=3.0)
    few = specification.optimize.replaced(starts=3)
    (field,) = find_limits(
        specification.replaced(constraints=limits, optimize=few), quantities=(FIELD,), most=1.0
    )
    assert field.reached is None or field.reached < field.asked


def test_a_goal_of_lenses_as_built_is_not_worked_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only constraints are to be met, and predictions take most of a search."""
    asked = load_specification(DESIGNS / "as_built_spec.toml")
    assert asked.asks_as_built

    def refused(*_: object) -> None:
        raise AssertionError("nothing asks for this")

    monkeypatch.setattr(type(asked.as_built), "evaluate", refused)
    (field,) = find_limits(asked, quantities=(FIELD,), most=1.0)
    assert field.reached is not None
    assert field.reached > 0.9 * field.asked
