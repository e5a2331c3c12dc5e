"""Fresnel diffraction at the aperture's edge, for the light of one object point on one plane.

Near the border of a footprint the field is that of the rays times a Fresnel integral F(x), on both sides of
the border. x^2 is k times the detour, the path difference between light by way of the rim and direct light; x
changes its sign at the border. See R. M. Lewis and J. Boersma, "Uniform asymptotic theory of edge
diffraction", J. Math. Phys. 10, 2291 (1969).

Far from the border the difference to a sharp edge is a wave from the rim, whose phase depends on the path
from the object to the rim. Neighbouring object points that share one F can therefore use it only near the
border.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

from lensdesign.common.arrays import Array
from wavesim.rays.edge_kernel import at_arms
from wavesim.rays.edge_path_difference import STEP_FRACTIONS, EdgePathDifference
from wavesim.rays.ray_bundles import OpenPupil
from wavesim.scene.scene import Scene

STEPS_WITHIN, STEPS_BEYOND = {True: 16, False: 6}, 3

EVERY, SMOOTH = 6, 1e-6
"""On a plane only one of so many arms is traced, if these arms determine the reach of the others to this
accuracy."""

LINEAR, CUBIC = (0, 1), (-1, 0, 1, 2)
"""Offsets of the neighbours that a polynomial interpolates."""


@dataclass(frozen=True, eq=False)
class Edge:
    """Diffraction at the rim of the open part of the stop.

    Attributes
    ----------
    pupil : OpenPupil
        Open part of the stop.
    terms : ndarray, shape (arms, terms)
        Coefficients of a polynomial in t, the distance from the rim inwards along an arm; x is t times it.
    deep, beyond : ndarray, shape (arms,)
        Largest t inside the rim, and outside it, up to which rays determine x.
    conjugate : ndarray of bool, shape (arms,)
        Whether light by way of the rim is ahead, as past a focus, so that F is replaced by its conjugate.
    shift_per_mm : float
        Largest change of x with the position of the object point.
    """

    pupil: OpenPupil
    terms: Array
    deep: Array
    beyond: Array
    conjugate: NDArray[np.bool_]
    shift_per_mm: float

    @property
    def rate(self) -> Array:
        """Derivative of x at the rim, shape (arms,)."""
        return self.terms[:, 0]

    @property
    def bend(self) -> Array:
        """Second-order coefficient of x relative to the first, shape (arms,)."""
        return np.asarray(self.terms[:, 1] / self.rate)

    @property
    def shadow(self) -> OpenPupil:
        """The open part with the part of its shadow that is not dark."""
        beyond = _beyond(self.pupil.reach, self.pupil.is_line, self.rate)
        return OpenPupil(self.pupil.centre, self.pupil.reach + beyond, self.pupil.angles)

    def resolved_to(self, width_mm: float) -> float:
        """Return the largest x up to which F is known all around, for a part of the object of some width."""
        return float(np.min(self._resolved_to(width_mm)))

    def _resolved_to(self, width_mm: float) -> Array:
        deepest = _detour(self.deep, self.terms, self.deep, self.beyond)
        # x times its change over neighbouring points above which their waves from the rim cancel on average.
        fringes = math.pi
        most = fringes / max(self.shift_per_mm * width_mm, 1e-300)
        # x up to which F is always used: the fields of neighbouring tiles do not cancel where edges are
        # sharper than diffraction allows.
        least_resolved = 2.0
        return np.minimum(np.maximum(deepest, least_resolved), most)

    def factor(self, stop: Array, width_mm: float, traced: OpenPupil) -> NDArray[np.complex128]:
        """Return F for light through points of the stop, y or y and x, shape (..., d).

        Parameters
        ----------
        stop
            Points of the stop.
        width_mm
            Width of the part of the object that shares the result.
        traced
            Part of the shadow from which light is traced; F has decreased to 0 at its border.
        """
        resolved, moved = self._resolved_to(width_mm), self.shift_per_mm * width_mm
        dark = -_detour(self.pupil.reach - traced.reach, self.terms, self.deep, self.beyond)
        ends = np.minimum(resolved, dark), resolved
        if self.pupil.is_line:
            up = stop[..., 0] - self.pupil.centre[1]
            distances = self.pupil.reach[0] - up, self.pupil.reach[1] + up
            first, second = (
                _diffracted(
                    _detour(distance, self.terms[arm], self.deep[arm], self.beyond[arm]),
                    (ends[0][arm], ends[1][arm]),
                    moved,
                    self.conjugate[arm],
                )
                for arm, distance in enumerate(distances)
            )
            return np.asarray(first * second)
        y, x = stop[..., 0] - self.pupil.centre[1], stop[..., 1] - self.pupil.centre[0]
        found = np.ones(y.shape, complex)
        near = y * y + x * x > self._clear_radius(resolved) ** 2
        found[near] = self._at(y[near], x[near], ends, moved)
        return found

    def _clear_radius(self, resolved: Array) -> float:
        """Return the distance from the centre of a plane's pupil within which F is 1."""
        # Sampled positions along an arm.
        samples = 65
        distances = self.pupil.reach[:, None] * np.linspace(0.0, 1.0, samples)
        terms, deep, beyond = self.terms[:, None], self.deep[:, None], self.beyond[:, None]
        inside = _detour(distances, terms, deep, beyond) >= max(resolved)
        first = np.where(inside.any(axis=1), np.argmax(inside, axis=1), samples - 1)
        return max(0.0, float(np.min(self.pupil.reach * (1.0 - (first + 1) / (samples - 1)))))

    def _at(self, y: Array, x: Array, ends: tuple[Array, Array], moved: float) -> NDArray[np.complex128]:
        """Return F at points of a plane's stop, relative to the centre of the pupil."""
        arms = np.column_stack([self.pupil.reach, self.deep, self.beyond, *ends, self.terms])
        x_of, found, arm_before = at_arms(y, x, arms)
        return _diffracted(x_of, (found[0], found[1]), moved, self.conjugate[arm_before])


