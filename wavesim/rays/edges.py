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
from wavesim.rays.edge_kernel import at_arms
from wavesim.rays.edge_path_difference import STEP_SHARES, EdgePathDifference
from wavesim.rays.ray_bundles import OpenPupil
from wavesim.scene.scene import Scene

SHADOW = {True: 24.0, False: 8.0}
"""x at which the shadow is taken for dark, on a line and on a plane."""

LEAST_TOLD = 2.0
"""x up to which F is told all the same: neighbours do not cancel where edges are sharper
than light draws them."""

DEEPEST = {True: 1.9, False: 0.9}
"""Of the reach, how far within it rays by way of the rim are looked for, on a line and on a plane."""

FARTHEST = 0.4
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

EVERY, SMOOTH = 6, 1e-6
"""Of a plane's arms, one in so many is followed where those tell the reach of the others to such a share."""

LINEAR, CUBIC = (0, 1), (-1, 0, 1, 2)
"""Neighbours through which there are polynomials."""


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
        beyond = _beyond(self.pupil.reach, self.pupil.is_line, self.rate)
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
        near = y * y + x * x > self._clear_radius(told) ** 2
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
        arms = np.column_stack([self.pupil.reach, self.deep, self.seen, *ends, self.terms])
        x_of, found, before = at_arms(y, x, arms)
        return _drawn(x_of, (found[0], found[1]), moved, self.turned[before])


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


def _beyond(reach: Array, line: bool, rate: Array) -> Array:
    """How far beyond the rim it is not dark, in stop coordinates."""
    return np.minimum(SHADOW[line] / rate, FARTHEST * reach)


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
    for every in (EVERY, 1) if _is_smooth(pupil) else (1,):
        found = _followed(EdgePathDifference(scene, point_mm, pupil, plane_z_mm, every))
        if every == 1 or (np.all(found.good) and len(set(found.moves < 0.0)) == 1):
            break
    terms = _between(found.terms, every, CUBIC)
    deep, seen = (_between(way, every, LINEAR) for way in (found.deep, found.seen))
    turned = np.repeat(found.moves < 0.0, every)
    return Edge(pupil, terms, deep, seen, turned, float(np.max(np.abs(found.moves))))


def _is_smooth(pupil: OpenPupil) -> bool:
    """Whether some arms tell where the rim is between them: nothing has cut a corner into it."""
    if pupil.is_line or len(pupil.angles) % EVERY:
        return False
    off = _between(pupil.reach[::EVERY], EVERY, CUBIC) - pupil.reach
    return bool(np.max(np.abs(off)) < SMOOTH * np.max(pupil.reach))


def _between(values: Array, every: int, points: tuple[int, ...]) -> Array:
    """All arms' values from those of one in so many, by Lagrange's polynomials through neighbouring ones."""
    if every == 1:
        return values
    share = np.arange(every) / every
    parts = np.zeros((len(values), every, *values.shape[1:]))
    for at in points:
        others = [other for other in points if other != at]
        weight = np.prod([(share - other) / (at - other) for other in others], axis=0)
        own = weight.reshape(-1, *(1,) * (values.ndim - 1))
        parts += own * np.roll(values, -at, axis=0)[:, None]
    return parts.reshape(-1, *values.shape[1:])


@dataclass(frozen=True)
class _Followed:
    """What rays tell of some arms: as of :class:`Edge`, with x for an object point's movement in 1/mm, and
    whether they tell anything."""

    terms: Array
    deep: Array
    seen: Array
    moves: Array
    good: NDArray[np.bool_]


def _followed(detours: EdgePathDifference) -> _Followed:
    """March along arms to both sides of the rim."""
    inwards, detour, moved, good = _beside(detours)
    line, arms = detours.pupil.is_line, np.arange(len(detours.reach))
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.where(good, np.sqrt(np.abs(detour[0])) / np.abs(inwards[0]), SHARPEST)
    moves = np.where(good, np.sign(detour[0]) * np.sqrt(np.abs(detour[0])) / moved, 0.0)
    depths = np.full((STEPS_WITHIN[line], 2, len(arms)), np.nan)
    within, beyond = (np.linspace(0.0, 1.0, n + 1)[1:, None] for n in (len(depths), STEPS_BEYOND))
    depths[:, 0] = within * DEEPEST[line] * detours.reach
    depths[:STEPS_BEYOND, 1] = -beyond * _beyond(detours.reach, line, rate)
    twice = (np.tile(part, 2) for part in (arms, (inwards[0] - inwards[1]) / (2.0 * moved), good))
    steps = list(detours.marched(depths.reshape(len(depths), -1), *twice))
    way, longer, ok = (
        np.reshape([getattr(step, name) for step in steps], depths.shape)
        for name in ("inwards", "detour", "ok")
    )
    ways, detours_of = (
        np.concatenate([beside, part[:, 0], part[:STEPS_BEYOND, 1]]).T
        for beside, part in ((inwards, way), (detour, longer))
    )
    terms, (deep, seen) = _fitted(ways, detours_of, np.sum(ok, axis=0).T, good)
    terms[~good, 0] = SHARPEST
    return _Followed(terms, deep, seen, moves, good)


def _beside(detours: EdgePathDifference) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Ways inwards and detours next to the rim on either side, shape (2, arms), by which movement they were
    found, and whether they tell anything."""
    count = len(detours.reach)
    inwards, detour = np.zeros((2, count)), np.zeros((2, count))
    moved, good = np.ones(count), np.zeros(count, bool)
    for share in STEP_SHARES:
        some = np.flatnonzero(detours.told & ~good)
        if not len(some):
            break
        step = share * detours.zone_mm[some]
        found = detours.landed(np.concatenate([step, -step]), np.tile(some, 2))
        way, longer, ok = (part.reshape(2, -1) for part in (found.inwards, found.detour, found.ok))
        with np.errstate(invalid="ignore"):
            new = ok.all(axis=0) & (way[0] * way[1] < -(LEAST**2)) & (longer[0] * longer[1] > 0.0)
        new &= np.isfinite(longer).all(axis=0)
        inwards[:, some[new]], detour[:, some[new]] = way[:, new], longer[:, new]
        moved[some[new]], good[some[new]] = step[new], True
    return inwards, detour, moved, good


def _fitted(
    way: Array, detour: Array, many: NDArray[np.intp], good: NDArray[np.bool_]
) -> tuple[Array, tuple[Array, Array]]:
    """Coefficients of x over the way t, and from where to where they follow the rays, for each arm.

    Rays farthest from the rim, within it and beyond, are left out until the others agree.

    Parameters
    ----------
    way, detour
        Of two rays beside the rim, then of those within it and of those beyond, shape (arms, nodes).
    many
        How many of either side arrive, shape (arms, 2).
    good
        Whether the first two do.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.sqrt(np.abs(detour)) / np.abs(way)
    terms, left, arms = np.zeros((len(good), ORDER + 1)), good.copy(), np.arange(len(good))
    starts = 2, way.shape[1] - STEPS_BEYOND
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
