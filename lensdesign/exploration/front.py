"""Pareto fronts: lenses that no other lens improves in one objective without being worse in another.

The fronts are computed by the epsilon-constraint method (Haimes, Lasdon and Wismer, IEEE Trans. SMC 1, 296,
1971): each search optimizes one objective while constraints bound the others. It starts from the nearest lens
that is known.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError
from lensdesign.exploration.objectives import Axis, Objective, values_of
from lensdesign.lens.lens import Lens
from lensdesign.optimization.local_search import (
    Budget,
    SearchResult,
    UntraceableStartError,
    search_from,
    starts_of,
)
from lensdesign.optimization.operands.operand import ACCEPTED_VIOLATION
from lensdesign.optimization.problem import DesignProblem, finished_lens
from lensdesign.optimization.specification.choices import bases_of
from lensdesign.optimization.specification.specification import Specification

MAX_GLASSES = 6
"""Largest number of glass choices that are explored; a first screening selects them from more choices."""


@dataclass(frozen=True, eq=False)
class ExploredPoint:
    """Result of one search of an exploration.

    Attributes
    ----------
    key : str
        Description of the search: glasses, and the bound of each objective.
    glasses : str
        Glasses of the elements.
    values : dict
        Values of the objectives by column; empty if no lens was found.
    point : tuple of float
        Variables of the lens, normalized to the unit box.
    lens : Lens or None
        The lens; None if no lens was found that meets every constraint.
    """

    key: str
    glasses: str
    values: dict[str, float]
    point: tuple[float, ...]
    lens: Lens | None


@dataclass(frozen=True, eq=False)
class Exploration:
    """Exploration of the trade-off between the objectives of a specification.

    Attributes
    ----------
    specification
        Requirements and variables of the lens.
    axes : tuple of Axis
        Objectives; the last one is the goal of each search, the others are bounded.
    lenses : int
        Approximate number of searches for each choice of glasses (default: 50).
    known : dict
        Results of earlier searches by key, which are not repeated (default: none).
    on_result
        Called with each new result.
    progress
        Progress callback: ``progress(completed, total, description)``.
    """

    specification: Specification
    axes: tuple[Axis, ...]
    lenses: int = 50
    known: dict[str, ExploredPoint] = field(default_factory=dict)
    on_result: Callable[[ExploredPoint], None] = lambda _: None
    progress: Callable[[int, int, str], None] = lambda *_: None

    def __post_init__(self) -> None:
        # A search for another objective would only reduce a variable field to its smallest diameter.
        object.__setattr__(self, "specification", self.specification.with_fixed_field())

    def run(self) -> list[ExploredPoint]:
        """Run all searches and return their results, ordered by the choice of glasses.

        Raises
        ------
        DesignError
            If no lens meets the specification with any choice of glasses.
        """
        results: list[ExploredPoint] = []
        bases = list(bases_of(self.specification))
        if len(bases) > MAX_GLASSES:
            bases = self._screen_glasses(bases)
        counts = self._counts()
        each = math.prod(counts) + len(self._searched_axes)
        for index, (glasses, base) in enumerate(bases):
            results += self._explore_glasses(glasses, base, counts, index * each, len(bases) * each)
        if not any(result.lens is not None for result in results):
            raise DesignError(
                "no lens meets the specification: widen the bounds of its variables or its limits"
            )
        return results

    def _screen_glasses(self, bases: list[tuple[str, Lens]]) -> list[tuple[str, Lens]]:
        """Return the glass choices with the best lenses by single objectives, after one start each."""
        ends: list[ExploredPoint] = []
        for index, (glasses, base) in enumerate(bases):
            for axis in self._searched_axes:
                self.progress(index, len(bases), f"{glasses}: best {axis.objective.name}, from one start")
                ends.append(self._anchor(glasses, base, axis.objective, 1))
        names = list(dict.fromkeys(result.glasses for result in front_of(ends, self.axes)))
        goal = self.axes[-1].objective
        lenses = [result for result in ends if result.lens is not None]
        lenses.sort(key=lambda result: result.values[goal.column], reverse=goal.larger_is_better)
        names += [result.glasses for result in lenses if result.glasses not in names]
        kept = list(dict.fromkeys(names))[:MAX_GLASSES]
        return [(glasses, base) for glasses, base in bases if glasses in kept]

    @property
    def _searched_axes(self) -> list[Axis]:
        return [axis for axis in self.axes if not axis.objective.scanned]

    def _counts(self) -> tuple[int, ...]:
        """Return the number of bounds for each objective but the last."""
        bounded = len(self.axes) - 1
        count = max(2, round(self.lenses ** (1.0 / bounded)))
        return (count,) * bounded

    def _explore_glasses(
        self, glasses: str, base: Lens, counts: tuple[int, ...], done: int, total: int
    ) -> list[ExploredPoint]:
        results: list[ExploredPoint] = []
        goal = self.axes[-1].objective
        for axis in self._searched_axes:
            self.progress(done + len(results), total, f"{glasses}: best {axis.objective.name}")
            results.append(self._anchor(glasses, base, axis.objective))
        if any(result.lens is None for result in results):
            return results
        for node in itertools.product(*self._grids(results, counts)):
            limits = list(zip((axis.objective for axis in self.axes[:-1]), node, strict=True))
            self.progress(done + len(results), total, f"{glasses}: {_limit_text(limits)}")
            results.append(self._node(glasses, base, goal, limits, results))
        return results

    def _grids(self, anchors: list[ExploredPoint], counts: tuple[int, ...]) -> Iterator[Array]:
        """Yield the bounds of each objective but the last: from its best value to the best of the others."""
        for axis, count in zip(self.axes[:-1], counts, strict=True):
            column = axis.objective.column
            if axis.bounds is not None:
                low, high = axis.bounds
            else:
                values = [result.values[column] for result in anchors]
                low, high = min(values), max(values)
            yield np.linspace(low, high, count)

    def _anchor(self, glasses: str, base: Lens, objective: Objective, max_starts: int = 3) -> ExploredPoint:
        """Search for the best lens by one objective without bounds on the others."""
        key = f"{glasses}; best {objective.name}" + (" from one start" if max_starts == 1 else "")
        specification = objective.as_goal(self.specification)
        problem = DesignProblem(specification, _with_object(base, specification))
        starts = itertools.islice(starts_of(problem, 0), max_starts)
        return self._search(key, glasses, problem, list(starts))

    def _node(
        self,
        glasses: str,
        base: Lens,
        goal: Objective,
        limits: Sequence[tuple[Objective, float]],
        results: list[ExploredPoint],
    ) -> ExploredPoint:
        """Search for the best lens by the goal within limits, starting from the nearest known lens."""
        specification = goal.as_goal(self.specification)
        for objective, value in limits:
            specification = objective.limited(specification, value)
        problem = DesignProblem(specification, _with_object(base, specification))

        def distance(result: ExploredPoint) -> float:
            return sum(abs(result.values[o.column] / value - 1.0) for o, value in limits)

        nearest = sorted((result for result in results if result.lens is not None), key=distance)
        starts = [np.array(result.point) for result in nearest[:1]]
        # If the nearest lens fails, the best lenses by single objectives may lead to a solution.
        starts += [
            np.array(result.point)
            for result in results[: len(self._searched_axes)]
            if result is not nearest[0]
        ]
        return self._search(f"{glasses}; {_limit_text(limits)}", glasses, problem, starts, sufficient=1)

    def _search(
        self, key: str, glasses: str, problem: DesignProblem, starts: list[Array], sufficient: int = 0
    ) -> ExploredPoint:
        """Search from all starts, or until `sufficient` of them meet every constraint; return the best."""
        if key in self.known:
            return self.known[key]
        best: SearchResult | None = None
        feasible = 0
        for start in starts:
            budget = Budget(problem.specification.optimize.max_evaluations)
            try:
                result = search_from(problem, start, budget, 0, lambda *_: None)
            except UntraceableStartError:
                continue
            if best is None or result.rank < best.rank:
                best = result
            feasible += result.outcome.violation <= ACCEPTED_VIOLATION
            if sufficient and feasible >= sufficient:
                break
        explored = self._point_of(key, glasses, best)
        self.on_result(explored)
        return explored

    def _point_of(self, key: str, glasses: str, best: SearchResult | None) -> ExploredPoint:
        if best is None or best.outcome.violation > ACCEPTED_VIOLATION:
            return ExploredPoint(key, glasses, {}, (), None)
        point = best.outcome.point
        try:
            lens = finished_lens(best.problem, point, best.rays)
            values = values_of(self.axes, lens, best.problem, point, best.rays)
        except DesignError:
            return ExploredPoint(key, glasses, {}, (), None)
        return ExploredPoint(key, glasses, values, tuple(point.tolist()), lens)


def front_of(explored: Sequence[ExploredPoint], axes: Sequence[Axis]) -> list[ExploredPoint]:
    """Return the non-dominated lenses: no other lens is better in one objective and not worse in any.

    Parameters
    ----------
    explored
        Results of searches.
    axes
        Objectives.

    Returns
    -------
    list of ExploredPoint
        Lenses of the front, ordered by the first objective.
    """
    lenses = [result for result in explored if result.lens is not None]
    if not lenses:
        return []
    signs = np.array([-1.0 if axis.objective.larger_is_better else 1.0 for axis in axes])
    costs = signs * np.array([[result.values[axis.objective.column] for axis in axes] for result in lenses])
    ranges = np.ptp(costs, axis=0)
    # Smallest improvement of an objective, as a fraction of its range, that counts as an improvement.
    min_improvement = 2e-3
    slack = min_improvement * np.where(ranges > 0.0, ranges, 1.0)
    kept: list[int] = []
    for i in np.lexsort(costs.T[::-1]):
        others = costs[kept] if kept else np.empty((0, len(axes)))
        dominated = np.any(np.all(others <= costs[i] + slack, axis=1))
        if not dominated:
            kept.append(int(i))
    return [lenses[i] for i in kept]


def _with_object(base: Lens, specification: Specification) -> Lens:
    """Return the lens with the object space of the specification; a stop may depend on its aperture."""
    return base.model_copy(update={"object": specification.object})


def _limit_text(limits: Sequence[tuple[Objective, float]]) -> str:
    return ", ".join(f"{objective.name} {value:.6g}".strip() for objective, value in limits)
