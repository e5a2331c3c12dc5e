"""The aperture's edge as light draws it, for the light of one object point on one plane.

Near the border of a footprint the field is that of the rays times a Fresnel integral F(x), on both sides of
the border: x^2 is k times the detour of light that comes by way of the rim, and x changes its sign there. See
R. M. Lewis and J. Boersma, "Uniform asymptotic theory of edge diffraction", J. Math. Phys. 10, 2291 (1969).

Far from the border the difference to a sharp edge is light of the rim, whose phase follows the way from the
object to the rim. Of neighbouring object points that share one F it can be told near the border alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

from lensdesign.common.arrays import Array
from wavesim.rays.ray_bundles import STEP, OpenPupil, RayBundle, inverses, shoot, trace_bundle
from wavesim.scene.scene import Scene

SHADOW = 8.0
"""x at which the shadow is taken for dark."""

BENT = 0.1
"""Of the first order of x, what the second may be where F is told: farther from the rim two do not do."""

LEAST_TOLD = 2.0
"""x up to which F is told all the same: neighbours do not cancel where edges are sharper
than light draws them."""

DEEPEST, FARTHEST = 0.6, 0.25
"""Of the reach, what is looked at within it and beyond."""

AIM_STEPS = 8
STEP_SHARES = (1.0, 0.2, 0.04)
"""Of a Fresnel zone of the object, by which neighbours are moved: the first with which rays tell."""

BEYOND = 1.0 + 1e-6
"""Of the reach, where light is stopped; what stops it there is taken for the edge."""

FRINGES = 3.0
"""Most that x times the movement of x over neighbouring points may be, where F is told."""

AIMED_MM = 1e-5
MET_MM = 1e-13
"""Rounding: nearer rays do not come."""
LEAST = 1e-9
"""Way in stop coordinates over which a rate can be told."""

SHARPEST = 1e7
"""Rate of x over the stop's coordinates where the plane is that of the rim, or rays do not tell it."""


@dataclass(frozen=True, eq=False)
class Edge:
    """How light falls off at the rim of the open part of the stop.

    Attributes
    ----------
    pupil : OpenPupil
        The open part.
    rate, bend : ndarray, shape (arms,)
        x is rate times (t + bend t^2), to second order in the way t from the rim inwards along an arm.
    turned : ndarray of bool, shape (arms,)
        Whether light by way of the rim is ahead, as past a focus: F then is its conjugate.
    shift_per_mm : float
        How much x changes for an object point's movement, at most.
    """

    pupil: OpenPupil
    rate: Array
    bend: Array
    turned: NDArray[np.bool_]
    shift_per_mm: float

    @property
    def shadow(self) -> OpenPupil:
        """The open part, with as much around it as is not dark."""
        beyond = np.minimum(SHADOW / self.rate, FARTHEST * self.pupil.reach)
        return OpenPupil(self.pupil.centre, self.pupil.reach + beyond, self.pupil.angles)

    def told(self, width_mm: float) -> float:
        """The largest x at which F is told for a part of the object of some width."""
        with np.errstate(divide="ignore"):
            depth = np.minimum(DEEPEST * self.pupil.reach, BENT / np.abs(self.bend))
        deepest = max(float(np.min(_detour(depth, self.rate, self.bend))), LEAST_TOLD)
        return min(FRINGES / max(self.shift_per_mm * width_mm, 1e-300), deepest)

    def factor(self, stop: Array, width_mm: float, traced: OpenPupil) -> NDArray[np.complex128]:
        """F for light through points of the stop, y or y and x, shape (..., d).

        Parameters
        ----------
        stop
            Points.
        width_mm
            Of the part of the object that shares it.
        traced
            As much of the shadow as there is light from: there F has come down to 0.
        """
        dark = -float(np.max(_detour(self.pupil.reach - traced.reach, self.rate, self.bend)))
        told = self.told(width_mm)
        most = min(told, dark), told
        if self.pupil.is_line:
            up = stop[..., 0] - self.pupil.centre[1]
            ways = self.pupil.reach[0] - up, self.pupil.reach[1] + up
            first, second = (
                _drawn(_detour(way, self.rate[arm], self.bend[arm]), most, self.turned[arm])
                for arm, way in enumerate(ways)
            )
            return first * second
        y, x = stop[..., 0] - self.pupil.centre[1], stop[..., 1] - self.pupil.centre[0]
        found = np.ones(y.shape, complex)
        near = np.hypot(y, x) > self._clear_radius(told)
        found[near] = self._at(y[near], x[near], most)
        return found

    def _clear_radius(self, most: float) -> float:
        """How far from the centre of a plane's pupil x stays above a value, along all arms and between."""
        values = self.pupil.reach, self.rate, self.bend
        reach, rate, bend = (np.minimum(v, np.roll(v, -1)) for v in values)
        with np.errstate(divide="ignore", invalid="ignore"):
            grown = (np.sqrt(1.0 + 4.0 * bend * most / rate) - 1.0) / (2.0 * bend)
            way = np.where(bend > 0.0, grown, most / (rate + bend * most))
        # Of a bend outwards, x may stay below it.
        return max(0.0, float(np.min(reach - np.where(way > 0.0, way, np.inf))))

    def _at(self, y: Array, x: Array, most: tuple[float, float]) -> NDArray[np.complex128]:
        """F at points of a plane's stop from the centre of the pupil."""
        arms = len(self.pupil.angles)
        place = np.mod(np.arctan2(y, x) * (arms / (2.0 * math.pi)), arms)
        first_arm = place.astype(np.intp) % arms
        share, next_arm = place - np.floor(place), (first_arm + 1) % arms
        values = np.stack([self.pupil.reach, self.rate, self.bend])
        reach, rate, bend = (v[first_arm] + share * (v[next_arm] - v[first_arm]) for v in values)
        return _drawn(_detour(reach - np.hypot(y, x), rate, bend), most, self.turned[first_arm])


