"""A refracting surface, as a design file states it: shape, medium behind it, aperture, measured figure."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import accumulate
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from lensdesign.common.frozen_model import Finite, FrozenModel, Positive
from lensdesign.common.number_limits import SMALLEST_IN_FILES
from lensdesign.lens.catalogues.thermal import LOWEST_INDEX
from lensdesign.lens.coatings.coating import SurfaceCoating
from lensdesign.lens.shapes.base import COEFFICIENTS, Shape, azimuths_rad, term_of
from lensdesign.lens.shapes.registry import SHAPES, shape_class, shape_classes
from lensdesign.lens.surface_figure_source import SurfaceFigureSource
from lensdesign.lens.surface_roughness import SurfaceRoughness


class Surface(FrozenModel):
    """A refracting surface and the medium behind it.

    Attributes
    ----------
    radius_mm
        Radius of curvature, positive if its centre is at larger z; None is a plane.
    conic
        Conic constant.
    asphere
        Coefficients of r^4, r^6, ... of an even asphere, in mm^-3, mm^-5, ...; those of y^4, ... of a toroid.
    shape_type
        Name of the shape in :mod:`lensdesign.lens.shapes.registry`; its key in a file is `shape`. None means
        an even asphere if `asphere` is given, else a conic.
    radius_x_mm, conic_x
        Radius and conic constant of a biconic along x; `radius_mm` and `conic` are those along y. The radius
        of a toroid along x is that of its rotation.
    odd_asphere
        Coefficients of r^3, r^4, ... of an odd asphere, in mm^-2, mm^-3, ...
    normalization_radius_mm, q_mm
        Normalization radius and coefficients of a Forbes asphere (``Qcon`` or ``Qbfs``). `radius_mm` is that
        of the conic or sphere, to which the polynomials add.
    thickness_mm
        Distance to the vertex of the next surface; None for the last surface.
    material
        Glass name or constant index of the medium behind; None is air.
    semi_diameter_mm
        Clear semi-diameter; rays outside it are clipped. None clips no ray.
    stop
        Whether this surface is the aperture stop.
    figure
        Measured sag error of the made surface; None means no error.
    coating
        ``ideal`` (all light is transmitted), ``bare`` (Fresnel's equations), ``mgf2`` (a quarter wave of
        magnesium fluoride at the design's first wavelength), or layers or a table; see
        :class:`lensdesign.Coating`.
    roughness
        Roughness that scatters light; None means a smooth surface.

    Examples
    --------
    >>> from lensdesign import Surface
    >>> surface = Surface(radius_mm=10.0, thickness_mm=3.0, material="N-BK7", semi_diameter_mm=4.0)
    >>> surface.kind, round(float(surface.sag_mm(4.0)), 4)
    ('sphere', 0.8348)
    """

    radius_mm: Finite | None = None
    conic: Finite = 0.0
    asphere: Annotated[tuple[Finite, ...], Field(max_length=len(COEFFICIENTS["asphere"]))] = ()
    shape_type: str | None = Field(None, alias="shape")
    radius_x_mm: Finite | None = None
    conic_x: Finite = 0.0
    odd_asphere: Annotated[tuple[Finite, ...], Field(max_length=len(COEFFICIENTS["odd_asphere"]))] = ()
    normalization_radius_mm: Positive | None = None
    q_mm: Annotated[tuple[Finite, ...], Field(max_length=len(COEFFICIENTS["q_mm"]))] = ()
    thickness_mm: Positive | None = None
    material: str | Annotated[float, Field(ge=LOWEST_INDEX, allow_inf_nan=False)] | None = None
    semi_diameter_mm: Positive | None = None
    stop: bool = False
    figure: SurfaceFigureSource | None = None
    coating: SurfaceCoating = "ideal"
    roughness: SurfaceRoughness | None = None

    @model_serializer(mode="wrap")
    def _serialized(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit an ideal coating and a missing roughness, so that saved runs without them keep their keys."""
        values: dict[str, Any] = handler(self)
        if self.coating == "ideal":
            values.pop("coating", None)
        if self.roughness is None:
            values.pop("roughness", None)
        return values

    @field_validator("shape_type")
    @classmethod
    def _known(cls, value: str | None) -> str | None:
        if value is not None and value not in SHAPES:
            raise ValueError(f"shape = {value!r}: unknown; allowed: {', '.join(SHAPES)}")
        return value

    @field_validator("radius_mm", "radius_x_mm")
    @classmethod
    def _radius(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value == 0.0:
            raise ValueError(f"a radius of 0 is not a surface; leave {info.field_name} out for a plane")
        if value is not None and abs(value) < SMALLEST_IN_FILES:
            raise ValueError(f"its magnitude must be at least {SMALLEST_IN_FILES:g}")
        return value

    @model_validator(mode="after")
    def _keys_fit_shape(self) -> Surface:
        own = self.shape_class
        for shape in shape_classes():
            for key in shape.KEYS:
                value = getattr(self, key)
                if key not in own.KEYS and value != type(self).model_fields[key].default:
                    raise ValueError(
                        f"{key} = {value!r}: a surface of shape {own.NAME} has none; "
                        f"{self._shape_with_keys(shape)}"
                    )
        if "normalization_radius_mm" in own.KEYS and self.normalization_radius_mm is None:
            raise ValueError(
                f"normalization_radius_mm: a surface of shape {own.NAME} needs one; commonly its clear "
                "semi-diameter"
            )
        return self

    def _shape_with_keys(self, other: type[Shape]) -> str:
        """Return which shape has all keys of this surface, or that none has."""
        fields = type(self).model_fields
        keys = {key for shape in shape_classes() for key in shape.KEYS}
        given = {key for key in keys if getattr(self, key) != fields[key].default}
        names = [shape.NAME for shape in (other, *shape_classes()) if given <= set(shape.KEYS)]
        return f'write shape = "{names[0]}"' if names else f"remove it, or use shape {other.NAME} alone"

    @model_validator(mode="after")
    def _within_normalization(self) -> Surface:
        normalization, semi = self.normalization_radius_mm, self.semi_diameter_mm
        # Largest radial height over the normalization radius; the polynomials grow fast beyond 1.
        most = 2.0
        if normalization is not None and semi is not None and semi > most * normalization:
            raise ValueError(
                f"normalization_radius_mm = {normalization:g}: the semi_diameter_mm of {semi:g} is more than "
                f"{most:g} times larger; use about the semi-diameter"
            )
        if normalization is not None and not np.all(np.isfinite(self.shape.traced.terms)):
            raise ValueError(f"normalization_radius_mm = {normalization:g}: too small")
        return self

    @model_validator(mode="after")
    def _within_edge(self) -> Surface:
        edge = self.shape.edge_radius_mm
        if self.semi_diameter_mm is None:
            return self
        if self.semi_diameter_mm > edge:
            raise ValueError(
                f"semi_diameter_mm = {self.semi_diameter_mm:g} lies beyond the edge of the "
                f"{self.shape_class.NAME}, which ends at a radial height of {edge:.6g} mm"
            )
        # A conic may end with a slope that is not finite, but the departure from it may not.
        if self.semi_diameter_mm == edge and not self._has_finite_departures(edge):
            raise ValueError(
                f"semi_diameter_mm = {self.semi_diameter_mm:g}: a surface of shape {self.shape_class.NAME} "
                f"ends at {edge:.6g} mm, where it is parallel to the axis; use a smaller one"
            )
        return self

    def _has_finite_departures(self, radial_height_mm: float) -> bool:
        """Return whether all sections have a finite departure from their conic, and a finite slope of it."""
        with np.errstate(all="ignore"):
            found = [
                self.shape.section(azimuth).departure(np.array(radial_height_mm))
                for azimuth in azimuths_rad(self.shape)
            ]
        return bool(np.all(np.isfinite(found)))

    @model_validator(mode="after")
    def _within_figure(self) -> Surface:
        if self.figure is None:
            return self
        if self.semi_diameter_mm is None:
            raise ValueError("a surface with a figure needs a semi_diameter_mm")
        known = self.figure.semi_diameter_mm
        if known is not None and known < self.semi_diameter_mm:
            raise ValueError(
                f"the figure's semi_diameter_mm of {known:g} is less than the surface's of "
                f"{self.semi_diameter_mm:g}; the figure must be known over the whole clear aperture"
            )
        return self

    @cached_property
    def shape(self) -> Shape:
        """Shape of the surface, without the figure."""
        return self.shape_class.of_keys(self.shape_keys)

    @property
    def shape_class(self) -> type[Shape]:
        """Class of the shape."""
        return shape_class(self.shape_type or ("even asphere" if self.asphere else "conic"))

    @property
    def shape_keys(self) -> dict[str, Any]:
        """Values that define the shape, by their keys in a design file."""
        return {key: getattr(self, key) for key in self.shape_class.KEYS}

    @property
    def shape_parameters(self) -> tuple[str, ...]:
        """Names of the shape parameters that an optimizer may vary or a study perturb."""
        terms = self.shape_class.TERMS[: len(self.shape.terms)]
        return tuple(name for name in self.shape_class.PARAMETERS if term_of(name) in terms)

    @property
    def curvature(self) -> float:
        """Curvature at the vertex in the y-z meridian, in 1/mm; 0 for a plane."""
        return self.shape.curvature

    @property
    def kind(self) -> str:
        """Name of the simplest shape of this form: plane, sphere, or the name of the shape."""
        return self.shape.kind

    def sag_mm(self, r_mm: Any) -> NDArray[np.float64]:
        """Return the sag at radial heights in the y-z plane, without the figure; NaN beyond the edge."""
        return self.shape.sag(0.0, r_mm)

    def slope(self, r_mm: Any) -> NDArray[np.float64]:
        """Return the slope dz/dr at radial heights in the y-z plane, without the figure."""
        return self.shape.sag_and_slopes(0.0, r_mm)[2]


def vertex_z_mm(surfaces: Sequence[Surface]) -> NDArray[np.float64]:
    """Return z of every vertex in mm, shape (surfaces,); the front vertex is at 0."""
    return np.array(list(accumulate((s.thickness_mm or 0.0 for s in surfaces[:-1]), initial=0.0)))
