"""The largest field, aperture, pixel pitch and tolerances for which a lens is found.

The search finds the largest value for which a lens meets every constraint. Random starts find a lens for a
smaller value. The value is then raised step by step, each search starting from the previous lens
(continuation), until no step succeeds. Then independent starts search lenses for four fifths of the value,
and from these for a value just above it. If one is found, the value is raised from there. If none is found,
the value is the limit, confirmed by those starts, which is not a proof. Lenses of two elements have several
families with different limits, and only one start in fifteen may lead to the best family. The number of
starts therefore grows with the number of variables.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.deadlines import DeadlineExceeded, no_deadline
from lensdesign.common.text import number_with_unit
from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens
from lensdesign.optimization.limits.limited_quantities import LimitedQuantity, limited_quantities
from lensdesign.optimization.local_search import (
    Budget,
    SearchResult,
    UntraceableStartError,
    dense_rays,
    search_from,
    starts_of,
)
from lensdesign.optimization.operands.operand import ACCEPTED_VIOLATION
from lensdesign.optimization.problem import DesignProblem, Rays, finished_lens
from lensdesign.optimization.specification.choices import bases_of
from lensdesign.optimization.specification.sections import AS_BUILT_GOALS
from lensdesign.optimization.specification.specification import Specification, validate_possible
from lensdesign.optimization.specification_check import check_against

RESOLUTION = 5e-4
"""Relative precision of a limit."""

FRACTIONS = (0.75, 0.5, 0.3, 0.15, 0.07, 0.03, 0.01)
"""Fractions of the required value at which random starts search a first lens."""

FEWEST_STARTS, MOST_STARTS, STARTS_OF_OTHERS = 12, 64, 6
"""Independent starts: for up to four variables, at most, and for each other choice of glasses. Each variable
above four adds as many as the first four together."""

NEARBY_STARTS, NEARBY = 3, (0.03, 0.1, 0.2)
"""Starts near the last lens per variable, and their distances in turn, in ranges of the variables."""

Report = Callable[[str], None]


@dataclass(frozen=True)
class Limit:
    """The largest value of one quantity for which a lens was found, with everything else as specified.

    Attributes
    ----------
    name, unit
        Name of the value and its unit.
    asked
        Value in the specification; 1 for tolerances, which are multiplied.
    reached
        Largest value with a lens that passes the check; None if none was found.
    ended
        True if larger values were tried without success. False if the search ended at the largest value that
        it tries.
    starts
        Number of independent starts, none of which found a lens above `reached`; if `reached` is None, the
        number of starts at all values.
    binding
        Active constraints and bounds at `reached`.
    cut
        Limit that stopped the search before confirmation: ``max_evaluations``, ``max_seconds`` or
        ``interrupt``; empty if there was none.
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
        """Return plain data for JSON, without the lens."""
        return {k: v for k, v in vars(self).items() if k != "lens"} | {"binding": list(self.binding)}

    @property
    def confidence(self) -> str:
        """Reliability of the limit as text."""
        if self.cut:
            return f"not confirmed: {self.cut} stopped the search"
        if self.reached is None:
            least = FRACTIONS[-1]
            return f"{self.starts} starts found no lens down to {least:g} times the required value (no proof)"
        if not self.ended:
            return "no larger value was tried"
        return f"{self.starts} independent starts found no lens above it (no proof)"


class LimitsInterrupted(KeyboardInterrupt):
    """An interrupt of a search for limits.

    Attributes
    ----------
    limits
        Limits that were found; the last may be unconfirmed.
    """

    def __init__(self, limits: tuple[Limit, ...]) -> None:
        super().__init__("interrupted")
        self.limits = limits


