"""The cover glass of an image sensor: a plane plate in air, at a fixed distance in front of the pixels."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from lensdesign.common.frozen_model import FrozenModel, NotNegative, Positive
from lensdesign.lens.coatings.coating import SurfaceCoating


class CoverGlass(FrozenModel):
    """A plane plate of glass in front of the pixels, which moves with the sensor.

    Attributes
    ----------
    thickness_mm
        Thickness of the plate.
    material
        Glass by its name, or a constant refractive index; the same values as for a surface.
    distance_mm
        Distance in air from the rear face of the plate to the pixels.
    coating
        Coating of both faces, as of a :class:`lensdesign.Surface`. It determines ghosts; direct light passes
        the plate without loss, since its loss is the same for all rays within 1 %.

    Examples
    --------
    >>> from lensdesign import CoverGlass
    >>> glass = CoverGlass(thickness_mm=0.7, material="N-BK7", distance_mm=0.5)
    >>> glass.depth_mm
    1.2
    """

    thickness_mm: Positive
    material: str | Annotated[float, Field(ge=1.0, allow_inf_nan=False)]
    distance_mm: NotNegative
    coating: SurfaceCoating = "ideal"

    @property
    def depth_mm(self) -> float:
        """Distance from the front face of the plate to the pixels."""
        return self.thickness_mm + self.distance_mm
