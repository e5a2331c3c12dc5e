"""How a glass element ends outside its clear apertures: ground diameter, flats, bevels, flange."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from lensdesign.common.number_limits import LARGEST_IN_FILES
from lensdesign.common.section import Finite, Positive, Section

NotNegative = Annotated[float, Field(ge=0.0, le=LARGEST_IN_FILES, allow_inf_nan=False)]


class Flange(Section):
    """A ring about the edge cylinder by which a moulded lens is held.

    Attributes
    ----------
    semi_diameter_mm
        Its outer radius.
    distance_mm
        From the element's front vertex to the ring's front face, along z.
    thickness_mm
        Between its faces.
    """

    semi_diameter_mm: Positive
    distance_mm: Finite
    thickness_mm: Positive


class Edge(Section):
    """The edge of one glass element, about the axis of the lens.

    Attributes
    ----------
    semi_diameter_mm
        Of the edge cylinder; None is the largest clear semi-diameter of the lens, for which exports and
        drawings choose a ground diameter (:func:`lensdesign.analysis.outline.drawn_outline`).
    front_flat_from_mm, back_flat_from_mm
        Radial height at which the surface ends and a flat ring goes on to the edge; None prolongs the surface
        with its own sag.
    front_bevel_mm, back_bevel_mm
        Leg of the protective bevel at 45 degrees; 0 is a sharp edge.
    flange
        Ring about the edge cylinder; None is none.
    """

    semi_diameter_mm: Positive | None = None
    front_flat_from_mm: Positive | None = None
    back_flat_from_mm: Positive | None = None
    front_bevel_mm: NotNegative = 0.0
    back_bevel_mm: NotNegative = 0.0
    flange: Flange | None = None

    @model_validator(mode="after")
    def _flange_outside(self) -> Edge:
        if self.flange is None:
            return self
        if self.semi_diameter_mm is None:
            raise ValueError("an edge with a flange needs a semi_diameter_mm, that of the cylinder within it")
        if self.flange.semi_diameter_mm <= self.semi_diameter_mm:
            raise ValueError(
                f"the flange's semi_diameter_mm of {self.flange.semi_diameter_mm:g} must be greater than the "
                f"edge's of {self.semi_diameter_mm:g}"
            )
        return self

    def sides(self) -> tuple[tuple[float | None, float], tuple[float | None, float]]:
        """Beginning of the flat and leg of the bevel, of front and back."""
        return (
            (self.front_flat_from_mm, self.front_bevel_mm),
            (self.back_flat_from_mm, self.back_bevel_mm),
        )
