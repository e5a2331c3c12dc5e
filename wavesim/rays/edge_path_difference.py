"""Detour of light that the stop's rim diffracts: its path minus that of the direct ray to the same point.

Rays of neighbouring object points through one point of the rim land on both sides of the footprint's border.
The direct ray of the object point itself is aimed at each of these landing points. The detour is the
difference of both paths. It is evaluated where it is stationary along the rim.

An *arm* is a radial line of the open pupil. Its end is a point of the rim.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.raytrace.rays import RayTrace
from wavesim.rays.ray_bundles import STEP, OpenPupil, inverses, shoot, trace_bundle
from wavesim.scene.scene import Scene

AIM_STEPS = 12
"""Largest number of Newton steps that aim a ray."""

STEP_FRACTIONS = (1.0, 0.2, 0.04)
"""Displacements of the object point that are tried, in Fresnel zones of the object."""

AIM_TOLERANCE_MM, RIM_TOLERANCE_MM = 1e-6, 1e-9
"""Tolerances of aiming on the plane and on the rim; the remaining phase error is below 1e-5 radians."""


@dataclass(frozen=True)
class EdgeRayLandings:
    """Landing points of rays by way of the rim.

    Attributes
    ----------
    inwards : ndarray, shape (n,)
        Distance of the direct ray inside the rim, in stop coordinates; negative in the shadow.
    detour : ndarray, shape (n,)
        Phase of the detour in radians: k times the difference of both paths.
    stop : ndarray, shape (n, 2)
        Stop point of the direct ray.
    ok : ndarray of bool, shape (n,)
        Whether both rays arrive.
    inverse : ndarray, shape (n, d, d)
        Derivative of the stop point with respect to the point on the plane.
    """

    inwards: Array
    detour: Array
    stop: Array
    ok: NDArray[np.bool_]
    inverse: Array


class EdgePathDifference:
    """Rays by way of the rim of an object point's open pupil.

    Attributes
    ----------
    reach : ndarray, shape (arms,)
        Length of the traced arms, from the pupil's centre to the rim.
    arrives : ndarray of bool, shape (arms,)
        Whether rays through the rim arrive.
    zone_mm : ndarray, shape (arms,)
        Fresnel zone of the object, as seen from the rim.

    Parameters
    ----------
    scene
        Lens and wavelength.
    point_mm
        Object point (x, y).
    pupil
        Open part of the stop for this point.
    plane_z_mm
        z of the plane behind the lens.
    every
        Trace every n-th arm of the pupil.
    """

    def __init__(
        self,
        scene: Scene,
        point_mm: tuple[float, float],
        pupil: OpenPupil,
        plane_z_mm: float,
        every: int = 1,
    ) -> None:
        self.scene, self.pupil, self.plane_z_mm = scene, pupil, plane_z_mm
        self.reach, self._rim = pupil.reach[::every], pupil.rim[::every]
        self._points = np.broadcast_to(np.asarray(point_mm, float), self._rim.shape)
        self._axes = [1] if scene.object_grid.is_line else [1, 0]
        base = trace_bundle(scene, np.asarray(point_mm), self._rim, plane_z_mm)
        self.arrives, self._across = base.ok, _directions_across_rim(pupil, every, base.cosine_jacobian)
        self._inverse = inverses(np.where(base.ok[:, None, None], base.jacobian, 1.0))
        # Position just outside the reach; the surface that stops light there is the edge.
        beyond = 1.0 + 1e-6
        self._surfaces = self._edge_surfaces(
            pupil.points(np.full(len(pupil.angles), beyond), pupil.angles)[::every]
        )
        arms = np.arange(len(self._rim))
        rays = self._trace(self._points, self._rim)
        self._at, self._before = self._points_on_edges(self._points, rays, arms)
        self._rim_inverse = self._inverse_at_rim(arms)
        with np.errstate(invalid="ignore"):
            self.zone_mm = np.sqrt(2.0 * self._before / scene.wavenumber_per_mm)

    def _trace(self, points: Array, stop: Array, clip: bool = False) -> RayTrace:
        """Trace rays from object points through stop points to the plane."""
        return shoot(self.scene, points, stop, self.plane_z_mm, clip=clip)

    def _edge_surfaces(self, beyond: Array) -> NDArray[np.intp]:
        """Return the surface at which light outside each arm of the rim ends."""
        rays, last = self._trace(self._points, beyond, clip=True), self.scene.system.surfaces - 1
        ends = np.clip(rays.failed_surface, 0, last)
        return np.where(rays.ok, self.scene.lens.stop_index, ends).astype(np.intp)

    def _points_on_edges(self, points: Array, rays: RayTrace, arms: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return where rays meet the surfaces of their arms, shape (n, 3), and their paths up to there."""
        assert rays.hits is not None
        start = np.column_stack([points, np.full(len(points), self.scene.object_grid.z_mm)])
        legs = np.diff(np.concatenate([start[:, None], rays.hits], axis=1), axis=1)
        lengths = np.sqrt(np.einsum("nsi,nsi->ns", legs, legs)) * self.scene.system.index[0, :-1]
        each, surfaces = np.arange(len(arms)), self._surfaces[arms]
        return rays.hits[each, surfaces], np.cumsum(lengths, axis=1)[each, surfaces]

    def _inverse_at_rim(self, arms: NDArray[np.intp]) -> Array:
        """Return the derivatives of stop points with respect to points on the surfaces that stop light."""
        moves = STEP * np.array([sign * np.eye(2)[axis] for axis in self._axes for sign in (1.0, -1.0)])
        stop = (self._rim + moves[:, None]).reshape(-1, 2)
        points, many = np.tile(self._points, (len(moves), 1)), np.tile(arms, len(moves))
        ends = self._points_on_edges(points, self._trace(points, stop), many)[0][:, self._axes]
        ends = ends.reshape(len(self._axes), 2, len(arms), -1)
        return inverses(np.moveaxis((ends[:, 0] - ends[:, 1]) / (2.0 * STEP), 0, -1))

    def trace_landings(
        self,
        moved_mm: Array,
        arms: NDArray[np.intp],
        start: Array | None = None,
        inverse: Array | None = None,
    ) -> EdgeRayLandings:
        """Trace rays by way of the rim from points next to the object point, shape (n,).

        Parameters
        ----------
        moved_mm
            Displacement of the object points across the rim.
        arms
            Indices of the arms.
        start, inverse
            Initial stop points of the direct rays, and their derivatives. Default: those of the rim.
        """
        points = self._points[arms] + moved_mm[:, None] * self._across[arms]
        landing, path, arrives = self._trace_by_rim(points, arms)
        start = self._rim[arms] if start is None else start
        inverse = self._inverse[arms] if inverse is None else inverse
        stop, direct_path, ok, inverse = self._aim_direct_rays(landing, arms, start, inverse)
        detour = self.scene.wavenumber_per_mm * (path - direct_path)
        return EdgeRayLandings(self.pupil.inwards(stop), detour, stop, ok & arrives, inverse)

    def _trace_by_rim(self, points: Array, arms: NDArray[np.intp]) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return where rays by way of the rim meet the plane, their paths, and whether they arrive."""
        stop, inverse = self._rim[arms], self._rim_inverse[arms]
        change = miss = np.zeros((len(arms), len(self._axes)))
        for step in range(AIM_STEPS):
            rays = self._trace(points, stop)
            at, before = self._points_on_edges(points, rays, arms)
            last, miss = miss, (self._at[arms] - at)[:, self._axes]
            if not np.any(np.abs(miss) > RIM_TOLERANCE_MM):
                break
            inverse = inverse if step == 0 else _broyden_update(inverse, change, last - miss)
            change = np.einsum("nij,nj->ni", inverse, miss)
            stop = stop.copy()
            stop[:, self._axes] += change
        return rays.position, rays.opl - before + self._before[arms], rays.ok

    def _aim_direct_rays(
        self, target: Array, arms: NDArray[np.intp], start: Array, inverse: Array
    ) -> tuple[Array, Array, NDArray[np.bool_], Array]:
        """Return stop points of direct rays to targets, their paths, arrival, and the derivatives there."""
        axes, points, stop = self._axes, self._points[arms], start.copy()
        index = float(self.scene.system.index[0, -1])
        change = miss = np.zeros((len(arms), len(axes)))
        met = np.zeros(len(arms), bool)
        for step in range(AIM_STEPS):
            rays = self._trace(points, stop)
            last, miss = miss, np.where(rays.ok[:, None], (target - rays.position)[:, axes], 0.0)
            inverse = inverse if step == 0 else _broyden_update(inverse, change, last - miss)
            path = rays.opl + np.sum(index * rays.direction[:, axes] * miss, axis=1)
            change = np.where(met[:, None], 0.0, np.einsum("nij,nj->ni", inverse, miss))
            stop[:, axes] += change
            met |= np.abs(miss).max(axis=1) < AIM_TOLERANCE_MM
            if np.all(met):
                break
        return stop, path, rays.ok & met, inverse

    def march(
        self, depths: Array, arms: NDArray[np.intp], inwards_per_mm: Array, alive: NDArray[np.bool_]
    ) -> Iterator[EdgeRayLandings]:
        """March along all arms to some depths inside the rim, or in the shadow where depths are negative.

        Parameters
        ----------
        depths
            Depths in stop coordinates, increasing in magnitude, shape (steps, n); NaN for no step.
        arms
            Indices of the arms, shape (n,).
        inwards_per_mm
            Derivative of the distance inwards with respect to the object point, at the rim.
        alive
            Arms to trace.

        Yields
        ------
        EdgeRayLandings
            Landing points near each depth. An arm that was lost once stays not `ok`.
        """
        moved, reached = np.zeros(len(arms)), np.zeros(len(arms))
        rate, stop, inverse = inwards_per_mm.copy(), self._rim[arms], self._inverse[arms]
        unit = (self.pupil.centre - stop) / np.maximum(self.reach[arms], 1e-300)[:, None]
        alive = alive.copy()
        # Largest step of the object point, relative to the previous step.
        longest_ratio = 3.0
        for depth in depths:
            inwards, detour, ok = np.zeros(len(arms)), np.zeros(len(arms)), np.zeros(len(arms), bool)
            some = np.flatnonzero(alive & np.isfinite(depth))
            if len(some):
                remaining = depth[some] - reached[some]
                with np.errstate(divide="ignore", invalid="ignore"):
                    step = np.nan_to_num(remaining / rate[some], nan=0.0, posinf=0.0, neginf=0.0)
                guess = stop[some] + remaining[:, None] * unit[some]
                found = self.trace_landings(moved[some] + step, arms[some], guess, inverse[some])
                progress = (found.inwards - reached[some]) * np.sign(depth[some])
                alive[some] = (
                    found.ok
                    & (progress > 0.0)
                    & (progress < longest_ratio * np.abs(remaining))
                    & (step != 0.0)
                )
                inwards[some], detour[some], ok[some] = found.inwards, found.detour, alive[some]
                with np.errstate(divide="ignore", invalid="ignore"):
                    rate[some] = (found.inwards - reached[some]) / step
                moved[some] += step
                reached[some], stop[some], inverse[some] = found.inwards, found.stop, found.inverse
            yield EdgeRayLandings(inwards, detour, stop.copy(), ok, inverse)


def _broyden_update(inverse: Array, change: Array, effect: Array) -> Array:
    """Apply Broyden's rank-one update to inverse Jacobians, by the effect of a change of the stop point."""
    predicted = np.einsum("nij,nj->ni", inverse, effect)
    denominator = np.einsum("ni,ni->n", change, predicted)
    row = np.einsum("ni,nij->nj", change, inverse)
    with np.errstate(divide="ignore", invalid="ignore"):
        added = (change - predicted)[:, :, None] * row[:, None, :] / denominator[:, None, None]
    return inverse + np.where(np.isfinite(added), added, 0.0)


def _directions_across_rim(pupil: OpenPupil, every: int, cosine_jacobian: Array) -> Array:
    """Return unit directions (x, y) of the object point in which its detour changes only across the rim."""
    if pupil.is_line:
        return np.array([[0.0, 1.0]] * 2)
    rim = pupil.rim
    along = (np.roll(rim, -1, axis=0) - np.roll(rim, 1, axis=0))[::every, ::-1]
    y, x = np.einsum("nij,nj->ni", cosine_jacobian, along).T
    return np.column_stack([-y, x]) / np.maximum(np.hypot(x, y), 1e-300)[:, None]
