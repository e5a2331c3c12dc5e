"""How much of a specification that could not be met can be: field, aperture, lenses as built."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens, ObjectSpace
from lensdesign.optimization.asked.specification import Specification
from lensdesign.optimization.local_search import Budget, search_from
from lensdesign.optimization.problem import DesignProblem
from lensdesign.optimization.rows.row import KEPT

FIRST_STEP = 0.01
"""By which share field or aperture is lowered first; the next steps are twice as large each."""

RESOLUTION = 0.002
"""Share of what was asked to which the largest that can be met is sought."""


@dataclass(frozen=True)
class Reach:
    """What can be met, everything else being as it was asked for; None where nothing was found.

    Attributes
    ----------
    field_diameter_mm
        Largest field at the numerical aperture asked for.
    numerical_aperture
        Largest numerical aperture over the field asked for.
    good
        Largest share of good lenses as built that was predicted, where it is this that was missed.
    as_built_rms_waves
        Smallest root mean square, likewise.
    """

    field_diameter_mm: float | None = None
    numerical_aperture: float | None = None
    good: float | None = None
    as_built_rms_waves: float | None = None

    def in_words(self, asked: ObjectSpace) -> str:
        """What can be met of what was asked, as messages say it."""
        parts = []
        if self.good is not None:
            parts.append(f"a yield of {self.good:.3f}")
        if self.as_built_rms_waves is not None:
            parts.append(f"an as-built rms of {self.as_built_rms_waves:.4f} waves")
        if self.field_diameter_mm is not None:
            parts.append(f"a field of {self.field_diameter_mm:.4g} mm at NA {asked.numerical_aperture:g}")
        if self.numerical_aperture is not None:
            parts.append(f"NA {self.numerical_aperture:.4g} over a field of {asked.field_diameter_mm:g} mm")
        if not parts:
            return "no smaller field or aperture was found that can be met"
        return f"can be met, and no more was found: {', or '.join(parts)}"


def largest_that_can(specification: Specification, base: Lens, point: Array, evaluations: int) -> Reach:
    """Lower the field, and then the aperture, until a search finds a lens that keeps every constraint.

    What is found can be met; beyond it, searches from the nearest lenses found nothing, which is no proof.

    Parameters
    ----------
    specification
        One that could not be met.
    base, point
        The lens with its choice of glasses, and the point of the unit box, that came nearest.
    evaluations
        Most that each of the two may take.
    """
    if specification.as_built is not None:
        found = _best_as_built(specification, base, point, evaluations)
        if found is not None:
            return found
        specification = _nominal(specification)
    shares = [
        _largest_share(specification, base, point, key, evaluations)
        for key in ("field_diameter_mm", "numerical_aperture")
    ]
    field, aperture = shares
    scene = specification.object
    return Reach(
        None if field is None else field * scene.field_diameter_mm,
        None if aperture is None else aperture * scene.numerical_aperture,
    )


def _nominal(specification: Specification, goal: str = "thinnest lens") -> Specification:
    """The specification with another goal, and nothing asked of lenses as built."""
    limits = specification.constraints.replaced(min_yield=None, max_as_built_rms_waves=None)
    settings = specification.optimize.replaced(goal=goal)
    return specification.model_copy(update={"constraints": limits, "optimize": settings})


def _best_as_built(specification: Specification, base: Lens, point: Array, evaluations: int) -> Reach | None:
    """What was missed as built, as good as it gets; None where it is not that alone."""
    asked, best = specification.constraints, {}
    for key, goal, wanted in (
        ("good", "yield", asked.min_yield),
        ("as_built_rms_waves", "as-built rms", asked.max_as_built_rms_waves),
    ):
        if wanted is None:
            continue
        problem = DesignProblem(_nominal(specification, goal), base)
        found = search_from(problem, point, Budget(evaluations), 0, lambda *_: None)
        if found.outcome.violation > KEPT:
            return None
        built = problem.predicted(found.outcome.point)
        failing, rms = max(one.failing for one in built), max(float(np.max(one.rms_waves)) for one in built)
        best[key] = 1.0 - failing if key == "good" else rms
    return Reach(**best) if best else None


def _largest_share(
    specification: Specification, base: Lens, point: Array, key: str, evaluations: int
) -> float | None:
    """The largest share of a value of the object that a lens is found for."""
    budget = Budget(evaluations)
    high, low, near = 1.0, 1.0 - FIRST_STEP, point
    while True:
        met, near = _can(specification, base, near, key, low, budget)
        if met:
            break
        high, low = low, 1.0 - 2.0 * (1.0 - low)
        if low <= 0.0 or budget.used_up:
            return None
    while high - low > RESOLUTION and not budget.used_up:
        middle = 0.5 * (low + high)
        met, found = _can(specification, base, near, key, middle, budget)
        if met:
            low, near = middle, found
        else:
            high = middle
    return low


def _can(
    specification: Specification, base: Lens, start: Array, key: str, share: float, budget: Budget
) -> tuple[bool, Array]:
    """Whether a lens is found from a start, and the point of the unit box to which the search came."""
    value = share * getattr(specification.object, key)
    scene = specification.object.replaced(**{key: value})
    half = 0.5 * scene.field_diameter_mm
    limits = specification.constraints
    kept = tuple(limit for limit in limits.field_spread if limit.field_mm <= half)
    asked = specification.replaced(object=scene, constraints=limits.replaced(field_spread=kept))
    lens = base.replaced(object=scene)
    if key == "numerical_aperture" and specification.optimize.stop == "fixed":
        ratio = math.tan(math.asin(value)) / math.tan(math.asin(specification.object.numerical_aperture))
        semi = ratio * base.stop_semi_diameter_mm
        asked = asked.with_surface(base.stop_index, semi_diameter_mm=semi)
        lens = lens.with_surface(base.stop_index, semi_diameter_mm=semi)
    found = search_from(DesignProblem(asked, lens), start, budget, 0, lambda *_: None, only_feasible=True)
    return found.outcome.violation <= KEPT, found.outcome.point
