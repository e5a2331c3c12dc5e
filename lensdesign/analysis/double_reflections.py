"""All ghosts of a lens and its sensor: light that is reflected at two surfaces before the sensor records it.

Surfaces are those of the lens, both faces of the sensor's cover glass, and the sensor itself. The power of a
path is that of its rays with the coatings of all surfaces, relative to the direct light of the same rays, for
unpolarized light that an object point sends evenly over all direction cosines.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.text import finite_or_none
from lensdesign.errors import InputError
from lensdesign.lens.coatings.compiled import UniformCoating
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.lens.surface import Surface
from lensdesign.raytrace.bundles import directions_of, largest_cosine
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.ghosts import ghost_system
from lensdesign.raytrace.polarization import jones_matrices
from lensdesign.raytrace.rays import RayTrace, trace_compiled

SENSOR = "sensor"

FOCUSED_IRRADIANCE = 0.01
"""Relative irradiance above which a ghost counts as focused near a recording plane."""


@dataclass(frozen=True)
class GhostSampling:
    """Rays by which ghosts are computed.

    Attributes
    ----------
    fields
        Number of object points from the axis to the edge of the field, along each axis.
    directions
        Number of directions of the rays from each object point, a multiple of 4.
    edge_width
        Width over which the edges of apertures and of the sensor fade, relative to their half size. At 0 they
        are sharp. With a positive width, powers have derivatives, for searches with few rays.

    Examples
    --------
    >>> GhostSampling()
    GhostSampling(fields=3, directions=2000, edge_width=0.0)
    """

    fields: int = 3
    directions: int = 2000
    edge_width: float = 0.0


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
        Radius of an even disc with the same rms radius as the light of the object's centre on the plane; NaN
        if none of this light arrives.
    relative_irradiance : float
        Mean irradiance over that disc, relative to that of the direct light over its own disc.

    Examples
    --------
    See :func:`ghost_paths`.
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
    assumes_bare_surfaces : bool
        Whether surfaces count as bare because all coatings of the design are ideal.
    includes_sensor : bool
        Whether the design states the reflectance of the sensor, so that its paths are listed.

    Examples
    --------
    See :func:`ghost_paths`.
    """

    paths: tuple[GhostPath, ...]
    assumes_bare_surfaces: bool
    includes_sensor: bool

    @property
    def totals(self) -> dict[float, float]:
        """Power of all ghosts on the sensor's area, relative to the direct light, by plane distance in mm."""
        totals: dict[float, float] = {}
        for path in self.paths:
            totals[path.plane_distance_mm] = totals.get(path.plane_distance_mm, 0.0) + path.power_on_sensor
        return totals

    def total(self, plane_distance_mm: float | None = None) -> float:
        """Return the power of all ghosts on the sensor's area, relative to the direct light.

        Parameters
        ----------
        plane_distance_mm
            Distance of the recording plane (default: the one with the largest total).
        """
        if plane_distance_mm is not None:
            return self.totals[plane_distance_mm]
        return max(self.totals.values(), default=0.0)

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each recording plane near which a ghost is focused."""
        sentences = []
        for plane_distance_mm in self.totals:
            focused = [
                path
                for path in self.paths
                if path.plane_distance_mm == plane_distance_mm
                and path.relative_irradiance > FOCUSED_IRRADIANCE
            ]
            if focused:
                sentences.append(_focus_warning(focused))
        return tuple(sentences)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; values that are not finite become None."""
        return {
            "bare_surfaces": self.assumes_bare_surfaces,
            "includes_sensor": self.includes_sensor,
            "totals": [
                {"plane_distance_mm": plane_mm, "power_on_sensor": power}
                for plane_mm, power in self.totals.items()
            ],
            "warnings": list(self.warnings),
            "paths": [
                {key: finite_or_none(value) for key, value in asdict(path).items()} for path in self.paths
            ],
        }


def _focus_warning(focused: Sequence[GhostPath]) -> str:
    """Return the warning of the ghosts that are focused near one plane."""
    worst = max(focused, key=lambda path: path.relative_irradiance)
    side = "in front of" if worst.focus_mm < 0.0 else "behind"
    others = f" (and so are others, {len(focused)} paths in all)" if len(focused) > 1 else ""
    return (
        f"the ghost {worst.first} - {worst.second} is focused {abs(worst.focus_mm):.3g} mm {side} the plane "
        f"at {worst.plane_distance_mm:g} mm{others}: its irradiance is {worst.relative_irradiance:.2g} of "
        f"that of the direct light over a radius of {worst.radius_mm:.3g} mm; reduce the reflectance of "
        "these surfaces by coatings, or move the plane away from the focus"
    )