def find_limits(
    specification: Specification,
    report: Report = lambda _: None,
    seed: int = 0,
    quantities: Sequence[LimitedQuantity] | None = None,
    near: Mapping[str, Array] | None = None,
    most: float = 4.0,
) -> tuple[Limit, ...]:
    """Find the largest field, aperture, pixel pitch and, if a yield is limited, tolerances.

    A deadline (:func:`lensdesign.common.deadlines.deadline`) stops the search; its results so far are
    returned and marked as not confirmed. Yields are predicted, without trials.

    Parameters
    ----------
    specification
        The specification. Its goal has no effect. A variable field is required at its smallest diameter.
    report
        Progress callback, called with a line of text at each step (default: none).
    seed
        Seed of the random starts.
    quantities
        Values whose limits are searched (default: those of :func:`limited_quantities`).
    near
        Further start points in the unit box, by the name of their choice of glasses (default: none).
    most
        Multiple of the required value at which the search ends (default: 4).

    Returns
    -------
    tuple of Limit
        One for each quantity.

    Raises
    ------
    LimitsInterrupted
        If the search is interrupted.
    """
    specification = _without_as_built_goal(specification.with_fixed_field())
    limits: list[Limit] = []
    known = [*(near or {}).items()]
    for quantity in limited_quantities(specification) if quantities is None else quantities:
        search = _LimitSearch(specification, quantity, seed, report, known, most)
        limits.append(search.run())
        if limits[-1].cut == "interrupt":
            raise LimitsInterrupted(tuple(limits))
        known += [(end.glasses, end.point) for end in search.as_asked]
    return tuple(limits)


def _confirming_starts(variables: int) -> int:
    """Return the number of independent starts that confirm a limit with the best choice of glasses."""
    return min(max(variables - 3, 1) * FEWEST_STARTS, MOST_STARTS)


def _without_as_built_goal(specification: Specification) -> Specification:
    """Return the specification with a fast goal in place of one on lenses as built."""
    if specification.optimize.goal not in AS_BUILT_GOALS:
        return specification
    settings = specification.optimize.replaced(goal="thinnest lens")
    return specification.model_copy(update={"optimize": settings})


@dataclass(frozen=True, eq=False)
class _End:
    """A lens that meets every constraint: a point of the unit box of one choice of glasses."""

    value: float
    glasses: str
    point: Array


class _BudgetSpent(Exception):
    """Raised when the evaluations of the specification are used up."""


