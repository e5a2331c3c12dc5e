"""One start of a search: a local search over a working set of rays, to which worse rays are added."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.deadlines import now
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.registry import class_with
from lensdesign.optimization.nlopt_driver import (
    ALGORITHMS,
    FEASIBLE,
    UNTRACEABLE,
    Evaluation,
    Outcome,
    minimize,
    stationarity,
)
from lensdesign.optimization.operands.operand import KEPT
from lensdesign.optimization.problem import DesignProblem, Rays
from lensdesign.optimization.worst_rays import worse_rays

EXCHANGES = 12
"""Most times that rays found to be worse on the dense check are added and the search goes on."""

LOCAL_EVALUATIONS = 200
"""Most evaluations of one algorithm of a chain; what takes longer is better left to the next."""

LONE_EVALUATIONS = 2000
"""The same of an algorithm that has no next, or that searches the whole box."""

STATIONARY = 2e-3
"""First-order error at which a start counts as converged, whatever ended it."""

Improved = Callable[[float, float, int], None]


@dataclass
class Budget:
    """What is left for one choice of glasses; it shrinks as the search spends it.

    Evaluations do not depend on the machine; time counts where it is asked for.

    Attributes
    ----------
    evaluations
        Evaluations of a lens that are left.
    deadline
        Of :func:`lensdesign.common.deadlines.now`.
    spent
        Evaluations that were made.
    """

    evaluations: int
    deadline: float = math.inf
    spent: int = 0

    def spend(self, evaluations: int) -> None:
        """Take some off."""
        self.evaluations -= evaluations
        self.spent += evaluations

    @property
    def seconds(self) -> float:
        """Time that is left."""
        return self.deadline - now()

    @property
    def used_up(self) -> str:
        """The limit that has been reached, by its name in a specification; empty where none has."""
        if self.evaluations <= 0:
            return "max_evaluations"
        return "max_seconds" if self.seconds <= 0.0 else ""


@dataclass(frozen=True)
class Found:
    """The end of one start.

    Attributes
    ----------
    problem, rays
        What was searched, and the dense set of rays by which its end is judged.
    outcome
        The end: over these rays, and with all evaluations of the start.
    converged
        Whether it fulfils the conditions of first order, so that no small change makes it better.
    limit
        The limit of the whole search that cut it; empty where none did.
    """

    problem: DesignProblem
    rays: Rays
    outcome: Outcome
    converged: bool
    limit: str

    @property
    def rank(self) -> tuple[float, float]:
        """What the least of is the best: violation, then goal."""
        violation = self.outcome.violation if self.outcome.violation > KEPT else 0.0
        return violation, self.outcome.objective


def search_from(
    problem: DesignProblem,
    start: Array,
    budget: Budget,
    seed: int,
    on_improvement: Improved,
    only_feasible: bool = False,
    on_point: Callable[[Array], None] | None = None,
) -> Found:
    """Search, look densely, add what is worse, search on.

    Parameters
    ----------
    problem
        What is asked.
    start
        A point of its unit box.
    budget
        What the search may cost; what it takes comes off.
    seed
        For algorithms that draw random numbers.
    on_improvement
        As :func:`lensdesign.optimization.nlopt_driver.minimize` calls it.
    only_feasible
        Whether it is enough to keep every constraint, those of the final lens included.
    on_point
        Called with each point that is the best of the running step; what an interrupt leaves.
    """
    specification = problem.specification
    rays, dense = problem.sample_rays(3, 5, 1, _heights(problem)), dense_rays(problem)
    chain = _chain("slsqp" if only_feasible else specification.optimize.algorithm)
    point, before, limit = start, budget.spent, ""
    for _ in range(EXCHANGES):
        outcome = _solve(problem, rays, point, chain, budget, seed, on_improvement, only_feasible, on_point)
        point, limit = outcome.point, budget.used_up
        chain = _chain("slsqp") if ALGORITHMS[chain[0]].everywhere else chain
        worse = worse_rays(problem, point, rays, dense)
        if worse is None or limit:
            break
        rays = rays.with_rays(worse)
    dense = dense.with_rays(rays)
    final = problem.evaluate(point, dense)
    if only_feasible or final.violation > KEPT:
        final = _constraints_alone(problem.evaluate(point, dense, final=only_feasible))
        ended = Outcome(point, 0.0, final.objective, budget.spent - before, outcome.stopped_because)
    else:
        ended = Outcome(
            point, final.objective, final.violation, budget.spent - before, outcome.stopped_because
        )
    converged = worse is None and _stationary(lambda _: final, point)
    return Found(problem, dense, ended, converged, "" if converged else limit)


MOST_JUDGED = 30
"""Points of a stopped start that are judged over dense rays."""


def stopped_at(problem: DesignProblem, points: Sequence[Array], evaluations: int, limit: str) -> Found:
    """Find the last of the points of a stopped start that keeps every constraint over dense rays.

    The last point of all need not: it was judged by the working set of rays alone.

    Parameters
    ----------
    problem, points
        What was searched, and points of its unit box, each the best so far when it was reached.
    evaluations
        What the start took.
    limit
        What stopped it.
    """
    dense = dense_rays(problem)
    newest = list(reversed(points))
    every = max(1, math.ceil(2 * len(newest) / MOST_JUDGED))
    chosen = [*newest[: MOST_JUDGED // 2], *newest[MOST_JUDGED // 2 :: every]]
    found: list[Found] = []
    for point in chosen:
        found.append(_judged(problem, point, dense, evaluations, limit))
        if not found[-1].rank[0]:
            break
    return min(found, key=lambda one: one.rank)


def _judged(problem: DesignProblem, point: Array, dense: Rays, evaluations: int, limit: str) -> Found:
    """A point over dense rays, without derivatives."""
    goals, constraints = problem.rows(point, dense, derivatives=False)
    violation = max((float(np.max(row.values, initial=0.0)) for row in constraints), default=0.0)
    objective = max(float(np.max(row.values)) for row in goals)
    ends = (0.0, violation) if violation > KEPT else (objective, max(0.0, violation))
    goal, missed = (value if math.isfinite(value) else UNTRACEABLE for value in ends)
    return Found(problem, dense, Outcome(point, goal, missed, evaluations, limit), False, limit)


def dense_rays(problem: DesignProblem) -> Rays:
    """Return the rays by which the end of a start is judged."""
    return problem.sample_rays(16, 97, 12, _heights(problem))


def _heights(problem: DesignProblem) -> tuple[float, ...]:
    return tuple(f.field_mm for f in problem.specification.constraints.field_spread)


def _chain(algorithm: str) -> tuple[str, ...]:
    """What to run, each from where the one before ended, until one converges.

    SLSQP is the fastest, but at times loses its way in narrow valleys. COBYLA does not, and leaves SLSQP
    the last step.
    """
    if ALGORITHMS[algorithm].everywhere:
        return (algorithm, "slsqp", "cobyla", "slsqp")
    return ("slsqp", "cobyla", "slsqp") if algorithm == "slsqp" else (algorithm,)


def _constraints_alone(e: Evaluation) -> Evaluation:
    """With the largest constraint as the goal, and none left."""
    return Evaluation(e.constraints, e.constraints_by, e.constraints[:0], e.constraints_by[:0])


def _solve(
    problem: DesignProblem,
    rays: Rays,
    start: Array,
    chain: tuple[str, ...],
    budget: Budget,
    seed: int,
    on_improvement: Improved,
    only_feasible: bool,
    on_point: Callable[[Array], None] | None,
) -> Outcome:
    """Best lens for one working set of rays; a start outside the constraints is first led back inside."""

    def evaluate(point: Array) -> Evaluation:
        return problem.evaluate(point, rays)

    def restore(point: Array) -> Evaluation:
        return _constraints_alone(problem.evaluate(point, rays, final=only_feasible))

    def run(what: Callable[[Array], Evaluation], point: Array, algorithm: str, most: int) -> Outcome:
        found = minimize(
            what,
            point,
            algorithm,
            max_seconds=max(0.05, budget.seconds),
            max_evaluations=max(1, min(most, budget.evaluations)),
            seed=seed,
            on_improvement=on_improvement if what is evaluate else None,
            on_point=on_point,
        )
        budget.spend(found.evaluations)
        return found

    point = start
    if only_feasible or evaluate(start).violation > FEASIBLE:
        outcome = _in_turn(restore, start, _chain("slsqp"), run, enough=FEASIBLE)
        if only_feasible or (outcome.objective > FEASIBLE and _stationary(restore, outcome.point)):
            return outcome
        point = outcome.point
    return _in_turn(evaluate, point, chain, run)


def _in_turn(
    what: Callable[[Array], Evaluation],
    point: Array,
    chain: tuple[str, ...],
    run: Callable[[Callable[[Array], Evaluation], Array, str, int], Outcome],
    enough: float = -math.inf,
) -> Outcome:
    """The algorithms of a chain until one comes to an end, or down to what is enough."""
    for algorithm in chain:
        everywhere = ALGORITHMS[algorithm].everywhere
        lone = everywhere or len(chain) == 1
        outcome = run(what, point, algorithm, LONE_EVALUATIONS if lone else LOCAL_EVALUATIONS)
        point = outcome.point
        if outcome.objective <= enough or (not everywhere and _stationary(what, point)):
            break
    return outcome


def _stationary(what: Callable[[Array], Evaluation], point: Array) -> bool:
    """Whether a point is an end: nlopt calls some ends so that are none."""
    e = what(point)
    return max(e.objective, e.violation) < 0.5 * UNTRACEABLE and stationarity(e, point) <= STATIONARY


def starts_of(problem: DesignProblem, seed: int) -> Iterator[Array]:
    """Points of the unit box to start from; random ones only where all can be worked out."""
    settings = problem.specification.optimize
    rng = np.random.default_rng(seed)
    rays = problem.sample_rays(3, 9, 4)
    given = settings.starts
    if settings.start != "random":
        yield problem.to_unit(problem.base if settings.start == "design" else _plate(problem))
        given -= 1
    for _ in range(given):
        for _ in range(500):
            point = rng.random(len(problem.ranges))
            goals, constraints = problem.rows(point, rays, derivatives=False)
            if all(np.max(row.values) < 0.5 * UNTRACEABLE for row in (*goals, *constraints)):
                yield point
                break
        else:
            return


def _plate(problem: DesignProblem) -> Lens:
    """The start with its variable curvatures, conics and aspheres at zero."""
    lens = problem.base
    for variable in problem.variables:
        i = variable.surface
        if variable.of_shape:
            surface = lens.surfaces[i]
            values = {key: getattr(surface, key) for key in class_with(variable.kind).KEYS}
            lens = lens.with_surface(i, **class_with(variable.kind).changed_keys(values, variable.kind, 0.0))
    return lens
