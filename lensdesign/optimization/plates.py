"""Test plates that a shop has: spheres get their radii one by one, and the rest is optimized again."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lensdesign.analysis.report import CheckReport
from lensdesign.common.input_files import TOML_BYTES
from lensdesign.common.tables import read_list, read_number
from lensdesign.common.toml_files import read_toml
from lensdesign.errors import DesignError, InputError
from lensdesign.lens.lens import Lens
from lensdesign.optimization.compliance import check_against
from lensdesign.optimization.result import OptimizationResult
from lensdesign.optimization.search import optimize
from lensdesign.optimization.specification.specification import Specification
from lensdesign.optimization.specification.variables import VariableRange

Report = Callable[[str], None]


@dataclass(frozen=True)
class FittedSurface:
    """A surface whose radius is that of a plate.

    Attributes
    ----------
    surface
        Counted from 1.
    radius_mm
        That the search had found last.
    plate_mm
        Radius of the plate, with the surface's sign.
    """

    surface: int
    radius_mm: float
    plate_mm: float


@dataclass(frozen=True, eq=False)
class PlateFit:
    """A lens whose spheres are those of test plates.

    Attributes
    ----------
    lens
        What was found.
    fitted
        Surfaces, in the order in which they were fitted.
    before, after
        The searches before the first and after the last fit; the latter None where no variable was left.
    check
        The lens held against its specification.
    unfinished
        A sentence for each thing that a limit cut short in one of the searches.
    """

    lens: Lens
    fitted: tuple[FittedSurface, ...]
    before: OptimizationResult
    after: OptimizationResult | None
    check: CheckReport
    unfinished: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """As plain data, without the lens."""
        return {
            "fitted": [vars(one) for one in self.fitted],
            "goal": self.before.goal,
            "goal_unit": self.before.goal_unit,
            "goal_before": self.before.goal_value,
            "goal_after": None if self.after is None else self.after.goal_value,
            "feasible": self.check.feasible,
            "violations": list(self.check.violations),
            "unfinished": list(self.unfinished),
        }


def load_plates(path: str | os.PathLike[str]) -> tuple[float, ...]:
    """Radii of test plates in mm, from a TOML file (``radii_mm = [...]``) or a list, one a line, of another.

    Signs do not count, a pair has both. In a list a remark may follow a number, after a comma, semicolon or
    #; lines with two numbers or a decimal comma are refused.

    Raises
    ------
    InputError
        If it cannot be read, or holds something else than radii above 0.
    """
    file = Path(path)
    if file.suffix == ".toml":
        held = read_toml(file)
        listed = held.get("radii_mm")
        if not isinstance(listed, list) or set(held) != {"radii_mm"}:
            raise DesignError(f"{file}: must hold radii_mm, a list of radii, and nothing else")
        places = [f"{file}, radii_mm, number {n}" for n in range(1, len(listed) + 1)]
        items = [
            (read_number(str(item), where, "radius"), where)
            for item, where in zip(listed, places, strict=True)
        ]
    else:
        items = read_list(file, "radius", TOML_BYTES)
    if not items:
        raise InputError(f"{file}: holds no radius")
    return tuple(sorted({_magnitude(value, where) for value, where in items}))


def _magnitude(value: float, where: str) -> float:
    if not 0.0 < abs(value) < math.inf:
        raise InputError(f"{where}: {value:g}: must be a radius in mm, finite and not 0")
    return abs(value)


def fit_plates(
    specification: Specification, plates_mm: Sequence[float], report: Report | None = None, seed: int = 0
) -> PlateFit:
    """The lens that a specification asks for, its spheres of radii that test plates have.

    The lens is searched for; then of the spheres whose radius may vary that is fitted whose rim moves
    least, and all that is left is searched again from there, until none is left to fit. Conics and aspheres
    have no plates and stay variable, planes need none.

    Parameters
    ----------
    specification
        What is asked.
    plates_mm
        Radii, without signs.
    report, seed
        As of :func:`lensdesign.optimization.optimize`.

    Raises
    ------
    InputError
        If there is no plate, or no sphere whose radius may vary.
    DesignError
        As of :func:`lensdesign.optimization.optimize`; or if a surface with its plate is no lens's.
    """
    plates = sorted(abs(radius) for radius in plates_mm)
    if not plates:
        raise InputError("plates: there is none")
    waiting = [v for v in specification.variables if _is_sphere(specification, v)]
    if not waiting:
        raise InputError("no sphere has a radius that may vary: conics and aspheres have no test plates")
    before = optimize(specification, report, seed)
    lens, fitted = before.lens, list[FittedSurface]()
    left = [v for v in specification.variables if v.parameter != "material"]
    result: OptimizationResult | None = before
    unfinished = list(before.unfinished)
    while waiting:
        moves = [(_move_mm(lens, v, plates), n) for n, v in enumerate(waiting)]
        variable = waiting.pop(min(moves)[1])
        left.remove(variable)
        i = (variable.surface or 1) - 1
        radius = lens.surfaces[i].radius_mm
        if radius is None:
            continue
        plate = math.copysign(nearest_plate_mm(radius, plates), radius)
        fitted.append(FittedSurface(i + 1, radius, plate))
        lens = lens.with_surface(i, radius_mm=plate)
        result = None
        if left:
            result = optimize(_rest(specification, lens, left), report, seed)
            lens = result.lens
            unfinished += result.unfinished
    check = check_against(lens, specification)
    return PlateFit(lens, tuple(fitted), before, result, check, tuple(unfinished))


def nearest_plate_mm(radius_mm: float, plates_mm: Sequence[float]) -> float:
    """The plate whose curvature is nearest to that of a radius; without a sign."""
    return min(plates_mm, key=lambda plate: abs(1.0 / plate - 1.0 / abs(radius_mm)))


def _is_sphere(specification: Specification, variable: VariableRange) -> bool:
    """Whether it is the radius of a surface that is a sphere and stays one."""
    if variable.parameter != "radius_mm" or variable.surface is None:
        return False
    surface = specification.surfaces[variable.surface - 1]
    bent = {v.parameter for v in specification.variables if v.surface == variable.surface}
    formed = any(name == "conic" or name.startswith(("asphere", "conic_x", "radius_x")) for name in bent)
    return surface.kind in ("plane", "sphere") and not formed


def _move_mm(lens: Lens, variable: VariableRange, plates: Sequence[float]) -> float:
    """How far the rim of a surface moves if it takes its nearest plate; a plane's does not."""
    surface = lens.surfaces[(variable.surface or 1) - 1]
    if surface.radius_mm is None:
        return 0.0
    away = abs(1.0 / nearest_plate_mm(surface.radius_mm, plates) - 1.0 / abs(surface.radius_mm))
    return 0.5 * away * (surface.semi_diameter_mm or 1.0) ** 2


def _rest(specification: Specification, lens: Lens, left: Sequence[VariableRange]) -> Specification:
    """What remains to be searched, from a lens on; apertures are worked out anew where they were."""
    surfaces = tuple(
        found.replaced(semi_diameter_mm=asked.semi_diameter_mm)
        for found, asked in zip(lens.surfaces, specification.surfaces, strict=True)
    )
    return specification.replaced(
        surfaces=surfaces,
        object=lens.object,
        variables=tuple(left),
        optimize=specification.optimize.replaced(start="design", starts=1),
    )
