"""Fronts: lenses of which none is better than another in everything.

Each is the end of a search that makes one objective as good as can be while the others are held no worse than
some value (the epsilon-constraint method: Haimes, Lasdon and Wismer, IEEE Trans. SMC 1, 296, 1971), started
from the nearest lens that is known.
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
from lensdesign.optimization.local_search import Budget, Found, search_from, starts_of
from lensdesign.optimization.operands.operand import KEPT
from lensdesign.optimization.problem import DesignProblem, finished_lens
from lensdesign.optimization.specification.choices import bases_of
from lensdesign.optimization.specification.specification import Specification

ANCHOR_STARTS = 3
"""From which the best lens by one objective alone is sought."""

MOST_GLASSES = 6
"""Choices of glasses that are explored; of more, those are that hold the best lenses by single objectives."""

ALIKE = 2e-3
"""Share of an objective's range by which a lens must be better to count as better."""

Keep = Callable[["ExploredPoint"], None]


@dataclass(frozen=True, eq=False)
class ExploredPoint:
    """One search's end.

    Attributes
    ----------
    key : str
        What was asked: glasses, and the value that each objective was held to.
    glasses : str
    values : dict
        By the objectives' columns; empty where no lens was found.
    point : tuple of float
        Of the unit box.
    lens : Lens or None
        The lens; None where none was found that keeps every constraint.
    """

    key: str
    glasses: str
    values: dict[str, float]
    point: tuple[float, ...]
    lens: Lens | None