def ghost_paths(
    lens: Lens,
    wavelength_um: float | None = None,
    *,
    pose: Pose = Pose(),
    surface_perturbations: Mapping[int, SurfacePerturbation] | None = None,
    sensor_poses: Sequence[Pose] = (),
    sampling: GhostSampling = GhostSampling(),
) -> GhostPaths:
    """Trace all paths with two reflections to every recording plane.

    Parameters
    ----------
    lens
        The nominal lens with its sensor. Without a stated reflectance of the sensor, paths that it reflects
        are not listed. If all coatings are ideal, bare surfaces are assumed.
    wavelength_um
        Vacuum wavelength (default: the first of the design).
    pose, surface_perturbations
        Pose of the whole lens and perturbations of its surfaces, as in :func:`lensdesign.trace`, for a single
        lens (default: nominal).
    sensor_poses
        Pose of the sensor with its cover glass for each recording plane (default: nominal). As for the whole
        lens, the pivot is measured from the front vertex.
    sampling
        Rays by which the ghosts are computed.

    Raises
    ------
    InputError
        If no ray passes the lens, a coating's table ends before the angles of the rays, or the number of
        `sensor_poses` differs from that of the planes.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> from lensdesign.analysis import ghost_paths
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> found = ghost_paths(lens)
    >>> strongest = found.paths[0]
    >>> strongest.first, strongest.second, found.assumes_bare_surfaces
    ('surface 2', 'surface 1', True)
    """
    wavelength = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    planes_mm = lens.sensor.plane_distances_mm
    if sensor_poses and len(sensor_poses) != len(planes_mm):
        raise InputError(
            f"sensor_poses has {len(sensor_poses)} poses: must have one for each of the {len(planes_mm)} "
            "recording planes"
        )
    assumes_bare_surfaces = has_ideal_coatings(lens)
    if assumes_bare_surfaces:
        lens = lens.with_coating("bare")
    found: list[GhostPath] = []
    for plane_distance_mm, sensor_pose in zip(
        planes_mm, sensor_poses or (Pose(),) * len(planes_mm), strict=True
    ):
        system, names = sensor_system(
            lens, wavelength, plane_distance_mm, pose, surface_perturbations, sensor_pose
        )
        light = _Light(lens, system, sampling)
        paths = [
            light.path(names, front, back, plane_distance_mm) for front, back in reflecting_pairs(lens, names)
        ]
        found += sorted(paths, key=lambda path: -path.power)
    return GhostPaths(tuple(found), assumes_bare_surfaces, lens.sensor.reflectance is not None)


def has_ideal_coatings(lens: Lens) -> bool:
    """Return whether all surfaces of a lens, and of its cover glass, transmit all light."""
    glass = lens.sensor.cover_glass
    return all(surface.coating == "ideal" for surface in lens.surfaces) and (
        glass is None or glass.coating == "ideal"
    )


def reflecting_pairs(lens: Lens, names: Sequence[str], first_back: int = 1) -> list[tuple[int, int]]:
    """Return the indices, front and back, of the two reflecting surfaces of all paths.

    Parameters
    ----------
    lens
        The lens, which states whether its sensor reflects.
    names
        Names of the surfaces, from :func:`sensor_system`.
    first_back
        Smallest index of the surface that reflects first.
    """
    return [
        (front, back)
        for back in range(first_back, len(names))
        for front in range(back)
        if names[back] != SENSOR or lens.sensor.reflectance
    ]


