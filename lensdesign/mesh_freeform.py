"""Mesh of a body whose surfaces are decentered, tilted, or have figures.

Both surfaces are heights above one disc, meshed over rings and azimuths, and joined by the ground edge.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError
from lensdesign.lens_solid import Element, SurfaceMeridian
from lensdesign.mesh_bodies import HeightSurface, LensMesh, PerturbedBodies
from lensdesign.mesh_rings import (
    BALANCE,
    MOST_TRIANGLES,
    ChordErrors,
    area_factor,
    circle,
    edge_error,
    ring_density,
    ring_faces,
    ring_parameters,
)

Array = NDArray[np.float64]

_DIRECTIONS = 24
"""Meridians that say where the rings have to lie; facets everywhere are measured afterwards."""

_BLOCK = 1 << 17
"""Facets, or points on them, measured at one time."""

_MOST_PARTS = 24
"""Into which the sides of facets are divided, to find figures finer than these."""


def freeform_mesh(bodies: PerturbedBodies, number: int, chord_error_mm: float, count: int) -> LensMesh:
    """Mesh one body over rings and azimuths.

    Parameters
    ----------
    bodies, number
        The body.
    chord_error_mm
        Distance aimed at between facets of the surfaces and the exact ones; what came out is measured.
    count
        Number of azimuths that its nominal shape needs.

    Raises
    ------
    InputError
        If the body does not close, a surface ends inside the ground edge, or too many triangles are needed.
    """
    import trimesh

    element, sides = bodies.elements[number], bodies.surfaces(number)
    _refuse_crossing(element, sides)
    meridians, error_mm = (element.front, element.back), BALANCE * chord_error_mm
    for side in sides:
        count = _azimuths(side, element.edge_mm, error_mm, count)
    radii = [
        _ring_radii(s, m, element.edge_mm, error_mm, count) for s, m in zip(sides, meridians, strict=True)
    ]
    rings = len(radii[0]) + len(radii[1])
    _refuse_detail(min(sides, key=lambda s: s.finest_mm), rings, count, error_mm)
    vertices = np.concatenate([_points(s, r, count) for s, r in zip(sides, radii, strict=True)])
    faces = ring_faces(rings, count)
    # Vertices come as: front pole, front rings outwards, back pole, back rings outwards.
    order = _ring_order(len(radii[0]), len(radii[1]), count)
    faces = order[faces]
    front, edge = count * (2 * len(radii[0]) - 1), 2 * count
    parts = faces[:front], faces[front + edge :]
    measured_mm = max(_balance(s, vertices, own) for s, own in zip(sides, parts, strict=True))
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.units = "mm"
    edge_error_mm = edge_error(element.edge_mm, count)
    return LensMesh(mesh, measured_mm, edge_error_mm, float(mesh.volume), _volume_mm3(element, sides))


def _ring_order(front: int, back: int, count: int) -> NDArray[np.int64]:
    """Where the vertices stand that ring_faces numbers from pole to pole."""
    poles = np.array([0, 1 + front * count])
    inner = 1 + np.arange(front * count)
    outer = 2 + front * count + np.arange(back * count).reshape(back, count)[::-1]
    return np.concatenate([poles, inner, outer.ravel()])


def _points(side: HeightSurface, radii: Array, count: int) -> Array:
    """Vertex and ring points of a surface; rings have the area of their circle."""
    across = np.outer(radii, area_factor(count) * circle(count)[0])
    down = np.outer(radii, area_factor(count) * circle(count)[1])
    x, y = (np.concatenate([[0.0], part.ravel()]) for part in (across, down))
    return np.stack([x, y, _finite_heights(side, x, y)], axis=-1)


def _finite_heights(side: HeightSurface, x: Array, y: Array) -> Array:
    z = side.heights(x, y)
    missing = ~np.isfinite(z)
    if np.any(missing):
        where = float(np.min(np.hypot(x, y)[missing]))
        raise InputError(
            f"surface {side.index + 1}, as perturbed, ends at a radial height of about {where:.6g} mm, "
            "inside the ground edge; lower semi_diameter_mm or the perturbation"
        )
    return z


def _ring_radii(
    side: HeightSurface, meridian: SurfaceMeridian, edge_mm: float, error_mm: float, count: int
) -> Array:
    """Radii of the rings, the vertex left out."""
    errors = _chord_errors(side, meridian)
    end_mm, finest = meridian.end_mm, side.finest_mm
    # Within a quarter of a figure's cell chord errors go with the square of the spacing.
    shortest = 0.0 if math.isinf(finest) else 0.25 * finest / end_mm
    density = ring_density(errors, end_mm, min(1e-5, error_mm / end_mm), shortest)
    _refuse_detail(side, density[1][-1] / math.sqrt(error_mm), count, error_mm)
    rings = ring_parameters(errors, density, end_mm, error_mm)
    radii = meridian.points(rings)[1:, 0]
    radii[-1] = end_mm
    return np.append(radii, edge_mm) if end_mm < edge_mm else radii


def _chord_errors(side: HeightSurface, meridian: SurfaceMeridian) -> ChordErrors:
    """Greatest over meridians in several directions."""
    x, y = circle(_DIRECTIONS)
    share = np.linspace(0.0, 1.0, 9)[1:-1, None, None, None]

    def greatest(t: Array) -> Array:
        r = meridian.points(t)[:, 0]
        across, down = np.outer(r, x), np.outer(r, y)
        ends = np.stack([across, down, _finite_heights(side, across, down)], axis=-1)
        rise, cosine = side.rises((1.0 - share) * ends[:-1] + share * ends[1:])
        return np.asarray(np.max(np.abs(rise * cosine), axis=(0, 2)))

    return greatest


def _azimuths(side: HeightSurface, edge_mm: float, error_mm: float, count: int) -> int:
    """Number of azimuths with which chords round the rings hold; measured on 12 of them."""
    r = np.linspace(edge_mm / 12.0, edge_mm, 12)
    for _ in range(12):
        ends = _points(side, r, count)[1:].reshape(len(r), count, 3)
        rise, cosine = side.rises(0.5 * (ends + np.roll(ends, -1, axis=1)))
        greatest = float(np.max(np.abs(rise * cosine)))
        if greatest <= error_mm:
            break
        _refuse_detail(side, len(r), count, error_mm)
        count = 4 * math.ceil(0.25 * count * min(4.0, 1.01 * math.sqrt(greatest / error_mm)))
    return count


def _refuse_detail(side: HeightSurface, rings: float, count: int, error_mm: float) -> None:
    triangles = 2.0 * rings * count
    if triangles <= MOST_TRIANGLES:
        return
    cause = "" if math.isinf(side.finest_mm) else f" for its figure (nodes every {side.finest_mm:.4g} mm)"
    raise InputError(
        f"surface {side.index + 1} would need {triangles:.3g} triangles{cause} to hold a chord error of "
        f"{error_mm / BALANCE:.3g} mm; allowed: at most {MOST_TRIANGLES:.3g}, so ask for a larger one"
    )


def _balance(side: HeightSurface, vertices: Array, faces: NDArray[np.int64]) -> float:
    """Move vertices along z until facets straddle the surface; greatest distance of the facets from it.

    Distances are had at the vertices, centre and middles of the sides of every facet: a paraboloid's facets
    are nowhere farther off but by a few per cent, and its means over the middles of the sides are exact.
    Where facets are larger than the cells of a figure, points in every cell add to these.
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
    vertices[:, 2] += shift
    own = shift[faces]
    moved = rises + np.column_stack([own @ _MIDDLES.T, np.mean(own, axis=1)])
    greatest = max(np.max(np.abs(moved * cosines)), np.max(np.abs(own) * cosines[:, :3]))
    largest = float(np.max(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)))
    parts = min(_MOST_PARTS, math.ceil(2.0 * largest / side.finest_mm))
    if parts > 2:
        greatest = max(greatest, _distance(side, vertices, faces, parts))
    return float(greatest)


