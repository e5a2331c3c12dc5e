"""What lenses are weighed by: each a goal of a search, or a limit of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.optimization.as_built import read_as_built
from lensdesign.optimization.problem import DesignProblem, Rays
from lensdesign.optimization.specification.sections import AS_BUILT_GOALS
from lensdesign.optimization.specification.specification import Specification


@dataclass(frozen=True)
class Objective:
    """One thing that a trade-off weighs.

    Attributes
    ----------
    name
        As the command takes it; its column with the unit.
    unit
    larger_is_better
    goal
        By which a search makes it as good as can be; empty where it is a value of the object, or the cost.
    limit
        Constraint, or value of the object or of the tolerances, that holds it.
    """

    name: str
    unit: str
    goal: str
    limit: str
    larger_is_better: bool = False

    @property
    def column(self) -> str:
        """Name with the unit."""
        return f"{self.name}_{self.unit}" if self.unit else self.name

    @property
    def scanned(self) -> bool:
        """Whether it is given to a search rather than sought by it."""
        return not self.goal

    def sought(self, specification: Specification) -> Specification:
        """The specification with this as its goal."""
        return specification.model_copy(update={"optimize": specification.optimize.replaced(goal=self.goal)})

    def limited(self, specification: Specification, value: float) -> Specification:
        """The specification that allows it no worse a value."""
        if self.name == "cost":
            assert specification.tolerances is not None  # the axis asked for them
            tolerances = specification.tolerances.replaced(cost=value, factor=1.0)
            return specification.model_copy(update={"tolerances": tolerances})
        if self.scanned:
            scene = specification.object.replaced(**{self.limit: value})
            return specification.model_copy(update={"object": scene})
        limits = specification.constraints
        if self.name == "spread":
            value = min(value, limits.max_spread_deg) if isinstance(limits.max_spread_deg, float) else value
        return specification.model_copy(update={"constraints": limits.replaced(**{self.limit: value})})

    def better(self, one: float, other: float) -> bool:
        """Whether one value is better than another."""
        return one > other if self.larger_is_better else one < other


OBJECTIVES = {
    found.name: found
    for found in (
        Objective("thickness", "mm", "thinnest lens", "max_lens_thickness_mm"),
        Objective("track", "mm", "shortest track", "max_track_mm"),
        Objective("semi_diameter", "mm", "smallest aperture", "max_semi_diameter_mm"),
        Objective("spread", "deg", "smallest spread angle", "max_spread_deg"),
        Objective("as_built_rms", "waves", "as-built rms", "max_as_built_rms_waves"),
        Objective("yield", "", "yield", "min_yield", larger_is_better=True),
        Objective("field", "mm", "", "field_diameter_mm", larger_is_better=True),
        Objective("na", "", "", "numerical_aperture", larger_is_better=True),
        Objective("cost", "", "", "cost"),
    )
}


@dataclass(frozen=True)
class Axis:
    """An objective, and between which values it is varied.

    Attributes
    ----------
    objective
    bounds
        In its unit; None for those that the searches themselves find.
    """

    objective: Objective
    bounds: tuple[float, float] | None = None


def axes_of(text: str, specification: Specification) -> tuple[Axis, ...]:
    """Read ``thickness,as_built_rms`` or ``field=2:4,thickness``.

    Raises
    ------
    InputError
        For what is no objective, stands twice, has no bounds although it needs them, or asks for tolerances
        that the specification does not name.
    """
    axes = [_axis(part.strip(), specification) for part in text.split(",")]
    names = [axis.objective.name for axis in axes]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated:
        raise InputError(f"--over {text}: {repeated} stands twice")
    if not 2 <= len(axes) <= 4:
        raise InputError(f"--over {text}: {len(axes)} named; allowed: two to four")
    if all(axis.objective.scanned for axis in axes):
        allowed = ", ".join(name for name, found in OBJECTIVES.items() if not found.scanned)
        raise InputError(f"--over {text}: at least one must be sought: {allowed}")
    built = any(axis.objective.goal in AS_BUILT_GOALS for axis in axes)
    if "cost" in names and not (built or specification.asks_as_built):
        raise InputError(
            f"--over {text}: cost changes nothing without as_built_rms or yield; weigh one of them, or ask "
            "for min_yield or max_as_built_rms_waves"
        )
    # What is given stands first; what is sought last of all is the goal of each search.
    return tuple(sorted(axes, key=lambda axis: not axis.objective.scanned))


def _axis(text: str, specification: Specification) -> Axis:
    name, _, given = text.partition("=")
    if name not in OBJECTIVES:
        raise InputError(f"--over: {name!r} is no objective; allowed: {', '.join(OBJECTIVES)}")
    objective = OBJECTIVES[name]
    if (name == "cost" or objective.goal in AS_BUILT_GOALS) and specification.tolerances is None:
        raise InputError(f"--over: {name} needs tolerances: [tolerances] study in the specification")
    if given:
        try:
            low, high = (float(part) for part in given.split(":"))
        except ValueError:
            raise InputError(f"--over {text}: bounds are two numbers, as in {name}=2:4") from None
        if not 0.0 < low < high < np.inf:
            raise InputError(f"--over {text}: bounds must be above 0, the smaller first")
        return Axis(objective, (low, high))
    if name == "cost":
        return Axis(objective, _costs_about(specification))
    if objective.scanned:
        value = getattr(specification.object, objective.limit)
        return Axis(objective, (0.7 * value, value))
    return Axis(objective)


def _costs_about(specification: Specification) -> tuple[float, float]:
    """What the study's tolerances cost on its lens when they are twice as wide, and half as wide."""
    assert specification.tolerances is not None  # the axis asked for them
    lens = (study := read_as_built(specification.tolerances)).reference
    elements = len(lens.glass_fronts)
    own = study.cost(lens) - elements
    return elements + 0.5 * own, elements + 2.0 * own


def values_of(
    axes: Sequence[Axis], lens: Lens, problem: DesignProblem, point: np.ndarray, rays: Rays
) -> dict[str, float]:
    """What the finished lens of a point is worth by each objective, in the units of their columns."""
    state = problem.state(point, rays, derivatives=False)
    found = {}
    for axis in axes:
        name = axis.objective.name
        if name == "cost":
            assert problem.specification.tolerances is not None  # the axis asked for them
            value = read_as_built(problem.specification.tolerances).cost(lens)
        elif axis.objective.scanned:
            value = getattr(lens.object, axis.objective.limit)
        elif name == "thickness":
            value = lens.exit_vertex_z_mm
        elif name == "track":
            value = lens.track_mm
        elif name == "semi_diameter":
            value = max(s.semi_diameter_mm or 0.0 for s in lens.surfaces)
        elif name == "spread":
            sines = [np.max(np.linalg.norm(t.cosines[t.ok], axis=-1)) for s in state.all for t in s.traces]
            value = float(np.degrees(np.arcsin(max(sines))))
        else:
            built = problem.predicted(point, lens)
            rms, failing = (max(np.max(b.rms_waves) for b in built), max(b.failing for b in built))
            value = rms if name == "as_built_rms" else 1.0 - failing
        found[axis.objective.column] = float(value)
    return found
