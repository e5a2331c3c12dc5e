"""The largest field, aperture, pixel and tolerances for which a lens is found.

Of one value of a specification the largest is sought for which a lens keeps every constraint. Fresh starts
find a lens for some smaller value. From lens to lens the value is raised, each search starting from the lens
before (continuation), until it cannot be raised further. Then independent starts find other lenses for four
fifths of the value, and from these for a value just above. If one is found, the value is raised from there.
If none is, this is the limit: confirmed by those starts, which is no proof. Lenses of two elements have
several families with limits of their own, the best of which one start in fifteen may lead to; the number of
starts grows with the number of variables.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.deadlines import OutOfTime, no_deadline
from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens
from lensdesign.optimization.compliance import check_against
from lensdesign.optimization.limits.kinds import Kind, kinds_of
from lensdesign.optimization.local_search import Budget, Found, dense_rays, search_from, starts_of
from lensdesign.optimization.operands.operand import KEPT
from lensdesign.optimization.problem import DesignProblem, Rays, finished_lens
from lensdesign.optimization.specification.choices import bases_of
from lensdesign.optimization.specification.sections import AS_BUILT_GOALS
from lensdesign.optimization.specification.specification import Specification, validate_possible

RESOLUTION = 5e-4
"""Relative step to which a limit is found."""

FIRST_STEP = 0.02
"""Relative step by which a value is raised first; it is doubled after each lens that is found."""

SHARES = (0.75, 0.5, 0.3, 0.15, 0.07, 0.03, 0.01)
"""Fractions of the value asked at which fresh starts look for a first lens."""

FRESH_STARTS = 6
"""Fresh starts at each of these."""

EASIER = 0.8
"""Fraction of the largest value at which independent starts find a lens before they look just above it."""

FEWEST_STARTS, MOST_STARTS, STARTS_OF_OTHERS = 12, 64, 6
"""Independent starts with the best choice of glasses: for up to four variables, at most, and of each other
choice; each variable more than four adds as many as the four together."""

NEARBY_STARTS, NEARBY = 3, (0.03, 0.1, 0.2)
"""Starts near the last lens, for each variable; their distances in turn, in ranges of the variables."""

MOST_SEARCHES = 10
"""Evaluations of a limit, over those of a search for one lens."""

EVALUATIONS = 1500
"""Most evaluations of one search."""

MOST_VERIFIED = 12
"""Lenses that are checked at most, from the largest value down, until one passes."""

MOST = 4.0
"""Multiple of the value asked beyond which no limit is sought."""

BINDING = 2e-3
"""Constraints within this of their limit, scaled, bind at a limit."""

Report = Callable[[str], None]


@dataclass(frozen=True)
class Limit:
    """The largest value of one kind for which a lens was found, everything else as asked.

    Attributes
    ----------
    name, unit
        What is meant, and its unit.
    asked
        Value in the specification; 1 for tolerances, which are multiplied.
    reached
        Largest value for which a lens was found that passes the check; None where none was found.
    ended
        Whether larger values were tried and not met. False where the search ended at the largest multiple
        of the value asked that it tries, or at the value asked itself.
    starts
        Independent starts, none of which found a lens above `reached`; where `reached` is None, starts at all
        values that were tried.
    binding
        Constraints and bounds that are reached there.
    cut
        What stopped the search before it was confirmed: ``max_evaluations``, ``max_seconds`` or
        ``interrupt``; empty where nothing did.
    lens
        The lens at `reached`.
    """

    name: str
    unit: str
    asked: float
    reached: float | None
    ended: bool
    starts: int = 0
    binding: tuple[str, ...] = ()
    cut: str = ""
    lens: Lens | None = None

    def as_dict(self) -> dict[str, object]:
        """Return the values as plain data, without the lens."""
        return {k: v for k, v in vars(self).items() if k != "lens"} | {"binding": list(self.binding)}

    @property
    def confidence(self) -> str:
        """How sure the limit is, in words."""
        if self.cut:
            return f"not confirmed: {self.cut} stopped the search"
        if self.reached is None:
            return f"{self.starts} starts found no lens down to {SHARES[-1]:g} times what is asked, not proof"
        if not self.ended:
            return "no larger value was tried"
        return f"{self.starts} independent starts found no lens above it, not proof"


class LimitsInterrupted(KeyboardInterrupt):
    """An interrupt of a search for limits.

    Attributes
    ----------
    limits
        What was found so far; the last may be unconfirmed.
    """

    def __init__(self, limits: tuple[Limit, ...]) -> None:
        super().__init__("interrupted")
        self.limits = limits


def find_limits(
    specification: Specification,
    report: Report = lambda _: None,
    seed: int = 0,
    kinds: Sequence[Kind] | None = None,
    near: Mapping[str, Array] | None = None,
    most: float = MOST,
) -> tuple[Limit, ...]:
    """Find the largest field, aperture, pixel pitch and, where a yield is asked for, tolerances.

    A deadline (:func:`lensdesign.common.deadlines.deadline`) stops the search; what it found by then is
    returned, marked as not confirmed. Yields are those that are predicted; no trials are made.

    Parameters
    ----------
    specification
        What is asked. Its goal does not matter.
    report
        Called with a line of text at each step.
    seed
        For the random starts.
    kinds
        Which limits are sought; default: those of :func:`kinds_of`.
    near
        A point of the unit box for some choices of glasses, by their names; a search may start there, too.
    most
        Multiple of the value asked beyond which no limit is sought.

    Returns
    -------
    tuple of Limit
        One for each kind.

    Raises
    ------
    LimitsInterrupted
        If it is interrupted.
    """
    specification = _without_as_built_goal(specification)
    limits: list[Limit] = []
    known = [*(near or {}).items()]
    for kind in kinds_of(specification) if kinds is None else kinds:
        search = _LimitSearch(specification, kind, seed, report, known, most)
        limits.append(search.run())
        if limits[-1].cut == "interrupt":
            raise LimitsInterrupted(tuple(limits))
        known += [(end.glasses, end.point) for end in search.as_asked]
    return tuple(limits)


def _confirming_starts(variables: int) -> int:
    """How many independent starts confirm a limit with one choice of glasses."""
    return min(max(variables - 3, 1) * FEWEST_STARTS, MOST_STARTS)


def _without_as_built_goal(specification: Specification) -> Specification:
    """With another goal in place of one of lenses as built, whose predictions take most of the time."""
    if specification.optimize.goal not in AS_BUILT_GOALS:
        return specification
    settings = specification.optimize.replaced(goal="thinnest lens")
    return specification.model_copy(update={"optimize": settings})


@dataclass(frozen=True, eq=False)
class _End:
    """A lens that keeps every constraint: a point of the unit box of one choice of glasses."""

    value: float
    glasses: str
    point: Array


class _BudgetSpent(Exception):
    """The evaluations of the specification are used up."""


@dataclass
class _LimitSearch:
    """The search for one limit; `best` is the lens with the largest value so far."""

    specification: Specification
    kind: Kind
    seed: int
    report: Report
    near: Sequence[tuple[str, Array]]
    most: float
    best: _End | None = None
    as_asked: list[_End] = field(default_factory=list)
    ends: list[_End] = field(default_factory=list)
    failed: int = 0
    starts: int = 0

    def __post_init__(self) -> None:
        self.asked = self.kind.asked(self.specification)
        choices = sum(1 for _ in bases_of(self.specification))
        self.names = [glasses for glasses, _ in bases_of(self.specification)]
        self.budget = Budget(MOST_SEARCHES * choices * self.specification.optimize.max_evaluations)
        self.seeds = itertools.count(self.seed * 1_000_003)

    def run(self) -> Limit:
        """Find the limit, or what can be said of it until something stops the search."""
        cut = ""
        try:
            self._first()
            while self.best is not None and self.best.value < self.most * self.asked:
                self._climb()
                if not self._confirm():
                    break
        except KeyboardInterrupt:
            cut = "interrupt"
        except OutOfTime:
            cut = "max_seconds"
        except _BudgetSpent:
            cut = "max_evaluations"
        with no_deadline():
            return self._limit(cut)

    def _limit(self, cut: str) -> Limit:
        kind, found = self.kind, None
        for end in sorted(self.ends, key=lambda one: -one.value)[:MOST_VERIFIED]:
            found = self._verified(end)
            if found is not None:
                break
        if found is None:
            return Limit(kind.name, kind.unit, self.asked, None, True, self.failed, (), cut)
        value, lens, binding = found
        ended = value < self.most * self.asked * (1.0 - 1e-12)
        return Limit(kind.name, kind.unit, self.asked, value, ended, self.starts, binding, cut, lens)

    def _first(self) -> None:
        """A first lens: as asked, or for less; from what is known, and from fresh starts."""
        shares = SHARES if self.most <= 1.0 else (1.0, *SHARES)
        for share in shares:
            value = share * self.asked
            for glasses in self.names:
                near = [point for name, point in self.near if name == glasses]
                for point in itertools.chain(near, self._fresh(value, glasses, FRESH_STARTS)):
                    if self._can(value, glasses, point):
                        break
            if self.best is not None:
                return

    def _climb(self) -> None:
        """Raise the value from lens to lens as far as the search from the last one finds another."""
        end = self.best
        assert end is not None  # there is a first lens
        step, failed_at, top = FIRST_STEP, math.inf, self.most * self.asked
        while end.value < top and failed_at - end.value > RESOLUTION * end.value:
            value = min(end.value * (1.0 + step), top)
            if math.isfinite(failed_at):
                value = 0.5 * (end.value + failed_at)
            if self._can(value, end.glasses, end.point):
                assert self.best is not None  # it was found just now
                end, step = self.best, 2.0 * step
            else:
                failed_at = value

    def _confirm(self) -> bool:
        """Whether independent starts get further than the best lens."""
        end = self.best
        assert end is not None  # it was raised before
        self.starts = 0
        value = end.value * (1.0 + 2.0 * RESOLUTION)
        if value > self.most * self.asked:
            return False
        rng = np.random.default_rng(next(self.seeds))
        for number in range(NEARBY_STARTS * len(end.point)):
            away = NEARBY[number % len(NEARBY)] * rng.standard_normal(len(end.point))
            point = np.clip(end.point + away, 0.0, 1.0)
            if self._can(value, end.glasses, point):
                return True
        for glasses in sorted(self.names, key=lambda name: name != end.glasses):
            count = _confirming_starts(len(end.point)) if glasses == end.glasses else STARTS_OF_OTHERS
            for point in self._fresh(EASIER * end.value, glasses, count):
                self.starts += 1
                easier = self._search(EASIER * end.value, glasses, point)
                if easier is None or easier.outcome.violation > KEPT:
                    continue
                if self._can(value, glasses, easier.outcome.point):
                    return True
        return False

    def _can(self, value: float, glasses: str, point: Array) -> bool:
        """Whether a search from a point finds a lens for a value; it then is the best."""
        self.report(f"{self.kind.name}: {value:.4g} {self.kind.unit}".rstrip() + f", {glasses}")
        found = self._search(value, glasses, point)
        if found is None or found.outcome.violation > KEPT:
            self.failed += 1
            return False
        end = _End(value, glasses, found.outcome.point)
        if value == self.asked:
            self.as_asked.append(end)
        if self.best is None or value > self.best.value:
            self.best = end
        self.ends.append(end)
        return True

    def _search(self, value: float, glasses: str, point: Array) -> Found | None:
        """The end of a search for any lens; None where no lens can be asked for such a value."""
        problem = self._problem(value, glasses)
        if problem is None:
            return None
        if self.budget.used_up:
            raise _BudgetSpent
        budget = Budget(min(EVALUATIONS, self.budget.evaluations))
        found = search_from(problem, point, budget, next(self.seeds), lambda *_: None, only_feasible=True)
        self.budget.spend(budget.spent)
        return found

    def _fresh(self, value: float, glasses: str, count: int) -> Iterator[Array]:
        """Random starts, after the specification's own."""
        problem = self._problem(value, glasses)
        if problem is None:
            return
        own = problem.specification.optimize.starts
        if own < count:
            settings = problem.specification.optimize.replaced(starts=count)
            asked = problem.specification.model_copy(update={"optimize": settings})
            problem = DesignProblem(asked, problem.base)
        yield from itertools.islice(starts_of(problem, next(self.seeds)), count)

    def _problem(self, value: float, glasses: str) -> DesignProblem | None:
        try:
            asked = self.kind.changed(self.specification, value)
            validate_possible(asked)
            return DesignProblem(asked, dict(bases_of(asked))[glasses])
        except (DesignError, ValueError):
            return None  # a numerical aperture above 1, say, or more than the etendue bound allows

    def _verified(self, end: _End) -> tuple[float, Lens, tuple[str, ...]] | None:
        """The largest value at which the finished lens passes the check, the lens, and what binds it."""
        for step in range(6):
            value = end.value * (1.0 - step * RESOLUTION)
            problem = self._problem(value, end.glasses)
            if problem is None:
                continue
            try:
                rays = dense_rays(problem)
                lens = finished_lens(problem, end.point, rays)
                if check_against(lens, problem.specification.without_as_built()).feasible:
                    return value, lens, binding(problem, end.point, rays, BINDING)
            except DesignError:
                continue
        return None


def binding(problem: DesignProblem, point: Array, rays: Rays, within: float) -> tuple[str, ...]:
    """Return the names of constraints and bounds that a point of the unit box reaches.

    Parameters
    ----------
    problem, point, rays
        The specification, the point, and the rays by which it is judged.
    within
        Distance from zero of a scaled constraint that counts as reached.
    """
    _, constraints = problem.rows(point, rays, final=True, derivatives=False)
    worst = ((row.name, float(np.max(row.values, initial=-1.0))) for row in constraints)
    names = [name for name, value in worst if -within < value <= KEPT]
    for v, u in zip(problem.ranges, point, strict=True):
        if u < 1e-6 or u > 1.0 - 1e-6:
            names.append(f"{v.name} at its {'lower' if u < 0.5 else 'upper'} bound")
    return tuple(names)
