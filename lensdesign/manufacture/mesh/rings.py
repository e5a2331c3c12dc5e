"""Rings and azimuths of a mesh about the axis: where they lie, how many, and the triangles between them.

The chord errors of triangles go with the square of their sides, so the square root of the chord error adds
up along a meridian. Vertices straddle the surface rather than lie on it: moved out by the mean distance of
the facets, they halve neither rings nor facets, yet the volume comes out right to higher order.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.meridian import SurfaceMeridian

ChordErrors = Callable[[Array], Array]
"""Greatest distance of a meridian from each of its chords between successive parameters 0 ... 1."""

FEWEST_AZIMUTHS = 12
MOST_TRIANGLES = 20_000_000

BALANCE = 0.72
"""Share of a chord error for each of meridian and azimuth: vertices stand off by two thirds of both."""


def meridian_chord_errors(meridian: SurfaceMeridian) -> ChordErrors:
    """Chord errors of an exact meridian."""
    return lambda t: np.asarray(np.max(np.abs(_offsets(meridian, t)), axis=1))


def _offsets(meridian: SurfaceMeridian, t: Array) -> Array:
    """Distances of 15 inner points of each interval to the left of its chord, shape (intervals, 15)."""
    ends = meridian.points(t)
    chord = np.diff(ends, axis=0)
    share = np.linspace(0.0, 1.0, 17)[1:-1]
    inner = meridian.points(t[:-1, None] + share * np.diff(t)[:, None]) - ends[:-1, None]
    across = chord[:, None, 0] * inner[..., 1] - chord[:, None, 1] * inner[..., 0]
    return np.asarray(across / np.linalg.norm(chord, axis=1)[:, None])


def ring_density(
    chord_errors: ChordErrors, end_mm: float, resolved: float = 1e-5, shortest: float = 0.0
) -> tuple[Array, Array]:
    """Parameters t, and up to each the sum of sqrt(chord error), which counts rings.

    This sum over the square root of the error allowed is the number of rings. Intervals are halved until
    their chord error is at most `resolved` times `end_mm`, or they are no longer than `shortest`.
    """
    t = np.linspace(0.0, 1.0, 65)
    for _ in range(24):
        coarse = (chord_errors(t) > resolved * end_mm) & (np.diff(t) > shortest)
        if not np.any(coarse):
            break
        t = np.sort(np.concatenate([t, (0.5 * (t[:-1] + t[1:]))[coarse]]))
    errors = chord_errors(t)
    # An interval with an inflection looks straight; its neighbours do not.
    weights = np.sqrt(np.maximum(errors, 1e-3 * np.mean(errors)))
    return t, np.concatenate([[0.0], np.cumsum(weights)])


def ring_parameters(
    chord_errors: ChordErrors, density: tuple[Array, Array], end_mm: float, error_mm: float
) -> Array:
    """Parameters of the rings: as few as keep every chord within the error allowed.

    Parameters
    ----------
    chord_errors, density, end_mm
        Of the meridian, as :func:`ring_density` takes and gives them.
    error_mm
        Greatest chord error allowed.
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
    """Number of meridians, a multiple of 4, from r (1 - cos(pi / n)) = 2 r sin^2(pi / 2n)."""
    sine = math.sqrt(min(1.0, 0.5 * error_mm / radius_mm)) if radius_mm > 0.0 else 1.0
    return max(FEWEST_AZIMUTHS, 4 * math.ceil(0.125 * math.pi / math.asin(sine)))


def sloping_radius_mm(meridian: SurfaceMeridian) -> float:
    """Greatest radial height times sine of slope: a chord stands off the surface by that share of itself."""
    t = np.linspace(0.0, 1.0, 257)
    tangent = meridian.tangents(t)
    return float(np.max(meridian.points(t)[:, 0] * np.abs(tangent[:, 1]) / np.linalg.norm(tangent, axis=1)))


def area_factor(count: int) -> float:
    """Circumradius of the regular polygon that has the area of the unit circle."""
    angle = 2.0 * math.pi / count
    return math.sqrt(angle / math.sin(angle))


def edge_error(radius_mm: float, count: int) -> float:
    """Greatest distance in mm of such a polygon from its circle."""
    factor = area_factor(count)
    return radius_mm * max(factor - 1.0, 1.0 - factor * math.cos(math.pi / count))


def balanced_profile(meridian: SurfaceMeridian, t: Array, movable_rim: bool) -> Array:
    """Corners of a polygon that straddles a meridian, so that as much lies to either side of it.

    Parameters
    ----------
    meridian
        The exact meridian.
    t
        Parameters of the corners, from 0 to 1.
    movable_rim
        Whether the rim may move along z: it ends on the edge cylinder, and no flat ring or bevel goes on.

    Returns
    -------
    ndarray, shape (n, 2)
        Radial height (rising, from 0 to the rim's) and z in mm.
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
    # The rim stays at its radial height, and where the tangent stands upright also at its z.
    upright = normal[-1, 1] < 0.1
    rise = shift[-1] / normal[-1, 1] if movable_rim and not upright else 0.0
    moved[-1] = meridian.end_mm, points[-1, 1] + rise
    return moved


def revolve(profile: Array, count: int) -> tuple[Array, NDArray[np.int64]]:
    """Vertices and triangles of an open polygon (r, z), both ends on the axis, turned about z.

    Rings are regular polygons with the area of the circle of radius r.
    """
    x, y = area_factor(count) * circle(count)
    r, z = profile[1:-1, 0, None], profile[1:-1, 1, None]
    rings = np.stack(np.broadcast_arrays(r * x, r * y, z), axis=-1)
    poles = np.array([[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]])
    return np.concatenate([poles, rings.reshape(-1, 3)]), ring_faces(len(rings), count)


def circle(count: int) -> Array:
    """x and y of points on the unit circle, the first at x = 1, shape (2, count)."""
    angle = 2.0 * math.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)])


def ring_faces(rings: int, count: int) -> NDArray[np.int64]:
    """Triangles of a closed body: first pole, rings, second pole.

    Vertices 0 and 1 are the front and back pole; ring k has the `count` vertices from 2 + k count on.
    Facets have their normals outwards where the rings run round from the front pole to the back one.
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
