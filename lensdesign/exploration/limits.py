"""How far each of what is asked can be taken: the largest field and aperture, pixel, and tolerances."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens
from lensdesign.optimization.asked.sections import AS_BUILT_GOALS
from lensdesign.optimization.asked.specification import Specification
from lensdesign.optimization.local_search import Budget, search_from
from lensdesign.optimization.problem import DesignProblem
from lensdesign.optimization.rows.row import KEPT
from lensdesign.optimization.search import bases_of, starts_of

FIRST_STEP, MOST = 0.02, 4.0
"""Share by which a value is raised first, doubled each time; and how often the value asked, at most."""

RESOLUTION = 0.002
"""Share of what is asked to which a limit is found."""

EVALUATIONS = 1500
"""Most of one search."""


@dataclass(frozen=True)
class Limit:
    """How far one value can be taken, everything else being as asked.

    Attributes
    ----------
    name, unit
    asked
        What the specification asks for; 1 of tolerances.
    reached
        The largest for which a lens was found; None where the specification itself is not met.
    ended
        Whether more was tried and not met.
    """

    name: str
    unit: str
    asked: float
    reached: float | None
    ended: bool


def find_limits(
    specification: Specification, report: Callable[[str], None] = lambda _: None
) -> tuple[Limit, ...]:
    """Take field, aperture, pixel and, where a yield is asked for, tolerances as far as lenses are found.

    A coarser pixel sees a smaller spread (Eq. 2); the sensor keeps its size. Tolerances are multiplied all
    together, where they are not to cost what the specification says.

    Parameters
    ----------
    specification
    report
        Told what is sought.
    """
    kinds: list[tuple[str, str, float, Callable[[Specification, float], Specification]]] = [
        ("field", "mm", specification.object.field_diameter_mm, _of_object("field_diameter_mm")),
        ("numerical aperture", "", specification.object.numerical_aperture, _of_object("numerical_aperture")),
        ("pixel pitch", "um", specification.sensor.pixel_pitch_um, _with_pitch),
    ]
    tolerances = specification.tolerances
    if specification.constraints.min_yield is not None and tolerances is not None and tolerances.cost is None:
        kinds.append(("tolerances", "times", 1.0, _with_tolerances))
    specification = _without_dear_goal(specification)
    starts = _ends(specification, 1.0, lambda s, _: s)
    return tuple(_limit(specification, *kind, starts, report) for kind in kinds)


def _without_dear_goal(specification: Specification) -> Specification:
    """With another goal in place of one of lenses as built: constraints alone are to be met."""
    if specification.optimize.goal not in AS_BUILT_GOALS:
        return specification
    settings = specification.optimize.replaced(goal="thinnest lens")
    return specification.model_copy(update={"optimize": settings})


def _of_object(key: str) -> Callable[[Specification, float], Specification]:
    def changed(specification: Specification, value: float) -> Specification:
        scene = specification.object.replaced(**{key: value})
        return specification.model_copy(update={"object": scene})

    return changed


def _with_pitch(specification: Specification, pitch_um: float) -> Specification:
    sensor = specification.sensor
    pixels = tuple(max(1, round(n * sensor.pixel_pitch_um / pitch_um)) for n in sensor.pixels)
    return specification.model_copy(
        update={"sensor": sensor.replaced(pixel_pitch_um=pitch_um, pixels=pixels)}
    )


def _with_tolerances(specification: Specification, factor: float) -> Specification:
    assert specification.tolerances is not None  # a yield is asked for
    tolerances = specification.tolerances.replaced(factor=factor)
    return specification.model_copy(update={"tolerances": tolerances})


@dataclass(frozen=True, eq=False)
class _End:
    """A lens that was found, as a point of the box of one choice of glasses."""

    number: int
    point: Array


def _limit(
    specification: Specification,
    name: str,
    unit: str,
    asked: float,
    changed: Callable[[Specification, float], Specification],
    starts: list[_End],
    report: Callable[[str], None],
) -> Limit:
    if not starts:
        return Limit(name, unit, asked, None, True)
    low, high, near, step = asked, math.inf, starts, FIRST_STEP
    while high == math.inf and low < MOST * asked:
        value = min(asked * (1.0 + step), MOST * asked)
        report(f"{name}: {value:.4g} {unit}")
        found = _ends(specification, value, changed, near)
        low, near, high = (value, found, high) if found else (low, near, value)
        step *= 2.0
    while high - low > RESOLUTION * asked and high < math.inf:
        middle = 0.5 * (low + high)
        report(f"{name}: {middle:.4g} {unit}")
        found = _ends(specification, middle, changed, near)
        low, near, high = (middle, found, high) if found else (low, near, middle)
    return Limit(name, unit, asked, low, high < math.inf)


def _ends(
    specification: Specification,
    value: float,
    changed: Callable[[Specification, float], Specification],
    near: list[_End] | None = None,
) -> list[_End]:
    """Lenses that meet the changed specification, one for each choice of glasses that has one."""
    try:
        asked = changed(specification, value)
        bases = list(bases_of(asked))
    except (DesignError, ValueError):
        return []  # a numerical aperture above 1, say
    found = []
    numbers = range(len(bases)) if near is None else [end.number for end in near]
    for order, number in enumerate(numbers):
        problem = DesignProblem(asked, _scaled_stop(asked, bases[number][1], specification))
        points = [near[order].point] if near is not None else _starts(problem)
        for point in points:
            one = search_from(problem, point, Budget(EVALUATIONS), 0, lambda *_: None, only_feasible=True)
            if one.outcome.violation <= KEPT:
                found.append(_End(number, one.outcome.point))
                break
    return found


def _starts(problem: DesignProblem) -> list[Array]:
    points = []
    for point in starts_of(problem, 0):
        points.append(np.asarray(point))
        if len(points) == 3:
            break
    return points


def _scaled_stop(asked: Specification, base: Lens, before: Specification) -> Lens:
    """The lens with a fixed stop as much larger as the aperture is."""
    apertures = [s.object.numerical_aperture for s in (asked, before)]
    if asked.optimize.stop != "fixed" or apertures[0] == apertures[1]:
        return base
    after, first = (math.tan(math.asin(aperture)) for aperture in apertures)
    return base.with_surface(base.stop_index, semi_diameter_mm=after / first * base.stop_semi_diameter_mm)
