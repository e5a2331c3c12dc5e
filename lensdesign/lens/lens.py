"""The immutable lens: surfaces between an object plane and a sensor, as the design file states them."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from lensdesign.common.frozen_model import FrozenModel, Positive, as_path
from lensdesign.common.notebook import html_table
from lensdesign.errors import DesignError, InputError
from lensdesign.lens.coatings.coating import Coating, SurfaceCoating
from lensdesign.lens.cover_glass import CoverGlass
from lensdesign.lens.edges import Edge
from lensdesign.lens.glass import is_air, refractive_index
from lensdesign.lens.moulding import Moulding
from lensdesign.lens.section_picture import section_svg
from lensdesign.lens.shapes.base import axial_gaps_mm, directions
from lensdesign.lens.solid import (
    glass_element,
    glass_elements,
    glass_fronts,
    validate_edge,
)
from lensdesign.lens.surface import Surface, vertex_z_mm


class ObjectSpace(FrozenModel):
    """Object plane of a lens: field, numerical aperture and working distance.

    Attributes
    ----------
    field_diameter_mm
        Diameter of the circular field of view.
    numerical_aperture
        Sine of the angle between the marginal ray and the axis, in air.
    working_distance_mm
        Distance from the object plane to the front vertex.

    Examples
    --------
    >>> from lensdesign import ObjectSpace
    >>> ObjectSpace(field_diameter_mm=3.0, numerical_aperture=0.5, working_distance_mm=13.5)
    ObjectSpace(field_diameter_mm=3.0, numerical_aperture=0.5, working_distance_mm=13.5)
    """

    field_diameter_mm: Positive
    numerical_aperture: Annotated[Positive, Field(lt=1.0)]
    working_distance_mm: Positive


class Sensor(FrozenModel):
    """The image sensor and its recording planes.

    Attributes
    ----------
    pixel_pitch_um
        Distance between the centres of neighbouring pixels.
    pixels
        Number of pixels along x and y.
    plane_distances_mm
        Distances of the recording planes H1, H2, ... from the exit vertex to the pixels, increasing.
    cover_glass
        Plane plate in front of the pixels, which moves with the sensor (default: none).
    reflectance
        Fraction of the power that the sensor reflects, from 0 to 1 (default: unknown). It causes ghosts.

    Examples
    --------
    >>> from lensdesign import Sensor
    >>> sensor = Sensor(pixel_pitch_um=3.2, pixels=(9344, 7000), plane_distances_mm=(2.0, 22.0))
    >>> width, height = sensor.size_mm
    >>> round(width, 1), round(height, 1)
    (29.9, 22.4)
    """

    pixel_pitch_um: Positive
    pixels: tuple[Annotated[int, Field(gt=0, le=1_000_000)], Annotated[int, Field(gt=0, le=1_000_000)]]
    plane_distances_mm: Annotated[tuple[Positive, ...], Field(min_length=1)]
    cover_glass: CoverGlass | None = None
    reflectance: Annotated[float, Field(ge=0.0, lt=1.0, allow_inf_nan=False)] | None = None

    @field_validator("plane_distances_mm")
    @classmethod
    def _increasing(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if any(b <= a for a, b in pairwise(value)):
            raise ValueError("distances must increase from one plane to the next")
        return value

    @model_serializer(mode="wrap")
    def _serialized(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit missing values, so that saved runs of designs without them keep their keys."""
        values: dict[str, Any] = handler(self)
        for name in ("cover_glass", "reflectance"):
            if getattr(self, name) is None:
                values.pop(name, None)
        return values

    @model_validator(mode="after")
    def _glass_fits(self) -> Sensor:
        self.cover_glass_at(self.plane_distances_mm[0])
        return self

    def cover_glass_at(self, plane_distance_mm: float) -> CoverGlass | None:
        """Return the cover glass in front of a recording plane, after a check that it fits behind the lens.

        Parameters
        ----------
        plane_distance_mm
            Distance of the plane from the exit vertex. At 0 lies the exit vertex itself: a plane in air.

        Returns
        -------
        CoverGlass or None
            None if the sensor has none, or the plane is that of the exit vertex.

        Raises
        ------
        DesignError
            If the plate does not fit between the exit vertex and the plane.
        """
        glass = self.cover_glass
        if glass is None or plane_distance_mm == 0.0:
            return None
        if glass.depth_mm > plane_distance_mm * (1.0 + 1e-12):
            raise DesignError(
                f"cover_glass: its front face lies {glass.depth_mm:g} mm in front of the pixels "
                f"(thickness_mm = {glass.thickness_mm:g}, distance_mm = {glass.distance_mm:g}), but the "
                f"recording plane lies only {plane_distance_mm:g} mm behind the exit vertex; "
                f"thickness_mm + distance_mm must be at most {plane_distance_mm:g}, or the plane farther away"
            )
        return glass

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width (x) and height (y) of the photosensitive area in mm."""
        return self.pixels[0] * self.pixel_pitch_um * 1e-3, self.pixels[1] * self.pixel_pitch_um * 1e-3


class Lens(FrozenModel):
    """A transfer lens with its object, sensor and wavelengths: the content of a design file.

    Load one with :func:`lensdesign.load_design`, or build it from its components. Change it with
    :meth:`with_surface` or :meth:`replaced`; both validate the result.

    Attributes
    ----------
    title
        Title of the design.
    wavelengths_um
        Vacuum wavelengths of the design; air has the index 1.
    glass_catalogs
        Paths of glass catalogue files (AGF).
    object
        Object plane: field, numerical aperture and working distance.
    sensor
        Sensor and its recording planes.
    surfaces
        Refracting surfaces, front to back.
    edges
        One edge for each glass element, front to back, or none at all.
    moulding
        Settings of the moulding checks; None for their defaults.

    Examples
    --------
    >>> from lensdesign import Lens, ObjectSpace, Sensor, Surface
    >>> lens = Lens(
    ...     wavelengths_um=(0.55,),
    ...     object=ObjectSpace(field_diameter_mm=2.0, numerical_aperture=0.1, working_distance_mm=20.0),
    ...     sensor=Sensor(pixel_pitch_um=3.5, pixels=(1000, 1000), plane_distances_mm=(20.0,)),
    ...     surfaces=(
    ...         Surface(radius_mm=10.0, thickness_mm=3.0, material="N-BK7", semi_diameter_mm=4.0, stop=True),
    ...         Surface(radius_mm=-10.0, semi_diameter_mm=4.0),
    ...     ),
    ... )
    >>> lens.track_mm
    43.0
    >>> lens.with_surface(0, thickness_mm=4.0).track_mm
    44.0
    """

    title: str = ""
    wavelengths_um: Annotated[tuple[Positive, ...], Field(min_length=1)]
    glass_catalogs: tuple[Path, ...] = ()
    object: ObjectSpace
    sensor: Sensor
    surfaces: Annotated[tuple[Surface, ...], Field(alias="surface", min_length=1)]
    edges: Annotated[tuple[Edge, ...], Field(alias="edge")] = ()
    moulding: Moulding | None = None

    @field_validator("glass_catalogs", mode="before")
    @classmethod
    def _paths(cls, value: Any) -> Any:
        if not isinstance(value, list | tuple):
            return value
        return tuple(as_path(v) for v in value)

    @model_validator(mode="after")
    def _sequence(self) -> Lens:
        *front, last = self.surfaces
        for number, surface in enumerate(front, start=1):
            if surface.thickness_mm is None:
                raise ValueError(
                    f"surface {number}: thickness_mm is missing (only the last surface has none)"
                )
        if last.thickness_mm is not None:
            raise ValueError(
                f"surface {len(self.surfaces)}: the last surface has no thickness_mm; "
                "the distances of the sensor are given as [sensor] plane_distances_mm"
            )
        stops = [i + 1 for i, surface in enumerate(self.surfaces) if surface.stop]
        if len(stops) > 1:
            raise ValueError(f"surfaces {stops} are all marked stop = true; a lens has one stop")
        if self.surfaces[self.stop_index].semi_diameter_mm is None:
            raise ValueError(f"surface {self.stop_index + 1} is the stop and needs a semi_diameter_mm")
        if self.sensor.cover_glass is not None and not is_air(last.material):
            raise ValueError(
                f"surface {len(self.surfaces)}: material = {last.material!r} fills the space up to the "
                "sensor; with a [sensor.cover_glass] there must be air behind the lens (no material)"
            )
        self._check_crossing()
        self._check_object_outside()
        self._check_edges()
        return self

    def _check_crossing(self) -> None:
        for i, (front, back) in enumerate(pairwise(self.surfaces)):
            heights = [s.semi_diameter_mm for s in (front, back) if s.semi_diameter_mm is not None]
            if not heights:
                continue
            r = np.linspace(0.0, min(heights), 257)
            gap = axial_gaps_mm(front.shape, back.shape, front.thickness_mm or 0.0, r)
            if np.any(gap <= 0.0):
                height = r[np.argmax(gap <= 0.0)]
                raise ValueError(
                    f"surfaces {i + 1} and {i + 2} cross inside the aperture, at a radial height of "
                    f"{height:.4g} mm (smallest gap {np.nanmin(gap):.4g} mm within {r[-1]:g} mm); "
                    "raise thickness_mm or lower semi_diameter_mm"
                )

    def _check_object_outside(self) -> None:
        front = self.surfaces[0]
        if front.semi_diameter_mm is None:
            return
        x, y = directions(front.shape)
        r = np.linspace(0.0, front.semi_diameter_mm, 257)[:, None]
        sag = front.shape.sag(r * x, r * y)
        reach = -float(np.nanmin(sag))
        if reach >= self.object.working_distance_mm:
            raise ValueError(
                f"the object plane lies within the lens: working_distance_mm = "
                f"{self.object.working_distance_mm:g}, but surface 1 comes {reach:.4g} mm towards the object "
                f"within its semi_diameter_mm of {front.semi_diameter_mm:g}; raise working_distance_mm"
            )

    def _check_edges(self) -> None:
        fronts = self.glass_fronts
        if self.edges and len(self.edges) != len(fronts):
            raise ValueError(
                f"edge: {len(self.edges)} tables given; must be one for each glass element, front to back "
                f"({len(fronts)}), or none at all"
            )
        for number, (i, edge) in enumerate(zip(fronts, self.edges, strict=False), start=1):
            element = glass_element(self, number - 1)
            radii, edge_mm = element.edge_radii_mm, element.edge_mm
            for j, (flat_mm, bevel_mm), radius in zip((i, i + 1), edge.sides(), radii, strict=True):
                inner = radius - bevel_mm if flat_mm is None else flat_mm
                clear = self.surfaces[j].semi_diameter_mm or 0.0
                if inner < clear or inner <= 0.0 or inner > radius - bevel_mm:
                    is_narrowed = radius < edge_mm
                    narrowed = f", which its draft narrows to {radius:.6g} mm there," if is_narrowed else ""
                    flat = f"flat from {flat_mm:g} mm and " if flat_mm is not None else ""
                    raise ValueError(
                        f"edge {number}: the cylinder of semi_diameter_mm = {edge_mm:g}{narrowed} leaves no "
                        f"room for surface {j + 1} (clear semi-diameter {clear:g} mm), its {flat}bevel of "
                        f"{bevel_mm:g} mm"
                    )
            validate_edge(element)
        for number in (self.moulding and self.moulding.elements) or ():
            if number > len(fronts):
                raise ValueError(
                    f"moulding: elements has {number}, but the lens has {len(fronts)}; allowed: 1 to "
                    f"{len(fronts)}"
                )

    @property
    def glass_fronts(self) -> tuple[int, ...]:
        """Index of the front surface of every glass element, front to back."""
        return glass_fronts(self)

    @property
    def stop_index(self) -> int:
        """Index of the aperture stop among the surfaces; the entrance surface if none is marked."""
        return next((i for i, surface in enumerate(self.surfaces) if surface.stop), 0)

    @property
    def stop_semi_diameter_mm(self) -> float:
        """Semi-diameter of the aperture stop."""
        value = self.surfaces[self.stop_index].semi_diameter_mm
        assert value is not None  # the validator requires it
        return value

    @property
    def vertex_z_mm(self) -> NDArray[np.float64]:
        """z of every vertex in mm, shape (surfaces,); the front vertex is at 0."""
        return vertex_z_mm(self.surfaces)

    @property
    def exit_vertex_z_mm(self) -> float:
        """z of the last vertex, from which sensor planes are measured."""
        return float(self.vertex_z_mm[-1])

    @property
    def object_z_mm(self) -> float:
        """z of the object plane."""
        return -self.object.working_distance_mm

    @property
    def track_mm(self) -> float:
        """Distance from the object to the last sensor plane."""
        return self.object.working_distance_mm + self.sensor_z_mm[-1]

    @property
    def sensor_z_mm(self) -> tuple[float, ...]:
        """z of each sensor plane."""
        return tuple(self.exit_vertex_z_mm + d for d in self.sensor.plane_distances_mm)

    @property
    def half_field_mm(self) -> float:
        """Largest field height: half of the field diameter."""
        return 0.5 * self.object.field_diameter_mm

    def indices(self, wavelength_um: float) -> NDArray[np.float64]:
        """Return the index before the first surface (air) and behind each surface, shape (surfaces + 1,).

        Parameters
        ----------
        wavelength_um
            Vacuum wavelength (air has the index 1).

        Raises
        ------
        MaterialError
            If a glass is unknown, or the wavelength lies outside the range for which it is known.
        """
        media = [s.material for s in self.surfaces]
        return np.array(
            [1.0]
            + [
                1.0 if m is None else refractive_index(m, wavelength_um, catalogs=self.glass_catalogs)
                for m in media
            ]
        )

    def sensor_medium_index(self, wavelength_um: float) -> float:
        """Return the index of the medium in which light reaches the recording planes; 1 for air.

        With a cover glass, it is that of the air in front of the glass. A plane plate does not change the
        product of index and sine of an angle, which determines the fringes on the pixels.

        Raises
        ------
        MaterialError
            If the material is unknown, or the wavelength lies outside the range for which it is known.
        """
        medium = self.surfaces[-1].material
        return 1.0 if medium is None else refractive_index(medium, wavelength_um, self.glass_catalogs)

    def cover_glass_index(self, wavelength_um: float) -> float:
        """Return the refractive index of the sensor's cover glass; 1 without one.

        Raises
        ------
        MaterialError
            If the glass is unknown, or the wavelength lies outside the range for which it is known.
        """
        glass = self.sensor.cover_glass
        if glass is None:
            return 1.0
        return refractive_index(glass.material, wavelength_um, catalogs=self.glass_catalogs)

    def without_cover_glass(self) -> Self:
        """Return the lens with a sensor without cover glass: the same lens if it has none."""
        if self.sensor.cover_glass is None:
            return self
        return self.model_copy(update={"sensor": self.sensor.model_copy(update={"cover_glass": None})})

    def with_surface(self, index: int, **changes: Any) -> Self:
        """Return a validated lens with some values of one surface replaced.

        Parameters
        ----------
        index
            Index of the surface in `surfaces`, from 0; files and messages call it surface 1.
        **changes
            New values by the names of :class:`Surface`'s fields.

        Raises
        ------
        DesignError
            If there is no such surface, or the result is not a valid lens.
        """
        count = len(self.surfaces)
        if not -count <= index < count:
            raise DesignError(
                f"index = {index!r}: must be from 0 to {count - 1}, for surface 1 to surface {count}"
            )
        surface = self.surfaces[index].replaced(**changes)
        surfaces = (*self.surfaces[:index], surface, *self.surfaces[index + 1 :])
        return self.replaced(surfaces=surfaces)

    def with_coating(self, coating: SurfaceCoating) -> Self:
        """Return the lens with one coating on all surfaces and on both faces of the sensor's cover glass.

        Parameters
        ----------
        coating
            Coating as of a :class:`Surface`.

        Raises
        ------
        DesignError
            If it is no coating. The rest of the lens is not validated again.
        """
        change = {"coating": Surface().replaced(coating=coating).coating}
        sensor, glass = self.sensor, self.sensor.cover_glass
        if glass is not None:
            sensor = sensor.model_copy(update={"cover_glass": glass.model_copy(update=change)})
        surfaces = tuple(surface.model_copy(update=change) for surface in self.surfaces)
        return self.model_copy(update={"surfaces": surfaces, "sensor": sensor})

    def __repr__(self) -> str:
        media = ", ".join(str(s.material) for s in self.surfaces if s.material is not None)
        return (
            f"<Lens {self.title!r}: {len(self.surfaces)} surfaces, {media or 'no glass'}, "
            f"field {self.object.field_diameter_mm:g} mm, NA {self.object.numerical_aperture:g}>"
        )

    def _repr_html_(self) -> str:
        rows = [(f"surface {number}", text) for number, text in enumerate(map(_summary, self.surfaces), 1)]
        pixels = " x ".join(map(str, self.sensor.pixels))
        planes = ", ".join(f"{d:g}" for d in self.sensor.plane_distances_mm)
        glass = self.sensor.cover_glass
        cover = "" if glass is None else f"; cover glass of {glass.thickness_mm:g} mm {glass.material}"
        rows += [
            ("wavelengths", f"{', '.join(f'{w:g}' for w in self.wavelengths_um)} µm"),
            (
                "object",
                f"field {self.object.field_diameter_mm:g} mm, NA {self.object.numerical_aperture:g}, "
                f"{self.object.working_distance_mm:g} mm before surface 1",
            ),
            ("sensor", f"{pixels} pixels of {self.sensor.pixel_pitch_um:g} µm, {planes} mm behind{cover}"),
        ]
        try:
            picture = section_svg(glass_elements(self))
        except InputError:  # a lens without glass or without a size has no section to draw
            picture = ""
        return html_table(self.title or "Lens", rows, picture)


def _summary(surface: Surface) -> str:
    """Return a surface on one line: the values that differ from their defaults."""
    given = surface.model_dump(exclude_defaults=True, exclude_none=True, exclude={"figure", "coating"})
    values = [
        key if value is True else f"{key} = {value:.7g}" if isinstance(value, float) else f"{key} = {value}"
        for key, value in given.items()
    ]
    if isinstance(surface.coating, Coating):
        values.append(f"coating = {surface.coating.text}")
    elif surface.coating != "ideal":
        values.append(f"coating = {surface.coating}")
    return ", ".join(values + (["with a measured figure"] if surface.figure is not None else [])) or "plane"
