"""Tolerances of a drawing from the file that assumes them: a tolerance study, or a tolerance budget.

The ``[[perturbation]]`` tables of such a TOML file are read: ``target``, ``parameter``, and the largest
allowed deviation, which is ``limit``, else ``half_width``, else two ``sigma``. The deviation of an
irregularity is measured from 0 and includes ``mean``. Perturbations that a drawing cannot state are listed.
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, ValidationError

from lensdesign.common.frozen_model import Finite, FrozenModel, Positive
from lensdesign.common.toml_files import read_toml
from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import mechanical_semi_diameter_mm
from lensdesign.lens.surface_figure_source import TEST_WAVELENGTH_UM
from lensdesign.manufacture.drawing.tolerances import GENERAL_MARK, DrawingTolerances, SurfaceTolerances

Values = dict[str, float]
"""Values of a sheet or of a surface's column by name."""


class _Perturbation(FrozenModel):
    """A ``[[perturbation]]`` table; other keys are ignored."""

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
        """Largest allowed deviation; None for a distribution without one."""
        spread = None if self.sigma is None else 2.0 * self.sigma
        largest = next((v for v in (self.limit, self.half_width, spread) if v is not None), None)
        if largest is None or not self.parameter.startswith("irregularity"):
            return largest
        return abs(self.mean) + largest


@dataclass
class AssumedTolerances:
    """Tolerances that a study or budget assumes.

    Attributes
    ----------
    elements
        Values of the sheet of each element by name.
    surfaces
        Values of the column of each surface of the lens by name.
    left_out
        Perturbations that a drawing cannot state, in words.
    source
        Name of the file.
    design
        Design file that the file names, relative to it; empty if it names none.
    is_study
        Whether the file holds merits with limits, so that a yield can be predicted.
    """

    elements: list[Values]
    surfaces: list[Values]
    left_out: list[str] = field(default_factory=list)
    source: str = ""
    design: str = ""
    is_study: bool = False

    def stated(
        self, index: int, front: int, base: DrawingTolerances, general: bool = False
    ) -> DrawingTolerances:
        """Return the tolerances of an element's sheet; assumed values replace those of `base`.

        Parameters
        ----------
        index, front
            Index of the element and of its front surface, from 0.
        base
            Tolerances where the file assumes nothing.
        general
            Whether `base` holds general tolerances; remaining values are then marked (default: False).
        """
        changes: dict[str, Any] = dict(self.elements[index])
        for side, surface in (("left", front), ("right", front + 1)):
            stated = _stated(getattr(base, side), self.surfaces[surface], base)
            changes[side] = stated.marked_general(self.surfaces[surface]) if general else stated
        others = f"; {GENERAL_MARK if general else 'others:'} {base.source}" if base.source else ""
        changes["source"] = f"tolerances of {self.source}{others}"[:200]
        result = base.replaced(**changes, fringe_wavelength_um=TEST_WAVELENGTH_UM)
        known = {*self.elements[index], "fringe_wavelength_um"}
        return result.marked_general(known) if general else result

    def missing(self, lens: Lens) -> list[str]:
        """Return indications of the sheets for which the file assumes no deviation."""
        missing = []
        for index, front in enumerate(lens.glass_fronts):
            for surface in (front, front + 1):
                own, curved = self.surfaces[surface], lens.surfaces[surface].radius_mm is not None
                if curved and not {"radius_mm", "radius_fringes"} & set(own):
                    missing.append(f"radius of surface {surface + 1}")
                if not {"irregularity_fringes", "rms_irregularity_fringes"} & set(own):
                    missing.append(f"irregularity of surface {surface + 1}")
                if "centring_arcmin" not in own:
                    missing.append(f"centring of surface {surface + 1}")
            if "thickness_mm" not in self.elements[index]:
                missing.append(f"thickness of element {index + 1}")
        return list(dict.fromkeys(missing))


def _stated(base: SurfaceTolerances, own: Values, sheet: DrawingTolerances) -> SurfaceTolerances:
    """Return the tolerances of a surface, with fringe spacings converted to the test wavelength."""
    ratio = sheet.fringe_wavelength_um / TEST_WAVELENGTH_UM
    fringes = ("radius_fringes", "irregularity_fringes", "symmetric_fringes", "rms_irregularity_fringes")
    converted = {name: value * ratio for name in fringes if (value := getattr(base, name)) is not None}
    changes: dict[str, Any] = {name: float(f"{value:.4g}") for name, value in converted.items()} | own
    if {"radius_mm", "radius_fringes"} & set(own):
        changes["radius_fringes" if "radius_mm" in own else "radius_mm"] = None
    if "irregularity_fringes" in own:
        changes["symmetric_fringes"] = None
    if {"radius_fringes", "irregularity_fringes"} & set(own):
        changes["test_diameter_mm"] = None
    return base.replaced(**changes)


