"""A mesh held against the design: closed, how many bodies, which volume, and how far from each surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import Element, SurfaceMeridian, closed_elements
from lensdesign.manufacture.mesh.reading import TriangleMesh
from lensdesign.manufacture.mesh.topology import closed_bodies, merged

BLOCK_POINTS = 200_000

ALIKE = 0.7
"""Least cosine between the normals of a facet and of what it belongs to."""


@dataclass(frozen=True)
class SurfaceDistances:
    """Distances of a mesh's points from one side of an element.

    Attributes
    ----------
    element, surface
        Numbers from 1.
    points
        Vertices, edge midpoints and facet centres that belong to it.
    greatest_um, rms_um
        Their distances from the nominal surface; None where there are no points.
    """

    element: int
    surface: int
    points: int
    greatest_um: float | None
    rms_um: float | None


@dataclass(frozen=True)
class MeshReport:
    """What :func:`verify_mesh` found.

    Attributes
    ----------
    triangles, bodies, elements
        Of the mesh, closed bodies of the mesh, and glass elements of the design.
    closed
        Whether the triangles bound bodies: at each edge as many run one way as the other.
    open_edges
        Edges where they do not.
    volume_mm3, exact_volume_mm3
        Of the mesh, negative if it is inside out; of the design.
    distances
        For both sides of each element.
    edge_greatest_um
        Greatest distance of a facet centre that belongs to no optical surface from the design's edge; None
        where there is none.
    chord_error_um
        The distance allowed.
    """

    triangles: int
    bodies: int
    elements: int
    closed: bool
    open_edges: int
    volume_mm3: float
    exact_volume_mm3: float
    distances: tuple[SurfaceDistances, ...]
    edge_greatest_um: float | None
    chord_error_um: float

    @property
    def faults(self) -> tuple[str, ...]:
        """What does not hold, a sentence each."""
        found = [] if self.closed else [f"the mesh is open: {self.open_edges} edges without a counterpart"]
        if self.closed and self.bodies != self.elements:
            found.append(f"{self.bodies} bodies, where the design has {self.elements}")
        if self.closed and not self.volume_mm3 > 0.0:
            found.append("the mesh is inside out: its volume is not above 0")
        for side in self.distances:
            name = f"surface {side.surface} of element {side.element}"
            if side.greatest_um is None:
                found.append(f"no part of the mesh belongs to {name}")
            elif not side.greatest_um <= self.chord_error_um:
                found.append(f"{name}: {side.greatest_um:.4g} um off; allowed: {self.chord_error_um:g} um")
        return tuple(found)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self) | {"faults": list(self.faults), "agrees": not self.faults}


def verify_mesh(lens: Lens, mesh: TriangleMesh, chord_error_um: float = 0.1) -> MeshReport:
    """Hold a mesh against the nominal shape of a lens.

    A facet belongs to what its centre lies nearest to, among the optical surfaces and the parts of the edge
    whose normal there is within 45 degrees of the facet's. A point belongs to an optical surface if all
    facets that meet in it do, so that points of the rim belong to none.

    Parameters
    ----------
    lens
        A lens whose elements close. The mesh must lie as it does: front vertex at z = 0, axis along z.
    mesh
        As :func:`lensdesign.manufacture.mesh.reading.read_mesh` gives it.
    chord_error_um
        Greatest distance allowed.

    Raises
    ------
    InputError
        If the lens does not close, or the distance allowed is not above 0.
    """
    if not 0.0 < chord_error_um < np.inf:
        raise InputError(f"chord_error_um = {chord_error_um:g}: must be above 0 and finite")
    elements = closed_elements(lens)
    vertices, faces = merged(mesh)
    bodies, open_edges = closed_bodies(vertices, faces)
    corners = vertices[faces]
    volume = float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0
    belongs, off_edge = _belonging(corners, elements)
    sides = [(e, m) for e in elements for m in (e.front, e.back)]
    return MeshReport(
        triangles=len(faces),
        bodies=bodies,
        elements=len(elements),
        closed=open_edges == 0,
        open_edges=open_edges,
        volume_mm3=volume,
        exact_volume_mm3=sum(e.volume_mm3 for e in elements),
        distances=tuple(
            _distances(element, meridian, side % 2, vertices, faces, belongs == side)
            for side, (element, meridian) in enumerate(sides)
        ),
        edge_greatest_um=off_edge,
        chord_error_um=chord_error_um,
    )


def _belonging(corners: Array, elements: Sequence[Element]) -> tuple[NDArray[np.int64], float | None]:
    """For each facet the side (front and back of each element in turn) that it belongs to, -1 for none.

    Also the greatest distance of the others from the edge, in um.
    """
    sides = [(m, sign) for e in elements for m, sign in ((e.front, -1.0), (e.back, 1.0))]
    belongs = np.full(len(corners), -1, np.int64)
    off_edge = None
    for start in range(0, len(corners), BLOCK_POINTS):
        block = slice(start, start + BLOCK_POINTS)
        centres, normals = _centres_and_normals(corners[block])
        best, off = np.full(len(centres), np.inf), np.full(len(centres), np.inf)
        for side, (meridian, sign) in enumerate(sides):
            distance = meridian.distances(centres)
            tangent = meridian.tangents(meridian.parameters(centres[:, 0]))
            outward = sign * np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
            alike = np.sum(outward * normals, axis=-1) >= ALIKE * np.linalg.norm(outward, axis=-1)
            nearer = alike & (distance < best)
            best[nearer], belongs[block][nearer] = distance[nearer], side
        for element in elements:
            for a, b in zip(element.rim[:-1], element.rim[1:], strict=True):
                distance, outward = _from_segment(centres, a, b)
                off = np.minimum(off, distance)
                nearer = (normals @ outward >= ALIKE) & (distance <= best)
                best[nearer], belongs[block][nearer] = distance[nearer], -1
        none = belongs[block] < 0
        if none.any():
            off_edge = max(off_edge or 0.0, 1e3 * float(np.max(off[none])))
    return belongs, off_edge


def _centres_and_normals(corners: Array) -> tuple[Array, Array]:
    """Of each facet in its meridional plane: (radial height, z), and unit outward normal along the two."""
    centres = corners.mean(axis=1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    r = np.hypot(centres[:, 0], centres[:, 1])
    along = np.sum(centres[:, :2] * normals[:, :2], axis=1) / np.where(r > 0.0, r, 1.0)
    return np.stack([r, centres[:, 2]], axis=-1), np.stack([along, normals[:, 2]], axis=-1)


def _from_segment(points: Array, a: Array, b: Array) -> tuple[Array, Array]:
    """Distances of points (radial height, z) from a straight part of the rim, and its outward normal."""
    step = b - a
    length = float(np.linalg.norm(step))
    if length == 0.0:
        return np.full(len(points), np.inf), np.zeros(2)
    share = np.clip((points - a) @ step / length**2, 0.0, 1.0)
    # The rim runs from front to back, so that outside lies to its right.
    return np.linalg.norm(a + share[:, None] * step - points, axis=-1), np.array([step[1], -step[0]]) / length


def _distances(
    element: Element,
    meridian: SurfaceMeridian,
    which: int,
    vertices: Array,
    faces: NDArray[np.int64],
    mine: NDArray[np.bool_],
) -> SurfaceDistances:
    """Of vertices, edge midpoints and centres of facets that belong to one side."""
    inside = np.ones(len(vertices), bool)
    inside[faces[~mine]] = False
    own = faces[mine]
    inside_corners = np.unique(own[inside[own]])
    ends = np.sort(own[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    ends, uses = np.unique(ends[:, 0] * len(vertices) + ends[:, 1], return_counts=True)
    ends = ends[uses > 1]
    middles = 0.5 * (vertices[ends // len(vertices)] + vertices[ends % len(vertices)])
    points = np.concatenate([vertices[inside_corners], middles, vertices[own].mean(axis=1)])
    rz = np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]], axis=-1)
    off = [meridian.distances(rz[i : i + BLOCK_POINTS]) for i in range(0, len(rz), BLOCK_POINTS)]
    distances = 1e3 * np.concatenate(off) if off else np.empty(0)
    return SurfaceDistances(
        element=element.number + 1,
        surface=element.surfaces[which] + 1,
        points=len(distances),
        greatest_um=float(np.max(distances)) if len(distances) else None,
        rms_um=float(np.sqrt(np.mean(distances**2))) if len(distances) else None,
    )