def _detour(inwards: Array, rate: Array, bend: Array) -> Array:
    """x, which grows all the way inwards whatever the sign of its bend."""
    bent = bend * inwards
    with np.errstate(divide="ignore"):
        return np.asarray(rate * inwards * np.where(bent > 0.0, 1.0 + bent, 1.0 / (1.0 - bent)))


def _drawn(x: Array, most: tuple[float, float], turned: NDArray[np.bool_]) -> NDArray[np.complex128]:
    """F up to sizes of x in the shadow and in the light, and a sharp edge beyond; in between both."""
    share = np.clip(2.0 - 2.0 * np.abs(x) / np.where(x < 0.0, *np.maximum(most, 1e-300)), 0.0, 1.0)
    share *= share * (3.0 - 2.0 * share)
    found = np.asarray(x > 0.0, complex)
    near = share > 0.0
    drawn = fresnel_edge(x[near])
    if np.any(turned):
        drawn = np.where(np.broadcast_to(turned, x.shape)[near], drawn.conj(), drawn)
    found[near] += share[near] * (drawn - found[near])
    return found


def fresnel_edge(x: Array) -> NDArray[np.complex128]:
    """F(x) = e^(-i pi/4) / sqrt(pi) times the integral of exp(i t^2) from minus infinity to x."""
    sine, cosine = fresnel(math.sqrt(2.0 / math.pi) * np.asarray(x))
    return np.asarray(0.5 * (1.0 - 1j) * ((cosine + 0.5) + 1j * (sine + 0.5)))


