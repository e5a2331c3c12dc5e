"""Rays from the object disc to one given point of the sensor (Fig. 2d)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.bundles import directions_of, launch_compiled, pupil_hexapolar
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.rays import trace_compiled

Flags = NDArray[np.bool_]

RINGS, ARMS = 8, 32
"""Rings and points per ring of the ray map over the stop."""

ARRIVAL_TOLERANCE_MM = 1e-9
"""Largest distance from the target at which a ray counts as arriving."""


@dataclass(frozen=True)
class ArrivalAngles:
    """Rays from the whole object disc that arrive at one point of the sensor.

    An object point has a row for each of its rays that arrives. A point without such a ray has one row with
    `ok` False.

    Attributes
    ----------
    sensor_point_mm, plane_distance_mm
        The point, and the distance of its plane from the exit vertex.
    object_points_mm : ndarray, shape (n, 2)
        Object points, uniformly distributed over the disc.
    cosines : ndarray, shape (n, 2)
        Direction cosines L, M behind the lens; 0 where no ray arrives.
    ok : ndarray of bool, shape (n,)
        False where no ray exists or the ray is clipped.
    fraction
        Fraction of the object points from which a ray arrives (0 to 1).
    largest_deg
        Largest angle to the axis; NaN if nothing arrives.
    """

    sensor_point_mm: tuple[float, float]
    plane_distance_mm: float
    object_points_mm: Array
    cosines: Array
    ok: NDArray[np.bool_]
    fraction: float
    largest_deg: float

    @property
    def angles_deg(self) -> Array:
        """Angles (theta_x, theta_y) in the xz and yz planes, atan(L/N) and atan(M/N), shape (n, 2)."""
        n = np.sqrt(1.0 - np.sum(self.cosines**2, axis=-1, keepdims=True))
        return np.rad2deg(np.arctan2(self.cosines, n))


def arrival_angles(
    lens: Lens,
    sensor_point_mm: tuple[float, float],
    plane_distance_mm: float = 3.0,
    wavelength_um: float | None = None,
    object_rings: int = 16,
) -> ArrivalAngles:
    """Return the directions in which light from the whole object disc arrives at a sensor point (Fig. 2d).

    The ray map of each object point is divided into triangles. Each triangle whose image contains the sensor
    point starts Newton's method on the launch direction. Where the map folds, each sheet gives its own ray.

    Parameters
    ----------
    lens
        The lens.
    sensor_point_mm
        x and y on the plane.
    plane_distance_mm
        Distance of the plane from the exit vertex.
    wavelength_um
        Vacuum wavelength (default: the first of the lens).
    object_rings
        Number r of rings of object points on the disc, with 1 + 3 r (r + 1) points.

    Raises
    ------
    InputError
        If the sensor point is not two finite numbers.
    """
    wavelength_um = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    target = np.asarray(sensor_point_mm, float)
    if target.shape != (2,) or not np.all(np.isfinite(target)):
        raise InputError(f"sensor_point_mm = {sensor_point_mm!r}: must be two finite numbers, x and y")
    points = lens.half_field_mm * pupil_hexapolar(object_rings).points
    system = compile_system(lens, wavelength_um)
    lens.sensor.cover_glass_at(plane_distance_mm)
    plane_z_mm = lens.exit_vertex_z_mm + plane_distance_mm
    owner, direction, ok = arriving_rays(lens, system, points, target, plane_z_mm)
    angle = np.arctan2(np.hypot(direction[:, 0], direction[:, 1]), direction[:, 2])
    return ArrivalAngles(
        sensor_point_mm=(float(target[0]), float(target[1])),
        plane_distance_mm=plane_distance_mm,
        object_points_mm=points[owner],
        cosines=np.where(ok[:, None], direction[:, :2], 0.0),
        ok=ok,
        fraction=len(np.unique(owner[ok])) / len(points),
        largest_deg=math.degrees(np.max(angle[ok])) if np.any(ok) else math.nan,
    )


def arriving_rays(
    lens: Lens, system: CompiledSystem, object_points_mm: Array, target_mm: Array, plane_z_mm: float
) -> tuple[NDArray[np.int64], Array, Flags]:
    """Find every ray from each object point to a target point.

    Parameters
    ----------
    lens, system
        The nominal lens and the system compiled from it (one trial).
    object_points_mm
        x and y of object points, shape (points, 2).
    target_mm, plane_z_mm
        x and y of the target, and z of its plane.

    Returns
    -------
    owner : ndarray of int, shape (n,)
        Index of the object point of each ray, in increasing order; every object point has at least one row.
    direction : ndarray, shape (n, 3)
        Direction cosines behind the lens.
    ok : ndarray of bool, shape (n,)
        Whether the ray exists and passes the lens.
    """
    cosines, landed, alive = _ray_map(lens, system, object_points_mm, plane_z_mm)
    owner, start = _starts(cosines, landed - target_mm, alive)
    origins = np.column_stack([object_points_mm, np.full(len(object_points_mm), lens.object_z_mm)])
    solution = _newton(system, origins[owner], start, target_mm, plane_z_mm)
    rays = trace_compiled(system, origins[owner], directions_of(solution), plane_z_mm)
    distance = np.linalg.norm(rays.position[:, :2] - target_mm, axis=-1)
    ok = rays.ok & (distance < ARRIVAL_TOLERANCE_MM)
    return _distinct_rays(owner, solution, rays.direction, ok, len(object_points_mm))


def _triangles() -> NDArray[np.int64]:
    """Return the corners of the triangles between the centre and the rings, shape (triangles, 3)."""
    arm = np.arange(ARMS)
    after = (arm + 1) % ARMS
    triangles = [np.stack([np.zeros(ARMS, int), 1 + arm, 1 + after], axis=-1)]
    for ring in range(1, RINGS):
        inner, outer = 1 + (ring - 1) * ARMS, 1 + ring * ARMS
        triangles.append(np.stack([inner + arm, outer + arm, outer + after], axis=-1))
        triangles.append(np.stack([inner + arm, outer + after, inner + after], axis=-1))
    return np.concatenate(triangles)


def _ray_map(
    lens: Lens, system: CompiledSystem, object_points_mm: Array, plane_z_mm: float
) -> tuple[Array, Array, Flags]:
    """Return launch cosines over the stop for every object point, their landing points, and which arrive."""
    angle = 2.0 * np.pi * np.arange(ARMS) / ARMS
    radius = np.arange(1, RINGS + 1) / RINGS
    polar = np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))], axis=-1)
    pupil = np.concatenate([np.zeros((1, 2)), polar.reshape(-1, 2)])
    origins, directions = launch_compiled(
        system, object_points_mm, pupil, lens.object_z_mm, lens.stop_index, lens.stop_semi_diameter_mm
    )
    cosines = directions[:, :2].reshape(len(object_points_mm), len(pupil), 2).copy()
    # The outermost triangles reach slightly past the rim, so that their chords cover the whole stop.
    cosines[:, -ARMS:] = cosines[:, :1] + 1.02 * (cosines[:, -ARMS:] - cosines[:, :1])
    rays = trace_compiled(system, origins, directions_of(cosines.reshape(-1, 2)), plane_z_mm, clip=False)
    shape = cosines.shape[:2]
    return cosines, rays.position[:, :2].reshape(*shape, 2), rays.ok.reshape(shape)


def _starts(cosines: Array, offset: Array, alive: Flags) -> tuple[NDArray[np.int64], Array]:
    """Return object index and interpolated launch cosines of triangles whose image contains the target."""
    corners = _triangles()
    a, b, c = (offset[:, corners[:, i]] for i in range(3))

    def cross(u: Array, v: Array) -> Array:
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    weights = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=-1)
    total = weights.sum(axis=-1)
    # Slightly larger than the triangle, so that no ray is lost between the curved edges of two triangles.
    slack = 0.02 * np.abs(total)[..., None]
    contains = np.all(weights * np.sign(total)[..., None] >= -slack, axis=-1) & (total != 0.0)
    contains &= alive[:, corners].all(axis=-1)
    owner, triangle = np.nonzero(contains)
    barycentric = weights[owner, triangle] / total[owner, triangle, None]
    return owner, np.einsum("nk,nkx->nx", barycentric, cosines[owner[:, None], corners[triangle]])


def _newton(
    system: CompiledSystem, origins: Array, cosines: Array, target: Array, plane_z_mm: float
) -> Array:
    """Return launch cosines of rays that land on the target, by damped Newton steps."""

    def residual(cosines: Array) -> Array:
        rays = trace_compiled(system, origins, directions_of(cosines), plane_z_mm, clip=False)
        return np.where(rays.ok[:, None], rays.position[:, :2] - target, np.inf)

    delta = 1e-6
    error = residual(cosines)
    scale = np.ones(len(cosines))
    for _ in range(30):
        distance = np.linalg.norm(error, axis=-1)
        if not np.any((distance > 0.1 * ARRIVAL_TOLERANCE_MM) & np.isfinite(distance)):
            break
        with np.errstate(invalid="ignore"):  # inf - inf where the ray fails on both sides
            columns = [
                (residual(cosines + delta * axis) - residual(cosines - delta * axis)) for axis in np.eye(2)
            ]
        jacobian = np.stack(columns, axis=-1) / (2.0 * delta)
        usable = np.all(np.isfinite(jacobian), axis=(1, 2)) & np.isfinite(distance)
        jacobian[~usable] = np.eye(2)
        usable &= np.abs(np.linalg.det(jacobian)) > 1e-9
        jacobian[~usable] = np.eye(2)
        step = np.linalg.solve(jacobian, np.where(usable[:, None], error, 0.0)[..., None])[..., 0]
        trial = cosines - scale[:, None] * step
        trial_error = residual(trial)
        better = np.linalg.norm(trial_error, axis=-1) < distance
        cosines = np.where(better[:, None], trial, cosines)
        error = np.where(better[:, None], trial_error, error)
        scale = np.where(better, 1.0, 0.5 * scale)
    return cosines


def _distinct_rays(
    owner: NDArray[np.int64], cosines: Array, direction: Array, ok: Flags, points: int
) -> tuple[NDArray[np.int64], Array, Flags]:
    """Return each distinct ray once, and a row that is not ok for every object point without rays."""
    _, first = np.unique(np.column_stack([owner, np.round(cosines, 7)]), axis=0, return_index=True)
    keep = np.zeros(len(owner), bool)
    keep[first] = True
    keep &= ok
    without = np.setdiff1d(np.arange(points), owner[keep])
    owner = np.concatenate([owner[keep], without])
    direction = np.concatenate([direction[keep], np.tile([0.0, 0.0, 1.0], (len(without), 1))])
    flags = np.arange(len(owner)) < len(owner) - len(without)
    order = np.argsort(owner, kind="stable")
    return owner[order], direction[order], flags[order]
