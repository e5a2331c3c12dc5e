"""Mesh of a body that is not a body of revolution: its surfaces are decentered, tilted, or have figures.

Both surfaces are heights above discs, meshed over rings and azimuths. The edge joins them: flat rings and
bevels follow the rim of their surface; the edge cylinder and the flange are centred on the axis of the lens.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.meridian import SurfaceMeridian, ring_volume_mm3
from lensdesign.lens.solid import Element
from lensdesign.manufacture.mesh.bodies import HeightSurface, LensMesh, PerturbedBodies
from lensdesign.manufacture.mesh.rings import (
    BALANCE,
    MAX_TRIANGLES,
    ChordErrors,
    circle,
    cumulative_ring_count,
    edge_error,
    equal_area_circumradius,
    ring_faces,
    ring_parameters,
)

_DIRECTIONS = 24
"""Number of meridians that determine the rings; the finished facets are measured everywhere."""

_BLOCK = 1 << 17
"""Number of facets, or of points on them, in one block of the computation."""


def freeform_mesh(bodies: PerturbedBodies, index: int, error_mm: float, count: int) -> LensMesh:
    """Mesh one body over rings and azimuths.

    Parameters
    ----------
    bodies, index
        All bodies, and the index of the one to mesh.
    error_mm
        Intended distance between the facets and the exact surfaces in mm; the result holds the measured one.
    count
        Number of azimuths that the nominal shape needs.

    Raises
    ------
    InputError
        If the body does not close, a surface ends inside its rim, or too many triangles are needed.
    """
    import trimesh

    element, sides = bodies.elements[index], bodies.surfaces(index)
    _check_crossing(element, sides)
    meridians, error_mm = (element.front, element.back), BALANCE * error_mm
    for side, meridian in zip(sides, meridians, strict=True):
        count = _azimuths(side, meridian.end_mm, error_mm, count)
    radii = [_ring_radii(s, m, error_mm, count) for s, m in zip(sides, meridians, strict=True)]
    optical = [_points(s, r, count) for s, r in zip(sides, radii, strict=True)]
    for side, points, end in zip(sides, optical, element.ends, strict=True):
        if len(end):
            _level_rim(side, points[-count:], count)
    ends = [_end_points(p[-count:], end, count) for p, end in zip(optical, element.ends, strict=True)]
    ring = _flange_points(element, ends, optical, count)
    rings = [len(radii[0]) + len(element.ends[0]), len(ring) // count, len(radii[1]) + len(element.ends[1])]
    _check_triangle_count(min(sides, key=lambda s: s.finest_mm), sum(rings), count, error_mm)
    vertices = np.concatenate([optical[0], ends[0], ring, optical[1], ends[1]])
    faces = _ring_order(rings, count)[ring_faces(sum(rings), count)]
    side_faces = faces[: count * (2 * len(radii[0]) - 1)], faces[-count * (2 * len(radii[1]) - 1) :]
    starts = (0, len(vertices) - len(optical[1]) - len(ends[1]))
    measured_mm = 0.0
    for i, side in enumerate(sides):
        outer = starts[i] + len(optical[i])
        fixed = slice(outer - count, outer) if len(element.ends[i]) else slice(0)
        measured_mm = max(measured_mm, _balance(side, vertices, side_faces[i], fixed))
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.units = "mm"
    edge_error_um = 1e3 * edge_error(element.outer_mm, count)
    return LensMesh(mesh, 1e3 * measured_mm, edge_error_um, float(mesh.volume), _volume_mm3(element, sides))


def _ring_order(rings: Sequence[int], count: int) -> NDArray[np.int64]:
    """Return the index of each vertex in the order of ring_faces, which runs from pole to pole.

    The vertices are stored as front pole, rings of the front side outwards, rings of the flange, back pole,
    and rings of the back side outwards.
    """
    back_pole = 1 + (rings[0] + rings[1]) * count
    inner = 1 + np.arange(back_pole - 1)
    outer = back_pole + 1 + np.arange(rings[2] * count).reshape(rings[2], count)[::-1]
    return np.concatenate([[0, back_pole], inner, outer.ravel()])


def _end_points(rim: Array, end: Array, count: int) -> Array:
    """Return the rings of flat ring and bevel, which follow the rim; shape (len(end) * count, 3)."""
    x, y = equal_area_circumradius(count) * circle(count)
    rings = [np.column_stack([r * x, r * y, rim[:, 2] + rise]) for r, rise in end]
    return np.concatenate([np.empty((0, 3)), *rings])


def _flange_points(element: Element, ends: Sequence[Array], optical: Sequence[Array], count: int) -> Array:
    """Return the rings of the flange, which must lie on the edge cylinder at every azimuth."""
    front, back = (np.concatenate([o, e])[-count:, 2] for o, e in zip(optical, ends, strict=True))
    corners = element.flange_corners
    faces_z = corners[[0, -1], 1] if len(corners) else (np.max(front), np.min(back))
    if np.any(front > faces_z[0]) or np.any(back < faces_z[1]) or np.any(back <= front):
        raise InputError(
            f"{element.name}, with its perturbations: the edge cylinder extends at its narrowest from z = "
            f"{float(np.max(front)):.6g} to {float(np.min(back)):.6g} mm, too short for the edge; raise "
            "thickness_mm, or lower the bevels, the flange or the perturbation"
        )
    x, y = equal_area_circumradius(count) * circle(count)
    rings = [np.column_stack([r * x, r * y, np.full(count, z)]) for r, z in corners]
    return np.concatenate([np.empty((0, 3)), *rings])


def _points(side: HeightSurface, radii: Array, count: int) -> Array:
    """Return the vertex and the ring points of a surface; each ring has the area of its circle."""
    ring = equal_area_circumradius(count) * circle(count)
    x, y = (np.concatenate([[0.0], np.outer(radii, axis).ravel()]) for axis in ring)
    return np.stack([x, y, _finite_heights(side, x, y)], axis=-1)


def _level_rim(side: HeightSurface, rim: Array, count: int) -> None:
    """Set the corners of the rim to the heights of its circle, which a flat ring or bevel follows."""
    x, y = rim[:, :2].T / equal_area_circumradius(count)
    rim[:, 2] = _finite_heights(side, x, y)


def _finite_heights(side: HeightSurface, x: Array, y: Array) -> Array:
    z = side.heights(x, y)
    missing = ~np.isfinite(z)
    if np.any(missing):
        radius = float(np.min(np.hypot(x, y)[missing]))
        raise InputError(
            f"surface {side.index + 1}, with its perturbation, ends at a radial height of about "
            f"{radius:.6g} mm, inside its rim; lower semi_diameter_mm or the perturbation"
        )
    return z


def _ring_radii(side: HeightSurface, meridian: SurfaceMeridian, error_mm: float, count: int) -> Array:
    """Return the radii of the rings without the vertex."""
    errors = _chord_errors(side, meridian)
    end_mm, finest = meridian.end_mm, side.finest_mm
    # Below a quarter of a figure's cell, chord errors are proportional to the square of the spacing.
    shortest = 0.0 if math.isinf(finest) else 0.25 * finest / end_mm
    density = cumulative_ring_count(errors, end_mm, min(1e-5, error_mm / end_mm), shortest)
    _check_triangle_count(side, density[1][-1] / math.sqrt(error_mm), count, error_mm)
    rings = ring_parameters(errors, density, end_mm, error_mm)
    radii = meridian.points(rings)[1:, 0]
    radii[-1] = end_mm
    return np.asarray(radii)


def _chord_errors(side: HeightSurface, meridian: SurfaceMeridian) -> ChordErrors:
    """Return a function of ring parameters: the largest chord errors over several meridians."""
    x, y = circle(_DIRECTIONS)
    fraction = np.linspace(0.0, 1.0, 9)[1:-1, None, None, None]

    def largest(t: Array) -> Array:
        r = meridian.points(t)[:, 0]
        px, py = np.outer(r, x), np.outer(r, y)
        ends = np.stack([px, py, _finite_heights(side, px, py)], axis=-1)
        rise, cosine = side.rises((1.0 - fraction) * ends[:-1] + fraction * ends[1:])
        return np.asarray(np.max(np.abs(rise * cosine), axis=(0, 2)))

    return largest


def _azimuths(side: HeightSurface, end_mm: float, error_mm: float, count: int) -> int:
    """Return the number of azimuths for which chords along the rings meet the limit, tested on 12 rings."""
    r = np.linspace(end_mm / 12.0, end_mm, 12)
    for _ in range(12):
        ends = _points(side, r, count)[1:].reshape(len(r), count, 3)
        rise, cosine = side.rises(0.5 * (ends + np.roll(ends, -1, axis=1)))
        greatest = float(np.max(np.abs(rise * cosine)))
        if greatest <= error_mm:
            break
        _check_triangle_count(side, len(r), count, error_mm)
        count = 4 * math.ceil(0.25 * count * min(4.0, 1.01 * math.sqrt(greatest / error_mm)))
    return count


def _check_triangle_count(side: HeightSurface, rings: float, count: int, error_mm: float) -> None:
    triangles = 2.0 * rings * count
    if triangles <= MAX_TRIANGLES:
        return
    cause = "" if math.isinf(side.finest_mm) else f" for its figure (nodes every {side.finest_mm:.4g} mm)"
    raise InputError(
        f"surface {side.index + 1} would need {triangles:.3g} triangles{cause} for a chord error of "
        f"{error_mm / BALANCE:.3g} mm; allowed: at most {MAX_TRIANGLES:.3g}, so give a larger chord error"
    )


def _balance(side: HeightSurface, vertices: Array, faces: NDArray[np.int64], fixed: slice) -> float:
    """Move vertices along z so that facets straddle the surface; return the largest distance of the facets.

    The vertices `fixed` of a rim with a flat ring or bevel do not move.

    Distances are measured at the vertices, the centre and the middles of the sides of every facet. On a
    paraboloid, other points deviate by at most a few per cent more, and the mean over the middles of the
    sides is exact. If facets are larger than the cells of a figure, points in every cell are added.
    """
    rises, cosines = _facet_rises(side, vertices, faces)
    corners = vertices[faces]
    a, b = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    mean = np.mean(rises[:, :3], axis=1)
    weight, sums = (
        np.bincount(faces.ravel(), np.repeat(w, 3), minlength=len(vertices)) for w in (area, area * mean)
    )
    shift = np.where(weight > 0.0, -sums / np.where(weight > 0.0, weight, 1.0), 0.0)
    free = np.ones(len(vertices))
    free[fixed] = shift[fixed] = 0.0
    # The free vertices balance the remaining volume error of the fixed ones.
    remainder, free_area = (
        np.sum(area * m) for m in (mean + np.mean(shift[faces], axis=1), np.mean(free[faces], axis=1))
    )
    shift = np.where(weight > 0.0, shift - free * remainder / free_area, 0.0)
    vertices[:, 2] += shift
    own = shift[faces]
    moved = rises + np.column_stack([own @ _MIDDLES.T, np.mean(own, axis=1)])
    deviation = max(np.max(np.abs(moved * cosines)), np.max(np.abs(own) * cosines[:, :3]))
    longest_side = float(np.max(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)))
    divisions = min(24, math.ceil(2.0 * longest_side / side.finest_mm))
    if divisions > 2:
        deviation = max(deviation, _largest_distance(side, vertices, faces, divisions))
    return float(deviation)


def _largest_distance(
    side: HeightSurface, vertices: Array, faces: NDArray[np.int64], divisions: int
) -> float:
    """Return the largest distance from the surface, over a grid of points on every facet."""
    i, j = np.meshgrid(np.arange(divisions + 1), np.arange(divisions + 1))
    weights = np.stack([i, j, divisions - i - j], axis=-1)[i + j <= divisions] / divisions
    step = max(1, _BLOCK // len(weights))
    blocks = (faces[start : start + step] for start in range(0, len(faces), step))
    found = (side.rises(weights @ vertices[block]) for block in blocks)
    return max(float(np.max(np.abs(rise * cosine))) for rise, cosine in found)


_MIDDLES = 0.5 * (np.ones((3, 3)) - np.eye(3))
"""Weights of a facet's corners at the middles of its sides."""


