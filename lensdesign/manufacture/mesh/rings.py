"""Rings and azimuths of a mesh about the axis: their number, positions, and the triangles between them.

The chord error of a triangle is proportional to the square of its sides, so the square root of the chord
error is additive along a meridian. Vertices lie slightly off the surface: they are displaced by the mean
distance of the facets, which then cross the surface, so that the volume of the mesh is correct to higher
order.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.meridian import SurfaceMeridian

ChordErrors = Callable[[Array], Array]
"""Largest distance of a meridian from each of its chords between successive parameters (from 0 to 1)."""

MAX_TRIANGLES = 20_000_000

BALANCE = 0.72
"""Fraction of the allowed error for the chords of a meridian, and for those of a ring.

After the vertices are displaced, two thirds of the sum of both errors remain.
"""


def meridian_chord_errors(meridian: SurfaceMeridian) -> ChordErrors:
    """Return a function of parameters: the chord errors of an exact meridian in mm."""
    return lambda t: np.asarray(np.max(np.abs(_offsets(meridian, t)), axis=1))


def _offsets(meridian: SurfaceMeridian, t: Array) -> Array:
    """Return signed distances of 15 inner points of each interval from its chord, shape (intervals, 15)."""
    ends = meridian.points(t)
    chord = np.diff(ends, axis=0)
    fraction = np.linspace(0.0, 1.0, 17)[1:-1]
    inner = meridian.points(t[:-1, None] + fraction * np.diff(t)[:, None]) - ends[:-1, None]
    across = chord[:, None, 0] * inner[..., 1] - chord[:, None, 1] * inner[..., 0]
    return np.asarray(across / np.linalg.norm(chord, axis=1)[:, None])


def cumulative_ring_count(
    chord_errors: ChordErrors, end_mm: float, resolved: float = 1e-5, shortest: float = 0.0
) -> tuple[Array, Array]:
    """Return parameters t along a meridian and the cumulative sum of sqrt(chord error) at each.

    The total sum, divided by the square root of the allowed error, is the number of rings. Intervals are
    halved until their chord error is at most `resolved` times `end_mm`, or their length at most `shortest`.
    """
    t = np.linspace(0.0, 1.0, 65)
    for _ in range(24):
        coarse = (chord_errors(t) > resolved * end_mm) & (np.diff(t) > shortest)
        if not np.any(coarse):
            break
        t = np.sort(np.concatenate([t, (0.5 * (t[:-1] + t[1:]))[coarse]]))
    errors = chord_errors(t)
    # An interval with an inflection point has almost no chord error although its neighbours have.
    weights = np.sqrt(np.maximum(errors, 1e-3 * np.mean(errors)))
    return t, np.concatenate([[0.0], np.cumsum(weights)])


def ring_parameters(
    chord_errors: ChordErrors, density: tuple[Array, Array], end_mm: float, error_mm: float
) -> Array:
    """Return the parameters of the fewest rings for which every chord meets the allowed error.

    Parameters
    ----------
    chord_errors, density, end_mm
        Chord errors of the meridian, result of :func:`cumulative_ring_count`, and radial height of its end in
        mm.
    error_mm
        Largest allowed chord error in mm.
    """
    t, total = density
    if total[-1] <= 1e-7 * math.sqrt(end_mm):
        return np.array([0.0, 1.0])
    count = max(1, math.ceil(total[-1] / math.sqrt(error_mm)))
    while True:
        rings = np.interp(np.linspace(0.0, total[-1], count + 1), total, t)
        if np.max(chord_errors(rings)) <= error_mm:
            return rings
        count += 1 + count // 30


def azimuths(radius_mm: float, error_mm: float) -> int:
    """Return the number of meridians for a chord error, a multiple of 4 and at least 12.

    The sagitta of a chord is r (1 - cos(pi / n)) = 2 r sin^2(pi / 2n).
    """
    sine = math.sqrt(min(1.0, 0.5 * error_mm / radius_mm)) if radius_mm > 0.0 else 1.0
    return max(12, 4 * math.ceil(0.125 * math.pi / math.asin(sine)))


def ring_chord_radius_mm(meridian: SurfaceMeridian) -> float:
    """Return the maximum of radial height times sine of slope.

    The chord error of a ring is this radius times 1 - cos(pi / n) for n meridians.
    """
    t = np.linspace(0.0, 1.0, 257)
    tangent = meridian.tangents(t)
    return float(np.max(meridian.points(t)[:, 0] * np.abs(tangent[:, 1]) / np.linalg.norm(tangent, axis=1)))


def equal_area_circumradius(count: int) -> float:
    """Return the circumradius of the regular polygon whose area is that of the unit circle."""
    angle = 2.0 * math.pi / count
    return math.sqrt(angle / math.sin(angle))


def edge_error(radius_mm: float, count: int) -> float:
    """Return the largest distance in mm of a regular polygon from the circle of the same area."""
    factor = equal_area_circumradius(count)
    return radius_mm * max(factor - 1.0, 1.0 - factor * math.cos(math.pi / count))


def balanced_profile(meridian: SurfaceMeridian, t: Array, movable_rim: bool) -> Array:
    """Return the corners of a polygon that straddles a meridian with equal areas on both sides.

    Parameters
    ----------
    meridian
        The exact meridian.
    t
        Parameters of the corners, from 0 to 1.
    movable_rim
        Whether the rim may move along z, because no flat ring or bevel follows.

    Returns
    -------
    ndarray, shape (n, 2)
        Radial height (increasing, from 0 to that of the rim) and z in mm.
    """
    points, tangent = meridian.points(t), meridian.tangents(t)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    # The trapezoidal rule over 16 parts, made exact for a parabola.
    area = np.pad(np.sum(_offsets(meridian, t), axis=1) / 16.0 * (256.0 / 255.0) * length, 1)
    length = np.pad(length, 1)
    shift = (area[:-1] + area[1:]) / (length[:-1] + length[1:])
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / np.linalg.norm(tangent, axis=1)[:, None]
    moved = points + shift[:, None] * normal
    moved[0, 0] = 0.0
    # The rim keeps its radial height, and for a tangent along z also its z.
    upright = normal[-1, 1] < 0.1
    rise = shift[-1] / normal[-1, 1] if movable_rim and not upright else 0.0
    moved[-1] = meridian.end_mm, points[-1, 1] + rise
    return moved


def revolve(profile: Array, count: int) -> tuple[Array, NDArray[np.int64]]:
    """Return vertices and triangles of a polygon (r, z), with both ends on the axis, rotated about z.

    Rings are regular polygons with the area of the circle of radius r.
    """
    x, y = equal_area_circumradius(count) * circle(count)
    r, z = profile[1:-1, 0, None], profile[1:-1, 1, None]
    rings = np.stack(np.broadcast_arrays(r * x, r * y, z), axis=-1)
    poles = np.array([[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]])
    return np.concatenate([poles, rings.reshape(-1, 3)]), ring_faces(len(rings), count)


def circle(count: int) -> Array:
    """Return x and y of points on the unit circle, the first at x = 1; shape (2, count)."""
    angle = 2.0 * math.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)])


def ring_faces(rings: int, count: int) -> NDArray[np.int64]:
    """Return the triangles of a closed body that consists of a pole, rings and a second pole.

    Vertices 0 and 1 are the front and the back pole; ring k has the `count` vertices from 2 + k count on.
    Normals point outwards if the rings are ordered from the front pole to the back pole.
    """
    here = np.arange(count)
    after = (here + 1) % count
    start = 2 + count * np.arange(rings)
    inner, outer = start[:-1, None], start[1:, None]
    quads = np.stack(
        [inner + here, outer + after, outer + here, inner + here, inner + after, outer + after], axis=-1
    )
    first = np.stack([np.zeros_like(here), start[0] + after, start[0] + here], axis=-1)
    last = np.stack([np.ones_like(here), start[-1] + here, start[-1] + after], axis=-1)
    return np.concatenate([first, quads.reshape(-1, 3), last])
