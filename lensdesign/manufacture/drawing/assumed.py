"""Tolerances of a sheet from the file that they were assumed in: a tolerance study, or its budget.

Of such a TOML file the ``[[perturbation]]`` tables are read: ``target``, ``parameter``, and the largest
deviation that counts as allowed, which is ``limit``, else ``half_width``, else two ``sigma``; that of an
irregularity is counted from nothing, ``mean`` included. What is no matter of the part, or not for a sheet
to say, is named.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, ValidationError

from lensdesign.common.section import Finite, Positive, Section
from lensdesign.common.toml_files import read_toml
from lensdesign.errors import DesignError
from lensdesign.lens.figure_source import TEST_WAVELENGTH_UM
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import mechanical_semi_diameter_mm
from lensdesign.manufacture.drawing.tolerances import GENERAL_MARK, DrawingTolerances, SurfaceTolerances

FRINGES_PER_WAVE = 2.0
"""A fringe spacing is half a wavelength of sag."""

Values = dict[str, float]


class _Assumed(Section):
    """What is read of one ``[[perturbation]]`` table."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    target: Annotated[str, Field(max_length=60)]
    parameter: Annotated[str, Field(max_length=60)]
    mean: Finite = 0.0
    sigma: Positive | None = None
    limit: Positive | None = None
    half_width: Positive | None = None

    @property
    def name(self) -> str:
        return f"{self.target} {self.parameter}"

    @property
    def tolerance(self) -> float | None:
        """Largest deviation; None of a distribution that states none."""
        spread = None if self.sigma is None else 2.0 * self.sigma
        largest = next((v for v in (self.limit, self.half_width, spread) if v is not None), None)
        if largest is None or not self.parameter.startswith("irregularity"):
            return largest
        return abs(self.mean) + largest


@dataclass
class AssumedTolerances:
    """What a study or budget assumed of the elements of a lens.

    Attributes
    ----------
    elements
        For each element the values of its sheet by name.
    surfaces
        For each surface of the lens the values of its column by name.
    left_out
        What no sheet says, in words.
    source
        Name of the file.
    design
        Design file that it names, relative to it; empty where it names none.
    is_study
        Whether the file holds limits, by which a yield can be predicted.
    """

    elements: list[Values]
    surfaces: list[Values]
    left_out: list[str] = field(default_factory=list)
    source: str = ""
    design: str = ""
    is_study: bool = False

    def stated(
        self, number: int, front: int, given: DrawingTolerances, general: bool = False
    ) -> DrawingTolerances:
        """The tolerances of an element's sheet, those that were assumed in the place of others.

        Parameters
        ----------
        number, front
            Of the element, and of its front surface, from 0.
        given
            What the sheet says where nothing was assumed.
        general
            Whether these are general tolerances; what remains of them is then marked.
        """
        changes: dict[str, Any] = dict(self.elements[number])
        for side, surface in (("left", front), ("right", front + 1)):
            stated = _stated(getattr(given, side), self.surfaces[surface], given)
            changes[side] = stated.marked_general(self.surfaces[surface]) if general else stated
        others = f"; {GENERAL_MARK if general else 'others:'} {given.source}" if given.source else ""
        changes["source"] = f"tolerances of {self.source}{others}"[:200]
        made = given.replaced(**changes, fringe_wavelength_um=TEST_WAVELENGTH_UM)
        known = {*self.elements[number], "fringe_wavelength_um"}
        return made.marked_general(known) if general else made

    def missing(self, lens: Lens) -> list[str]:
        """What a sheet states although the file assumed no scatter of it."""
        missing = []
        for number, front in enumerate(lens.glass_fronts):
            for surface in (front, front + 1):
                own, curved = self.surfaces[surface], lens.surfaces[surface].radius_mm is not None
                if curved and not {"radius_mm", "radius_fringes"} & set(own):
                    missing.append(f"radius of surface {surface + 1}")
                if not {"irregularity_fringes", "rms_irregularity_fringes"} & set(own):
                    missing.append(f"irregularity of surface {surface + 1}")
                if "centring_arcmin" not in own:
                    missing.append(f"centring of surface {surface + 1}")
            if "thickness_mm" not in self.elements[number]:
                missing.append(f"thickness of element {number + 1}")
        return list(dict.fromkeys(missing))


def _stated(given: SurfaceTolerances, own: Values, sheet: DrawingTolerances) -> SurfaceTolerances:
    ratio = sheet.fringe_wavelength_um / TEST_WAVELENGTH_UM
    counted = ("radius_fringes", "irregularity_fringes", "symmetric_fringes", "rms_irregularity_fringes")
    kept = {name: value * ratio for name in counted if (value := getattr(given, name)) is not None}
    changes: dict[str, Any] = {name: float(f"{value:.4g}") for name, value in kept.items()} | own
    if {"radius_mm", "radius_fringes"} & set(own):
        changes["radius_fringes" if "radius_mm" in own else "radius_mm"] = None
    if "irregularity_fringes" in own:
        changes["symmetric_fringes"] = None
    if {"radius_fringes", "irregularity_fringes"} & set(own):
        changes["test_diameter_mm"] = None
    return given.replaced(**changes)


