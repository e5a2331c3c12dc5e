"""Rays of object points through a lens, with the quantities that a wave along them needs.

A ray is named by its object point and by the point of the stop through which it goes, as a share of the
stop's semi-diameter. Beside its end on a plane it carries the optical path V, the object-side direction
cosines p, and the amplitude `a = sqrt(|dp/ds| cos(t_obj) / (n cos(t_out)))` that keeps the flux of a tube of
rays. Each caustic that it has touched on its way turns its phase back by a quarter wave; see Yu. A. Kravtsov
and Yu. I. Orlov, "Geometrical Optics of Inhomogeneous Media" (1990).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.raytrace.bundles import launch_pairs
from lensdesign.raytrace.polarization import incidence_cosines, jones_matrices
from lensdesign.raytrace.rays import RayTrace, trace_compiled
from lensdesign.raytrace.status import Status
from wavesim.rays.interfaces import coating_transmission, validate_meridional
from wavesim.scene.polarization import components_of, is_vector
from wavesim.scene.scene import Scene

STEP = 3e-4
"""Step in stop coordinates for central differences of rays; their relative error is about 1e-8."""


class FoldError(InputError):
    """The map from directions at the object to sensor points folds: no single ray per sensor point."""


@dataclass(frozen=True)
class OpenPupil:
    """The part of the stop through which light of one object point passes the whole lens.

    Attributes
    ----------
    centre : ndarray, shape (2,)
        A point inside, in stop coordinates.
    reach : ndarray, shape (arms,)
        Distance from the centre to the rim along arms at evenly spaced angles; on a line, along +y and -y.
    angles : ndarray, shape (arms,)
        Angles of the arms in radians, from x towards y.
    """

    centre: Array
    reach: Array
    angles: Array

    @property
    def is_line(self) -> bool:
        """True if there is only y."""
        return len(self.angles) == 2

    @cached_property
    def rim(self) -> Array:
        """Points where the light ends, shape (arms, 2)."""
        return self.points(np.ones(len(self.angles)), self.angles)

    def points(self, fraction: Array, angle: Array) -> Array:
        """Return stop points at fractions of the reach along angles, shape (n, 2)."""
        along = np.column_stack([np.cos(angle) * (not self.is_line), np.sin(angle)])
        return self.centre + (fraction * self._reach_at(angle))[:, None] * along

    def inwards(self, stop: Array) -> Array:
        """Return the distance of stop points (n, 2) inside the rim, along their arms; negative outside."""
        x, y = (stop - self.centre).T
        return np.asarray(self._reach_at(np.arctan2(y, x)) - np.hypot(x, y))

    def _reach_at(self, angle: Array) -> Array:
        if self.is_line:
            return np.where(angle > 0.0, self.reach[0], self.reach[1])
        step = 2.0 * np.pi / len(self.angles)
        closed = np.append(self.reach, self.reach[0])
        return np.interp(np.mod(angle, 2.0 * np.pi), step * np.arange(len(closed)), closed)


@dataclass(frozen=True, eq=False)
class RayBundle:
    """Rays from object points to one plane; arrays of n rays, `d` is 1 on a line and 2 on a plane.

    Attributes
    ----------
    ok : ndarray of bool, shape (n,)
        True if the ray and its neighbours arrive. The other values of a ray that does not are undefined.
    pupil : ndarray, shape (n, 2)
        Stop coordinates.
    sensor_mm : ndarray, shape (n, d)
        Coordinates on the plane: y, or y and x.
    path_mm : ndarray, shape (n,)
        Optical path V, with the phase of the coatings for scalar waves.
    cosines, slopes : ndarray, shape (n, d)
        -dV/ds at the object (p), and dV/ds at the plane.
    amplitude : ndarray, shape (n,)
        Amplitude in mm^(-d/2). For scalar waves it includes the transmission of the coatings.
    jacobian, cosine_jacobian : ndarray, shape (n, d, d)
        Derivatives of `sensor_mm` and `cosines` with respect to the stop coordinates.
    slope_jacobian : ndarray, shape (n, d, d)
        Derivatives of the slopes dx/dz and dy/dz behind the lens with respect to the stop coordinates.
    caustics : ndarray of int, shape (n,)
        Caustics touched between object and plane.
    jones : ndarray, shape (n, components), or None
        Components of the field behind the lens relative to `amplitude` and `path_mm`; None for scalar waves.
    """

    ok: NDArray[np.bool_]
    pupil: Array
    sensor_mm: Array
    path_mm: Array
    cosines: Array
    slopes: Array
    amplitude: Array
    jacobian: Array
    cosine_jacobian: Array
    slope_jacobian: Array
    caustics: NDArray[np.intp]
    jones: NDArray[np.complex128] | None = None

    def jacobian_before(self, distance_mm: float) -> Array:
        """Return derivatives of the points on a plane at a distance in front of this one, shape (n, d, d)."""
        return self.jacobian - distance_mm * self.slope_jacobian

    @cached_property
    def determinant(self) -> Array:
        """Determinant of `jacobian`: 0 on a caustic, of one sign where the map does not fold."""
        return determinants(self.jacobian)


def shoot(scene: Scene, points_mm: Array, pupil: Array, plane_z_mm: float, *, clip: bool) -> RayTrace:
    """Trace rays from object points (x, y) through stop points, one of each, with hits on all surfaces.

    Where the stop's surface does not reach, rays count as missed.
    """
    origins, directions = launch_pairs(scene.system, points_mm, pupil, scene.object_grid.z_mm, *scene.stop)
    real = np.asarray(np.isfinite(directions).all(axis=-1))
    directions = np.where(real[..., None], directions, [0.0, 0.0, 1.0])
    rays = trace_compiled(scene.system, origins, directions, plane_z_mm, clip=clip, record_hits=True)
    rays.status[~real.reshape(rays.status.shape)] = Status.MISSED
    if clip:
        steep = rays.ok & (np.hypot(*rays.direction[:, :2].T) > scene.steepest_sine)
        rays.status[steep], rays.failed_surface[steep] = Status.CLIPPED, scene.system.surfaces - 1
    return rays


def open_pupil(scene: Scene, point_mm: tuple[float, float], plane_z_mm: float, arms: int = 180) -> OpenPupil:
    """Find the part of the stop that is open to an object point.

    Raises
    ------
    InputError
        If no ray of the object point gets through the lens, or the open part has a hole in its middle.
    """
    is_line = scene.object_grid.is_line
    # Samples along each side of the grid that finds the open part of the stop, on a line and on a plane.
    centre_samples = {True: 401, False: 41}
    rim = 1.0 - 1e-9
    side = np.linspace(-rim, rim, centre_samples[is_line])
    if is_line:
        raster = np.column_stack([np.zeros(len(side)), side])
        angles = np.array([0.5, -0.5]) * np.pi
    else:
        raster = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        raster = raster[np.hypot(*raster.T) <= rim]
        angles = 2.0 * np.pi * np.arange(arms) / arms

    def passes(pupil: Array) -> NDArray[np.bool_]:
        points = np.broadcast_to(np.asarray(point_mm, float), pupil.shape)
        return shoot(scene, points, pupil, plane_z_mm, clip=True).ok

    through = passes(raster)
    if not np.any(through):
        raise InputError(
            f"no ray from the object point ({point_mm[0]:g}, {point_mm[1]:g}) mm gets through the lens: "
            "choose object points that the lens sees"
        )
    centre = raster[through].mean(axis=0)
    if not passes(centre[None])[0]:
        raise InputError(
            f"the light of the object point ({point_mm[0]:g}, {point_mm[1]:g}) mm is stopped in the middle "
            "of the bundle: maps over its footprint need one without a hole"
        )
    along = np.column_stack([np.cos(angles) * (not is_line), np.sin(angles)])
    dot = along @ centre
    far = -dot + np.sqrt(dot * dot + rim * rim - centre @ centre)
    near = np.zeros(len(angles))
    clipped = ~passes(centre + far[:, None] * along)
    if np.any(clipped):
        high = far.copy()
        bisections = 34
        for _ in range(bisections):
            middle = 0.5 * (near + high)
            good = passes(centre + middle[:, None] * along)
            near, high = np.where(good, middle, near), np.where(good, high, middle)
    return OpenPupil(centre, np.where(clipped, near, far), angles)


def trace_bundle(scene: Scene, points_mm: Array, pupil: Array, plane_z_mm: float) -> RayBundle:
    """Trace rays from object points (x, y) through stop points, with their neighbours.

    Raises
    ------
    InputError
        If the scene is that of a line, and rays leave the meridional plane.
    """
    axes = [1] if scene.object_grid.is_line else [1, 0]
    points = np.broadcast_to(np.asarray(points_mm, float), pupil.shape)
    moves = STEP * np.array([np.zeros(2), *(sign * np.eye(2)[axis] for axis in axes for sign in (1.0, -1.0))])
    # Calls for each neighbour would cost more than the rays themselves.
    all_points = np.tile(points, (len(moves), 1))
    bunch = shoot(scene, all_points, (pupil + moves[:, None]).reshape(-1, 2), plane_z_mm, clip=False)
    rays = bunch.selected(slice(0, len(pupil)))
    validate_meridional(scene, rays)
    headings = _first_headings(scene, all_points, bunch).reshape(len(moves), -1, 3)
    first = headings[0]
    ok = bunch.ok.reshape(len(moves), -1).all(axis=0)
    tangents = (bunch.direction / bunch.direction[:, 2:]).reshape(len(moves), -1, 3)
    all_knots = _knots(bunch).reshape(len(moves), len(pupil), -1, 3)
    knots, turns, tilts = (
        np.stack([(a[i] - a[i + 1]) / (2.0 * STEP) for i in range(1, len(moves), 2)], axis=-1)
        for a in (all_knots, headings, tangents)
    )
    n_object, n_image = (float(scene.system.index[0, i]) for i in (0, -1))
    jacobian = knots[:, -1][:, axes]
    cosine_jacobian = n_object * turns[:, axes]
    ratio = (n_object * first[:, 2]) / (n_image * rays.direction[:, 2])
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.abs(determinants(cosine_jacobian) / determinants(jacobian))
        amplitude, path_mm = np.sqrt(spread * ratio), rays.opl
    jones = None
    if is_vector(scene.polarization) or not scene.has_ideal_coatings:
        through = _through_coatings(scene, points, rays)
        amplitude, jones = amplitude * through.amplitude, through.jones
        path_mm = path_mm + through.phase_rad / scene.wavenumber_per_mm
    return RayBundle(
        ok=ok & np.isfinite(amplitude),
        pupil=pupil,
        sensor_mm=rays.position[:, axes],
        path_mm=path_mm,
        cosines=n_object * first[:, axes],
        slopes=n_image * rays.direction[:, axes],
        amplitude=amplitude,
        jacobian=jacobian,
        cosine_jacobian=cosine_jacobian,
        slope_jacobian=tilts[:, axes],
        caustics=_caustics(rays, knots),
        jones=jones,
    )


def determinants(matrices: Array) -> Array:
    """Return determinants of matrices of one or two rows, shape (n, d, d), faster than by elimination."""
    if matrices.shape[-1] == 1:
        return np.asarray(matrices[:, 0, 0])
    return np.asarray(matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0])


def inverses(matrices: Array) -> Array:
    """Return inverses of matrices of one or two rows, shape (n, d, d); 0 where a matrix is singular."""
    size = determinants(matrices)
    with np.errstate(divide="ignore"):
        inverse = np.where(size != 0.0, 1.0 / size, 0.0)[:, None, None]
    if matrices.shape[-1] == 1:
        return np.asarray(inverse)
    (a, b), (c, d) = np.moveaxis(matrices, 0, -1)
    return np.asarray(inverse * np.moveaxis(np.array([[d, -b], [-c, a]]), -1, 0))


def _knots(rays: RayTrace) -> Array:
    """Return the points on each surface and on the plane, shape (n, surfaces + 1, 3)."""
    assert rays.hits is not None
    return np.concatenate([rays.hits, rays.position[:, None]], axis=1)


def _first_headings(scene: Scene, points: Array, rays: RayTrace) -> Array:
    assert rays.hits is not None
    way = rays.hits[:, 0] - np.column_stack([points, np.full(len(points), scene.object_grid.z_mm)])
    return np.asarray(way / np.linalg.norm(way, axis=1, keepdims=True))


class _ThroughCoatings(NamedTuple):
    """Effect of the coatings: a factor on the amplitude, a phase, and the components relative to both."""

    amplitude: Array
    phase_rad: Array
    jones: NDArray[np.complex128] | None


def _through_coatings(scene: Scene, points: Array, rays: RayTrace) -> _ThroughCoatings:
    """Return the effect of the coatings on rays; for components, the amplitude is part of their matrices."""
    origins = np.column_stack([points, np.full(len(points), scene.object_grid.z_mm)])
    is_polarized = is_vector(scene.polarization)
    polarized = jones_matrices(scene.system, origins, rays) if is_polarized else None
    cosines = incidence_cosines(scene.system, origins, rays) if polarized is None else polarized.cos_incidence
    transmitted = coating_transmission(scene, cosines)
    axial = complex(coating_transmission(scene, np.ones((1, scene.system.surfaces)))[0])
    # The phase relative to that on the axis has no jumps.
    phase = np.angle(transmitted / axial) + np.angle(axial)
    if polarized is None:
        return _ThroughCoatings(np.abs(transmitted), phase, None)
    components = components_of(scene.polarization)
    jones = np.stack([component.of(polarized.jones) for component in components], axis=-1)
    return _ThroughCoatings(np.ones(len(points)), phase, jones * np.exp(-1j * phase)[:, None])


def _caustics(rays: RayTrace, knots: Array) -> NDArray[np.intp]:
    """Count the zeros of a ray tube's cross-section behind the first surface.

    Between surfaces points and their derivatives to the stop coordinates are linear along the ray, so that
    the cross-section is a polynomial of the first (line) or second (plane) degree.
    """
    points = _knots(rays)
    count = np.zeros(len(points), np.intp)
    for leg in range(points.shape[1] - 1):
        heading = points[:, leg + 1] - points[:, leg]
        heading = np.where(np.any(heading != 0.0, axis=1)[:, None], heading, rays.direction)
        areas = [
            _cross_section((1.0 - t) * knots[:, leg] + t * knots[:, leg + 1], heading)
            for t in (0.0, 0.5, 1.0)
        ]
        start, half, end = areas
        bend, slope = 2.0 * (start - 2.0 * half + end), 4.0 * half - 3.0 * start - end
        turns = np.abs(slope) + np.abs(bend) > 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            place = np.where(turns & (bend != 0.0), -0.5 * slope / bend, -1.0)
            lowest = start - 0.25 * np.where(bend != 0.0, slope * slope / bend, 0.0)
        crossed = np.sign(start) * np.sign(end) < 0.0
        twice = ~crossed & (place > 0.0) & (place < 1.0) & (np.sign(lowest) * np.sign(start) < 0.0)
        count += crossed + 2 * twice
    return count


def _cross_section(derivatives: Array, heading: Array) -> Array:
    """Return the determinant of the derivatives across the ray and its heading, shape (n,)."""
    if derivatives.shape[-1] == 1:
        return np.asarray(derivatives[:, 1, 0] * heading[:, 2] - derivatives[:, 2, 0] * heading[:, 1])
    (ax, bx), (ay, by), (az, bz) = np.moveaxis(derivatives, 0, -1)
    x, y, z = heading.T
    return np.asarray((ay * bz - az * by) * x + (az * bx - ax * bz) * y + (ax * by - ay * bx) * z)
