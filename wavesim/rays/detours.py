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
from wavesim.rays.ray_bundles import STEP, OpenPupil, inverses, shoot, trace_bundle
from wavesim.scene.scene import Scene

AIM_STEPS = 8
STEP_SHARES = (1.0, 0.2, 0.04)
"""Of a Fresnel zone of the object, by which neighbours are moved: the first with which rays tell."""

BEYOND = 1.0 + 1e-6
"""Of the reach, where light is stopped; what stops it there is taken for the edge."""

AIMED_MM = 1e-5
MET_MM = 1e-9
"""Near enough: what is left adds no more than 1e-5 radians."""

LONGEST = 3.0
"""Of the movement before, how much farther an object point is moved at a time."""


@dataclass(frozen=True)
class Landed:
    """Where rays by way of the rim land, one for each arm.

    Attributes
    ----------
    inwards : ndarray, shape (arms,)
        How far the direct ray passes within the rim, in stop coordinates; negative in the shadow.
    detour : ndarray, shape (arms,)
        Its phase in radians: k times the difference of both paths.
    stop : ndarray, shape (arms, 2)
        Through which point the direct ray goes.
    ok : ndarray of bool, shape (arms,)
        Whether both rays arrive.
    """

    inwards: Array
    detour: Array
    stop: Array
    ok: NDArray[np.bool_]

    def replaced(self, new: NDArray[np.bool_], found: Landed) -> Landed:
        """With what was found of some arms."""
        return Landed(
            np.where(new, found.inwards, self.inwards),
            np.where(new, found.detour, self.detour),
            np.where(new[:, None], found.stop, self.stop),
            new | self.ok,
        )


class Detours:
    """Rays by way of the rim of an object point's open pupil.

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
    """

    def __init__(
        self, scene: Scene, point_mm: tuple[float, float], pupil: OpenPupil, plane_z_mm: float
    ) -> None:
        rim = pupil.rim
        self.scene, self.pupil, self.plane_z_mm = scene, pupil, plane_z_mm
        self.points = np.broadcast_to(np.asarray(point_mm, float), rim.shape)
        self.base = trace_bundle(scene, np.asarray(point_mm), rim, plane_z_mm)
        self._rims = _Rim(scene, _stopped_by(scene, self.points, pupil, plane_z_mm), plane_z_mm)
        self._at, self._before = self._rims.reached(self.points, rim)
        self._across = _across(pupil, self.base.cosine_jacobian)
        with np.errstate(invalid="ignore"):
            self.zone_mm = np.sqrt(2.0 * self._before / scene.wavenumber_per_mm)
        axes = [1] if scene.object_grid.is_line else [1, 0]
        self._axes = axes
        self._inverse = inverses(np.where(self.base.ok[:, None, None], self.base.jacobian, 1.0))

    def landed(self, moved_mm: Array, start: Array | None = None, steps: int = AIM_STEPS) -> Landed:
        """Of rays from points beside the object point, moved across the rim, shape (arms,).

        Parameters
        ----------
        moved_mm
            How far.
        start
            Stop points from which the direct rays are sought; those of the rim if left out.
        steps
            Of the search, at most.
        """
        scene, k = self.scene, self.scene.wavenumber_per_mm
        moved = self.points + moved_mm[:, None] * self._across
        through = self._rims.through(moved, self.pupil.rim, self._at)
        by_rim = shoot(scene, moved, through, self.plane_z_mm, clip=False)
        path = by_rim.opl - self._rims.reached(moved, through)[1] + self._before
        stop, straight, ok = self._aimed(by_rim.position, self.base.pupil if start is None else start, steps)
        return Landed(self.pupil.inwards(stop), k * (path - straight), stop, ok & by_rim.ok)

    def _aimed(self, target: Array, start: Array, steps: int) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Stop points of direct rays that meet the plane at targets, their paths, and whether they do."""
        axes, stop, inverse = self._axes, start.copy(), self._inverse
        index = float(self.scene.system.index[0, -1])
        before: tuple[Array, Array] | None = None
        for _ in range(steps):
            rays = shoot(self.scene, self.points, stop, self.plane_z_mm, clip=False)
            miss = np.where(rays.ok[:, None], (target - rays.position)[:, axes], 0.0)
            if not np.any(np.abs(miss) > MET_MM):
                break
            if before is not None:
                inverse = _renewed(inverse, before[0], before[1] - miss)
            change = np.einsum("nij,nj->ni", inverse, miss)
            stop[:, axes] += change
            before = change, miss
        rays = shoot(self.scene, self.points, stop, self.plane_z_mm, clip=False)
        miss = (target - rays.position)[:, axes]
        path = rays.opl + np.sum(index * rays.direction[:, axes] * miss, axis=1)
        return stop, path, rays.ok & (np.abs(miss).max(axis=1) < AIMED_MM)

    def marched(self, depths: Array, inwards_per_mm: Array, alive: NDArray[np.bool_]) -> Iterator[Landed]:
        """Along all arms at a time, to some depths within the rim (in the shadow where they are negative).

        Parameters
        ----------
        depths
            In stop coordinates, growing in size, shape (steps, arms).
        inwards_per_mm
            Of the way inwards, for an object point's movement, at the rim.
        alive
            Which arms to follow.

        Yields
        ------
        Landed
            Near each depth; of an arm that was lost once none is `ok`.
        """
        moved, last = np.zeros(len(self.points)), np.zeros(len(self.points))
        rate, stop = inwards_per_mm.copy(), self.pupil.rim.copy()
        for depth in depths:
            with np.errstate(divide="ignore", invalid="ignore"):
                step = np.nan_to_num((depth - last) / rate, nan=0.0, posinf=0.0, neginf=0.0)
            along = (depth - last)[:, None] / np.maximum(self.pupil.reach, 1e-300)[:, None]
            guess = stop + along * (self.pupil.centre - self.pupil.rim)
            found = self.landed(moved + step, guess, 2 * AIM_STEPS)
            onwards = (found.inwards - last) * np.sign(depth)
            alive = alive & found.ok & (onwards > 0.0) & (onwards < LONGEST * np.abs(depth - last))
            with np.errstate(divide="ignore", invalid="ignore"):
                rate = np.where(alive, (found.inwards - last) / np.where(step != 0.0, step, 1.0), rate)
            moved, last = np.where(alive, moved + step, moved), np.where(alive, found.inwards, last)
            stop = np.where(alive[:, None], found.stop, stop)
            yield Landed(found.inwards, found.detour, found.stop, alive.copy())


def _renewed(inverse: Array, change: Array, came: Array) -> Array:
    """Broyden's rank-one update of inverse Jacobians, by what a change of the stop point did on the plane."""
    gone = np.einsum("nij,nj->ni", inverse, came)
    down = np.einsum("ni,ni->n", change, gone)
    row = np.einsum("ni,nij->nj", change, inverse)
    with np.errstate(divide="ignore", invalid="ignore"):
        added = (change - gone)[:, :, None] * row[:, None, :] / down[:, None, None]
    return inverse + np.where(np.isfinite(added), added, 0.0)