def load_tolerances(path: str | os.PathLike[str], lens: Lens) -> AssumedTolerances:
    """Read the tolerances of a lens from a tolerance study or budget.

    Parameters
    ----------
    path
        A TOML file with ``[[perturbation]]`` tables.
    lens
        The lens of the study.

    Returns
    -------
    AssumedTolerances
        Values for the sheets, and perturbations that sheets cannot state.

    Raises
    ------
    DesignError
        If the file cannot be read, holds no such tables, or names surfaces or elements that the lens lacks.
    """
    path = Path(path)
    data = read_toml(path)
    tables, design = data.get("perturbation"), data.get("design")
    if not (isinstance(tables, list) and tables and all(isinstance(t, dict) for t in tables)):
        raise DesignError(
            f"{path}: holds no [[perturbation]] tables: give a tolerance study, or a file that tolerancing "
            "budget has written"
        )
    found = AssumedTolerances([{} for _ in lens.glass_fronts], [{} for _ in lens.surfaces], source=path.name)
    found.design = design if isinstance(design, str) else ""
    found.is_study = "merit" in data
    for index, table in enumerate(tables, start=1):
        try:
            _add(found, lens, _Perturbation.model_validate(table))
        except ValidationError as error:
            fault = error.errors()[0]
            key = ".".join(str(segment) for segment in fault["loc"])
            raise DesignError(f"{path}: perturbation {index}: {key}: {fault['msg']}") from None
        except IndexError:
            raise DesignError(
                f"{path}: perturbation {index}: target = {table['target']!r}: the lens has "
                f"{len(lens.surfaces)} surfaces and {len(lens.glass_fronts)} elements; is it of another lens?"
            ) from None
    return found


def _add(found: AssumedTolerances, lens: Lens, one: _Perturbation) -> None:
    """Convert one perturbation to a value of a sheet, or list it as left out."""
    match = re.fullmatch(r"(surface|element) ([1-9]\d{0,3})", one.target)
    size = one.tolerance
    if match is None or size is None:
        reason = "a measured distribution" if size is None else "of the mount or the light"
        found.left_out.append(f"{one.name} ({reason})")
        return
    index = int(match[2]) - 1
    if match[1] == "element":
        front = lens.glass_fronts[index]
        if one.parameter.startswith("edge_difference"):
            radius = mechanical_semi_diameter_mm(lens, index)
            _tighten(found.surfaces[front + 1], "centring_arcmin", _wedge_arcmin(size, radius))
        else:
            found.left_out.append(f"{one.name} (of the mount)")
        return
    surface, values = lens.surfaces[index], found.surfaces[index]
    elements = {front: found.elements[k] for k, front in enumerate(lens.glass_fronts)}
    name, semi = one.parameter, surface.semi_diameter_mm
    if one.mean and not name.startswith("irregularity"):
        found.left_out.append(f"mean of {one.name} ({one.mean:g})")
    # Number of fringe spacings per wavelength of sag error.
    fringes_per_wave = 2.0
    if name == "radius_mm":
        _tighten(values, "radius_mm", size)
    elif name == "radius_percent" and surface.radius_mm is not None:
        _tighten(values, "radius_mm", 0.01 * abs(surface.radius_mm) * size)
    elif name == "radius_fringes":
        _tighten(values, "radius_fringes", size)
    elif name == "irregularity_pv_waves":
        _tighten(values, "irregularity_fringes", fringes_per_wave * size)
    elif name == "irregularity_rms_waves":
        _tighten(values, "rms_irregularity_fringes", fringes_per_wave * size)
    elif name in ("tilt_x_deg", "tilt_y_deg"):
        _tighten(values, "centring_arcmin", 60.0 * size)
    elif name in ("tir_x_mm", "tir_y_mm") and semi is not None:
        _tighten(values, "centring_arcmin", _wedge_arcmin(size, semi))
    elif name in ("decenter_x_mm", "decenter_y_mm"):
        _tighten(values, "decenter_mm", size)
    elif name == "conic":
        _tighten(values, "conic", size)
    elif name in ("thickness_mm", "index", "abbe_percent") and index in elements:
        _tighten(elements[index], name, size)
    else:
        reason = "between parts" if name == "thickness_mm" else "a drawing does not state it"
        found.left_out.append(f"{one.name} ({reason})")


def _tighten(values: Values, name: str, size: float) -> None:
    """Keep the smaller of several tolerances of one quantity, to four digits."""
    values[name] = min(float(f"{size:.4g}"), values.get(name, float("inf")))


def _wedge_arcmin(difference_mm: float, radius_mm: float) -> float:
    """Return the tilt in arcmin for a difference of edge thickness or runout over a diameter."""
    return 60.0 * math.degrees(math.asin(min(difference_mm / (2.0 * radius_mm), 1.0)))
