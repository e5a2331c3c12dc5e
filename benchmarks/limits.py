"""Limits of ten infeasible specifications, five seeds each: whether they are true, and how far seeds differ.

The limit of the field is sought as `lensdesign optimize` and `lensdesign limits` do it. True means that the
lens at the limit passes the check, and that a dense multistart (sixty fresh starts and sixty starts near the
best lens) at 1.01 times the largest limit of all seeds finds no lens; where no limit is found, that sixty
fresh starts find no lens at a hundredth of the field. `--specifications 0,3` measures some of them, `--seeds`
fewer seeds.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

from lensdesign.optimization.limits.limited_quantities import FIELD
from lensdesign.optimization.limits.search import Limit, find_limits
from lensdesign.optimization.local_search import Budget, search_from, starts_of
from lensdesign.optimization.operands.operand import ACCEPTED_VIOLATION
from lensdesign.optimization.problem import DesignProblem
from lensdesign.optimization.specification.choices import bases_of
from lensdesign.optimization.specification.specification import Specification
from lensdesign.optimization.specification_check import check_against

SEEDS, DENSE_STARTS, AGREEMENT = 5, 60, 3e-3


def specification(
    field_mm: float,
    aperture: float,
    glass: str = "N-BK7",
    *,
    pair: bool = False,
    asphere: bool = False,
    sphere: bool = False,
    pixel_um: float = 3.2,
    pixels: tuple[int, int] = (5472, 3648),
    wavelength_um: float = 0.532,
    limits: dict[str, Any] | None = None,
) -> Specification:
    """Return a specification of a singlet or a pair, started from plates."""
    front = {"thickness_mm": 3.0, "material": glass, "semi_diameter_mm": 7.5, "stop": True}
    surfaces: list[dict[str, Any]] = [front, {}]
    variables: list[dict[str, Any]] = [
        {"surface": i, "parameter": "radius_mm", "smallest_radius_mm": 5.0} for i in (1, 2)
    ]
    variables.append({"surface": 1, "parameter": "thickness_mm", "bounds": [1.0, 15.0]})
    if pair:
        surfaces = [front, {"thickness_mm": 0.5}, {"thickness_mm": 3.0, "material": glass}, {}]
        variables += [{"surface": i, "parameter": "radius_mm", "smallest_radius_mm": 5.0} for i in (3, 4)]
        variables += [
            {"surface": 2, "parameter": "thickness_mm", "bounds": [0.1, 5.0]},
            {"surface": 3, "parameter": "thickness_mm", "bounds": [1.0, 12.0]},
        ]
    elif not sphere:
        variables.append({"surface": 2, "parameter": "conic", "bounds": [-5.0, 1.0]})
    if asphere:
        variables.append({"surface": 1, "parameter": "asphere_4", "bounds": [-1e-3, 1e-3]})
    return Specification.model_validate(
        {
            "wavelengths_um": [wavelength_um],
            "object": {
                "field_diameter_mm": field_mm,
                "numerical_aperture": aperture,
                "working_distance_mm": 13.5,
            },
            "sensor": {
                "pixel_pitch_um": pixel_um,
                "pixels": list(pixels),
                "plane_distances_mm": [2.0, 8.0],
            },
            "surface": surfaces,
            "constraints": limits or {},
            "optimize": {"goal": "thinnest lens", "start": "plate", "stop": "numerical aperture"},
            "variable": variables,
        }
    )


SPECIFICATIONS = {
    "N-BK7, conic, 4 mm, NA 0.3": specification(4.0, 0.3),
    "N-BK7, sphere, 3 mm, NA 0.35": specification(3.0, 0.35, sphere=True),
    "N-SF11, conic, 3 mm, NA 0.4": specification(3.0, 0.4, "N-SF11", pixel_um=2.4, pixels=(7000, 5472)),
    "N-BK7, sphere, thin, 1.5 mm, NA 0.5": specification(
        1.5, 0.5, sphere=True, limits={"max_lens_thickness_mm": 6.0}
    ),
    "N-SF11, asphere, 2.5 mm, NA 0.5": specification(2.5, 0.5, "N-SF11", asphere=True, pixel_um=2.4),
    "N-LAK8, conic, 6 mm, NA 0.2": specification(6.0, 0.2, "N-LAK8", wavelength_um=0.633),
    "N-BK7, conic, 0.9 mm, NA 0.6, small sensor": specification(0.9, 0.6, pixels=(2400, 1800), pixel_um=2.0),
    "N-SF11, sphere, 4 mm, NA 0.25": specification(4.0, 0.25, "N-SF11", sphere=True),
    "pair of N-BK7, 4 mm, NA 0.3": specification(4.0, 0.3, pair=True),
    "pair of N-SF11, 4 mm, NA 0.35": specification(4.0, 0.35, "N-SF11", pair=True, pixel_um=2.4),
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Limits of infeasible specifications.")
    parser.add_argument("--specifications", default=",".join(map(str, range(len(SPECIFICATIONS)))))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    arguments = parser.parse_args()
    names = [list(SPECIFICATIONS)[int(number)] for number in arguments.specifications.split(",")]
    print(f"{'largest field':45} {'least':>8} {'largest':>8} {'differ':>8} {'s each':>7}  lens   above")
    for name in names:
        print(measured(name, SPECIFICATIONS[name], arguments.seeds), flush=True)


def measured(name: str, asked: Specification, seeds: int) -> str:
    """Return a row of the table."""
    began = time.perf_counter()
    found = [find_limits(asked, seed=seed, quantities=(FIELD,), most=1.0)[0] for seed in range(seeds)]
    seconds = (time.perf_counter() - began) / seeds
    values = [one.reached for one in found if one.reached is not None]
    if not values:
        above = "FOUND" if any_at(FIELD.changed(asked, 0.01 * FIELD.value_in(asked)), None) else "none"
        return f"{name:45} none found with any seed {seconds:21.1f}         {above}"
    if len(values) < seeds:
        return f"{name:45} none found with {seeds - len(values)} of {seeds} seeds  DIFFER"
    differ = max(values) / min(values) - 1.0
    kept = "passes" if all(passes(asked, one) for one in found) else "FAILS"
    above = "FOUND" if any_above(asked, max(found, key=lambda one: one.reached or 0.0)) else "none"
    missed = "" if differ <= AGREEMENT else "  DIFFER"
    return (
        f"{name:45} {min(values):8.4f} {max(values):8.4f} {100.0 * differ:6.2f} % {seconds:7.1f}  "
        f"{kept} {above}{missed}"
    )


def passes(asked: Specification, limit: Limit) -> bool:
    """Whether the lens at a limit passes the check there."""
    assert limit.lens is not None  # it was reached
    assert limit.reached is not None
    return check_against(limit.lens, FIELD.changed(asked, limit.reached)).feasible


def any_above(asked: Specification, limit: Limit) -> bool:
    """Whether a dense multistart finds a lens for a field 1 % larger than a limit."""
    assert limit.lens is not None  # it was reached
    assert limit.reached is not None
    if 1.01 * limit.reached > FIELD.value_in(asked):
        return False
    return any_at(FIELD.changed(asked, 1.01 * limit.reached), limit)


def any_at(asked: Specification, limit: Limit | None) -> bool:
    """Whether a dense multistart, fresh and near the lens of a limit, finds a lens."""
    settings = asked.optimize.replaced(start="random", starts=DENSE_STARTS)
    asked = asked.model_copy(update={"optimize": settings})
    ((_, base),) = bases_of(asked)
    problem, rng = DesignProblem(asked, base), np.random.default_rng(99)
    points = list(starts_of(problem, 12345))
    if limit is not None and limit.lens is not None:
        known = problem.to_unit(limit.lens)
        spread = 0.1 * rng.standard_normal((DENSE_STARTS, len(known)))
        points += list(np.clip(known + spread, 0.0, 1.0))
    for number, point in enumerate(points):
        budget = Budget(3000)
        found = search_from(problem, point, budget, number, lambda *_: None, only_feasible=True)
        if found.outcome.violation <= ACCEPTED_VIOLATION:
            return True
    return False


if __name__ == "__main__":
    main()
