"""An indication of a sheet that predictions score: what it tolerances, and by how much."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

Kind = Literal[
    "radius",
    "irregularity",
    "centring",
    "decenter",
    "conic",
    "thickness",
    "index",
    "Abbe number",
    "inhomogeneity",
]

Key = tuple[Kind, int]
"""Kind of an indication, and index of its surface."""

Origin = Literal["study", "general", "sheet", "open"]
"""Where a value comes from: the study, the general tolerances, the user's sheet file, or nowhere yet."""

FIELDS: dict[Kind, tuple[str, ...]] = {
    "radius": ("radius_mm", "radius_fringes"),
    "irregularity": ("rms_irregularity_fringes", "irregularity_fringes"),
    "centring": ("centring_arcmin",),
    "decenter": ("decenter_mm",),
    "conic": ("conic",),
    "thickness": ("thickness_mm",),
    "index": ("index",),
    "Abbe number": ("abbe_percent",),
    "inhomogeneity": ("inhomogeneity",),
}
"""Fields of a sheet's tolerances by kind; the first that is given counts."""

OF_ELEMENT: tuple[Kind, ...] = ("thickness", "index", "Abbe number", "inhomogeneity")

UNITS = {
    "radius_mm": " mm",
    "radius_fringes": " fringes",
    "irregularity_fringes": " fringes",
    "rms_irregularity_fringes": " fringes rms",
    "centring_arcmin": "′",
    "decenter_mm": " mm",
    "thickness_mm": " mm",
    "abbe_percent": " %",
}


class Deviation(NamedTuple):
    """A perturbed parameter and its tolerance, in the parameter's unit."""

    target: str
    parameter: str
    tolerance: float


@dataclass(frozen=True)
class SheetItem:
    """An indication of a sheet that predictions score.

    Attributes
    ----------
    kind
        Kind of the tolerance.
    element, surface
        Indices from 0; of an indication for the whole element its front surface.
    field
        Field of the sheet's tolerances.
    value
        In the field's unit; of the homogeneity its class.
    origin
        Where the value comes from.
    deviations
        Deviations that it allows.
    """

    kind: Kind
    element: int
    surface: int
    field: str
    value: float
    origin: Origin
    deviations: tuple[Deviation, ...]

    @property
    def label(self) -> str:
        """The item in words."""
        if self.kind in OF_ELEMENT:
            return f"{self.kind} of element {self.element + 1}"
        return f"{self.kind} of surface {self.surface + 1}"

    @property
    def text(self) -> str:
        """The item with its value."""
        if self.kind == "inhomogeneity":
            return f"{self.label} (class {self.value:g})"
        return f"{self.label} (±{self.value:g}{UNITS.get(self.field, '')})"

    @property
    def key(self) -> Key:
        """Kind and surface, by which perturbations are found."""
        return self.kind, self.surface
