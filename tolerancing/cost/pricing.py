"""Cost of the tolerances of a study, line by line, with derivatives."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.glass import is_gap
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import length_power
from tolerancing.cost.table import CostTable
from tolerancing.perturbations.batch import radius_delta_mm
from tolerancing.perturbations.parameters import (
    COATING_THICKNESS,
    EDGE_DIFFERENCES,
    IRREGULARITIES,
    RADII,
    ROLLS,
    ROUGHNESS,
    RUNOUTS,
    SHAPE_PARAMETERS,
    TILTS,
    PerturbedParameter,
)
from tolerancing.study.study import Study


@dataclass(frozen=True)
class CostLine:
    """Cost of one tolerance.

    Attributes
    ----------
    perturbation
        Column of the perturbation in the study.
    process, quantity
        Process and quantity that set the price; empty for operating conditions, which cost nothing.
    tolerance
        Tolerance in the unit of the quantity.
    cost
        Cost relative to a part without tolerances.
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
    """Cost of a lens with all tolerances of a study.

    Attributes
    ----------
    lines
        Costs of the tolerances, in the order of the study's perturbations.
    elements
        Number of glass elements. An element without tolerances costs 1.
    """

    lines: tuple[CostLine, ...]
    elements: int

    @property
    def total(self) -> float:
        """Cost of elements and tolerances."""
        return self.elements + sum(line.cost for line in self.lines)

    @property
    def gradient(self) -> Array:
        """Derivatives of the total by the tolerances, shape (perturbations,), in units of their columns."""
        return np.array([line.slope for line in self.lines])

    def as_dict(self) -> dict[str, Any]:
        """Return the cost as a dictionary for JSON."""
        return {"total": self.total, "elements": self.elements, "lines": [vars(line) for line in self.lines]}


def cost_of(study: Study, lens: Lens, table: CostTable, tolerances: ArrayLike | None = None) -> Cost:
    """Return the cost of a study's tolerances.

    Equal tolerances along x and y are one requirement in manufacture, so each has half the cost.

    Parameters
    ----------
    study
        The study with the perturbations.
    lens
        The nominal lens.
    table
        Price table from :func:`tolerancing.cost.table.load_costs`.
    tolerances : array_like, shape (perturbations,), optional
        Largest deviations in the units of the columns, above 0; default: the tolerances of the study.

    Raises
    ------
    InputError
        If the table has no price for a tolerance (the message lists all of them), or if a tolerance is not
        above 0.

    Examples
    --------
    >>> from tolerancing.cost.table import load_costs
    >>> from tolerancing.study.files import load_study
    >>> loaded = load_study("designs/paper_tolerances.toml")
    >>> cost_of(loaded.study, loaded.lens, load_costs()).total > 1.0
    True
    """
    own = [p.tolerance for p in study.perturbations] if tolerances is None else tolerances
    values = np.asarray(own, float)
    if values.shape != (len(study.perturbations),) or not np.all(np.isfinite(values) & (values > 0.0)):
        raise InputError("tolerances: must be one for each perturbation, finite and above 0")
    priced = [(p, *_priced_by(p, lens, table)) for p in study.perturbations]
    _check_prices(table, priced)
    pairs = Counter((p.target, quantity) for p, quantity, _ in priced if _is_axis(p))
    lines = []
    for (p, quantity, process), value in zip(priced, values.tolist(), strict=True):
        if not quantity:
            lines.append(CostLine(p.column, "", "", value, 0.0, 0.0))
            continue
        price, fraction = table.processes[process].prices[quantity], 1.0 / max(pairs[p.target, quantity], 1)
        tolerance = value * _unit(p, quantity, lens)
        cost = fraction * price.share * price.reference / tolerance
        lines.append(CostLine(p.column, process, quantity, tolerance, cost, -cost / value))
    return Cost(tuple(lines), len(lens.glass_fronts))


def _check_prices(table: CostTable, priced: Sequence[tuple[PerturbedParameter, str, str]]) -> None:
    missing = dict.fromkeys(
        f"process.{process} has no {quantity}, for {p.column}"
        for p, quantity, process in priced
        if quantity and quantity not in table.processes[process].prices
    )
    if missing:
        raise InputError(f"cost table {table.title!r}: {'; '.join(missing)}")


def _priced_by(parameter: PerturbedParameter, lens: Lens, table: CostTable) -> tuple[str, str]:
    """Return the quantity and process that set the price of a tolerance; air spaces belong to the mount."""
    quantity, element = _quantity(parameter), None
    if quantity == "edge_difference_mm":
        element = parameter.element
    if parameter.surface is not None:
        i = parameter.surface
        if quantity == "distance_mm" or (quantity == "thickness_mm" and is_gap(lens.surfaces[i].material)):
            return "distance_mm", table.mount
        element = next((n for n, front in enumerate(lens.glass_fronts) if i in (front, front + 1)), None)
    return quantity, table.mount if element is None else table.process_of(element)


def _quantity(parameter: PerturbedParameter) -> str:
    """Return the quantity of the table that prices a tolerance; empty for operating conditions."""
    name = parameter.parameter
    if parameter.target in ("light", "environment"):
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
    if name in (*IRREGULARITIES, ROUGHNESS, COATING_THICKNESS, "thickness_mm", "index", "abbe_percent"):
        return name
    return "form_um" if name in SHAPE_PARAMETERS else "distance_mm"


def _unit(parameter: PerturbedParameter, quantity: str, lens: Lens) -> float:
    """Return one unit of the study's column in units of the quantity."""
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
            f"{parameter.column}: the surface has no semi_diameter_mm, to which its form refers; give it one"
        )
    if not name.startswith("conic"):  # the coefficient of a polynomial, or of a power of the radial height
        return 1e3 * h ** (1 - length_power(name))
    radius = surface.radius_x_mm if name == "conic_x" else surface.radius_mm
    if radius is None:
        raise InputError(f"{parameter.column}: the surface is a plane, which has no form tolerance")
    return 1e3 * h**4 / (8.0 * abs(radius) ** 3)


def _is_axis(parameter: PerturbedParameter) -> bool:
    """Return whether a parameter is along one of the two lateral directions."""
    return "_x_" in parameter.parameter or "_y_" in parameter.parameter
