"""All ghosts of a lens and its sensor: light that is reflected at two surfaces before the sensor records it.

Surfaces are those of the lens, both faces of the sensor's cover glass, and the sensor itself. The power of a
path is that of its rays with the coatings of all surfaces, relative to the direct light of the same rays, for
unpolarized light that an object point sends evenly over all direction cosines.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.coatings.compiled import UniformCoating
from lensdesign.lens.lens import Lens
from lensdesign.lens.surface import Surface
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.ghosts import ghost_system
from lensdesign.raytrace.polarization import jones_matrices
from lensdesign.raytrace.rays import RayTrace, trace_compiled

SENSOR = "sensor"


@dataclass(frozen=True)
class GhostPath:
    """Light that is reflected at one surface and then at another one in front of it, on one recording plane.

    Attributes
    ----------
    first, second : str
        Surfaces in the order in which they reflect: ``surface 2``, ``cover glass rear``, ``sensor``.
    plane_distance_mm : float
        Distance of the recording plane from the exit vertex.
    power : float
        Power that reaches the plane, as a fraction of that of the direct light; mean over the field.
    power_on_sensor : float
        Part of it that falls on the sensor's area.
    focus_mm : float
        Distance of the paraxial image of the object's centre behind the plane; negative in front of it.
    radius_mm : float
        Radius of an even disc with the same rms radius as the light of the object's centre on the plane.
    relative_irradiance : float
        Mean irradiance over that disc, relative to that of the direct light over its own disc.
    """

    first: str
    second: str
    plane_distance_mm: float
    power: float
    power_on_sensor: float
    focus_mm: float
    radius_mm: float
    relative_irradiance: float


@dataclass(frozen=True)
class GhostPaths:
    """The ghosts of a lens and its sensor.

    Attributes
    ----------
    paths : tuple of GhostPath
        For every recording plane, the paths in the order of their power, the strongest first.
    is_what_if : bool
        Whether surfaces count as bare because all coatings of the design are ideal.

    Examples
    --------
    See :func:`ghost_paths`.
    """

    paths: tuple[GhostPath, ...]
    is_what_if: bool

    def total(self, plane_distance_mm: float | None = None) -> float:
        """Return the power of all ghosts on the sensor's area, relative to the direct light.

        Parameters
        ----------
        plane_distance_mm
            Distance of the recording plane (default: the one with the largest total).
        """
        totals: dict[float, float] = {}
        for path in self.paths:
            totals[path.plane_distance_mm] = totals.get(path.plane_distance_mm, 0.0) + path.power_on_sensor
        if plane_distance_mm is not None:
            return totals[plane_distance_mm]
        return max(totals.values(), default=0.0)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"bare_surfaces": self.is_what_if, "paths": [asdict(path) for path in self.paths]}


def ghost_paths(lens: Lens, wavelength_um: float | None = None) -> GhostPaths:
    """Trace all paths with two reflections to every recording plane.

    Parameters
    ----------
    lens
        The nominal lens with its sensor. Without a stated reflectance of the sensor, paths that it reflects
        are not listed. If all coatings are ideal, bare surfaces are assumed.
    wavelength_um
        Vacuum wavelength (default: the first of the design).

    Raises
    ------
    InputError
        If no ray passes the lens, or a coating's table ends before the angles of the rays.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> found = ghost_paths(lens)
    >>> strongest = found.paths[0]
    >>> strongest.first, strongest.second, found.is_what_if
    ('surface 2', 'surface 1', True)
    """
    wavelength = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    is_what_if = all(surface.coating == "ideal" for surface in lens.surfaces) and (
        lens.sensor.cover_glass is None or lens.sensor.cover_glass.coating == "ideal"
    )
    if is_what_if:
        lens = with_coating(lens, "bare")
    found: list[GhostPath] = []
    for plane_distance_mm in lens.sensor.plane_distances_mm:
        system, names = sensor_system(lens, wavelength, plane_distance_mm)
        light = _Light(lens, system)
        paths = [
            light.path(names, front, back, plane_distance_mm)
            for back in range(system.surfaces)
            for front in range(back)
            if names[back] != SENSOR or lens.sensor.reflectance
        ]
        found += sorted(paths, key=lambda path: -path.power)
    return GhostPaths(tuple(found), is_what_if)


def with_coating(lens: Lens, coating: str) -> Lens:
    """Return a lens whose surfaces, and the faces of its cover glass, all have a coating of this name."""
    surfaces = tuple(surface.replaced(coating=coating) for surface in lens.surfaces)
    sensor = lens.sensor
    if sensor.cover_glass is not None:
        sensor = sensor.replaced(cover_glass=sensor.cover_glass.replaced(coating=coating))
    return lens.replaced(surfaces=surfaces, sensor=sensor)


def sensor_system(
    lens: Lens, wavelength_um: float, plane_distance_mm: float
) -> tuple[CompiledSystem, tuple[str, ...]]:
    """Return the surfaces of lens, cover glass and sensor for one recording plane, with their names.

    Parameters
    ----------
    lens
        The nominal lens.
    wavelength_um
        Vacuum wavelength.
    plane_distance_mm
        Distance of the sensor from the exit vertex.
    """
    *front, last = lens.surfaces
    names = [f"surface {number}" for number in range(1, len(lens.surfaces) + 1)]
    glass = lens.sensor.cover_glass_at(plane_distance_mm)
    behind = [Surface()]
    gap_mm = plane_distance_mm
    if glass is not None:
        gap_mm = plane_distance_mm - glass.depth_mm
        plate = Surface(material=glass.material, thickness_mm=glass.thickness_mm, coating=glass.coating)
        behind = [plate, Surface()]
        names.append("cover glass front")
        if glass.distance_mm > 0.0:
            rear = Surface(thickness_mm=glass.distance_mm, coating=glass.coating)
            behind = [plate, rear, Surface()]
            names.append("cover glass rear")
    names.append(SENSOR)
    least_gap_mm = 1e-9  # a plate that touches the exit vertex
    bare_sensor = lens.sensor.replaced(cover_glass=None)
    whole = lens.replaced(
        surfaces=(*front, last.replaced(thickness_mm=max(gap_mm, least_gap_mm)), *behind),
        sensor=bare_sensor,
        edges=(),
        moulding=None,
    )
    system = compile_system(whole, wavelength_um)
    coatings = (*system.coatings[:-1], UniformCoating(lens.sensor.reflectance or 0.0))
    return replace(system, coatings=coatings), tuple(names)


class _Light:
    """Rays of object points that pass the lens, and their direct light on the sensor."""

    def __init__(self, lens: Lens, system: CompiledSystem) -> None:
        self.lens, self.system = lens, system
        origins, directions = field_rays(lens)
        direct = trace_compiled(system, origins, directions, record_hits=True)
        if not np.any(direct.ok):
            raise InputError("no ray from the field passes the lens: there is no light for a ghost")
        self.origins, self.directions = origins[direct.ok], directions[direct.ok]
        self.direct = trace_compiled(system, self.origins, self.directions, record_hits=True)
        self.power = jones_matrices(system, self.origins, self.direct).transmittance
        self.is_central = np.all(self.origins[:, :2] == 0.0, axis=1)

    def path(self, names: tuple[str, ...], front: int, back: int, plane_distance_mm: float) -> GhostPath:
        system = ghost_system(self.system, front, back)
        rays = trace_compiled(system, self.origins, self.directions, record_hits=True)
        power = np.nan_to_num(jones_matrices(system, self.origins, rays).transmittance) * rays.ok
        total = float(np.sum(self.power))
        half = 0.5 * np.array(self.lens.sensor.size_mm)
        inside = np.all(np.abs(rays.position[:, :2]) <= half, axis=1)
        fraction = float(np.sum(power)) / total
        radius, direct_radius = self._radius_mm(rays, power), self._radius_mm(self.direct, self.power)
        irradiance = fraction * (direct_radius / radius) ** 2 if radius > 0.0 else float("inf")
        return GhostPath(
            first=names[back],
            second=names[front],
            plane_distance_mm=plane_distance_mm,
            power=fraction,
            power_on_sensor=float(np.sum(power * inside)) / total,
            focus_mm=self._focus_mm(system),
            radius_mm=radius,
            relative_irradiance=irradiance,
        )

    def _radius_mm(self, rays: RayTrace, power: Array) -> float:
        """Return the radius of an even disc with the rms radius of the central point's light."""
        weight = power * self.is_central * rays.ok
        total = float(np.sum(weight))
        if total == 0.0:
            return float("nan")
        points = rays.position[:, :2]
        centre = weight @ points / total
        return float(np.sqrt(2.0 * (weight @ np.sum((points - centre) ** 2, axis=1)) / total))

    def _focus_mm(self, system: CompiledSystem) -> float:
        """Return how far behind the sensor a paraxial ray from the object's centre meets the axis."""
        sine = 1e-6
        start, heading = [[0.0, 0.0, self.lens.object_z_mm]], [[0.0, sine, np.sqrt(1.0 - sine**2)]]
        ray = trace_compiled(system, start, heading, clip=False)
        slope = ray.direction[0, 1] / ray.direction[0, 2]
        return float(-ray.position[0, 1] / slope) if slope else float("inf")