def _diffracted(
    x: Array, ends: tuple[Array, Array], moved: float, conjugate: NDArray[np.bool_]
) -> NDArray[np.complex128]:
    """Return F up to some x in the shadow and in the light, a sharp edge beyond, with a smooth transition.

    For points over which x changes by `moved`, the wave from the rim has the mean of their phases.
    """
    most = np.maximum(np.where(x < 0.0, *ends), 1e-300)
    # Fraction of the largest x over which F changes smoothly into a sharp edge.
    eased_fraction = 0.1
    weight = np.clip((1.0 - np.abs(x) / most) / eased_fraction, 0.0, 1.0)
    weight *= weight * (3.0 - 2.0 * weight) * np.sinc(np.minimum(np.abs(x) * moved / math.pi, 1.0))
    found = np.asarray(x > 0.0, complex)
    near = weight > 0.0
    edge = fresnel_edge(x[near])
    if np.any(conjugate):
        edge = np.where(np.broadcast_to(conjugate, x.shape)[near], edge.conj(), edge)
    found[near] += weight[near] * (edge - found[near])
    return found


def _detour(distance: Array, terms: Array, deep: Array, beyond: Array) -> Array:
    """Return x at distances from the rim; where rays do not determine it, it grows as at the rim."""
    inside = np.clip(distance, -beyond, deep)
    total = np.zeros(np.broadcast_shapes(inside.shape, terms.shape[:-1]))
    for term in np.moveaxis(terms, -1, 0)[::-1]:
        total = total * inside + term
    return np.asarray(total * inside + terms[..., 0] * (distance - inside))


def _beyond(reach: Array, line: bool, rate: Array) -> Array:
    """Return the width of the shadow that is not dark, in stop coordinates."""
    # x at which the shadow counts as dark, on a line and on a plane.
    shadow = {True: 24.0, False: 8.0}
    # Distance outside the rim to which rays are traced, relative to the reach.
    farthest = 0.4
    return np.minimum(shadow[line] / rate, farthest * reach)


