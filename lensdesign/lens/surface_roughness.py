"""The roughness of a surface, as a design file states it."""

from __future__ import annotations

from lensdesign.common.frozen_model import FrozenModel, Positive

NO_ROUGHNESS = (
    "the design states no roughness of this surface, so that its correlation length is unknown; add "
    "roughness = { rms_nm = ..., correlation_length_um = ... } to the surface"
)
"""Message for a surface whose roughness is to change and is not stated."""


class SurfaceRoughness(FrozenModel):
    """Roughness of a surface: Gaussian heights with a Gaussian autocorrelation.

    Both values are those of the polished surface in the band of spatial periods that scatter light, without
    the form error, which is a figure.

    Attributes
    ----------
    rms_nm
        Root mean square height (Rq).
    correlation_length_um
        Distance at which the autocorrelation of the heights falls to 1/e.

    Examples
    --------
    >>> from lensdesign import Surface, SurfaceRoughness
    >>> roughness = SurfaceRoughness(rms_nm=2.0, correlation_length_um=5.0)
    >>> Surface(radius_mm=10.0, roughness=roughness).roughness.rms_nm
    2.0
    """

    rms_nm: Positive
    correlation_length_um: Positive
