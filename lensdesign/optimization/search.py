"""Optimize a lens to a specification: starts, glasses, exchange of rays, and what binds in the end."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.notebook import html_table
from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.registry import class_with
from lensdesign.optimization.nlopt_driver import ALGORITHMS, FEASIBLE, Evaluation, Outcome, minimize
from lensdesign.optimization.problem import DesignProblem, Rays, finished_lens
from lensdesign.optimization.requirements import KEPT, Row
from lensdesign.optimization.specification import Specification, refuse_impossible
from lensdesign.optimization.worst_rays import worse_rays

Report = Callable[[str], None]

EXCHANGES = 12
"""Most times that rays found to be worse on the dense check are added and the search goes on."""

LOCAL_EVALUATIONS = 200
"""Most evaluations of one algorithm of a chain; what takes longer is better left to the next."""

BINDING = 1e-4
"""A constraint binds where its scaled value is within this of zero."""


@dataclass(frozen=True, repr=False)
class OptimizationResult:
    """What a search found.

    Attributes
    ----------
    lens
        The best lens; feasible if `feasible` says so, else the one that violates least.
    variables
        Value of each variable by name, in the units of its name.
    goal, goal_value
        What was made small, and what it came to (degrees for a spread, else mm).
    feasible, violations
        Whether every constraint holds over the dense set of rays, and which do not.
    binding
        Constraints and bounds that stop it from getting better.
    evaluations, seconds
        What it cost.
    algorithm, stopped_because
        How the best start was searched, and why that ended.
    starts, starts_at_best
        Number of starts, and how many of them came to the best goal (within 0.1 %).
    """

    lens: Lens
    variables: dict[str, float | str | None]
    goal: str
    goal_value: float
    feasible: bool
    violations: list[str]
    binding: list[str]
    evaluations: int
    seconds: float
    algorithm: str
    stopped_because: str
    starts: int
    starts_at_best: int

    def __repr__(self) -> str:
        met = "feasible" if self.feasible else f"not met: {len(self.violations)}"
        return f"<OptimizationResult {self.goal} = {self.goal_value:.6g}, {met}, {self.lens!r}>"

    def _repr_html_(self) -> str:
        rows = [
            (name, "plane" if v is None else f"{v:.8g}" if isinstance(v, float) else v)
            for name, v in self.variables.items()
        ]
        rows += [
            (self.goal, f"{self.goal_value:.6g}"),
            ("binding", ", ".join(self.binding)),
            *(("not met", sentence) for sentence in self.violations),
            ("search", f"{self.algorithm}: {self.evaluations} evaluations in {self.seconds:.2f} s"),
        ]
        return html_table("Optimization", rows) + self.lens._repr_html_()

    def as_dict(self) -> dict[str, Any]:
        """As plain data, without the lens."""
        return {k: v for k, v in asdict(self).items() if k != "lens"} | {"title": self.lens.title}


@dataclass(frozen=True)
class _Found:
    """The end of one start."""

    problem: DesignProblem
    rays: Rays
    outcome: Outcome

    @property
    def rank(self) -> tuple[float, float]:
        violation = self.outcome.violation if self.outcome.violation > KEPT else 0.0
        return violation, self.outcome.objective


def optimize(specification: Specification, report: Report | None = None, seed: int = 0) -> OptimizationResult:
    """Search for the lens that a specification asks for.

    Every start is a local search over a working set of rays, to which the worst rays of a dense check
    are added until none is worse (an exchange method). Material choices are tried one by one.

    Parameters
    ----------
    specification
        What is asked.
    report
        Called with a line of text at each improvement.
    seed
        For the random starts, and for the algorithms that draw random numbers.

    Returns
    -------
    OptimizationResult

    Raises
    ------
    DesignError
        If no start can be traced, or the etendue bound forbids the specification.
    """
    refuse_impossible(specification)
    began = time.monotonic()
    deadline = began + specification.optimize.max_seconds
    found: list[_Found] = []
    evaluations = 0
    for base in _glasses(specification):
        problem = DesignProblem(specification, base)
        for number, start in enumerate(_starts(problem, seed, deadline)):
            said = _narrator(report, base, number, specification, began)
            one, spent = _search(problem, start, deadline, seed + number, said)
            found.append(one)
            evaluations += spent
            if time.monotonic() > deadline:
                break
    if not found:
        raise DesignError("no start can be traced: no drawn lens lets all rays through; narrow the bounds")
    best = min(found, key=lambda f: f.rank)
    return _result(best, found, evaluations, time.monotonic() - began)


def _glasses(specification: Specification) -> Iterator[Lens]:
    """The start with each combination of the material choices."""
    materials = [v for v in specification.variables if v.parameter == "material"]
    for choice in itertools.product(*(v.choices for v in materials)):
        lens = specification.lens
        for variable, glass in zip(materials, choice, strict=True):
            lens = lens.with_surface((variable.surface or 1) - 1, material=glass)
        yield lens


def _starts(problem: DesignProblem, seed: int, deadline: float) -> Iterator[Array]:
    """Points of the unit box to start from; random ones only where every ray gets through."""
    settings = problem.specification.optimize
    rng = np.random.default_rng(seed)
    rays = problem.sample_rays(3, 5, 1)
    given = settings.starts
    if settings.start != "random":
        yield problem.to_unit(problem.base if settings.start == "design" else _plate(problem))
        given -= 1
    for _ in range(given):
        for _ in range(500):
            point = rng.random(len(problem.ranges))
            if all(np.all(t.ok) for t in problem.state(point, rays).traces):
                yield point
                break
        if time.monotonic() > deadline:
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


def _search(
    problem: DesignProblem,
    start: Array,
    deadline: float,
    seed: int,
    on_improvement: Callable[[float, float, int], None],
) -> tuple[_Found, int]:
    """One start: search, look densely, add what is worse, search on."""
    specification = problem.specification
    heights = tuple(f.field_mm for f in specification.constraints.field_spread)
    rays = problem.sample_rays(3, 5, 1, heights)
    dense = problem.sample_rays(16, 97, 12, heights)
    chain = _chain(specification.optimize.algorithm)
    point, spent = start, 0
    for _ in range(EXCHANGES):
        outcome, evaluations = _solve(problem, rays, point, chain, deadline, seed, on_improvement)
        spent += evaluations
        point = outcome.point
        chain = _chain("slsqp") if ALGORITHMS[chain[0]].everywhere else chain
        worse = worse_rays(problem, point, rays, dense)
        if worse is None or time.monotonic() > deadline:
            break
        rays = rays.with_rays(worse)
    dense = dense.with_rays(rays)
    final = problem.evaluate(point, dense)
    ended = Outcome(point, final.objective, final.violation, spent, outcome.stopped_because)
    return _Found(problem, dense, ended), spent


def _chain(algorithm: str) -> tuple[str, ...]:
    """What to run, each from where the one before ended, until one converges.

    SLSQP is the fastest, but at times loses its way in narrow valleys. COBYLA does not, and leaves SLSQP
    the last step.
    """
    if ALGORITHMS[algorithm].everywhere:
        return (algorithm, "slsqp", "cobyla", "slsqp")
    return ("slsqp", "cobyla", "slsqp") if algorithm == "slsqp" else (algorithm,)


def _solve(
    problem: DesignProblem,
    rays: Rays,
    start: Array,
    chain: tuple[str, ...],
    deadline: float,
    seed: int,
    on_improvement: Callable[[float, float, int], None],
) -> tuple[Outcome, int]:
    """Best lens for one working set of rays; a start outside the constraints is first led back inside."""

    def evaluate(point: Array) -> Evaluation:
        return problem.evaluate(point, rays)

    def restore(point: Array) -> Evaluation:
        e = evaluate(point)
        return Evaluation(e.constraints, e.constraints_by, e.constraints[:0], e.constraints_by[:0])

    point, spent = start, 0
    if evaluate(start).violation > FEASIBLE:
        left = max(0.05, deadline - time.monotonic())
        restored = minimize(restore, start, "slsqp", left, max_evaluations=LOCAL_EVALUATIONS)
        point, spent = restored.point, restored.evaluations
    for algorithm in chain:
        everywhere = ALGORITHMS[algorithm].everywhere
        left = max(0.05, deadline - time.monotonic())
        outcome = minimize(
            evaluate,
            point,
            algorithm,
            max_seconds=0.5 * left if everywhere else left,
            max_evaluations=100_000 if everywhere or len(chain) == 1 else LOCAL_EVALUATIONS,
            seed=seed,
            on_improvement=on_improvement,
        )
        spent += outcome.evaluations
        point = outcome.point
        if outcome.converged and not everywhere:
            break
    return outcome, spent


def _result(best: _Found, found: list[_Found], evaluations: int, seconds: float) -> OptimizationResult:
    problem, point = best.problem, best.outcome.point
    specification = problem.specification
    goals, constraints = problem.rows(point, best.rays, final=True)
    lens = finished_lens(problem, point, best.rays)
    violations = [row.miss for row in constraints if np.max(row.values, initial=-1.0) > KEPT]
    target = best.rank[1] * 1.001
    at_best = [f for f in found if f.rank[0] == best.rank[0] and f.rank[1] <= target]
    values: dict[str, float | str | None] = {}
    for v in specification.variables:
        surface = lens.surfaces[(v.surface or 1) - 1]
        if v.parameter == "working_distance_mm":
            values[v.name] = lens.object.working_distance_mm
        elif hasattr(surface, v.parameter):
            values[v.name] = getattr(surface, v.parameter)
        else:
            values[v.name] = surface.shape.term(v.parameter)
    return OptimizationResult(
        lens=lens,
        variables=values,
        goal=specification.optimize.goal,
        goal_value=_goal_value(specification, goals),
        feasible=not violations,
        violations=violations,
        binding=_binding(problem, point, constraints),
        evaluations=evaluations,
        seconds=seconds,
        algorithm=specification.optimize.algorithm,
        stopped_because=best.outcome.stopped_because,
        starts=len(found),
        starts_at_best=len(at_best),
    )


def _goal_value(specification: Specification, goals: list[Row]) -> float:
    """The goal in the unit that people use."""
    largest = max(float(np.max(row.values)) for row in goals)
    if specification.optimize.goal == "smallest spread":
        sines = [
            math.sqrt(float(np.max(row.values))) * min(1.0, w / (2.0 * specification.sensor.pixel_pitch_um))
            for row, w in zip(goals, specification.wavelengths_um, strict=True)
        ]
        return math.degrees(math.asin(min(1.0, max(sines))))
    if specification.optimize.goal == "smallest aperture":
        return math.sqrt(largest) * specification.stop_semi_diameter_mm
    return largest * specification.exit_vertex_z_mm


def _binding(problem: DesignProblem, point: Array, constraints: list[Row]) -> list[str]:
    names = [row.name for row in constraints if np.max(row.values, initial=-1.0) > -BINDING]
    for v, u in zip(problem.ranges, point, strict=True):
        if u < 1e-6 or u > 1.0 - 1e-6:
            names.append(f"{v.name} at its {'lower' if u < 0.5 else 'upper'} bound")
    return names


def _narrator(
    report: Report | None, base: Lens, number: int, specification: Specification, began: float
) -> Callable[[float, float, int], None]:
    """Turns improvements into lines of text, at most ten a second."""
    last = [0.0]
    glasses = " ".join(str(s.material) for s in base.surfaces if s.material is not None)

    def said(objective: float, violation: float, evaluations: int) -> None:
        now = time.monotonic()
        if report is None or now - last[0] < 0.1:
            return
        last[0] = now
        kept = "feasible" if violation <= FEASIBLE else f"violation {violation:.2g}"
        report(
            f"{specification.optimize.goal}, {glasses}, start {number + 1}: {objective:.6f} of reference, "
            f"{kept}, {evaluations} evaluations, {now - began:.1f} s"
        )

    return said
