"""A start of an optimization: a local search over a working set of rays, to which worse rays are added."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.deadlines import now
from lensdesign.errors import DesignError, InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.registry import class_with
from lensdesign.optimization.nlopt_driver import (
    ALGORITHMS,
    CONVERGED,
    FEASIBLE,
    UNTRACEABLE,
    Evaluation,
    Outcome,
    constraints_alone,
    minimize,
    stationarity,
)
from lensdesign.optimization.operands.operand import ACCEPTED_VIOLATION
from lensdesign.optimization.problem import DesignProblem, Rays
from lensdesign.optimization.worst_rays import hidden_rays, worse_rays

Improved = Callable[[float, float, int], None]


@dataclass
class Budget:
    """Remaining evaluations and time of one choice of glasses.

    The number of evaluations does not depend on the machine. Time is limited only if the specification says
    so.

    Attributes
    ----------
    evaluations
        Remaining evaluations of a lens.
    deadline
        End on the clock of :func:`lensdesign.common.deadlines.now`.
    spent
        Number of evaluations made.
    """

    evaluations: int
    deadline: float = math.inf
    spent: int = 0

    def spend(self, evaluations: int) -> None:
        """Subtract evaluations."""
        self.evaluations -= evaluations
        self.spent += evaluations

    @property
    def seconds(self) -> float:
        """Remaining time in seconds."""
        return self.deadline - now()

    @property
    def used_up(self) -> str:
        """Name of the reached limit in a specification; empty if none is reached."""
        if self.evaluations <= 0:
            return "max_evaluations"
        return "max_seconds" if self.seconds <= 0.0 else ""


@dataclass(frozen=True)
class SearchResult:
    """Result of one start.

    Attributes
    ----------
    problem, rays
        The problem, and the dense set of rays by which the result is evaluated.
    outcome
        Best point over these rays, with the evaluations of the whole start.
    converged
        Whether the first-order optimality conditions are met.
    limit
        Limit of the whole search that stopped the start; empty if there was none.
    """

    problem: DesignProblem
    rays: Rays
    outcome: Outcome
    converged: bool
    limit: str

    @property
    def rank(self) -> tuple[float, float]:
        """Key of the order of results, smallest is best: violation, then goal."""
        violation = self.outcome.violation if self.outcome.violation > ACCEPTED_VIOLATION else 0.0
        return violation, self.outcome.objective


class UntraceableStartError(DesignError):
    """A start from which no lens can be evaluated, so that it has no result; others may have one."""


def search_from(
    problem: DesignProblem,
    start: Array,
    budget: Budget,
    seed: int,
    on_improvement: Improved,
    only_feasible: bool = False,
    on_point: Callable[[Array], None] | None = None,
) -> SearchResult:
    """Search from a start point; add worse rays of a dense check to the working set and repeat.

    Parameters
    ----------
    problem
        The problem.
    start
        Start point in its unit box.
    budget
        Remaining evaluations and time, from which the search subtracts.
    seed
        Seed of stochastic algorithms.
    on_improvement
        Progress callback of :func:`lensdesign.optimization.nlopt_driver.minimize`.
    only_feasible
        Whether the search ends as soon as every constraint is met, including those of the final lens.
    on_point
        Called with each new best point (default: none).

    Raises
    ------
    UntraceableStartError
        If a lens of the search cannot be evaluated.
    """
    try:
        return _search_from(problem, start, budget, seed, on_improvement, only_feasible, on_point)
    except InputError as error:
        raise UntraceableStartError(str(error)) from error


def _search_from(
    problem: DesignProblem,
    start: Array,
    budget: Budget,
    seed: int,
    on_improvement: Improved,
    only_feasible: bool,
    on_point: Callable[[Array], None] | None,
) -> SearchResult:
    """Return the result of :func:`search_from`."""
    specification = problem.specification
    rays, dense = problem.sample_rays(3, 5, 1, _heights(problem)), dense_rays(problem)
    algorithms = _algorithm_sequence("slsqp" if only_feasible else specification.optimize.algorithm)
    point, spent_before, limit = start, budget.spent, ""
    # Largest number of times that worse rays of the dense check are added to the working set.
    most_exchanges = 20
    for _ in range(most_exchanges):
        outcome = _solve(
            problem, rays, point, algorithms, budget, seed, on_improvement, only_feasible, on_point
        )
        point, limit = outcome.point, budget.used_up
        algorithms = _algorithm_sequence("slsqp") if ALGORITHMS[algorithms[0]].everywhere else algorithms
        worse = worse_rays(problem, point, rays, dense)
        if worse is None and not limit and not problem.rotational:
            worse = hidden_rays(problem, point, rays)
        if worse is None or limit:
            break
        rays = rays.with_rays(worse)
    dense = dense.with_rays(rays)
    final = problem.evaluate(point, dense, final=only_feasible)
    if only_feasible or final.violation > ACCEPTED_VIOLATION:
        final = constraints_alone(final)
        objective, violation = 0.0, final.objective
    else:
        objective, violation = final.objective, final.violation
    residual = stationarity(final, point)
    converged = worse is None and residual <= CONVERGED
    reason = outcome.stopped_because
    if worse is not None and not limit:
        reason = f"worse rays were still found after {most_exchanges} exchanges"
    elif reason == "converged" and not converged:
        reason = f"the first-order residual over all rays is {residual:.2g}"
    spent = budget.spent - spent_before
    result = Outcome(point, objective, violation, spent, "converged" if converged else reason, residual)
    return SearchResult(problem, dense, result, converged, "" if converged else limit)


def stopped_at(problem: DesignProblem, points: Sequence[Array], evaluations: int, limit: str) -> SearchResult:
    """Return the last point of a stopped start that meets every constraint over dense rays.

    The very last point need not meet them, since it was evaluated with the working set of rays only.

    Parameters
    ----------
    problem, points
        The problem, and the successive best points in its unit box.
    evaluations
        Evaluations of the start.
    limit
        Limit that stopped the start.
    """
    most = 30  # points that are evaluated
    dense = dense_rays(problem)
    newest = list(reversed(points))
    every = max(1, math.ceil(2 * len(newest) / most))
    chosen = [*newest[: most // 2], *newest[most // 2 :: every]]
    found: list[SearchResult] = []
    for point in chosen:
        found.append(_evaluated(problem, point, dense, evaluations, limit))
        if not found[-1].rank[0]:
            break
    return min(found, key=lambda one: one.rank)


def _evaluated(
    problem: DesignProblem, point: Array, dense: Rays, evaluations: int, limit: str
) -> SearchResult:
    """Evaluate a point over dense rays, without derivatives."""
    goals, constraints = problem.rows(point, dense, derivatives=False)
    violation = max((float(np.max(row.values, initial=0.0)) for row in constraints), default=0.0)
    objective = max(float(np.max(row.values)) for row in goals)
    rank = (0.0, violation) if violation > ACCEPTED_VIOLATION else (objective, max(0.0, violation))
    objective, violation = (value if math.isfinite(value) else UNTRACEABLE for value in rank)
    return SearchResult(
        problem, dense, Outcome(point, objective, violation, evaluations, limit), False, limit
    )


def dense_rays(problem: DesignProblem) -> Rays:
    """Return the rays by which the result of a start is evaluated."""
    return problem.sample_rays(16, 97, 12, _heights(problem))


def _heights(problem: DesignProblem) -> tuple[float, ...]:
    """Return the field heights at which constraints are evaluated, besides those of the sampling."""
    specification = problem.specification
    recording = specification.recording
    support = None if recording is None else recording.support_mm
    edge = () if support is None else (0.5 * support,)
    return (*(f.field_mm for f in specification.constraints.field_spread), *edge)


def _algorithm_sequence(algorithm: str) -> tuple[str, ...]:
    """Return the algorithms to run one after the other, each from the last point, until one converges.

    SLSQP is the fastest but may stall in narrow valleys. COBYLA does not stall, and SLSQP makes the last
    step.
    """
    if ALGORITHMS[algorithm].everywhere:
        return (algorithm, "slsqp", "cobyla", "slsqp")
    return ("slsqp", "cobyla", "slsqp") if algorithm == "slsqp" else (algorithm,)


def _solve(
    problem: DesignProblem,
    rays: Rays,
    start: Array,
    algorithms: tuple[str, ...],
    budget: Budget,
    seed: int,
    on_improvement: Improved,
    only_feasible: bool,
    on_point: Callable[[Array], None] | None,
) -> Outcome:
    """Return the best lens for one working set of rays; an infeasible start is first made feasible."""

    # Each algorithm begins at the last point of another, which is also tested for convergence.
    @lru_cache(maxsize=32)
    def evaluated(point: bytes) -> Evaluation:
        return problem.evaluate(np.frombuffer(point), rays, final=only_feasible)

    def evaluate(point: Array) -> Evaluation:
        return evaluated(point.tobytes())

    @lru_cache(maxsize=32)
    def restored(point: bytes) -> Evaluation:
        return problem.constraints_as_goals(np.frombuffer(point), rays, final=only_feasible)

    def restore(point: Array) -> Evaluation:
        return restored(point.tobytes())

    def run(function: Callable[[Array], Evaluation], point: Array, algorithm: str, most: int) -> Outcome:
        found = minimize(
            function,
            point,
            algorithm,
            max_seconds=max(0.05, budget.seconds),
            max_evaluations=max(1, min(most, budget.evaluations)),
            seed=seed,
            on_improvement=on_improvement if function is evaluate else None,
            on_point=on_point,
        )
        budget.spend(found.evaluations)
        return found

    point = start
    if only_feasible or np.max(restore(start).goals, initial=0.0) > FEASIBLE:
        outcome = _run_in_sequence(restore, start, _algorithm_sequence("slsqp"), run, enough=FEASIBLE)
        if only_feasible or (outcome.objective > FEASIBLE and _stationary(restore, outcome.point)):
            return outcome
        point = outcome.point
    return _run_in_sequence(evaluate, point, algorithms, run)


def _run_in_sequence(
    function: Callable[[Array], Evaluation],
    point: Array,
    algorithms: tuple[str, ...],
    run: Callable[[Callable[[Array], Evaluation], Array, str, int], Outcome],
    enough: float = -math.inf,
) -> Outcome:
    """Run the algorithms one after the other until one converges or the objective is small enough."""
    # Largest number of evaluations of one algorithm before the next one continues.
    local_evaluations = 200
    # Largest number of evaluations of a single algorithm, or of a global one.
    lone_evaluations = 2000
    for algorithm in algorithms:
        everywhere = ALGORITHMS[algorithm].everywhere
        lone = everywhere or len(algorithms) == 1
        outcome = run(function, point, algorithm, lone_evaluations if lone else local_evaluations)
        point = outcome.point
        if outcome.objective <= enough or (not everywhere and _stationary(function, point)):
            break
    return outcome


def _stationary(function: Callable[[Array], Evaluation], point: Array) -> bool:
    """Return whether a point meets the first-order conditions, since nlopt may stop too early."""
    return stationarity(function(point), point) <= CONVERGED


def starts_of(problem: DesignProblem, seed: int, count: int | None = None) -> Iterator[Array]:
    """Yield start points in the unit box; random points must allow an evaluation of all operands.

    Parameters
    ----------
    problem
        The problem.
    seed
        Seed of the random points.
    count
        Largest number of points (default: that of the specification).
    """
    settings = problem.specification.optimize
    rng = np.random.default_rng(seed)
    rays = problem.sample_rays(3, 9, 4)
    remaining = settings.starts if count is None else count
    if settings.start != "random":
        yield problem.to_unit(problem.base if settings.start == "design" else _flat_start(problem))
        remaining -= 1
    for _ in range(remaining):
        for _ in range(500):
            point = rng.random(len(problem.ranges))
            if _is_traceable(problem, point, rays):
                yield point
                break
        else:
            return


def _is_traceable(problem: DesignProblem, point: Array, rays: Rays) -> bool:
    """Return whether all operands can be evaluated at a point."""
    try:
        goals, constraints = problem.rows(point, rays, derivatives=False)
    except InputError:
        return False
    return all(np.max(row.values) < 0.5 * UNTRACEABLE for row in (*goals, *constraints))


def _flat_start(problem: DesignProblem) -> Lens:
    """Return the start lens with its variable curvatures, conics and aspheres set to zero."""
    lens = problem.base
    for variable in problem.variables:
        i = variable.surface
        if variable.is_shape_term:
            surface = lens.surfaces[i]
            values = {key: getattr(surface, key) for key in class_with(variable.kind).KEYS}
            lens = lens.with_surface(i, **class_with(variable.kind).changed_keys(values, variable.kind, 0.0))
    return lens