def fresnel_edge(x: Array) -> NDArray[np.complex128]:
    """Return F(x) = e^(-i pi/4) / sqrt(pi) times the integral of exp(i t^2) from minus infinity to x."""
    sine, cosine = fresnel(math.sqrt(2.0 / math.pi) * np.asarray(x))
    return np.asarray(0.5 * (1.0 - 1j) * ((cosine + 0.5) + 1j * (sine + 0.5)))


def light_edge(scene: Scene, point_mm: tuple[float, float], pupil: OpenPupil, plane_z_mm: float) -> Edge:
    """Trace the rays that determine the diffraction at the border of an object point's footprint.

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
    """
    for every in (EVERY, 1) if _is_smooth(pupil) else (1,):
        found = _followed(EdgePathDifference(scene, point_mm, pupil, plane_z_mm, every))
        if every == 1 or (np.all(found.good) and len(set(found.moves < 0.0)) == 1):
            break
    terms = _between(found.terms, every, CUBIC)
    deep, beyond = (_between(distance, every, LINEAR) for distance in (found.deep, found.beyond))
    conjugate = np.repeat(found.moves < 0.0, every)
    return Edge(pupil, terms, deep, beyond, conjugate, float(np.max(np.abs(found.moves))))


def _is_smooth(pupil: OpenPupil) -> bool:
    """Return whether some arms determine the rim between them, so that it has no corner."""
    if pupil.is_line or len(pupil.angles) % EVERY:
        return False
    off = _between(pupil.reach[::EVERY], EVERY, CUBIC) - pupil.reach
    return bool(np.max(np.abs(off)) < SMOOTH * np.max(pupil.reach))


def _between(values: Array, every: int, points: tuple[int, ...]) -> Array:
    """Return the values of all arms from those of every n-th one, by Lagrange interpolation."""
    if every == 1:
        return values
    fraction = np.arange(every) / every
    result = np.zeros((len(values), every, *values.shape[1:]))
    for at in points:
        others = [other for other in points if other != at]
        weight = np.prod([(fraction - other) / (at - other) for other in others], axis=0)
        own = weight.reshape(-1, *(1,) * (values.ndim - 1))
        result += own * np.roll(values, -at, axis=0)[:, None]
    return result.reshape(-1, *values.shape[1:])


@dataclass(frozen=True)
class _Followed:
    """Coefficients and limits of some arms as in :class:`Edge`, the change of x with the object point in
    1/mm, and whether rays determine them."""

    terms: Array
    deep: Array
    beyond: Array
    moves: Array
    good: NDArray[np.bool_]


def _followed(detours: EdgePathDifference) -> _Followed:
    """Trace rays along arms to both sides of the rim."""
    inwards, detour, moved, good = _next_to_rim(detours)
    line, arms = detours.pupil.is_line, np.arange(len(detours.reach))
    # Rate of x over the stop's coordinates where the plane is that of the rim, or rays do not determine it.
    sharpest_rate = 1e7
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.where(good, np.sqrt(np.abs(detour[0])) / np.abs(inwards[0]), sharpest_rate)
    moves = np.where(good, np.sign(detour[0]) * np.sqrt(np.abs(detour[0])) / moved, 0.0)
    depths = np.full((STEPS_WITHIN[line], 2, len(arms)), np.nan)
    within, beyond = (np.linspace(0.0, 1.0, n + 1)[1:, None] for n in (len(depths), STEPS_BEYOND))
    # Depth inside the rim to which rays are traced, relative to the reach, on a line and on a plane.
    deepest = {True: 1.9, False: 0.9}
    depths[:, 0] = within * deepest[line] * detours.reach
    depths[:STEPS_BEYOND, 1] = -beyond * _beyond(detours.reach, line, rate)
    twice = (np.tile(part, 2) for part in (arms, (inwards[0] - inwards[1]) / (2.0 * moved), good))
    steps = list(detours.march(depths.reshape(len(depths), -1), *twice))
    distance, longer, ok = (
        np.reshape([getattr(step, name) for step in steps], depths.shape)
        for name in ("inwards", "detour", "ok")
    )
    distances, detours_of = (
        np.concatenate([beside, steps_of[:, 0], steps_of[:STEPS_BEYOND, 1]]).T
        for beside, steps_of in ((inwards, distance), (detour, longer))
    )
    terms, (deep, outside) = _fitted(distances, detours_of, np.sum(ok, axis=0).T, good)
    terms[~good, 0] = sharpest_rate
    return _Followed(terms, deep, outside, moves, good)


