"""The edge of a glass element outside its clear apertures: diameter, draft, flats, bevels, flange, gate."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field, model_validator

from lensdesign.common.frozen_model import Finite, FrozenModel, NotNegative, Positive


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


class Gate(FrozenModel):
    """The place at the edge of a moulded element where the material enters the mould.

    The gate ends on a flat, which is parallel to the axis and perpendicular to -y, so that what remains of
    the gate after cutting does not extend beyond the diameter. The sheet shows the flat. Meshes, STEP files
    and outlines do not contain it.

    Attributes
    ----------
    flat_depth_mm
        Depth of the flat below the largest radius of the edge or its flange.
    width_mm, thickness_mm
        Width of the gate across the axis and thickness along the axis; None if they are not yet known.

    Examples
    --------
    >>> from lensdesign import Edge, Gate
    >>> Edge(semi_diameter_mm=5.0, gate=Gate(flat_depth_mm=0.4)).gate.flat_width_mm(5.0)
    3.919183588453085
    """

    flat_depth_mm: Positive
    width_mm: Positive | None = None
    thickness_mm: Positive | None = None

    def flat_width_mm(self, outer_mm: float) -> float:
        """Return the width of the flat on an edge or a flange of this radius: its chord."""
        return 2.0 * math.sqrt(self.flat_depth_mm * (2.0 * outer_mm - self.flat_depth_mm))


class Edge(FrozenModel):
    """The edge of one glass element, centred on the axis of the lens.

    Attributes
    ----------
    semi_diameter_mm
        Radius of the edge cylinder. None means the largest clear semi-diameter of the lens; exports and
        drawings then choose a ground diameter (:func:`lensdesign.analysis.outline.drawn_outline`).
    draft_deg
        Angle of the edge to the axis, from -30 to 30 degrees; 0 is a cylinder. A moulded edge is the frustum
        of a cone so that it leaves the mould. A positive draft narrows it towards the back, a negative one
        towards the front. The radius at the wide end is `semi_diameter_mm`. None means that the draft is not
        stated, and the edge is a cylinder.
    front_flat_from_mm, back_flat_from_mm
        Radial height at which the surface ends and a flat ring continues to the edge. None extends the
        surface with its own sag.
    front_bevel_mm, back_bevel_mm
        Leg length of the protective bevel at 45 degrees; 0 is a sharp edge.
    flange
        Ring around the edge cylinder; None means no flange.
    gate
        Gate and its flat; None means that they are not stated.

    Examples
    --------
    >>> from lensdesign import Edge
    >>> Edge(semi_diameter_mm=5.0, front_bevel_mm=0.2).sides()  # flat and bevel in front, and behind
    ((None, 0.2), (None, 0.0))
    """

    semi_diameter_mm: Positive | None = None
    draft_deg: Annotated[float, Field(ge=-30.0, le=30.0, allow_inf_nan=False)] | None = None
    front_flat_from_mm: Positive | None = None
    back_flat_from_mm: Positive | None = None
    front_bevel_mm: NotNegative = 0.0
    back_bevel_mm: NotNegative = 0.0
    flange: Flange | None = None
    gate: Gate | None = None

    @model_validator(mode="after")
    def _moulded_edge(self) -> Edge:
        if self.semi_diameter_mm is None:
            stated = {"flange": self.flange, "draft": self.draft_deg, "gate": self.gate}
            for name, value in stated.items():
                if value is not None:
                    raise ValueError(
                        f"an edge with a {name} needs a semi_diameter_mm, the radius of the edge"
                    )
            return self
        self._check_flange(self.semi_diameter_mm)
        outer_mm = self.semi_diameter_mm if self.flange is None else self.flange.semi_diameter_mm
        if self.gate is not None and not self.gate.flat_depth_mm < outer_mm:
            raise ValueError(
                f"the gate's flat_depth_mm of {self.gate.flat_depth_mm:g} must be less than the radius of "
                f"the edge, {outer_mm:g}"
            )
        return self

    def _check_flange(self, radius_mm: float) -> None:
        if self.flange is not None and self.flange.semi_diameter_mm <= radius_mm:
            raise ValueError(
                f"the flange's semi_diameter_mm of {self.flange.semi_diameter_mm:g} must be greater than the "
                f"edge's of {radius_mm:g}"
            )

    def sides(self) -> tuple[tuple[float | None, float], tuple[float | None, float]]:
        """Return the start of the flat and the leg of the bevel, for the front and for the back."""
        return (
            (self.front_flat_from_mm, self.front_bevel_mm),
            (self.back_flat_from_mm, self.back_bevel_mm),
        )
