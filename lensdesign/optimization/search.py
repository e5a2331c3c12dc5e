"""Optimize a lens to a specification: choices of glasses, and starts until several agree."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from lensdesign.common.arrays import Array
from lensdesign.common.deadlines import DeadlineExceeded, deadline, no_deadline, now
from lensdesign.common.given import FilePath, object_of
from lensdesign.errors import DesignError
from lensdesign.optimization.local_search import (
    Budget,
    SearchResult,
    UntraceableStartError,
    search_from,
    starts_of,
    stopped_at,
)
from lensdesign.optimization.nlopt_driver import FEASIBLE
from lensdesign.optimization.problem import DesignProblem
from lensdesign.optimization.result import INTERRUPT, GlassChoiceResult, OptimizationResult, result_of
from lensdesign.optimization.specification.choices import bases_of
from lensdesign.optimization.specification.specification import (
    Specification,
    load_specification,
    validate_possible,
)
from lensdesign.optimization.specification.stop_rules import Ending

Report = Callable[[str], None]


@dataclass(frozen=True)
class Improvement:
    """A better lens that a search has found.

    Attributes
    ----------
    seconds
        Time since the search began in s.
    start
        Index of the start, from 0, over all choices of glasses.
    goal
        Goal as a fraction of its reference, which is the same during the whole search; smaller is better.
    feasible
        Whether the lens meets every constraint on the rays of the search.
    """

    seconds: float
    start: int
    goal: float
    feasible: bool


class SearchInterrupted(KeyboardInterrupt):
    """An interrupt of an optimization that has a result.

    Attributes
    ----------
    result
        The best lens so far, checked against its specification.
    """

    def __init__(self, result: OptimizationResult) -> None:
        super().__init__("interrupted")
        self.result = result


def optimize(
    specification: Specification | FilePath,
    report: Report | None = None,
    seed: int = 0,
    on_improvement: Callable[[Improvement], None] | None = None,
) -> OptimizationResult:
    """Optimize a lens to a specification.

    Every start is a local search over a working set of rays. A dense check then adds its worst rays to the
    set, until no ray is worse than those of the set (an exchange method). Each choice of glasses is searched
    from several starts until enough of them agree. Limits of time and evaluations are divided among the
    choices. Finally, the result is checked against the specification independently of the search.

    A time limit also covers the check of the result, the trials of lenses as built, and, for an infeasible
    specification, the search for its feasibility limit. The result lists the steps for which no time was
    left.

    Parameters
    ----------
    specification
        Start lens, variables, goal and constraints; or the path of a specification file.
    report
        Progress callback, called with a line of text at each improvement (default: none).
    seed
        Seed of the random starts and of the stochastic algorithms.
    on_improvement
        Called at each improvement, at most ten times a second (default: none).

    Returns
    -------
    OptimizationResult
        The best lens, its check, and how the search ended.

    Raises
    ------
    DesignError
        If no start can be traced, or the etendue bound excludes the specification.
    SearchInterrupted
        If the search is interrupted; its `result` has the best lens so far. Without a lens, a plain
        KeyboardInterrupt is raised.

    Examples
    --------
    >>> from lensdesign import load_specification, optimize
    >>> result = optimize(load_specification("designs/feasible_singlet_spec.toml"))
    >>> result.feasible, round(result.lens.surfaces[1].radius_mm, 1)
    (True, -11.9)
    """
    specification = object_of(specification, Specification, load_specification, "specification")
    validate_possible(specification)
    settings = specification.optimize
    began, seconds = now(), math.inf if settings.max_seconds is None else settings.max_seconds
    ending = Ending(began, began + seconds, seed=seed, report=report)
    bases = list(bases_of(specification))
    tried: list[GlassChoiceResult] = []
    try:
        end = ending.plan_trials(specification)
        for number, (glasses, base) in enumerate(bases):
            time = now()
            budget = Budget(settings.max_evaluations, time + (end - time) / (len(bases) - number))
            progress = _Progress(
                specification, (number, len(bases)), glasses, began, budget, report, on_improvement
            )
            tried.append(_try(glasses, DesignProblem(specification, base), budget, seed, progress))
            if tried[-1].limit == INTERRUPT:
                ending.interrupted = True
                break
    except KeyboardInterrupt:
        ending.interrupted = True
    if ending.interrupted:
        tried += [GlassChoiceResult(glasses, (), INTERRUPT) for glasses, _ in bases[len(tried) :]]
    if not any(t.found for t in tried):
        if ending.interrupted:
            raise KeyboardInterrupt("interrupted before a first lens was found")
        raise DesignError(_nothing_tried(tried))
    result = result_of(specification, tried, ending)
    if ending.interrupted:
        raise SearchInterrupted(result)
    return result


def _nothing_tried(tried: list[GlassChoiceResult]) -> str:
    limits = {t.limit for t in tried} - {""}
    if limits:
        names = " and ".join(sorted(limits))
        return f"no start was made: {names} ended the search before the first one; use a larger limit"
    dropped = [error for t in tried for error in t.dropped]
    reason = f"; the first start ended with: {dropped[0]}" if dropped else ""
    return f"no start can be traced: no random lens transmits all rays{reason}; narrow the bounds"


def _try(
    glasses: str, problem: DesignProblem, budget: Budget, seed: int, progress: _Progress
) -> GlassChoiceResult:
    """Search with one choice of glasses until enough starts agree, or a limit or the user stops it.

    A start that cannot be evaluated is replaced by another one.
    """
    settings = problem.specification.optimize
    tried = GlassChoiceResult(glasses, (), "")
    try:
        with deadline(budget.deadline):
            for number, start in enumerate(starts_of(problem, seed, 2 * settings.starts)):
                if len(tried.found) == settings.starts:
                    break
                if budget.used_up:
                    return replace(tried, limit=budget.used_up)
                progress.begin(number, tried)
                try:
                    found = search_from(
                        problem, start, budget, seed + number, progress.improved, on_point=progress.reached
                    )
                except UntraceableStartError as error:
                    tried = replace(tried, dropped=(*tried.dropped, str(error)))
                    progress.points = []
                    continue
                tried = replace(tried, found=(*tried.found, found), limit=found.limit)
                progress.points = []
                if tried.at_best >= settings.agreeing:
                    return replace(tried, limit="")
    except (KeyboardInterrupt, DeadlineExceeded) as stop:
        limit = "max_seconds" if isinstance(stop, DeadlineExceeded) else INTERRUPT
        return _kept(tried, problem, progress, limit)
    return tried


def _kept(
    tried: GlassChoiceResult, problem: DesignProblem, progress: _Progress, limit: str
) -> GlassChoiceResult:
    """Return the finished starts of a stopped choice of glasses, and the best point of the running start."""
    found: tuple[SearchResult, ...] = tried.found
    if progress.points:
        with no_deadline():
            found = (*found, stopped_at(problem, progress.points, progress.evaluations, limit))
    return replace(tried, found=found, limit=limit)


@dataclass
class _Progress:
    """Progress of the starts of one choice of glasses, reported as lines of text.

    Attributes
    ----------
    choice
        Index of this choice of glasses, from 0, and the number of all.
    points
        Successive best points of the running start; empty between starts.
    evaluations
        Evaluations of the running start.
    """

    specification: Specification
    choice: tuple[int, int]
    glasses: str
    began: float
    budget: Budget
    report: Report | None
    on_improvement: Callable[[Improvement], None] | None = None
    points: list[Array] = field(default_factory=list)
    evaluations: int = 0
    number: int = 0
    agreeing: int = 0
    first: float = field(default_factory=now)
    last: float = -math.inf

    def begin(self, number: int, tried: GlassChoiceResult) -> None:
        """Note the begin of a start."""
        self.number, self.points, self.evaluations = number, [], 0
        self.agreeing = tried.at_best if tried.found else 0

    def reached(self, point: Array) -> None:
        """Note a new best point of the running start."""
        self.points.append(point)

    def improved(self, objective: float, violation: float, evaluations: int) -> None:
        """Report an improvement of the goal, at most ten times a second."""
        self.evaluations = max(self.evaluations, evaluations)
        time = now()
        if time - self.last < 0.1:
            return
        self.last = time
        if self.on_improvement is not None:
            start = self.choice[0] * self.specification.optimize.starts + self.number
            self.on_improvement(Improvement(time - self.began, start, objective, violation <= FEASIBLE))
        if self.report is None:
            return
        kept = "feasible" if violation <= FEASIBLE else f"violation {violation:.2g}"
        self.report(
            f"{self.specification.optimize.goal}, {self.glasses}, {self._starts()}: {objective:.6f} of "
            f"reference, {kept}, {evaluations} evaluations, {time - self.began:.1f} s{self._estimate(time)}"
        )

    def _starts(self) -> str:
        settings = self.specification.optimize
        most = f"start {self.number + 1} of at most {settings.starts}"
        if settings.agreeing >= settings.starts:
            return most
        agree = f"{self.agreeing} of {settings.agreeing} agree, " if self.agreeing else ""
        return f"{most} ({agree}usually stops early)"

    def _estimate(self, time: float) -> str:
        """Return the longest remaining time as text, estimated from the completed starts."""
        settings, (choice, choices) = self.specification.optimize, self.choice
        remaining = math.inf if settings.max_seconds is None else self.began + settings.max_seconds - time
        if self.number:
            each = (time - self.first) / (self.number + 0.5)
            starts = settings.starts - self.number + (choices - choice - 1) * settings.starts
            remaining = min(remaining, starts * each)
        return f", at most {remaining:.0f} s more" if math.isfinite(remaining) else ""