def _next_to_rim(detours: EdgePathDifference) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Return distances and detours on both sides of the rim (2, arms), displacements, and success."""
    count = len(detours.reach)
    inwards, detour = np.zeros((2, count)), np.zeros((2, count))
    moved, good = np.ones(count), np.zeros(count, bool)
    # Smallest distance in stop coordinates from which a rate can be determined.
    least_distance = 1e-9
    for fraction in STEP_FRACTIONS:
        some = np.flatnonzero(detours.arrives & ~good)
        if not len(some):
            break
        step = fraction * detours.zone_mm[some]
        found = detours.trace_landings(np.concatenate([step, -step]), np.tile(some, 2))
        way, longer, ok = (values.reshape(2, -1) for values in (found.inwards, found.detour, found.ok))
        with np.errstate(invalid="ignore"):
            new = ok.all(axis=0) & (way[0] * way[1] < -(least_distance**2)) & (longer[0] * longer[1] > 0.0)
        new &= np.isfinite(longer).all(axis=0)
        inwards[:, some[new]], detour[:, some[new]] = way[:, new], longer[:, new]
        moved[some[new]], good[some[new]] = step[new], True
    return inwards, detour, moved, good


def _fitted(
    distance: Array, detour: Array, many: NDArray[np.intp], good: NDArray[np.bool_]
) -> tuple[Array, tuple[Array, Array]]:
    """Return the coefficients of x over the distance t, and the limits up to which they fit the rays.

    Rays farthest from the rim, inside it and outside, are removed until the others agree.

    Parameters
    ----------
    distance, detour
        Distances and detours of two rays next to the rim, then of those inside and outside, shape (arms,
        nodes).
    many
        Numbers of rays that arrive inside and outside, shape (arms, 2).
    good
        Whether the first two rays arrive.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.sqrt(np.abs(detour)) / np.abs(distance)
    # Order of the polynomial for x over the distance t from the rim.
    order = 8
    terms, left, arms = np.zeros((len(good), order + 1)), good.copy(), np.arange(len(good))
    starts = 2, distance.shape[1] - STEPS_BEYOND
    # Largest difference between the detours of the rays and of the polynomial, in radians.
    largest_difference = 0.1
    while np.any(left):
        for counts in np.unique(many[left], axis=0):
            some = arms[left & np.all(many == counts, axis=1)]
            used = [0, 1, *(s + i for s, c in zip(starts, counts, strict=True) for i in range(c))]
            t, v = distance[some][:, used], values[some][:, used]
            powers = t[:, :, None] ** np.arange(min(order, len(used) // 2) + 1)
            weight = np.abs(t)[:, :, None]
            found = np.linalg.pinv(weight * powers) @ (weight * v[:, :, None])
            off = np.abs((t * (powers @ found)[:, :, 0]) ** 2 - (t * v) ** 2).max(axis=1)
            fits = (off < largest_difference) | (len(used) == 2)
            terms[some[fits], : powers.shape[2]] = found[fits, :, 0]
            left[some[fits]] = False
        longer = np.argmax(many, axis=1)
        many[arms[left], longer[left]] -= 1
    last = np.where(many > 0, np.array(starts) + many - 1, [0, 1])
    inside, outside = np.abs(distance[arms[:, None], last]).T
    return terms, (inside, outside)
