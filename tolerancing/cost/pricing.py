"""What the tolerances of a study cost, line by line, with derivatives."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.cost.table import CostTable
from tolerancing.perturbations.batch import radius_delta_mm
from tolerancing.perturbations.parameters import (
    EDGE_DIFFERENCES,
    IRREGULARITIES,
    RADII,
    ROLLS,
    RUNOUTS,
    TILTS,
    PerturbedParameter,
)
from tolerancing.study.study import Study

CONDITIONS = ("light", "environment")
"""Targets that nobody makes: they scatter at no cost."""


@dataclass(frozen=True)
class CostLine:
    """What one tolerance costs.

    Attributes
    ----------
    perturbation
        Its column in the study.
    process, quantity
        By which it is priced; empty for what nobody makes.
    tolerance
        In the unit of the quantity.
    cost
        Relative to a part without tolerances.
    slope
        Derivative of the cost by the tolerance in the unit of the study's column.
    """

    perturbation: str
    process: str
    quantity: str
    tolerance: float
    cost: float
    slope: float


@dataclass(frozen=True)
class Cost:
    """What all tolerances of a study cost, over a lens of as many elements without.

    Attributes
    ----------
    lines
        In the order of the study's perturbations.
    elements
        Number of glass elements; each costs 1 by itself.
    """

    lines: tuple[CostLine, ...]
    elements: int

    @property
    def total(self) -> float:
        """Elements and tolerances together."""
        return self.elements + sum(line.cost for line in self.lines)

    @property
    def gradient(self) -> Array:
        """Derivatives of the total by the tolerances, shape (perturbations,), in units of their columns."""
        return np.array([line.slope for line in self.lines])

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"total": self.total, "elements": self.elements, "lines": [vars(line) for line in self.lines]}


def cost_of(study: Study, lens: Lens, table: CostTable, tolerances: ArrayLike | None = None) -> Cost:
    """What a study's tolerances cost.

    A tolerance along x and the same along y are one for the shop: each has half the cost.

    Parameters
    ----------
    study, lens
        What scatters of which lens.
    table
        From :func:`load_costs`.
    tolerances : array_like, shape (perturbations,), optional
        In place of the study's own: largest deviations, in the units of its columns, above 0.

    Raises
    ------
    InputError
        If the table has no price for a tolerance; all gaps are named. If a tolerance is not above 0.
    """
    own = [p.tolerance for p in study.perturbations] if tolerances is None else tolerances
    values = np.asarray(own, float)
    if values.shape != (len(study.perturbations),) or not np.all(np.isfinite(values) & (values > 0.0)):
        raise InputError("tolerances: must be one for each perturbation, finite and above 0")
    priced = [(p, *_priced_by(p, lens, table)) for p in study.perturbations]
    _refuse_gaps(table, priced)
    alike = Counter((p.target, quantity) for p, quantity, _ in priced if _is_axis(p))
    lines = []
    for (p, quantity, process), value in zip(priced, values.tolist(), strict=True):
        if not quantity:
            lines.append(CostLine(p.column, "", "", value, 0.0, 0.0))
            continue
        price, share = table.processes[process].prices[quantity], 1.0 / max(alike[p.target, quantity], 1)
        tolerance = value * _unit(p, quantity, lens)
        cost = share * price.share * price.reference / tolerance
        lines.append(CostLine(p.column, process, quantity, tolerance, cost, -cost / value))
    return Cost(tuple(lines), len(lens.glass_fronts))


def _refuse_gaps(table: CostTable, priced: Sequence[tuple[PerturbedParameter, str, str]]) -> None:
    gaps = dict.fromkeys(
        f"process.{process} has no {quantity}, for {p.column}"
        for p, quantity, process in priced
        if quantity and quantity not in table.processes[process].prices
    )
    if gaps:
        raise InputError(f"cost table {table.title!r}: {'; '.join(gaps)}")


def _priced_by(parameter: PerturbedParameter, lens: Lens, table: CostTable) -> tuple[str, str]:
    """Quantity and process by which a tolerance is priced; spaces of air are the mount's."""
    quantity, of_part = _quantity(parameter), None
    if quantity == "edge_difference_mm":
        of_part = parameter.element
    if parameter.surface is not None:
        i = parameter.surface
        if quantity == "distance_mm" or (quantity == "thickness_mm" and lens.surfaces[i].material is None):
            return "distance_mm", table.mount
        of_part = next((n for n, front in enumerate(lens.glass_fronts) if i in (front, front + 1)), None)
    return quantity, table.mount if of_part is None else table.process_of(of_part)


def _quantity(parameter: PerturbedParameter) -> str:
    """By which of the table's quantities a tolerance is priced; empty for a condition."""
    name = parameter.parameter
    if parameter.target in CONDITIONS:
        return ""
    if name in RADII:
        return "radius_percent"
    if name in RUNOUTS:
        return "runout_mm"
    if name in EDGE_DIFFERENCES:
        return "edge_difference_mm"
    if name in TILTS:
        return "tilt_deg"
    if name in ROLLS:
        return "roll_deg"
    if name.startswith("decenter"):
        return "decenter_mm"
    if name in (*IRREGULARITIES, "thickness_mm", "index", "abbe_percent"):
        return name
    return "distance_mm" if name.endswith("_mm") else "form_um"


def _unit(parameter: PerturbedParameter, quantity: str, lens: Lens) -> float:
    """A unit of the study's column in units of the quantity."""
    name = parameter.parameter
    if parameter.surface is None:
        return 1.0
    surface = lens.surfaces[parameter.surface]
    if name in RADII:
        change = float(radius_delta_mm(lens, parameter.surface, name, np.array(1.0)))
        return abs(100.0 * change / getattr(surface, RADII[name]))
    if quantity != "form_um":
        return 1.0
    h = surface.semi_diameter_mm
    if h is None:
        raise InputError(
            f"{parameter.column}: the surface has no semi_diameter_mm at which to count its form"
        )
    if name.startswith("asphere_"):
        return 1e3 * h ** int(name.removeprefix("asphere_"))
    radius = surface.radius_x_mm if name == "conic_x" else surface.radius_mm
    if radius is None:
        raise InputError(f"{parameter.column}: of a plane, which has no form to count")
    return 1e3 * h**4 / (8.0 * abs(radius) ** 3)


def _is_axis(parameter: PerturbedParameter) -> bool:
    """Whether it is one of two directions across the axis."""
    return "_x_" in parameter.parameter or "_y_" in parameter.parameter