def field_rays(lens: Lens, fields: int = 3, rings: int = 24) -> tuple[Array, Array]:
    """Return rays of object points along x and y, evenly over the direction cosines of the aperture.

    Parameters
    ----------
    lens
        The nominal lens.
    fields
        Number of object points from the axis to the edge of the field, along each axis.
    rings
        Number of rings of directions.
    """
    height = lens.half_field_mm * np.sqrt(np.linspace(0.0, 1.0, fields))
    points = [(0.0, 0.0)] + [p for h in height[1:] for p in ((h, 0.0), (0.0, h), (-h, 0.0), (0.0, -h))]
    # Directions of the edge of the field are a little steeper than the aperture on the axis.
    reach = min(0.999, 1.2 * lens.object.numerical_aperture)
    radius = reach * np.sqrt((np.arange(rings) + 0.5) / rings)
    angle = 2.0 * np.pi * np.arange(4 * rings) / (4 * rings)
    cosines = np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))], axis=-1)
    cosines = cosines.reshape(-1, 2)
    headings = np.column_stack([cosines, np.sqrt(1.0 - np.sum(cosines**2, axis=1))])
    starts = np.column_stack([np.array(points), np.full(len(points), lens.object_z_mm)])
    return np.repeat(starts, len(headings), axis=0), np.tile(headings, (len(starts), 1))