def light_edge(scene: Scene, point_mm: tuple[float, float], pupil: OpenPupil, plane_z_mm: float) -> Edge:
    """How the light of an object point falls off at the border of its footprint.

    Rays of neighbouring object points that pass the very point of the rim land beside the border; the same
    point of the plane is reached directly from the object point. What the ways differ by is the detour, on
    either side. Neighbours are taken where the detour is stationary along the rim.

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
    rim = pupil.rim
    points = np.broadcast_to(np.asarray(point_mm, float), rim.shape)
    base = trace_bundle(scene, np.asarray(point_mm), rim, plane_z_mm)
    rims = _Rim(scene, _stopped_by(scene, points, pupil, plane_z_mm), plane_z_mm)
    at, before = rims.reached(points, rim)
    zone_mm = np.sqrt(2.0 * before / scene.wavenumber_per_mm)[:, None] * _across(pupil, base)
    count = len(rim)
    rate, bend, moves = np.full(count, SHARPEST), np.zeros(count), np.zeros(count)
    for share in STEP_SHARES:
        step = share * zone_mm
        inner, outer = (
            _detour_by_rim(rims, pupil, base, points, sign * step, at, before) for sign in (1.0, -1.0)
        )
        found = _second_order(inner, outer)
        new = (rate == SHARPEST) & base.ok & found[2]
        rate, bend = np.where(new, found[0], rate), np.where(new, found[1], bend)
        x = np.sign(inner[1]) * np.sqrt(np.abs(inner[1]))
        moves = np.where(new, x / np.linalg.norm(step, axis=1), moves)
        if not np.any((rate == SHARPEST) & base.ok):
            break
    turned = moves < 0.0
    return Edge(pupil, np.minimum(rate, SHARPEST), bend, turned, float(np.max(np.abs(moves))))


def _detour_by_rim(
    rims: _Rim, pupil: OpenPupil, base: RayBundle, points: Array, step: Array, at: Array, before: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Of where light of neighbours passes the rim: how far inwards, k times the detour, whether rays tell."""
    scene, plane_z_mm = rims.scene, rims.plane_z_mm
    moved = points + step
    through = rims.through(moved, pupil.rim, at)
    by_rim = shoot(scene, moved, through, plane_z_mm, clip=False)
    path = by_rim.opl - rims.reached(moved, through)[1] + before
    direct, straight, ok = _aimed(scene, points, base, by_rim.position, plane_z_mm)
    return pupil.inwards(direct), scene.wavenumber_per_mm * (path - straight), ok & by_rim.ok


def _second_order(
    one: tuple[Array, Array, NDArray[np.bool_]], other: tuple[Array, Array, NDArray[np.bool_]]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Rate and bend of x through two places on either side of the rim, and where they mean something."""
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (np.sqrt(np.abs(detour)) / np.abs(way) for way, detour, _ in (one, other))
        apart = one[0] - other[0]
        rate = (second * one[0] - first * other[0]) / apart
        bend = (first - second) / apart / rate
        good = one[2] & other[2] & np.isfinite(bend) & (rate > 0.0) & (one[0] * other[0] < -(LEAST**2))
    return rate, bend, good & (one[1] * other[1] > 0.0)


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


def _across(pupil: OpenPupil, base: RayBundle) -> Array:
    """Ways (x, y) of unit length in which an object point moves its detour across the rim alone."""
    if pupil.is_line:
        return np.array([[0.0, 1.0]] * 2)
    rim = pupil.rim
    along = (np.roll(rim, -1, axis=0) - np.roll(rim, 1, axis=0))[:, ::-1]
    y, x = np.einsum("nij,nj->ni", base.cosine_jacobian, along).T
    return np.column_stack([-y, x]) / np.maximum(np.hypot(x, y), 1e-300)[:, None]


def _aimed(
    scene: Scene, points: Array, base: RayBundle, target: Array, plane_z_mm: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Stop points of rays that meet the plane at targets (x, y, z), their paths, and whether they do."""
    axes = [1] if scene.object_grid.is_line else [1, 0]
    stop, inverse = base.pupil.copy(), inverses(np.where(base.ok[:, None, None], base.jacobian, 1.0))
    index = float(scene.system.index[0, -1])
    for _ in range(AIM_STEPS):
        rays = shoot(scene, points, stop, plane_z_mm, clip=False)
        miss = np.where(rays.ok[:, None], (target - rays.position)[:, axes], 0.0)
        if not np.any(np.abs(miss) > MET_MM):
            break
        stop[:, axes] += np.einsum("nij,nj->ni", inverse, miss)
    rays = shoot(scene, points, stop, plane_z_mm, clip=False)
    miss = (target - rays.position)[:, axes]
    path = rays.opl + np.sum(index * rays.direction[:, axes] * miss, axis=1)
    return stop, path, rays.ok & (np.abs(miss).max(axis=1) < AIMED_MM)
