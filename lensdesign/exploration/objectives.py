"""Objectives of an exploration: each can be the goal of a search, or a limit of one."""

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
    """An objective of a trade-off.

    Attributes
    ----------
    name
        Name on the command line.
    unit
        Unit; empty for a dimensionless objective.
    goal
        Goal of a search that optimizes the objective; empty for values of the object space and for the cost.
    limit
        Constraint, or key of the object space or of the tolerances, that bounds the objective.
    larger_is_better
        Whether larger values are better (default: False).
    """

    name: str
    unit: str
    goal: str
    limit: str
    larger_is_better: bool = False

    @property
    def column(self) -> str:
        """Name of the table column: name and unit."""
        return f"{self.name}_{self.unit}" if self.unit else self.name

    @property
    def scanned(self) -> bool:
        """True if the objective is an input of a search instead of its goal."""
        return not self.goal

    def as_goal(self, specification: Specification) -> Specification:
        """Return the specification with this objective as its goal."""
        return specification.model_copy(update={"optimize": specification.optimize.replaced(goal=self.goal)})

    def limited(self, specification: Specification, value: float) -> Specification:
        """Return the specification with a bound on this objective."""
        if self.name == "cost":
            assert specification.tolerances is not None  # ensured by axes_of
            tolerances = specification.tolerances.replaced(cost=value, factor=1.0)
            return specification.model_copy(update={"tolerances": tolerances})
        if self.scanned:
            scene = specification.object.replaced(**{self.limit: value})
            return specification.model_copy(update={"object": scene})
        limits = specification.constraints
        if self.name == "spread":
            value = min(value, limits.max_spread_deg) if isinstance(limits.max_spread_deg, float) else value
        return specification.model_copy(update={"constraints": limits.replaced(**{self.limit: value})})


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
    """An objective and the range in which it is varied.

    Attributes
    ----------
    objective
        The objective.
    bounds
        Smallest and largest value in its unit; None: determined by searches.
    """

    objective: Objective
    bounds: tuple[float, float] | None = None


def axes_of(text: str, specification: Specification) -> tuple[Axis, ...]:
    """Return the objectives of a text such as ``thickness,as_built_rms`` or ``field=2:4,thickness``.

    Parameters
    ----------
    text
        Two to four names separated by commas, each optionally with bounds.
    specification
        The specification to explore.

    Returns
    -------
    tuple of Axis
        Objectives that are inputs come first; the last one is the goal of each search.

    Raises
    ------
    InputError
        If a name is not an objective or occurs twice, bounds are invalid, all objectives are inputs, or an
        objective needs tolerances that the specification does not name.

    Examples
    --------
    >>> from lensdesign.exploration import OBJECTIVES
    >>> OBJECTIVES["thickness"].column
    'thickness_mm'
    """
    axes = [_axis(item.strip(), specification) for item in text.split(",")]
    names = [axis.objective.name for axis in axes]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated:
        raise InputError(f"--over {text}: {repeated} is given twice")
    if not 2 <= len(axes) <= 4:
        raise InputError(f"--over {text}: {len(axes)} named; allowed: two to four")
    if all(axis.objective.scanned for axis in axes):
        allowed = ", ".join(name for name, found in OBJECTIVES.items() if not found.scanned)
        raise InputError(f"--over {text}: at least one must be a goal of a search: {allowed}")
    built = any(axis.objective.goal in AS_BUILT_GOALS for axis in axes)
    if "cost" in names and not (built or specification.asks_as_built):
        raise InputError(
            f"--over {text}: cost has no effect without as_built_rms or yield; add one of them, or set "
            "min_yield or max_as_built_rms_waves in the specification"
        )
    if "yield" in names:
        assert specification.tolerances is not None  # ensured by _axis
        read_as_built(specification.tolerances).check_whole_yields()
    # Inputs come first, so that the last objective is a goal.
    return tuple(sorted(axes, key=lambda axis: not axis.objective.scanned))


def _axis(text: str, specification: Specification) -> Axis:
    name, _, given = text.partition("=")
    if name not in OBJECTIVES:
        raise InputError(f"--over: {name!r} is not an objective; allowed: {', '.join(OBJECTIVES)}")
    objective = OBJECTIVES[name]
    if (name == "cost" or objective.goal in AS_BUILT_GOALS) and specification.tolerances is None:
        raise InputError(f"--over: {name} needs tolerances: [tolerances] study in the specification")
    if given:
        try:
            low, high = (float(bound) for bound in given.split(":"))
        except ValueError:
            raise InputError(f"--over {text}: bounds must be two numbers, as in {name}=2:4") from None
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
    """Return the costs of the study's lens with tolerances of twice and of half their width."""
    assert specification.tolerances is not None  # ensured by axes_of
    lens = (study := read_as_built(specification.tolerances)).reference
    elements = len(lens.glass_fronts)
    own = study.cost(lens) - elements
    return elements + 0.5 * own, elements + 2.0 * own


def values_of(
    axes: Sequence[Axis], lens: Lens, problem: DesignProblem, point: np.ndarray, rays: Rays
) -> dict[str, float]:
    """Return the values of the objectives for the finished lens of a point, by column."""
    state = problem.state(point, rays, derivatives=False)
    found = {}
    for axis in axes:
        name = axis.objective.name
        if name == "cost":
            assert problem.specification.tolerances is not None  # ensured by axes_of
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
