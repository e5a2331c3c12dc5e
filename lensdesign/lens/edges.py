"""The edge of a glass element outside its clear apertures: ground diameter, flats, bevels and flange."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from lensdesign.common.frozen_model import Finite, FrozenModel, Positive
from lensdesign.common.number_limits import LARGEST_IN_FILES

NotNegative = Annotated[float, Field(ge=0.0, le=LARGEST_IN_FILES, allow_inf_nan=False)]


class Flange(FrozenModel):
    """A ring around the edge cylinder by which a moulded lens is mounted.

    Attributes
    ----------
    semi_diameter_mm
        Outer radius of the ring.
    distance_mm
        Distance along z from the front vertex of the element to the front face of the ring.
    thickness_mm
        Distance between the two faces of the ring.

    Examples
    --------
    >>> from lensdesign import Edge, Flange
    >>> flange = Flange(semi_diameter_mm=6.0, distance_mm=1.0, thickness_mm=1.5)
    >>> Edge(semi_diameter_mm=5.0, flange=flange).flange.thickness_mm
    1.5
    """

    semi_diameter_mm: Positive
    distance_mm: Finite
    thickness_mm: Positive


class Edge(FrozenModel):
    """The edge of one glass element, centred on the axis of the lens.

    Attributes
    ----------
    semi_diameter_mm
        Radius of the edge cylinder. None means the largest clear semi-diameter of the lens; exports and
        drawings then choose a ground diameter (:func:`lensdesign.analysis.outline.drawn_outline`).
    front_flat_from_mm, back_flat_from_mm
        Radial height at which the surface ends and a flat ring continues to the edge. None extends the
        surface with its own sag.
    front_bevel_mm, back_bevel_mm
        Leg length of the protective bevel at 45 degrees; 0 is a sharp edge.
    flange
        Ring around the edge cylinder; None means no flange.

    Examples
    --------
    >>> from lensdesign import Edge
    >>> Edge(semi_diameter_mm=5.0, front_bevel_mm=0.2).sides()  # flat and bevel in front, and behind
    ((None, 0.2), (None, 0.0))
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
            raise ValueError(
                "an edge with a flange needs a semi_diameter_mm, the radius of the edge cylinder inside the "
                "flange"
            )
        if self.flange.semi_diameter_mm <= self.semi_diameter_mm:
            raise ValueError(
                f"the flange's semi_diameter_mm of {self.flange.semi_diameter_mm:g} must be greater than the "
                f"edge's of {self.semi_diameter_mm:g}"
            )
        return self

    def sides(self) -> tuple[tuple[float | None, float], tuple[float | None, float]]:
        """Return the start of the flat and the leg of the bevel, for the front and for the back."""
        return (
            (self.front_flat_from_mm, self.front_bevel_mm),
            (self.back_flat_from_mm, self.back_bevel_mm),
        )
