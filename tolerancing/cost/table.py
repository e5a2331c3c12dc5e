"""Price tables of tolerances, by manufacturing process (TOML)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from lensdesign.common.frozen_model import FrozenModel, Positive
from lensdesign.common.toml_files import read_toml, validate
from lensdesign.errors import InputError

RELATIVE = Path(__file__).with_name("relative.toml")
"""Default table of the package: relative costs, with their sources."""

QUANTITIES = {
    "radius_percent": "largest departure of a radius, in per cent",
    "irregularity_pv_waves": "irregularity of a surface, peak to valley, in waves of 632.8 nm",
    "irregularity_rms_waves": "irregularity of a surface, root mean square, in waves of 632.8 nm",
    "roughness_rms_nm": "roughness of a surface, root mean square, in nm",
    "coating_thickness_percent": "thickness of the films of a coating, in per cent",
    "form_um": "departure of a conic constant or an aspheric term, as sag at the clear semi-diameter",
    "thickness_mm": "centre thickness of a glass element",
    "tilt_deg": "tilt of a surface against its part (wedge), or of a part in its mount",
    "roll_deg": "roll of a part on its seat",
    "runout_mm": "total indicator runout of a surface",
    "edge_difference_mm": "wedge of an element, as difference of its edge thickness",
    "decenter_mm": "decenter of a surface against its part, or of a part in its mount",
    "distance_mm": "air spaces, including those to object and sensor",
    "index": "refractive index of the glass",
    "abbe_percent": "Abbe number of the glass, in per cent",
}
"""Quantities that a process can have prices for."""


class Price(FrozenModel):
    """Price of one tolerance: share * reference / tolerance, relative to a part without tolerances.

    Attributes
    ----------
    reference
        Reference tolerance, in the unit of its quantity.
    share
        Cost of the reference tolerance, as a fraction of the cost of a part without tolerances.
    """

    reference: Positive
    share: Positive


class Process(FrozenModel):
    """Prices of one manufacturing process; other quantities have no price.

    Attributes
    ----------
    source
        Source of the numbers.
    prices
        Prices by the names of `QUANTITIES`.
    """

    source: Annotated[str, Field(min_length=1)]
    prices: Mapping[str, Price]


class CostTable(FrozenModel):
    """Price table of tolerances.

    Attributes
    ----------
    title
        Title of the table.
    default
        Name of the process of elements that `elements` does not list.
    mount
        Name of the process of the mount.
    elements
        Names of processes by the number of the element, counted from 1.
    processes
        Processes by name; the ``[process.NAME]`` tables.
    """

    title: str = ""
    default: str
    mount: str
    elements: Mapping[int, str] = {}
    processes: Mapping[str, Process]

    @model_validator(mode="after")
    def _known(self) -> CostTable:
        named = {"default": self.default, "mount": self.mount}
        named |= {f"elements.{number}": name for number, name in self.elements.items()}
        for key, name in named.items():
            if name not in self.processes:
                allowed = ", ".join(self.processes)
                raise ValueError(f"{key} = {name!r}: there is no such process; allowed: {allowed}")
        for name, process in self.processes.items():
            for quantity in process.prices:
                if quantity not in QUANTITIES:
                    allowed = ", ".join(QUANTITIES)
                    raise ValueError(f"process.{name}.{quantity}: unknown; allowed: {allowed}")
        return self

    def process_of(self, element: int) -> str:
        """Return the name of the process of an element, counted from 0."""
        return self.elements.get(element + 1, self.default)

    def with_processes(self, items: Mapping[int | None, str]) -> CostTable:
        """Return the table with other processes of elements, counted from 1, or of the default (None).

        Raises
        ------
        InputError
            If a process does not exist.
        """
        for name in items.values():
            if name not in self.processes:
                raise InputError(f"process {name!r}: there is none; allowed: {', '.join(self.processes)}")
        own = {number: name for number, name in items.items() if number is not None}
        default = items.get(None, self.default)
        return self.model_copy(update={"default": default, "elements": {**self.elements, **own}})


def load_costs(path: str | os.PathLike[str] | None = None) -> CostTable:
    """Read a price table.

    Parameters
    ----------
    path
        Price table (TOML); default: the table of the package.

    Raises
    ------
    DesignError
        If a key or value is not allowed. The message lists every fault.

    Examples
    --------
    >>> load_costs().default in load_costs().processes
    True
    """
    file = RELATIVE if path is None else Path(path)
    table = read_toml(file)
    processes = {}
    for name, process in (table.pop("process", None) or {}).items():
        prices = dict(process) if isinstance(process, dict) else {}
        source = prices.pop("source", "")
        processes[name] = {"source": source, "prices": prices}
    elements = table.pop("elements", None) or {}
    numbered = {int(k) if str(k).isdigit() else k: v for k, v in elements.items()}
    return validate(CostTable, {**table, "elements": numbered, "processes": processes}, str(file))