@dataclass
class _LimitSearch:
    """The search for one limit; `best` is the lens with the largest value so far."""

    specification: Specification
    quantity: LimitedQuantity
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
        self.asked = self.quantity.value_in(self.specification)
        choices = sum(1 for _ in bases_of(self.specification))
        self.names = [glasses for glasses, _ in bases_of(self.specification)]
        # Evaluations of a limit, in multiples of those of the search for one lens.
        most_searches = 10
        self.budget = Budget(most_searches * choices * self.specification.optimize.max_evaluations)
        self.seeds = itertools.count(self.seed * 1_000_003)

    def run(self) -> Limit:
        """Return the limit, or the best value so far if the search is stopped."""
        cut = ""
        try:
            self._first()
            while self.best is not None and self.best.value < self.most * self.asked:
                self._climb()
                if not self._confirm():
                    break
        except KeyboardInterrupt:
            cut = "interrupt"
        except DeadlineExceeded:
            cut = "max_seconds"
        except _BudgetSpent:
            cut = "max_evaluations"
        with no_deadline():
            return self._limit(cut)

    def _limit(self, cut: str) -> Limit:
        quantity, found = self.quantity, None
        # Largest number of lenses that are checked, from the largest value down, until one passes.
        most_verified = 12
        for end in sorted(self.ends, key=lambda one: -one.value)[:most_verified]:
            found = self._verified(end)
            if found is not None:
                break
        if found is None:
            return Limit(quantity.name, quantity.unit, self.asked, None, True, self.failed, (), cut)
        value, lens, binding = found
        ended = value < self.most * self.asked * (1.0 - 1e-12)
        return Limit(quantity.name, quantity.unit, self.asked, value, ended, self.starts, binding, cut, lens)

    def _first(self) -> None:
        """Find a first lens at the required value or below, from known points and from random starts."""
        fractions = FRACTIONS if self.most <= 1.0 else (1.0, *FRACTIONS)
        for fraction in fractions:
            value = fraction * self.asked
            for glasses in self.names:
                near = [point for name, point in self.near if name == glasses]
                for point in itertools.chain(near, self._fresh(value, glasses, 6)):
                    if self._reaches(value, glasses, point):
                        break
            if self.best is not None:
                return

    def _climb(self) -> None:
        """Raise the value step by step, each search starting from the previous lens."""
        end = self.best
        assert end is not None  # there is a first lens
        # Relative size of the first step; it is doubled after each success.
        first_step = 0.02
        step, failed_at, top = first_step, math.inf, self.most * self.asked
        while end.value < top and failed_at - end.value > RESOLUTION * end.value:
            value = min(end.value * (1.0 + step), top)
            if math.isfinite(failed_at):
                value = 0.5 * (end.value + failed_at)
            if self._reaches(value, end.glasses, end.point):
                assert self.best is not None  # it was found just now
                end, step = self.best, 2.0 * step
            else:
                failed_at = value

    def _confirm(self) -> bool:
        """Return whether independent starts find a lens above the best value."""
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
            if self._reaches(value, end.glasses, point):
                return True
        # Fraction of the largest value at which independent starts find a lens before they try just above it.
        easier_fraction = 0.8
        for glasses in sorted(self.names, key=lambda name: name != end.glasses):
            count = _confirming_starts(len(end.point)) if glasses == end.glasses else STARTS_OF_OTHERS
            for point in self._fresh(easier_fraction * end.value, glasses, count):
                self.starts += 1
                easier = self._search(easier_fraction * end.value, glasses, point)
                if easier is None or easier.outcome.violation > ACCEPTED_VIOLATION:
                    continue
                if self._reaches(value, glasses, easier.outcome.point):
                    return True
        return False

    def _reaches(self, value: float, glasses: str, point: Array) -> bool:
        """Return whether a search from a point finds a lens for a value, and record the lens."""
        self.report(
            number_with_unit(f"{self.quantity.name}: {value:.4g}", self.quantity.unit) + f", {glasses}"
        )
        found = self._search(value, glasses, point)
        if found is None or found.outcome.violation > ACCEPTED_VIOLATION:
            self.failed += 1
            return False
        end = _End(value, glasses, found.outcome.point)
        if value == self.asked:
            self.as_asked.append(end)
        if self.best is None or value > self.best.value:
            self.best = end
        self.ends.append(end)
        return True

    def _search(self, value: float, glasses: str, point: Array) -> SearchResult | None:
        """Return the result of a search for a feasible lens; None if the value or the start is not valid."""
        problem = self._problem(value, glasses)
        if problem is None:
            return None
        if self.budget.used_up:
            raise _BudgetSpent
        budget = Budget(min(1500, self.budget.evaluations))
        try:
            return search_from(problem, point, budget, next(self.seeds), lambda *_: None, only_feasible=True)
        except UntraceableStartError:
            return None
        finally:
            self.budget.spend(max(1, budget.spent))

    def _fresh(self, value: float, glasses: str, count: int) -> Iterator[Array]:
        """Yield start points: the specification's own, then random ones."""
        problem = self._problem(value, glasses)
        if problem is None:
            return
        yield from starts_of(problem, next(self.seeds), count)

    def _problem(self, value: float, glasses: str) -> DesignProblem | None:
        try:
            asked = self.quantity.changed(self.specification, value)
            validate_possible(asked)
            return DesignProblem(asked, dict(bases_of(asked))[glasses])
        except (DesignError, ValueError):
            return None  # a numerical aperture above 1, say, or more than the etendue bound allows

    def _verified(self, end: _End) -> tuple[float, Lens, tuple[str, ...]] | None:
        """Return the largest value at which the lens passes the check, the lens, and active constraints."""
        # A constraint is active at a limit if the absolute value of its scaled value is smaller than this.
        tolerance = 2e-3
        for step in range(6):
            value = end.value * (1.0 - step * RESOLUTION)
            problem = self._problem(value, end.glasses)
            if problem is None:
                continue
            try:
                rays = dense_rays(problem)
                lens = finished_lens(problem, end.point, rays)
                if check_against(lens, problem.specification.without_as_built()).feasible:
                    return value, lens, binding(problem, end.point, rays, tolerance)
            except DesignError:
                continue
        return None


def binding(problem: DesignProblem, point: Array, rays: Rays, within: float) -> tuple[str, ...]:
    """Return the names of the active constraints and bounds at a point of the unit box.

    Parameters
    ----------
    problem, point, rays
        The problem, the point, and the rays by which it is evaluated.
    within
        Largest distance from zero of an active scaled constraint.
    """
    _, constraints = problem.rows(point, rays, final=True, derivatives=False)
    worst = ((row.name, float(np.max(row.values, initial=-1.0))) for row in constraints)
    names = [name for name, value in worst if -within < value <= ACCEPTED_VIOLATION]
    for v, u in zip(problem.ranges, point, strict=True):
        if u < 1e-6 or u > 1.0 - 1e-6:
            names.append(f"{v.name} at its {'lower' if u < 0.5 else 'upper'} bound")
    return tuple(names)