def _facet_rises(side: HeightSurface, vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return heights above the surface and slope cosines at the side middles and the centre of facets."""
    weights = np.concatenate([_MIDDLES, np.full((1, 3), 1.0 / 3.0)])
    blocks = [
        side.rises(weights @ vertices[faces[start : start + _BLOCK]])
        for start in range(0, len(faces), _BLOCK)
    ]
    rises, cosines = zip(*blocks, strict=True)
    return np.concatenate(rises), np.concatenate(cosines)


def _quadrature(side: HeightSurface, end_mm: float) -> tuple[float, float]:
    """Return the integral of a surface's height over its disc in mm^3, and the mean z of its rim in mm."""
    panels = min(256, max(64, math.ceil(end_mm / side.finest_mm)))
    directions = min(1024, max(256, math.ceil(4.0 * math.pi * end_mm / side.finest_mm)))
    nodes, weights = np.polynomial.legendre.leggauss(4)
    limits = end_mm * np.linspace(0.0, 1.0, panels + 1)
    half = 0.5 * np.diff(limits)[:, None]
    x, y = circle(directions)
    r = (limits[:-1, None] + half * (nodes + 1.0)).ravel()
    mean = np.mean(_finite_heights(side, np.outer(r, x), np.outer(r, y)), axis=1)
    total = 2.0 * math.pi * float(np.sum((half * weights).ravel() * r * mean))
    return total, float(np.mean(_finite_heights(side, end_mm * x, end_mm * y)))


def _volume_mm3(element: Element, sides: tuple[HeightSurface, HeightSurface]) -> float:
    """Return the exact volume; a flat ring or bevel has the volume of one at the mean z of its rim."""
    volumes, profiles = [], []
    for side, meridian, end in zip(sides, (element.front, element.back), element.ends, strict=True):
        volume, rim_z = _quadrature(side, meridian.end_mm)
        volumes.append(volume)
        profiles.append(_rim_profile(meridian, end) + np.array([0.0, rim_z]))
    rim = np.concatenate([profiles[0], element.flange_corners, profiles[1][::-1]])
    return volumes[1] - volumes[0] + ring_volume_mm3(rim)


def _check_crossing(element: Element, sides: tuple[HeightSurface, HeightSurface]) -> None:
    r = element.edge_mm * np.linspace(0.0, 1.0, 129)
    front, back = (
        _side_heights(s, m, end, r)
        for s, m, end in zip(sides, (element.front, element.back), element.ends, strict=True)
    )
    gap = np.min(back - front, axis=1)
    i = int(np.argmin(gap))
    if gap[i] <= 0.0:
        raise InputError(
            f"{element.name}, with its perturbations, does not close: its surfaces cross at a radial height "
            f"of {r[i]:.6g} mm (gap {gap[i]:.6g} mm); raise thickness_mm or lower semi_diameter_mm"
        )


def _side_heights(side: HeightSurface, meridian: SurfaceMeridian, end: Array, r: Array) -> Array:
    """Return z over radial heights and azimuths, including flat ring and bevel."""
    within = np.minimum(r, meridian.end_mm)
    x, y = (np.outer(within, axis) for axis in circle(4 * _DIRECTIONS))
    rise = np.interp(r, *_rim_profile(meridian, end).T)
    return np.asarray(_finite_heights(side, x, y) + rise[:, None])


def _rim_profile(meridian: SurfaceMeridian, end: Array) -> Array:
    return np.concatenate([[[meridian.end_mm, 0.0]], end])
