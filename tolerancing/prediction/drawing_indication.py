"""An indication of a drawing that a prediction uses: its tolerance and the perturbations that it allows."""

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
"""Origin of a value: the study, the general tolerances, the user's sheet file, or not stated (open)."""

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
"""Fields of a sheet's tolerances by kind, in order of preference."""

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
class DrawingIndication:
    """An indication of a drawing that a prediction uses.

    Attributes
    ----------
    kind
        Kind of the tolerance.
    element, surface
        Indices of element and surface; the front surface for an indication of the whole element.
    field
        Field of the sheet's tolerances.
    value
        Value in the unit of the field; class of the homogeneity.
    origin
        Origin of the value.
    deviations
        Deviations that the indication allows.
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
        """Kind and element or surface as text."""
        if self.kind in OF_ELEMENT:
            return f"{self.kind} of element {self.element + 1}"
        return f"{self.kind} of surface {self.surface + 1}"

    @property
    def text(self) -> str:
        """Kind, element or surface, and value as text."""
        if self.kind == "inhomogeneity":
            return f"{self.label} (class {self.value:g})"
        return f"{self.label} (±{self.value:g}{UNITS.get(self.field, '')})"

    @property
    def key(self) -> Key:
        """Kind and surface, by which perturbations are found."""
        return self.kind, self.surface
