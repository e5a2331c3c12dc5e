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
from wavesim.rays.detours import STEP_SHARES, Detours, Landed
from wavesim.rays.ray_bundles import OpenPupil
from wavesim.scene.scene import Scene

SHADOW = {True: 24.0, False: 8.0}
"""x at which the shadow is taken for dark, on a line and on a plane."""

LEAST_TOLD = 2.0
"""x up to which F is told all the same: neighbours do not cancel where edges are sharper
than light draws them."""

DEEPEST = {True: 1.9, False: 0.9}
"""Of the reach, how far within it rays by way of the rim are looked for, on a line and on a plane."""

FARTHEST = {True: 0.4, False: 0.25}
"""And how far beyond it."""

STEPS_WITHIN, STEPS_BEYOND = {True: 16, False: 6}, 3
ORDER = 8
"""Of the polynomial in the way from the rim that x over this way is."""

UNFOLLOWED = 0.1
"""Radians by which the detour of rays may differ from the polynomial's."""

EASED = 0.1
"""Of the x at which F ends, over how much it goes over into a sharp edge."""

FRINGES = math.pi
"""x times the movement of x over neighbouring points, from which on their light of the rim, each with a phase
of its own, is none on average."""

LEAST = 1e-9
"""Way in stop coordinates over which a rate can be told."""

SHARPEST = 1e7
"""Rate of x over the stop's coordinates where the plane is that of the rim, or rays do not tell it."""

LOOKED = 65
"""Places along an arm at which x is looked at."""


@dataclass(frozen=True, eq=False)
class Edge:
    """How light falls off at the rim of the open part of the stop.

    Attributes
    ----------
    pupil : OpenPupil
        The open part.
    terms : ndarray, shape (arms, terms)
        x is t times a polynomial in t, the way from the rim inwards along an arm; its coefficients.
    deep, seen : ndarray, shape (arms,)
        The t within the rim, and beyond it, up to which rays tell this.
    turned : ndarray of bool, shape (arms,)
        Whether light by way of the rim is ahead, as past a focus: F then is its conjugate.
    shift_per_mm : float
        How much x changes for an object point's movement, at most.
    """

    pupil: OpenPupil
    terms: Array
    deep: Array
    seen: Array
    turned: NDArray[np.bool_]
    shift_per_mm: float

    @property
    def rate(self) -> Array:
        """What x grows by at the rim, shape (arms,)."""
        return self.terms[:, 0]

    @property
    def bend(self) -> Array:
        """The second order of x, as a share of the first, shape (arms,)."""
        return np.asarray(self.terms[:, 1] / self.rate)

    @property
    def shadow(self) -> OpenPupil:
        """The open part, with as much around it as is not dark."""
        beyond = _beyond(self.pupil, self.rate)
        return OpenPupil(self.pupil.centre, self.pupil.reach + beyond, self.pupil.angles)

    def told(self, width_mm: float) -> float:
        """The largest x at which F is told all around, for a part of the object of some width."""
        return float(np.min(self._told(width_mm)))

    def _told(self, width_mm: float) -> Array:
        deepest = _detour(self.deep, self.terms, self.deep, self.seen)
        most = FRINGES / max(self.shift_per_mm * width_mm, 1e-300)
        return np.minimum(np.maximum(deepest, LEAST_TOLD), most)

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
        told, moved = self._told(width_mm), self.shift_per_mm * width_mm
        dark = -_detour(self.pupil.reach - traced.reach, self.terms, self.deep, self.seen)
        ends = np.minimum(told, dark), told
        if self.pupil.is_line:
            up = stop[..., 0] - self.pupil.centre[1]
            ways = self.pupil.reach[0] - up, self.pupil.reach[1] + up
            first, second = (
                _drawn(
                    _detour(way, self.terms[arm], self.deep[arm], self.seen[arm]),
                    (ends[0][arm], ends[1][arm]),
                    moved,
                    self.turned[arm],
                )
                for arm, way in enumerate(ways)
            )
            return np.asarray(first * second)
        y, x = stop[..., 0] - self.pupil.centre[1], stop[..., 1] - self.pupil.centre[0]
        found = np.ones(y.shape, complex)
        near = np.hypot(y, x) > self._clear_radius(told)
        found[near] = self._at(y[near], x[near], ends, moved)
        return found

    def _clear_radius(self, told: Array) -> float:
        """How far from the centre of a plane's pupil F is not told, along all arms and between."""
        ways = self.pupil.reach[:, None] * np.linspace(0.0, 1.0, LOOKED)
        terms, deep, seen = self.terms[:, None], self.deep[:, None], self.seen[:, None]
        inside = _detour(ways, terms, deep, seen) >= max(told)
        first = np.where(inside.any(axis=1), np.argmax(inside, axis=1), LOOKED - 1)
        return max(0.0, float(np.min(self.pupil.reach * (1.0 - (first + 1) / (LOOKED - 1)))))

    def _at(self, y: Array, x: Array, ends: tuple[Array, Array], moved: float) -> NDArray[np.complex128]:
        """F at points of a plane's stop from the centre of the pupil."""
        arms = len(self.pupil.angles)
        place = np.mod(np.arctan2(y, x) * (arms / (2.0 * math.pi)), arms)
        first_arm = place.astype(np.intp) % arms
        share, next_arm = place - np.floor(place), (first_arm + 1) % arms
        values = np.column_stack([self.pupil.reach, self.deep, self.seen, *ends, self.terms])
        mixed = values[first_arm] + share[:, None] * (values[next_arm] - values[first_arm])
        reach, deep, seen, dark, told = mixed.T[:5]
        x_of = _detour(reach - np.hypot(y, x), mixed[:, 5:], deep, seen)
        return _drawn(x_of, (dark, told), moved, self.turned[first_arm])


