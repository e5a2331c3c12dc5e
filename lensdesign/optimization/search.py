"""Optimize a lens to a specification: choices of glasses, and starts until several agree."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.registry import class_with
from lensdesign.optimization.asked.specification import Specification, refuse_impossible
from lensdesign.optimization.local_search import Budget, search_from
from lensdesign.optimization.nlopt_driver import FEASIBLE, UNTRACEABLE
from lensdesign.optimization.problem import DesignProblem
from lensdesign.optimization.result import OptimizationResult, Tried, result_of

Report = Callable[[str], None]


def optimize(specification: Specification, report: Report | None = None, seed: int = 0) -> OptimizationResult:
    """Search for the lens that a specification asks for.

    Every start is a local search over a working set of rays, to which the worst rays of a dense check
    are added until none is worse (an exchange method). Each choice of glasses is searched from as many
    starts as it takes until several agree, at most those of the specification, and has a share of its own
    of every limit. What was found is held against the specification by other means in the end.

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
    settings = specification.optimize
    end = math.inf if settings.max_seconds is None else began + settings.max_seconds
    tried = []
    bases = list(bases_of(specification))
    for number, (glasses, base) in enumerate(bases):
        now = time.monotonic()
        budget = Budget(settings.max_evaluations, now + (end - now) / (len(bases) - number))
        tried.append(_try(glasses, DesignProblem(specification, base), budget, seed, report, began))
    if not any(t.found for t in tried):
        raise DesignError(_nothing_tried(tried))
    return result_of(specification, tried, began)


def _nothing_tried(tried: list[Tried]) -> str:
    limits = {t.limit for t in tried} - {""}
    if limits:
        return f"no start was made: {' and '.join(sorted(limits))} left no room for one; raise it"
    return "no start can be traced: no drawn lens lets all rays through; narrow the bounds"


def _try(
    glasses: str, problem: DesignProblem, budget: Budget, seed: int, report: Report | None, began: float
) -> Tried:
    """One choice of glasses: starts until several agree."""
    settings = problem.specification.optimize
    tried = Tried(glasses, (), "")
    for number, start in enumerate(starts_of(problem, seed)):
        if budget.used_up:
            return replace(tried, limit=budget.used_up)
        said = _narrator(report, glasses, number, settings.goal, began)
        found = search_from(problem, start, budget, seed + number, said)
        tried = Tried(glasses, (*tried.found, found), found.limit)
        if tried.at_best >= settings.agreeing:
            return replace(tried, limit="")
    return tried


def bases_of(specification: Specification) -> Iterator[tuple[str, Lens]]:
    """The start with each combination of glasses and stops, and what to call it."""
    choices = [v for v in specification.variables if v.discrete]
    for choice in itertools.product(*(v.choices for v in choices)):
        lens = specification.lens
        for variable, chosen in zip(choices, choice, strict=True):
            if variable.parameter == "stop":
                lens = with_stop(lens, int(chosen) - 1)
            else:
                lens = lens.with_surface((variable.surface or 1) - 1, material=chosen)
        name = ", ".join(str(s.material) for s in lens.surfaces if s.material is not None)
        if any(v.parameter == "stop" for v in choices):
            name += f", stop on surface {lens.stop_index + 1}"
        yield name, lens


def with_stop(lens: Lens, surface: int) -> Lens:
    """The lens with its stop, and that stop's size, on another surface, counted from 0."""
    if surface == lens.stop_index:
        return lens
    semi = lens.surfaces[surface].semi_diameter_mm or lens.stop_semi_diameter_mm
    surfaces = [
        s.model_copy(update={"stop": i == surface, "semi_diameter_mm": semi if i == surface else None})
        if i in (surface, lens.stop_index)
        else s
        for i, s in enumerate(lens.surfaces)
    ]
    return lens.replaced(surfaces=tuple(surfaces))


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


def _narrator(
    report: Report | None, glasses: str, number: int, goal: str, began: float
) -> Callable[[float, float, int], None]:
    """Turns improvements into lines of text, at most ten a second."""
    last = [0.0]

    def said(objective: float, violation: float, evaluations: int) -> None:
        now = time.monotonic()
        if report is None or now - last[0] < 0.1:
            return
        last[0] = now
        kept = "feasible" if violation <= FEASIBLE else f"violation {violation:.2g}"
        report(
            f"{goal}, {glasses}, start {number + 1}: {objective:.6f} of reference, "
            f"{kept}, {evaluations} evaluations, {now - began:.1f} s"
        )

    return said