def _stopped_by(scene: Scene, points: Array, pupil: OpenPupil, plane_z_mm: float) -> NDArray[np.intp]:
    """The surface at which light beyond each arm of the rim ends."""
    beyond = pupil.points(np.full(len(pupil.angles), BEYOND), pupil.angles)
    rays = shoot(scene, points, beyond, plane_z_mm, clip=True)
    last = scene.system.surfaces - 1
    return np.where(rays.ok, scene.lens.stop_index, np.clip(rays.failed_surface, 0, last)).astype(np.intp)


@dataclass(frozen=True, eq=False)
class _Rim:
    """Points on the surfaces that stop light, one for each arm."""

    scene: Scene
    surfaces: NDArray[np.intp]
    plane_z_mm: float

    def reached(self, points: Array, stop: Array) -> tuple[Array, Array]:
        """Where rays of object points meet their surfaces, shape (n, 3), and their paths up to there."""
        rays = shoot(self.scene, points, stop, self.plane_z_mm, clip=False)
        assert rays.hits is not None
        start = np.column_stack([points, np.full(len(points), self.scene.object_grid.z_mm)])
        legs = np.linalg.norm(np.diff(np.concatenate([start[:, None], rays.hits], axis=1), axis=1), axis=-1)
        paths = np.cumsum(self.scene.system.index[0, :-1] * legs, axis=1)
        each = np.arange(len(points))
        return rays.hits[each, self.surfaces], paths[each, self.surfaces]

    def through(self, points: Array, stop: Array, at: Array) -> Array:
        """Stop points through which rays of other object points meet their surfaces at the same places."""
        axes = [1] if self.scene.object_grid.is_line else [0, 1]
        moves = [STEP * np.eye(2)[axis] for axis in axes]
        ends = [[self.reached(points, stop + sign * move)[0] for sign in (1.0, -1.0)] for move in moves]
        slopes = np.stack([(a - b)[:, axes] / (2.0 * STEP) for a, b in ends], axis=-1)
        inverse, found = inverses(slopes), stop.copy()
        for _ in range(AIM_STEPS):
            miss = (at - self.reached(points, found)[0])[:, axes]
            if not np.any(np.abs(miss) > MET_MM):
                break
            found[:, axes] += np.einsum("nij,nj->ni", inverse, miss)
        return found


def _across(pupil: OpenPupil, cosine_jacobian: Array) -> Array:
    """Ways (x, y) of unit length in which an object point moves its detour across the rim alone."""
    if pupil.is_line:
        return np.array([[0.0, 1.0]] * 2)
    rim = pupil.rim
    along = (np.roll(rim, -1, axis=0) - np.roll(rim, 1, axis=0))[:, ::-1]
    y, x = np.einsum("nij,nj->ni", cosine_jacobian, along).T
    return np.column_stack([-y, x]) / np.maximum(np.hypot(x, y), 1e-300)[:, None]