def _drawn(
    x: Array, ends: tuple[Array, Array], moved: float, turned: NDArray[np.bool_]
) -> NDArray[np.complex128]:
    """F up to some x in the shadow and in the light, a sharp edge beyond, and in between both.

    Of points over which x moves, the light by way of the rim has the mean of their phases.
    """
    most = np.maximum(np.where(x < 0.0, *ends), 1e-300)
    share = np.clip((1.0 - np.abs(x) / most) / EASED, 0.0, 1.0)
    share *= share * (3.0 - 2.0 * share) * np.sinc(np.minimum(np.abs(x) * moved / math.pi, 1.0))
    found = np.asarray(x > 0.0, complex)
    near = share > 0.0
    drawn = fresnel_edge(x[near])
    if np.any(turned):
        drawn = np.where(np.broadcast_to(turned, x.shape)[near], drawn.conj(), drawn)
    found[near] += share[near] * (drawn - found[near])
    return found


def _detour(way: Array, terms: Array, deep: Array, seen: Array) -> Array:
    """x at ways from the rim; where rays do not tell it, it grows on as at the rim."""
    inside = np.clip(way, -seen, deep)
    total = np.zeros(np.broadcast_shapes(inside.shape, terms.shape[:-1]))
    for term in np.moveaxis(terms, -1, 0)[::-1]:
        total = total * inside + term
    return np.asarray(total * inside + terms[..., 0] * (way - inside))


def _beyond(pupil: OpenPupil, rate: Array) -> Array:
    """How far beyond the rim it is not dark, in stop coordinates."""
    line = pupil.is_line
    return np.minimum(SHADOW[line] / rate, FARTHEST[line] * pupil.reach)


def fresnel_edge(x: Array) -> NDArray[np.complex128]:
    """F(x) = e^(-i pi/4) / sqrt(pi) times the integral of exp(i t^2) from minus infinity to x."""
    sine, cosine = fresnel(math.sqrt(2.0 / math.pi) * np.asarray(x))
    return np.asarray(0.5 * (1.0 - 1j) * ((cosine + 0.5) + 1j * (sine + 0.5)))


