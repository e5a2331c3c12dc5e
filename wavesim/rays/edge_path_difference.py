"""The way round by the rim of the stop: how much longer it is than the direct one, for points of a plane.

Rays of other object points that pass the very point of the rim land beside the border of the footprint; the
same points of the plane are reached directly from the object point itself. What the paths differ by is the
detour, on either side of the border. Other points are taken where the detour is stationary along the rim.
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
STEP_SHARES = (1.0, 0.2, 0.04)
"""Of a Fresnel zone of the object, by which neighbours are moved: the first with which rays tell."""

BEYOND = 1.0 + 1e-6
"""Of the reach, where light is stopped; what stops it there is taken for the edge."""

AIMED_MM, MET_MM = 1e-6, 1e-9
"""Near enough, on the plane and on the rim: what is left adds no more than 1e-5 radians."""

LONGEST = 3.0
"""Of the movement before, how much farther an object point is moved at a time."""


@dataclass(frozen=True)
class EdgeRayLandings:
    """Where rays by way of the rim land.

    Attributes
    ----------
    inwards : ndarray, shape (n,)
        How far the direct ray passes within the rim, in stop coordinates; negative in the shadow.
    detour : ndarray, shape (n,)
        Its phase in radians: k times the difference of both paths.
    stop : ndarray, shape (n, 2)
        Through which point the direct ray goes.
    ok : ndarray of bool, shape (n,)
        Whether both rays arrive.
    inverse : ndarray, shape (n, d, d)
        By how much a stop point is moved for a movement on the plane, there.
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
        Of the arms that are followed.
    told : ndarray of bool, shape (arms,)
        Whether rays arrive there.
    zone_mm : ndarray, shape (arms,)
        Fresnel zone of the object, as seen from the rim.

    Parameters
    ----------
    scene
        Lens and wavelength.
    point_mm
        Object point (x, y).
    pupil
        Its open part of the stop.
    plane_z_mm
        z of the plane behind the lens.
    every
        Of the pupil's arms one in so many is followed.
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
        self.told, self._across = base.ok, _across(pupil, every, base.cosine_jacobian)
        self._inverse = inverses(np.where(base.ok[:, None, None], base.jacobian, 1.0))
        self._surfaces = self._stopped_by(
            pupil.points(np.full(len(pupil.angles), BEYOND), pupil.angles)[::every]
        )
        arms = np.arange(len(self._rim))
        rays = self._shot(self._points, self._rim)
        self._at, self._before = self._reached(self._points, rays, arms)
        self._rim_inverse = self._inverse_at_rim(arms)
        with np.errstate(invalid="ignore"):
            self.zone_mm = np.sqrt(2.0 * self._before / scene.wavenumber_per_mm)

    def _shot(self, points: Array, stop: Array, clip: bool = False) -> RayTrace:
        return shoot(self.scene, points, stop, self.plane_z_mm, clip=clip)

    def _stopped_by(self, beyond: Array) -> NDArray[np.intp]:
        """The surface at which light beyond each arm of the rim ends."""
        rays, last = self._shot(self._points, beyond, clip=True), self.scene.system.surfaces - 1
        ends = np.clip(rays.failed_surface, 0, last)
        return np.where(rays.ok, self.scene.lens.stop_index, ends).astype(np.intp)

    def _reached(self, points: Array, rays: RayTrace, arms: NDArray[np.intp]) -> tuple[Array, Array]:
        """Where rays of object points meet the surfaces of arms, shape (n, 3), and their paths so far."""
        assert rays.hits is not None
        start = np.column_stack([points, np.full(len(points), self.scene.object_grid.z_mm)])
        legs = np.diff(np.concatenate([start[:, None], rays.hits], axis=1), axis=1)
        lengths = np.sqrt(np.einsum("nsi,nsi->ns", legs, legs)) * self.scene.system.index[0, :-1]
        each, surfaces = np.arange(len(arms)), self._surfaces[arms]
        return rays.hits[each, surfaces], np.cumsum(lengths, axis=1)[each, surfaces]

    def _inverse_at_rim(self, arms: NDArray[np.intp]) -> Array:
        """By how much stop points are moved for a movement on the surfaces that stop light."""
        moves = STEP * np.array([sign * np.eye(2)[axis] for axis in self._axes for sign in (1.0, -1.0)])
        stop = (self._rim + moves[:, None]).reshape(-1, 2)
        points, many = np.tile(self._points, (len(moves), 1)), np.tile(arms, len(moves))
        ends = self._reached(points, self._shot(points, stop), many)[0][:, self._axes]
        ends = ends.reshape(len(self._axes), 2, len(arms), -1)
        return inverses(np.moveaxis((ends[:, 0] - ends[:, 1]) / (2.0 * STEP), 0, -1))

    def landed(
        self,
        moved_mm: Array,
        arms: NDArray[np.intp],
        start: Array | None = None,
        inverse: Array | None = None,
    ) -> EdgeRayLandings:
        """Of rays from points beside the object point, moved across the rim, shape (n,).

        Parameters
        ----------
        moved_mm
            How far.
        arms
            By way of which of them.
        start, inverse
            Stop points from which the direct rays are sought, and their :class:`EdgeRayLandings`; default:
            those of the rim.
        """
        places, path, met = self._by_rim(self._points[arms] + moved_mm[:, None] * self._across[arms], arms)
        start = self._rim[arms] if start is None else start
        inverse = self._inverse[arms] if inverse is None else inverse
        stop, straight, ok, inverse = self._aimed(places, arms, start, inverse)
        detour = self.scene.wavenumber_per_mm * (path - straight)
        return EdgeRayLandings(self.pupil.inwards(stop), detour, stop, ok & met, inverse)

    def _by_rim(self, points: Array, arms: NDArray[np.intp]) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Where rays of other points by way of the rim meet the plane, their paths from the object point
        up to the rim and from there on, and whether they arrive."""
        stop, inverse = self._rim[arms], self._rim_inverse[arms]
        change = miss = np.zeros((len(arms), len(self._axes)))
        for step in range(AIM_STEPS):
            rays = self._shot(points, stop)
            at, before = self._reached(points, rays, arms)
            last, miss = miss, (self._at[arms] - at)[:, self._axes]
            if not np.any(np.abs(miss) > MET_MM):
                break
            inverse = inverse if step == 0 else _renewed(inverse, change, last - miss)
            change = np.einsum("nij,nj->ni", inverse, miss)
            stop = stop.copy()
            stop[:, self._axes] += change
        return rays.position, rays.opl - before + self._before[arms], rays.ok

    def _aimed(
        self, target: Array, arms: NDArray[np.intp], start: Array, inverse: Array
    ) -> tuple[Array, Array, NDArray[np.bool_], Array]:
        """Stop points of direct rays that meet the plane at targets, their paths, whether they do, and the
        inverses there."""
        axes, points, stop = self._axes, self._points[arms], start.copy()
        index = float(self.scene.system.index[0, -1])
        change = miss = np.zeros((len(arms), len(axes)))
        met = np.zeros(len(arms), bool)
        for step in range(AIM_STEPS):
            rays = self._shot(points, stop)
            last, miss = miss, np.where(rays.ok[:, None], (target - rays.position)[:, axes], 0.0)
            inverse = inverse if step == 0 else _renewed(inverse, change, last - miss)
            path = rays.opl + np.sum(index * rays.direction[:, axes] * miss, axis=1)
            change = np.where(met[:, None], 0.0, np.einsum("nij,nj->ni", inverse, miss))
            stop[:, axes] += change
            met |= np.abs(miss).max(axis=1) < AIMED_MM
            if np.all(met):
                break
        return stop, path, rays.ok & met, inverse

    def marched(
        self, depths: Array, arms: NDArray[np.intp], inwards_per_mm: Array, alive: NDArray[np.bool_]
    ) -> Iterator[EdgeRayLandings]:
        """Along arms, all at a time, to some depths within the rim (in the shadow where they are negative).

        Parameters
        ----------
        depths
            In stop coordinates, growing in size, shape (steps, n); none is asked for where they are NaN.
        arms
            Which, shape (n,).
        inwards_per_mm
            Of the way inwards, for an object point's movement, at the rim.
        alive
            Which to follow.

        Yields
        ------
        Landed
            Near each depth; of an arm that was lost once none is `ok`.
        """
        moved, way = np.zeros(len(arms)), np.zeros(len(arms))
        rate, stop, inverse = inwards_per_mm.copy(), self._rim[arms], self._inverse[arms]
        unit = (self.pupil.centre - stop) / np.maximum(self.reach[arms], 1e-300)[:, None]
        alive = alive.copy()
        for depth in depths:
            inwards, detour, ok = np.zeros(len(arms)), np.zeros(len(arms)), np.zeros(len(arms), bool)
            some = np.flatnonzero(alive & np.isfinite(depth))
            if len(some):
                ahead = depth[some] - way[some]
                with np.errstate(divide="ignore", invalid="ignore"):
                    step = np.nan_to_num(ahead / rate[some], nan=0.0, posinf=0.0, neginf=0.0)
                guess = stop[some] + ahead[:, None] * unit[some]
                found = self.landed(moved[some] + step, arms[some], guess, inverse[some])
                onwards = (found.inwards - way[some]) * np.sign(depth[some])
                alive[some] = found.ok & (onwards > 0.0) & (onwards < LONGEST * np.abs(ahead)) & (step != 0.0)
                inwards[some], detour[some], ok[some] = found.inwards, found.detour, alive[some]
                with np.errstate(divide="ignore", invalid="ignore"):
                    rate[some] = (found.inwards - way[some]) / step
                moved[some] += step
                way[some], stop[some], inverse[some] = found.inwards, found.stop, found.inverse
            yield EdgeRayLandings(inwards, detour, stop.copy(), ok, inverse)


def _renewed(inverse: Array, change: Array, came: Array) -> Array:
    """Broyden's rank-one update of inverse Jacobians, by what a change of the stop point did on the plane."""
    gone = np.einsum("nij,nj->ni", inverse, came)
    down = np.einsum("ni,ni->n", change, gone)
    row = np.einsum("ni,nij->nj", change, inverse)
    with np.errstate(divide="ignore", invalid="ignore"):
        added = (change - gone)[:, :, None] * row[:, None, :] / down[:, None, None]
    return inverse + np.where(np.isfinite(added), added, 0.0)


def _across(pupil: OpenPupil, every: int, cosine_jacobian: Array) -> Array:
    """Ways (x, y) of unit length in which an object point moves its detour across the rim alone."""
    if pupil.is_line:
        return np.array([[0.0, 1.0]] * 2)
    rim = pupil.rim
    along = (np.roll(rim, -1, axis=0) - np.roll(rim, 1, axis=0))[::every, ::-1]
    y, x = np.einsum("nij,nj->ni", cosine_jacobian, along).T
    return np.column_stack([-y, x]) / np.maximum(np.hypot(x, y), 1e-300)[:, None]
