"""Mesh of a body of revolution, and how far its facets are from the exact one."""

from __future__ import annotations

import math

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.solid import Element, smallest_gap
from lensdesign.manufacture.mesh.bodies import LensMesh
from lensdesign.manufacture.mesh.rings import (
    BALANCE,
    area_factor,
    balanced_profile,
    edge_error,
    meridian_chord_errors,
    revolve,
    ring_density,
    ring_parameters,
)


def symmetric_mesh(element: Element, error_mm: float, count: int) -> LensMesh:
    """Mesh one body of revolution.

    Parameters
    ----------
    element
        The exact body.
    error_mm
        Distance aimed at between facets of the surfaces and the exact ones; what came out is measured.
    count
        Number of meridians.

    Raises
    ------
    InputError
        If facets of the two surfaces would cross.
    """
    import trimesh

    sides = (element.front, element.back)
    optical = [
        balanced_profile(m, _rings(m, BALANCE * error_mm), len(end) == 0)
        for m, end in zip(sides, element.ends, strict=True)
    ]
    front, back = (
        np.concatenate([p, m.points(1.0) * [0.0, 1.0] + end])
        for m, p, end in zip(sides, optical, element.ends, strict=True)
    )
    r, gap = smallest_gap(front, back)
    if gap <= 0.0:
        raise InputError(
            f"chord_error_um = {1e3 * error_mm:g} is too coarse for {element.name}: facets of its "
            f"surfaces would cross at a radial height of {r:.6g} mm; ask for less"
        )
    vertices, faces = revolve(np.concatenate([front, element.flange_corners, back[::-1]]), count)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.units = "mm"
    return LensMesh(
        mesh,
        1e3
        * max(
            _measured_error(m, p, count, len(end) > 0)
            for m, p, end in zip(sides, optical, element.ends, strict=True)
        ),
        1e3 * edge_error(element.outer_mm, count),
        float(mesh.volume),
        element.volume_mm3,
    )


def _rings(meridian: SurfaceMeridian, error_mm: float) -> Array:
    errors, end_mm = meridian_chord_errors(meridian), meridian.end_mm
    return ring_parameters(errors, ring_density(errors, end_mm), end_mm, error_mm)


def _measured_error(meridian: SurfaceMeridian, profile: Array, count: int, goes_on: bool) -> float:
    """Greatest distance of facets from the surface, at 231 points of every facet of one sector.

    All sectors are alike. What reaches past the end of the meridian is held against its tangent there; of
    a flat ring or bevel that goes on from it only the inner rim can stand off.
    """
    points = _sector_points(profile, count)
    radial = np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]], axis=-1)
    beyond = radial[:, 0] > meridian.end_mm
    greatest = float(np.max(meridian.distances(radial[~beyond]), initial=0.0))
    if goes_on:
        inner = meridian.end_mm * area_factor(count) * math.cos(math.pi / count)
        return max(greatest, float(meridian.distances(np.array([[inner, profile[-1, 1]]]))[0]))
    tangent, off = meridian.tangents(1.0), radial[beyond] - meridian.points(1.0)
    across = off[:, 0] * tangent[1] - off[:, 1] * tangent[0]
    return max(greatest, float(np.max(np.abs(across), initial=0.0) / np.linalg.norm(tangent)))


def _sector_points(profile: Array, count: int, parts: int = 20) -> Array:
    """Points all over the facets of one sector of a surface, shape (n, 3)."""
    angle, factor = 2.0 * math.pi / count, area_factor(count)
    r, z = factor * profile[:, 0], profile[:, 1]
    one = np.stack([r, np.zeros(len(profile)), z], axis=-1)
    other = np.stack([r * math.cos(angle), r * math.sin(angle), z], axis=-1)
    corners = np.concatenate(
        [
            np.stack([one[:-1], one[1:], other[1:]], axis=1),
            np.stack([one[:-1], other[:-1], other[1:]], axis=1),
        ]
    )
    i, j = np.meshgrid(np.arange(parts + 1), np.arange(parts + 1))
    share = np.stack([i, j, parts - i - j], axis=-1)[i + j <= parts] / parts
    return (share @ corners).reshape(-1, 3)