def light_edge(scene: Scene, point_mm: tuple[float, float], pupil: OpenPupil, plane_z_mm: float) -> Edge:
    """How the light of an object point falls off at the border of its footprint.

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
    detours = Detours(scene, point_mm, pupil, plane_z_mm)
    inner, outer, moved, good = _beside(detours)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.where(good, np.sqrt(np.abs(inner.detour)) / np.abs(inner.inwards), SHARPEST)
    moves = np.where(good, np.sign(inner.detour) * np.sqrt(np.abs(inner.detour)) / moved, 0.0)
    per_mm = (inner.inwards - outer.inwards) / (2.0 * moved)
    within = np.linspace(0.0, 1.0, STEPS_WITHIN[pupil.is_line] + 1)[1:, None]
    beyond = np.linspace(0.0, -1.0, STEPS_BEYOND + 1)[1:, None]
    deep = list(detours.marched(within * DEEPEST[pupil.is_line] * pupil.reach, per_mm, good))
    dark = list(detours.marched(beyond * _beyond(pupil, rate), per_mm, good))
    terms, ends = _fitted((inner, outer), (deep, dark), good)
    terms[~good, 0] = SHARPEST
    return Edge(pupil, terms, *ends, moves < 0.0, float(np.max(np.abs(moves))))


def _beside(detours: Detours) -> tuple[Landed, Landed, Array, NDArray[np.bool_]]:
    """Light next to the rim on either side, by which movement it was found, and whether it tells anything."""
    count = len(detours.zone_mm)
    nothing = Landed(np.zeros(count), np.zeros(count), detours.pupil.rim, np.zeros(count, bool))
    inner = outer = nothing
    moved = np.ones(count)
    for share in STEP_SHARES:
        step = share * detours.zone_mm
        one, other = detours.landed(step), detours.landed(-step)
        new = ~inner.ok & detours.base.ok & one.ok & other.ok & np.isfinite(one.detour + other.detour)
        new &= (one.inwards * other.inwards < -(LEAST**2)) & (one.detour * other.detour > 0.0)
        inner, outer = inner.replaced(new, one), outer.replaced(new, other)
        moved = np.where(new, step, moved)
        if np.all(inner.ok | ~detours.base.ok):
            break
    return inner, outer, moved, inner.ok


def _fitted(
    beside: tuple[Landed, Landed], sides: tuple[list[Landed], list[Landed]], good: NDArray[np.bool_]
) -> tuple[Array, tuple[Array, Array]]:
    """Coefficients of x over the way t, and from where to where they follow the rays, for each arm.

    Rays farthest from the rim, within it and beyond, are left out until the others agree.
    """
    nodes = [*beside, *sides[0], *sides[1]]
    way, detour = (np.array([getattr(node, name) for node in nodes]).T for name in ("inwards", "detour"))
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.sqrt(np.abs(detour)) / np.abs(way)
    many = np.column_stack([np.sum([node.ok for node in side], axis=0) for side in sides])
    terms, left, arms = np.zeros((len(good), ORDER + 1)), good.copy(), np.arange(len(good))
    starts = 2, 2 + len(sides[0])
    while np.any(left):
        for counts in np.unique(many[left], axis=0):
            some = arms[left & np.all(many == counts, axis=1)]
            used = [0, 1, *(s + i for s, c in zip(starts, counts, strict=True) for i in range(c))]
            t, v = way[some][:, used], values[some][:, used]
            powers = t[:, :, None] ** np.arange(min(ORDER, len(used) // 2) + 1)
            weight = np.abs(t)[:, :, None]
            found = np.linalg.pinv(weight * powers) @ (weight * v[:, :, None])
            off = np.abs((t * (powers @ found)[:, :, 0]) ** 2 - (t * v) ** 2).max(axis=1)
            fits = (off < UNFOLLOWED) | (len(used) == 2)
            terms[some[fits], : powers.shape[2]] = found[fits, :, 0]
            left[some[fits]] = False
        longer = np.argmax(many, axis=1)
        many[arms[left], longer[left]] -= 1
    last = np.where(many > 0, np.array(starts) + many - 1, [0, 1])
    inside, outside = np.abs(way[arms[:, None], last]).T
    return terms, (inside, outside)