def _distance(side: HeightSurface, vertices: Array, faces: NDArray[np.int64], parts: int) -> float:
    """Greatest distance of a grid of points on every facet from the surface."""
    i, j = np.meshgrid(np.arange(parts + 1), np.arange(parts + 1))
    weights = np.stack([i, j, parts - i - j], axis=-1)[i + j <= parts] / parts
    step = max(1, _BLOCK // len(weights))
    blocks = (faces[start : start + step] for start in range(0, len(faces), step))
    found = (side.rises(weights @ vertices[block]) for block in blocks)
    return max(float(np.max(np.abs(rise * cosine))) for rise, cosine in found)


_MIDDLES = 0.5 * (np.ones((3, 3)) - np.eye(3))
"""Weights of a facet's corners in the middles of its sides."""


def _facet_rises(side: HeightSurface, vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, Array]:
    """Heights of facets above the surface and its slope's cosine, at the sides' middles and the centre."""
    weights = np.concatenate([_MIDDLES, np.full((1, 3), 1.0 / 3.0)])
    parts = [
        side.rises(weights @ vertices[faces[start : start + _BLOCK]])
        for start in range(0, len(faces), _BLOCK)
    ]
    rises, cosines = zip(*parts, strict=True)
    return np.concatenate(rises), np.concatenate(cosines)


def _quadrature(side: HeightSurface, end_mm: float, edge_mm: float) -> float:
    """Integral in mm^3 of a surface's height over the disc within the ground edge."""
    panels = min(256, max(64, math.ceil(end_mm / side.finest_mm)))
    directions = min(1024, max(256, math.ceil(4.0 * math.pi * end_mm / side.finest_mm)))
    nodes, weights = np.polynomial.legendre.leggauss(4)
    limits = end_mm * np.linspace(0.0, 1.0, panels + 1)
    half = 0.5 * np.diff(limits)[:, None]
    x, y = circle(directions)
    r = (limits[:-1, None] + half * (nodes + 1.0)).ravel()
    mean = np.mean(_finite_heights(side, np.outer(r, x), np.outer(r, y)), axis=1)
    total = 2.0 * math.pi * float(np.sum((half * weights).ravel() * r * mean))
    rim = float(np.mean(_finite_heights(side, end_mm * x, end_mm * y)))
    return total + math.pi * rim * (edge_mm**2 - end_mm**2)


def _volume_mm3(element: Element, sides: tuple[HeightSurface, HeightSurface]) -> float:
    front, back = (
        _quadrature(s, m.end_mm, element.edge_mm)
        for s, m in zip(sides, (element.front, element.back), strict=True)
    )
    return back - front


def _refuse_crossing(element: Element, sides: tuple[HeightSurface, HeightSurface]) -> None:
    r = element.edge_mm * np.linspace(0.0, 1.0, 129)
    x, y = (np.outer(r, part) for part in circle(4 * _DIRECTIONS))
    front, back = (_finite_heights(s, x, y) for s in sides)
    gap = np.min(back - front, axis=1)
    where = int(np.argmin(gap))
    if gap[where] <= 0.0:
        raise InputError(
            f"{element.name}, as perturbed, does not close: its surfaces cross at a radial height of "
            f"{r[where]:.6g} mm (gap {gap[where]:.6g} mm); raise thickness_mm or lower semi_diameter_mm"
        )
