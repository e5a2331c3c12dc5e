"""Feasibility limit of a specification that could not be met: field, aperture, lenses as built."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.deadlines import DeadlineExceeded
from lensdesign.lens.lens import Lens, ObjectSpace
from lensdesign.optimization.limits.limited_quantities import APERTURE, FIELD
from lensdesign.optimization.limits.search import Limit, LimitsInterrupted, find_limits
from lensdesign.optimization.local_search import Budget, UntraceableStartError, search_from
from lensdesign.optimization.operands.operand import ACCEPTED_VIOLATION
from lensdesign.optimization.problem import DesignProblem
from lensdesign.optimization.specification.specification import Specification


@dataclass(frozen=True)
class FeasibilityLimit:
    """Largest feasible values, each with all other requirements unchanged; None where nothing was found.

    Attributes
    ----------
    field_diameter_mm
        Largest field at the required numerical aperture.
    numerical_aperture
        Largest numerical aperture over the required field.
    good
        Largest predicted yield, if only constraints on lenses as built were violated.
    as_built_rms_waves
        Smallest predicted root mean square, if only constraints on lenses as built were violated.
    nominal
        Whether field and aperture are those of lenses as designed, without the constraints on lenses as
        built.
    limits
        Limits of field and aperture with their confidence.
    """

    field_diameter_mm: float | None = None
    numerical_aperture: float | None = None
    good: float | None = None
    as_built_rms_waves: float | None = None
    nominal: bool = False
    limits: tuple[Limit, ...] = ()

    def in_words(self, required: ObjectSpace) -> str:
        """Return the feasible values as text for messages."""
        if not self.nominal and any(one.reached == one.asked for one in self.limits):
            return "a lens that meets the specification was found by raising another value; allow more starts"
        values = []
        if self.good is not None:
            values.append(f"a predicted yield of {self.good:.3f}")
        if self.as_built_rms_waves is not None:
            values.append(f"a predicted as-built rms of {self.as_built_rms_waves:.4f} waves")
        if self.field_diameter_mm is not None:
            sure = self._confidence("field")
            values.append(
                f"a field of {self.field_diameter_mm:.4g} mm at NA {required.numerical_aperture:g}{sure}"
            )
        if self.numerical_aperture is not None:
            sure = self._confidence("numerical aperture")
            values.append(
                f"NA {self.numerical_aperture:.4g} over a field of {required.field_diameter_mm:g} mm{sure}"
            )
        if not values:
            reasons = "; ".join(f"{one.name}: {one.confidence}" for one in self.limits)
            return "no smaller field or aperture was found that can be met" + (
                f" ({reasons})" if reasons else ""
            )
        nominal = (
            " (for the lens as designed, without the constraints on lenses as built)" if self.nominal else ""
        )
        return f"the largest values found that can be met: {', or '.join(values)}{nominal}"

    def _confidence(self, name: str) -> str:
        return next((f" ({one.confidence})" for one in self.limits if one.name == name), "")

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, without lenses."""
        return vars(self) | {"limits": [one.as_dict() for one in self.limits]}


def feasibility_limit(
    specification: Specification,
    base: Lens,
    glasses: str,
    point: Array,
    seed: int = 0,
    report: Callable[[str], None] = lambda _: None,
) -> FeasibilityLimit:
    """Find the largest field and the largest aperture that can be met, or the best lens as built.

    Parameters
    ----------
    specification
        Specification that could not be met.
    base, glasses, point
        The lens with the best choice of glasses, the name of that choice, and the point of the unit box with
        the smallest violation.
    seed
        Seed of the random starts.
    report
        Progress callback, called with a line of text at each step (default: none).

    Raises
    ------
    LimitsInterrupted
        If the search is interrupted. After a deadline, the limits are returned as not confirmed.
    """
    limits = specification.constraints
    nominal = limits.min_yield is not None or limits.max_as_built_rms_waves is not None
    if nominal:
        try:
            found = _best_as_built(specification, base, point)
        except KeyboardInterrupt:
            raise LimitsInterrupted(()) from None
        except DeadlineExceeded:
            return FeasibilityLimit(nominal=True)
        if found is not None:
            return found
        specification = _nominal(specification)
    continuous = [v for v in specification.variables if not v.discrete]
    if all(v.parameter == "field_diameter_mm" for v in continuous):
        return FeasibilityLimit()  # nothing can be changed to reach more
    near = {glasses: point[[v.parameter != "field_diameter_mm" for v in continuous]]}
    return feasibility_limit_of(
        find_limits(specification, report, seed, (FIELD, APERTURE), near, most=1.0), nominal
    )


def feasibility_limit_of(limits: tuple[Limit, ...], nominal: bool = False) -> FeasibilityLimit:
    """Return the feasibility limit for limits of field and aperture."""
    values = {one.name: one.reached for one in limits}
    return FeasibilityLimit(
        values.get("field"), values.get("numerical aperture"), nominal=nominal, limits=limits
    )


def _nominal(specification: Specification, goal: str = "thinnest lens") -> Specification:
    """Return the specification with another goal and without constraints on lenses as built."""
    settings = specification.optimize.replaced(goal=goal)
    return specification.without_as_built().model_copy(update={"optimize": settings})


def _best_as_built(specification: Specification, base: Lens, point: Array) -> FeasibilityLimit | None:
    """Return the best values of lenses as built; None if other constraints are violated, too."""
    limits = specification.constraints
    most_evaluations = 3000
    best: dict[str, float] = {}
    for key, goal, limit in (
        ("good", "yield", limits.min_yield),
        ("as_built_rms_waves", "as-built rms", limits.max_as_built_rms_waves),
    ):
        if limit is None:
            continue
        problem = DesignProblem(_nominal(specification, goal), base)
        try:
            found = search_from(problem, point, Budget(most_evaluations), 0, lambda *_: None)
        except UntraceableStartError:
            return None
        if found.outcome.violation > ACCEPTED_VIOLATION:
            return None
        built = problem.predicted(found.outcome.point)
        failing, rms = max(one.failing for one in built), max(float(np.max(one.rms_waves)) for one in built)
        best[key] = 1.0 - failing if key == "good" else rms
    return FeasibilityLimit(good=best.get("good"), as_built_rms_waves=best.get("as_built_rms_waves"))
