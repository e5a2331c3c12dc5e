"""Fit to test plates: spheres take radii of plates one by one, and the other variables are reoptimized."""

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
from lensdesign.lens.shapes.registry import parameters
from lensdesign.optimization.result import OptimizationResult
from lensdesign.optimization.search import optimize
from lensdesign.optimization.specification.specification import Specification
from lensdesign.optimization.specification.variables import VariableRange
from lensdesign.optimization.specification_check import check_against

Report = Callable[[str], None]


@dataclass(frozen=True)
class FittedSurface:
    """A surface whose radius is that of a test plate.

    Attributes
    ----------
    surface
        Number of the surface, from 1.
    radius_mm
        Radius before the fit.
    plate_mm
        Radius of the plate, with the sign of the surface.
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
        The fitted lens.
    fitted
        Fitted surfaces, in the order of the fits.
    before, after
        Results of the searches before the first and after the last fit; the latter is None if no variable was
        left.
    check
        Check of the lens against its specification.
    unfinished
        A sentence for each step that a limit has shortened in one of the searches.
    """

    lens: Lens
    fitted: tuple[FittedSurface, ...]
    before: OptimizationResult
    after: OptimizationResult | None
    check: CheckReport
    unfinished: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, without the lens."""
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
    """Read the radii of test plates in mm.

    Parameters
    ----------
    path
        A TOML file (``radii_mm = [...]``), or a text file with one radius per line. Signs are ignored, since
        test plates come in pairs. In a text file, a remark may follow a number after a comma, semicolon or #.

    Returns
    -------
    tuple of float
        The radii without signs, in increasing order.

    Raises
    ------
    InputError
        If the file cannot be read, or contains anything other than finite radii that are not 0.
    """
    file = Path(path)
    if file.suffix == ".toml":
        tables = read_toml(file)
        listed = tables.get("radii_mm")
        if not isinstance(listed, list) or set(tables) != {"radii_mm"}:
            raise DesignError(f"{file}: must hold radii_mm, a list of radii, and nothing else")
        locations = [f"{file}, radii_mm, number {n}" for n in range(1, len(listed) + 1)]
        items = [
            (read_number(str(item), location, "radius"), location)
            for item, location in zip(listed, locations, strict=True)
        ]
    else:
        items = read_list(file, "radius", TOML_BYTES)
    if not items:
        raise InputError(f"{file}: holds no radius; give at least one")
    return tuple(sorted({_magnitude(value, location) for value, location in items}))


def _magnitude(value: float, location: str) -> float:
    if not 0.0 < abs(value) < math.inf:
        raise InputError(f"{location}: {value:g}: must be a radius in mm, finite and not 0")
    return abs(value)


def fit_plates(
    specification: Specification, plates_mm: Sequence[float], report: Report | None = None, seed: int = 0
) -> PlateFit:
    """Optimize a lens to a specification with spheres that have the radii of test plates.

    First the lens is optimized. Then the variable sphere whose rim moves least takes the radius of its
    nearest plate, and the remaining variables are optimized again, until all spheres are fitted. Conics and
    aspheres have no plates and stay variable. Planes need no plate.

    Parameters
    ----------
    specification
        Start lens, variables, goal and constraints.
    plates_mm
        Radii of the plates; signs are ignored.
    report
        Progress callback, called with a line of text at each improvement (default: none).
    seed
        Seed of the random starts.

    Returns
    -------
    PlateFit

    Raises
    ------
    InputError
        If there is no plate, or no sphere with a variable radius.
    DesignError
        If an optimization fails, or a surface with the radius of its plate is not valid.
    """
    plates = sorted(abs(radius) for radius in plates_mm)
    if not plates:
        raise InputError("plates: there is none; give at least one radius")
    waiting = [v for v in specification.variables if _is_sphere(specification, v)]
    if not waiting:
        raise InputError("no sphere has a radius that may vary: conics and aspheres have no test plates")
    before = optimize(specification, report, seed)
    lens, fitted = before.lens, list[FittedSurface]()
    remaining = [v for v in specification.variables if v.parameter != "material"]
    result: OptimizationResult | None = before
    unfinished = list(before.unfinished)
    while waiting:
        moves = [(_move_mm(lens, v, plates), n) for n, v in enumerate(waiting)]
        variable = waiting.pop(min(moves)[1])
        remaining.remove(variable)
        i = (variable.surface or 1) - 1
        radius = lens.surfaces[i].radius_mm
        if radius is None:
            continue
        plate = math.copysign(nearest_plate_mm(radius, plates), radius)
        fitted.append(FittedSurface(i + 1, radius, plate))
        lens = lens.with_surface(i, radius_mm=plate)
        result = None
        if remaining:
            result = optimize(_remaining_specification(specification, lens, remaining), report, seed)
            lens = result.lens
            unfinished += result.unfinished
    check = check_against(lens, specification)
    return PlateFit(lens, tuple(fitted), before, result, check, tuple(unfinished))


def nearest_plate_mm(radius_mm: float, plates_mm: Sequence[float]) -> float:
    """Return the radius of the plate whose curvature is nearest to that of a radius, without a sign."""
    return min(plates_mm, key=lambda plate: abs(1.0 / plate - 1.0 / abs(radius_mm)))


def _is_sphere(specification: Specification, variable: VariableRange) -> bool:
    """Return whether a variable is the radius of a surface that is and stays a sphere."""
    if variable.parameter != "radius_mm" or variable.surface is None:
        return False
    surface = specification.surfaces[variable.surface - 1]
    bent = {v.parameter for v in specification.variables if v.surface == variable.surface}
    formed = any(name in parameters() and name != "radius_mm" for name in bent)
    return surface.kind in ("plane", "sphere") and not formed


def _move_mm(lens: Lens, variable: VariableRange, plates: Sequence[float]) -> float:
    """Return the displacement of the rim of a surface that takes its nearest plate; 0 for a plane."""
    surface = lens.surfaces[(variable.surface or 1) - 1]
    if surface.radius_mm is None:
        return 0.0
    away = abs(1.0 / nearest_plate_mm(surface.radius_mm, plates) - 1.0 / abs(surface.radius_mm))
    return 0.5 * away * (surface.semi_diameter_mm or 1.0) ** 2


def _remaining_specification(
    specification: Specification, lens: Lens, remaining: Sequence[VariableRange]
) -> Specification:
    """Return the specification of the next search; free semi-diameters stay free."""
    surfaces = tuple(
        found.replaced(semi_diameter_mm=specified.semi_diameter_mm)
        for found, specified in zip(lens.surfaces, specification.surfaces, strict=True)
    )
    return specification.replaced(
        surfaces=surfaces,
        object=lens.object,
        variables=tuple(remaining),
        optimize=specification.optimize.replaced(start="design", starts=1),
    )