def sensor_system(
    lens: Lens,
    wavelength_um: float,
    plane_distance_mm: float,
    pose: Pose = Pose(),
    surface_perturbations: Mapping[int, SurfacePerturbation] | None = None,
    sensor_pose: Pose = Pose(),
) -> tuple[CompiledSystem, tuple[str, ...]]:
    """Return the surfaces of lens, cover glass and sensor for one recording plane, with their names.

    Parameters
    ----------
    lens
        The nominal lens.
    wavelength_um
        Vacuum wavelength.
    plane_distance_mm
        Nominal distance of the sensor from the exit vertex.
    pose, surface_perturbations, sensor_pose
        Deviations of a single lens and of the sensor; see :func:`ghost_paths`.
    """
    *front, last = lens.surfaces
    count = len(lens.surfaces)
    names = [f"surface {number}" for number in range(1, count + 1)]
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
    in_air = lens.model_copy(update={"sensor": lens.sensor.replaced(cover_glass=None)})
    spaced = last.model_copy(update={"thickness_mm": max(gap_mm, least_gap_mm)})
    whole = in_air.model_copy(update={"surfaces": (*front, spaced, *behind), "edges": (), "moulding": None})
    nominal = compile_system(whole, wavelength_um)
    sensor = _moved(nominal.part(count, nominal.surfaces), sensor_pose)
    system = _joined(compile_system(in_air, wavelength_um, pose, surface_perturbations), sensor)
    coatings = (*system.coatings[:-1], UniformCoating(lens.sensor.reflectance or 0.0))
    return replace(system, coatings=coatings), tuple(names)


def on_sensor(system: CompiledSystem, rays: RayTrace) -> Array:
    """Return the points on the sensor of :func:`sensor_system` in its own frame, shape (n, 3)."""
    return np.asarray((rays.position - system.vertex[0, -1]) @ system.rotation[0, -1])


def _moved(system: CompiledSystem, pose: Pose) -> CompiledSystem:
    """Return surfaces that move with a pose."""
    rotation, shift = pose.transform()
    turned = np.ascontiguousarray(rotation[:, None] @ system.rotation)
    return replace(
        system,
        rotation=turned,
        vertex=np.ascontiguousarray(np.einsum("tij,tsj->tsi", rotation, system.vertex) + shift[:, None]),
        tilted=np.any(turned != np.eye(3), axis=(0, 2, 3)),
    )


def _joined(lens: CompiledSystem, sensor: CompiledSystem) -> CompiledSystem:
    """Return the surfaces of a single lens followed by those of its sensor."""
    if lens.trials is not None or len(sensor.vertex) > 1:
        raise InputError("ghosts are those of a single lens: poses and perturbations must be numbers")
    return replace(
        lens,
        rotation=np.concatenate([lens.rotation, sensor.rotation], axis=1),
        vertex=np.concatenate([lens.vertex, sensor.vertex], axis=1),
        shapes=lens.shapes + sensor.shapes,
        index=np.concatenate([lens.index, sensor.index[:, 1:]], axis=1),
        semi_diameter=np.concatenate([lens.semi_diameter, sensor.semi_diameter]),
        tilted=np.concatenate([lens.tilted, sensor.tilted]),
        figures=lens.figures + sensor.figures,
        coatings=lens.coatings + sensor.coatings,
    )