def load_tolerances(path: str | os.PathLike[str], lens: Lens) -> AssumedTolerances:
    """Read the tolerances of a lens from a tolerance study or budget.

    Parameters
    ----------
    path
        A TOML file with ``[[perturbation]]`` tables.
    lens
        The lens that they are of.

    Raises
    ------
    DesignError
        If the file cannot be read, holds no such tables, or names what the lens does not have.
    """
    path = Path(path)
    data = read_toml(path)
    tables, design = data.get("perturbation"), data.get("design")
    if not (isinstance(tables, list) and tables and all(isinstance(t, dict) for t in tables)):
        raise DesignError(
            f"{path}: holds no [[perturbation]] tables: give a tolerance study, or what tolerancing budget "
            "writes"
        )
    found = AssumedTolerances([{} for _ in lens.glass_fronts], [{} for _ in lens.surfaces], source=path.name)
    found.design = design if isinstance(design, str) else ""
    found.is_study = "merit" in data
    for number, table in enumerate(tables, start=1):
        try:
            _add(found, lens, _Assumed.model_validate(table))
        except ValidationError as error:
            fault = error.errors()[0]
            key = ".".join(str(part) for part in fault["loc"])
            raise DesignError(f"{path}: perturbation {number}: {key}: {fault['msg']}") from None
        except IndexError:
            raise DesignError(
                f"{path}: perturbation {number}: target = {table['target']!r}: the lens has "
                f"{len(lens.surfaces)} surfaces and {len(lens.glass_fronts)} elements; is it of another lens?"
            ) from None
    return found


def _add(found: AssumedTolerances, lens: Lens, one: _Assumed) -> None:
    match = re.fullmatch(r"(surface|element) ([1-9]\d{0,3})", one.target)
    size = one.tolerance
    if match is None or size is None:
        why = "a measured distribution" if size is None else "of the mount or the light"
        found.left_out.append(f"{one.name} ({why})")
        return
    number = int(match[2]) - 1
    if match[1] == "element":
        front = lens.glass_fronts[number]
        if one.parameter.startswith("edge_difference"):
            reach = mechanical_semi_diameter_mm(lens, number)
            _tighten(found.surfaces[front + 1], "centring_arcmin", _arcmin(size, reach))
        else:
            found.left_out.append(f"{one.name} (of the mount)")
        return
    surface, values = lens.surfaces[number], found.surfaces[number]
    elements = {front: found.elements[k] for k, front in enumerate(lens.glass_fronts)}
    name, semi = one.parameter, surface.semi_diameter_mm
    if one.mean and not name.startswith("irregularity"):
        found.left_out.append(f"mean of {one.name} ({one.mean:g})")
    if name == "radius_mm":
        _tighten(values, "radius_mm", size)
    elif name == "radius_percent" and surface.radius_mm is not None:
        _tighten(values, "radius_mm", 0.01 * abs(surface.radius_mm) * size)
    elif name == "radius_fringes":
        _tighten(values, "radius_fringes", size)
    elif name == "irregularity_pv_waves":
        _tighten(values, "irregularity_fringes", FRINGES_PER_WAVE * size)
    elif name == "irregularity_rms_waves":
        _tighten(values, "rms_irregularity_fringes", FRINGES_PER_WAVE * size)
    elif name in ("tilt_x_deg", "tilt_y_deg"):
        _tighten(values, "centring_arcmin", 60.0 * size)
    elif name in ("tir_x_mm", "tir_y_mm") and semi is not None:
        _tighten(values, "centring_arcmin", _arcmin(size, semi))
    elif name in ("decenter_x_mm", "decenter_y_mm"):
        _tighten(values, "decenter_mm", size)
    elif name == "conic":
        _tighten(values, "conic", size)
    elif name in ("thickness_mm", "index", "abbe_percent") and number in elements:
        _tighten(elements[number], name, size)
    else:
        why = "between parts" if name == "thickness_mm" else "no sheet says it"
        found.left_out.append(f"{one.name} ({why})")


def _tighten(values: Values, name: str, size: float) -> None:
    """The smaller of several tolerances of one thing, to four digits."""
    values[name] = min(float(f"{size:.4g}"), values.get(name, float("inf")))


def _arcmin(difference_mm: float, reach_mm: float) -> float:
    from math import asin, degrees

    return 60.0 * degrees(asin(min(difference_mm / (2.0 * reach_mm), 1.0)))