@dataclass(frozen=True, eq=False)
class Exploration:
    """A specification that is explored.

    Attributes
    ----------
    specification
    axes : tuple of Axis
        What is weighed; the last one is each search's goal.
    lenses : int
        How many searches are made, about, for each choice of glasses.
    known : dict
        Ends of searches that were made before, by their keys.
    keep
        Given each new end.
    report
        Told how many searches are done, of how many, and what is sought.
    """

    specification: Specification
    axes: tuple[Axis, ...]
    lenses: int = 50
    known: dict[str, ExploredPoint] = field(default_factory=dict)
    keep: Keep = lambda _: None
    report: Callable[[int, int, str], None] = lambda *_: None

    def run(self) -> list[ExploredPoint]:
        """All ends, choice of glasses by choice of glasses.

        Raises
        ------
        DesignError
            If no lens meets the specification with any choice of glasses.
        """
        found: list[ExploredPoint] = []
        bases = list(bases_of(self.specification))
        if len(bases) > MOST_GLASSES:
            bases = self._screened(bases)
        counts = self._counts()
        each = math.prod(counts) + len(self._sought)
        for number, (glasses, base) in enumerate(bases):
            found += self._of_glasses(glasses, base, counts, number * each, len(bases) * each)
        if not any(one.lens is not None for one in found):
            raise DesignError("no lens was found that meets the specification: widen its bounds or limits")
        return found

    def _screened(self, bases: list[tuple[str, Lens]]) -> list[tuple[str, Lens]]:
        """The choices of glasses with the best lenses by single objectives, each sought from one start."""
        ends: list[ExploredPoint] = []
        for number, (glasses, base) in enumerate(bases):
            for axis in self._sought:
                self.report(number, len(bases), f"{glasses}: best {axis.objective.name}, from one start")
                ends.append(self._anchor(glasses, base, axis.objective, 1))
        names = list(dict.fromkeys(one.glasses for one in front_of(ends, self.axes)))
        goal = self.axes[-1].objective
        lenses = [one for one in ends if one.lens is not None]
        lenses.sort(key=lambda one: one.values[goal.column], reverse=goal.larger_is_better)
        names += [one.glasses for one in lenses if one.glasses not in names]
        kept = list(dict.fromkeys(names))[:MOST_GLASSES]
        return [(glasses, base) for glasses, base in bases if glasses in kept]

    @property
    def _sought(self) -> list[Axis]:
        return [axis for axis in self.axes if not axis.objective.scanned]

    def _counts(self) -> tuple[int, ...]:
        """Values that each objective but the last is held to."""
        held = len(self.axes) - 1
        count = max(2, round(self.lenses ** (1.0 / held)))
        return (count,) * held

    def _of_glasses(
        self, glasses: str, base: Lens, counts: tuple[int, ...], done: int, total: int
    ) -> list[ExploredPoint]:
        found: list[ExploredPoint] = []
        goal = self.axes[-1].objective
        for axis in self._sought:
            self.report(done + len(found), total, f"{glasses}: best {axis.objective.name}")
            found.append(self._anchor(glasses, base, axis.objective))
        if any(one.lens is None for one in found):
            return found
        for node in itertools.product(*self._grids(found, counts)):
            held = list(zip((axis.objective for axis in self.axes[:-1]), node, strict=True))
            self.report(done + len(found), total, f"{glasses}: {_words(held)}")
            found.append(self._node(glasses, base, goal, held, found))
        return found

    def _grids(self, anchors: list[ExploredPoint], counts: tuple[int, ...]) -> Iterator[Array]:
        """Values that each objective but the last is held to: from its best to where others are best."""
        for axis, count in zip(self.axes[:-1], counts, strict=True):
            column = axis.objective.column
            if axis.bounds is not None:
                low, high = axis.bounds
            else:
                values = [one.values[column] for one in anchors]
                low, high = min(values), max(values)
            yield np.linspace(low, high, count)

    def _anchor(
        self, glasses: str, base: Lens, objective: Objective, most: int = ANCHOR_STARTS
    ) -> ExploredPoint:
        """The best lens by one objective alone, whatever the others are."""
        key = f"{glasses}; best {objective.name}" + (" from one start" if most == 1 else "")
        asked = objective.sought(self.specification)
        problem = DesignProblem(asked, _of(base, asked))
        starts = itertools.islice(starts_of(problem, 0), most)
        return self._found(key, glasses, problem, list(starts))

    def _node(
        self,
        glasses: str,
        base: Lens,
        goal: Objective,
        held: Sequence[tuple[Objective, float]],
        found: list[ExploredPoint],
    ) -> ExploredPoint:
        """The best lens by the goal with the others held; from the nearest that is known."""
        asked = goal.sought(self.specification)
        for objective, value in held:
            asked = objective.limited(asked, value)
        problem = DesignProblem(asked, _of(base, asked))

        def distance(one: ExploredPoint) -> float:
            return sum(abs(one.values[o.column] / value - 1.0) for o, value in held)

        near = sorted((one for one in found if one.lens is not None), key=distance)
        starts = [np.array(one.point) for one in near[:1]]
        # Where the nearest leads to nothing, the best by what is held most tightly may.
        starts += [np.array(one.point) for one in found[: len(self._sought)] if one is not near[0]]
        return self._found(f"{glasses}; {_words(held)}", glasses, problem, starts, enough=1)

    def _found(
        self, key: str, glasses: str, problem: DesignProblem, starts: list[Array], enough: int = 0
    ) -> ExploredPoint:
        """The best end of some starts, or of the first of them that meets every constraint."""
        if key in self.known:
            return self.known[key]
        best: Found | None = None
        met = 0
        for start in starts:
            budget = Budget(problem.specification.optimize.max_evaluations)
            one = search_from(problem, start, budget, 0, lambda *_: None)
            if best is None or one.rank < best.rank:
                best = one
            met += one.outcome.violation <= KEPT
            if enough and met >= enough:
                break
        explored = self._explored(key, glasses, best)
        self.keep(explored)
        return explored

    def _explored(self, key: str, glasses: str, best: Found | None) -> ExploredPoint:
        if best is None or best.outcome.violation > KEPT:
            return ExploredPoint(key, glasses, {}, (), None)
        point = best.outcome.point
        try:
            lens = finished_lens(best.problem, point, best.rays)
            values = values_of(self.axes, lens, best.problem, point, best.rays)
        except DesignError:
            return ExploredPoint(key, glasses, {}, (), None)
        return ExploredPoint(key, glasses, values, tuple(point.tolist()), lens)


def front_of(explored: Sequence[ExploredPoint], axes: Sequence[Axis]) -> list[ExploredPoint]:
    """Of all lenses those that no other is better than in one objective, and no worse in any.

    Returns
    -------
    list of Explored
        By the first objective.
    """
    lenses = [one for one in explored if one.lens is not None]
    if not lenses:
        return []
    signs = np.array([-1.0 if axis.objective.larger_is_better else 1.0 for axis in axes])
    costs = signs * np.array([[one.values[axis.objective.column] for axis in axes] for one in lenses])
    ranges = np.ptp(costs, axis=0)
    slack = ALIKE * np.where(ranges > 0.0, ranges, 1.0)
    kept: list[int] = []
    for i in np.lexsort(costs.T[::-1]):
        others = costs[kept] if kept else np.empty((0, len(axes)))
        dominated = np.any(np.all(others <= costs[i] + slack, axis=1))
        if not dominated:
            kept.append(int(i))
    return [lenses[i] for i in kept]


def _of(base: Lens, asked: Specification) -> Lens:
    """The lens with the object that is asked about; a stop that follows the aperture does so by itself."""
    return base.model_copy(update={"object": asked.object})


def _words(held: Sequence[tuple[Objective, float]]) -> str:
    return ", ".join(f"{objective.name} {value:.6g}".strip() for objective, value in held)