class _Light:
    """Rays of object points that pass the lens, and their direct light on the sensor."""

    def __init__(self, lens: Lens, system: CompiledSystem, sampling: GhostSampling) -> None:
        self.lens, self.system, self.edge_width = lens, system, sampling.edge_width
        origins, directions = field_rays(lens, sampling.fields, sampling.directions)
        self.multiplicity = np.ones(len(origins))
        if system.rotational:  # object points at -x and -y give the mirror images of those at x and y
            mirrored = np.any(origins[:, :2] < 0.0, axis=1)
            origins, directions = origins[~mirrored], directions[~mirrored]
            self.multiplicity = np.where(np.any(origins[:, :2] > 0.0, axis=1), 2.0, 1.0)
        direct, weight = self._trace(system, origins, directions)
        passed = weight > 0.0
        if not np.any(passed):
            raise InputError("no ray from the field passes the lens: there is no light for a ghost")
        self.origins, self.directions = origins[passed], directions[passed]
        self.multiplicity = self.multiplicity[passed]
        self.direct = direct.selected(passed)
        self.power = self._power(system, self.direct, weight[passed])
        self.is_central = np.all(self.origins[:, :2] == 0.0, axis=1)

    def _trace(self, system: CompiledSystem, origins: Array, directions: Array) -> tuple[RayTrace, Array]:
        """Return rays, and the part of each (0 to 1) that all apertures transmit."""
        rays = trace_compiled(system, origins, directions, clip=self.edge_width == 0.0, record_hits=True)
        weight = rays.ok.astype(float)
        if self.edge_width > 0.0:
            assert rays.hits is not None  # they are recorded
            for i in np.flatnonzero(np.isfinite(system.semi_diameter)):
                own = (rays.hits[:, i] - system.vertex[0, i]) @ system.rotation[0, i]
                height = np.where(rays.ok, np.hypot(own[:, 0], own[:, 1]), 0.0)
                weight = weight * self._inside(height, float(system.semi_diameter[i]))
        return rays, weight

    def _power(self, system: CompiledSystem, rays: RayTrace, weight: Array) -> Array:
        transmittance = np.nan_to_num(jones_matrices(system, self.origins, rays).transmittance)
        return np.asarray(weight * self.multiplicity * transmittance)

    def _inside(self, distance_mm: Array, half_mm: float) -> Array:
        """Return 1 where a distance is within half a size, and 0 beyond, with the width of the edge."""
        if self.edge_width == 0.0 or half_mm == 0.0:
            return (distance_mm <= half_mm).astype(float)
        step = np.clip(0.5 + (half_mm - distance_mm) / (self.edge_width * half_mm), 0.0, 1.0)
        return np.asarray(step**2 * (3.0 - 2.0 * step))

    def path(self, names: tuple[str, ...], front: int, back: int, plane_distance_mm: float) -> GhostPath:
        system = ghost_system(self.system, front, back)
        rays, weight = self._trace(system, self.origins, self.directions)
        power = self._power(system, rays, weight)
        total = float(np.sum(self.power))
        x_mm, y_mm = np.abs(on_sensor(self.system, rays)[:, :2]).T
        width_mm, height_mm = self.lens.sensor.size_mm
        inside = self._inside(x_mm, 0.5 * width_mm) * self._inside(y_mm, 0.5 * height_mm)
        fraction = float(np.sum(power)) / total
        radius, direct_radius = self._radius_mm(rays, power), self._radius_mm(self.direct, self.power)
        irradiance = 0.0 if math.isnan(radius) else math.inf  # no light, or all of it in one point
        if radius > 0.0:
            irradiance = fraction * (direct_radius / radius) ** 2
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
        """Return the radius of an even disc with the rms radius of the central point's light; NaN without."""
        weight = power * self.is_central * rays.ok
        total = float(np.sum(weight))
        if total == 0.0:
            return math.nan
        points = on_sensor(self.system, rays)[:, :2]
        centre = weight @ points / total
        return float(np.sqrt(2.0 * (weight @ np.sum((points - centre) ** 2, axis=1)) / total))

    def _focus_mm(self, system: CompiledSystem) -> float:
        """Return how far behind the sensor paraxial rays from the object's centre cross each other."""
        sine = 1e-6
        headings = [[0.0, side * sine, np.sqrt(1.0 - sine**2)] for side in (1.0, -1.0)]
        rays = trace_compiled(system, [[0.0, 0.0, self.lens.object_z_mm]] * 2, headings, clip=False)
        height = rays.position[0, 1] - rays.position[1, 1]
        slope = float(np.subtract(*(rays.direction[:, 1] / rays.direction[:, 2])))
        return float(-height / slope) if slope else math.inf


def field_rays(lens: Lens, fields: int = 3, directions: int = 2000) -> tuple[Array, Array]:
    """Return rays of object points along x and y, evenly over the direction cosines of the aperture.

    The directions of each point are mirror images of each other in x and in y. All others have different
    angles to the axis, so that sums change little as rays cross an edge.

    Parameters
    ----------
    lens
        The nominal lens.
    fields
        Number of object points from the axis to the edge of the field, along each axis.
    directions
        Number of directions of each point, a multiple of 4.
    """
    height = lens.half_field_mm * np.sqrt(np.linspace(0.0, 1.0, fields))
    points = [(0.0, 0.0)] + [p for h in height[1:] for p in ((h, 0.0), (0.0, h), (-h, 0.0), (0.0, -h))]
    reach = largest_cosine(lens)
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    index = np.arange(directions // 4) + 0.5
    radius = reach * np.sqrt(index / len(index))
    angle = 0.5 * np.pi * np.mod(golden * index, 1.0)
    quadrant = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    cosines = np.concatenate([quadrant * signs for signs in ((1, 1), (-1, 1), (-1, -1), (1, -1))])
    headings = directions_of(cosines)
    starts = np.column_stack([np.array(points), np.full(len(points), lens.object_z_mm)])
    return np.repeat(starts, len(headings), axis=0), np.tile(headings, (len(starts), 1))
