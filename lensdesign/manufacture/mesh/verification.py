"""Verification of a mesh against the design: closure, number of bodies, volume, surface deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import Element, SurfaceMeridian, closed_elements
from lensdesign.manufacture.mesh.reading import TriangleMesh

UNITS_MM = {
    "inches": 25.4,
    "feet": 304.8,
    "thousandths of an inch": 0.0254,
    "metres": 1e3,
    "centimetres": 10.0,
    "micrometres": 1e-3,
    "nanometres": 1e-6,
}
"""Units in mm that a mesh without a unit may have in place of millimetres."""

BLOCK_POINTS = 200_000
"""Number of points in one block of the computation."""


@dataclass(frozen=True)
class SurfaceDistances:
    """Distances of a mesh's points from one surface of an element.

    Attributes
    ----------
    element, surface
        Numbers of element and surface, from 1.
    points
        Number of vertices, edge midpoints and facet centres that are assigned to the surface.
    greatest_um, rms_um
        Largest and root mean square distance from the nominal surface in um; None without points.
    """

    element: int
    surface: int
    points: int
    greatest_um: float | None
    rms_um: float | None


@dataclass(frozen=True)
class MeshReport:
    """Result of :func:`verify_mesh`.

    Attributes
    ----------
    triangles, bodies, elements
        Number of triangles of the mesh, of closed bodies of the mesh, and of glass elements of the design.
    closed
        Whether the triangles bound bodies: at each edge, equally many triangles run in both directions.
    open_edges
        Number of edges where this condition fails.
    volume_mm3, exact_volume_mm3
        Volume of the mesh (negative if it is inside out) and of the design in mm^3.
    distances
        Distances for both surfaces of each element.
    edge_greatest_um
        Largest distance from the design's edge of a facet centre that is not assigned to an optical surface,
        in um; None without such facets.
    chord_error_um
        Allowed distance in um.
    unit
        Unit in which the mesh has the size of the design; None for millimetres, or if no known unit fits.
    agrees_in_unit
        Whether the mesh agrees with the design in that unit.
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
    unit: str | None = None
    agrees_in_unit: bool = False

    @property
    def faults(self) -> tuple[str, ...]:
        """Violated conditions, one sentence each."""
        found = []
        if self.unit is not None:
            same = "agrees with the design" if self.agrees_in_unit else "has the size of the design"
            factor = UNITS_MM[self.unit]
            found.append(
                f"the mesh {same} after a factor of {factor:g}; is it in {self.unit}? Lengths must be in "
                f"millimetres: export it so, or multiply its lengths by {factor:g}"
            )
        if not self.closed:
            found.append(f"the mesh is open: {self.open_edges} edges without a counterpart")
        if self.closed and self.bodies != self.elements:
            found.append(f"{self.bodies} bodies, where the design has {self.elements}")
        if self.closed and not self.volume_mm3 > 0.0:
            found.append("the mesh is inside out: its volume is not above 0")
        for side in self.distances:
            name = f"surface {side.surface} of element {side.element}"
            if side.greatest_um is None:
                found.append(f"no part of the mesh belongs to {name}")
            elif not side.greatest_um <= self.chord_error_um:
                found.append(f"{name}: {side.greatest_um:.4g} µm off; allowed: {self.chord_error_um:g} µm")
        return tuple(found)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON."""
        return asdict(self) | {"faults": list(self.faults), "agrees": not self.faults}


def verify_mesh(lens: Lens, mesh: TriangleMesh, chord_error_um: float = 0.1) -> MeshReport:
    """Compare a mesh with the nominal shape of a lens.

    Each facet is assigned to the nearest optical surface or segment of the edge whose normal is within about
    45 degrees of the facet's normal. A vertex is assigned to an optical surface if all its facets are, so
    that vertices of the rim are not assigned.

    Parameters
    ----------
    lens
        A lens whose elements close. The mesh must have its front vertex at z = 0 and its axis along z.
    mesh
        Result of :func:`lensdesign.manufacture.mesh.reading.read_mesh`.
    chord_error_um
        Largest allowed distance in um (default: 0.1).

    Returns
    -------
    MeshReport
        Measured distances and volume; its `faults` has a sentence for each violated condition.

    Raises
    ------
    InputError
        If an element does not close, or the allowed distance is not above 0.

    Examples
    --------
    >>> from lensdesign import load_design, read_mesh, verify_mesh, write_mesh
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> mesh = write_mesh(lens, "lens.stl", chord_error_um=5.0)
    >>> report = verify_mesh(lens, read_mesh("lens.stl"), chord_error_um=5.0)
    >>> report.closed, report.bodies, report.faults
    (True, 1, ())
    """
    if not 0.0 < chord_error_um < np.inf:
        raise InputError(f"chord_error_um = {chord_error_um:g}: must be above 0 and finite")
    report = _verified(lens, mesh, chord_error_um)
    unit = _other_unit(mesh, closed_elements(lens)) if report.faults else None
    if unit is None:
        return report
    scaled = replace(mesh, vertices_mm=UNITS_MM[unit] * mesh.vertices_mm)
    return replace(report, unit=unit, agrees_in_unit=not _verified(lens, scaled, chord_error_um).faults)


def _other_unit(mesh: TriangleMesh, elements: Sequence[Element]) -> str | None:
    """Return the unit other than millimetres in which the mesh is as wide as the design; None without one."""
    if not len(mesh.faces):
        return None
    used = mesh.vertices_mm[np.unique(mesh.faces)]
    widest = float(np.max(np.ptp(used[:, :2], axis=0)))
    design_mm = 2.0 * max(element.edge_mm for element in elements)
    # Relative difference of the widths within which a unit is suggested.
    tolerance = 0.02
    return next(
        (unit for unit, mm in UNITS_MM.items() if abs(mm * widest / design_mm - 1.0) <= tolerance), None
    )


def _verified(lens: Lens, mesh: TriangleMesh, chord_error_um: float) -> MeshReport:
    """Return the report of a mesh in millimetres."""
    elements = closed_elements(lens)
    vertices, faces = merged(mesh)
    bodies, open_edges = closed_bodies(vertices, faces)
    corners = vertices[faces]
    volume = float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0
    assigned, edge_deviation = _assign_facets(corners, elements)
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
            _distances(element, meridian, side % 2, vertices, faces, assigned == side)
            for side, (element, meridian) in enumerate(sides)
        ),
        edge_greatest_um=edge_deviation,
        chord_error_um=chord_error_um,
    )


def _assign_facets(corners: Array, elements: Sequence[Element]) -> tuple[NDArray[np.int64], float | None]:
    """Return the surface index of each facet (-1: edge), and the largest distance of edge facets in um."""
    sides = [(m, sign) for e in elements for m, sign in ((e.front, -1.0), (e.back, 1.0))]
    assigned = np.full(len(corners), -1, np.int64)
    edge_deviation = None
    # Smallest cosine between the normals of a facet and of the surface that it is assigned to.
    min_normal_cosine = 0.7
    for start in range(0, len(corners), BLOCK_POINTS):
        block = slice(start, start + BLOCK_POINTS)
        centres, normals = _centres_and_normals(corners[block])
        best, off = np.full(len(centres), np.inf), np.full(len(centres), np.inf)
        for side, (meridian, sign) in enumerate(sides):
            distance = meridian.distances(centres)
            tangent = meridian.tangents(meridian.parameters(centres[:, 0]))
            outward = sign * np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
            aligned = np.sum(outward * normals, axis=-1) >= min_normal_cosine * np.linalg.norm(
                outward, axis=-1
            )
            nearer = aligned & (distance < best)
            best[nearer], assigned[block][nearer] = distance[nearer], side
        for element in elements:
            for a, b in zip(element.rim[:-1], element.rim[1:], strict=True):
                distance, outward = _from_segment(centres, a, b)
                off = np.minimum(off, distance)
                nearer = (normals @ outward >= min_normal_cosine) & (distance <= best)
                best[nearer], assigned[block][nearer] = distance[nearer], -1
        none = assigned[block] < 0
        if none.any():
            edge_deviation = max(edge_deviation or 0.0, 1e3 * float(np.max(off[none])))
    return assigned, edge_deviation


def _centres_and_normals(corners: Array) -> tuple[Array, Array]:
    """Return centre (radial height, z) and unit outward normal of each facet in its meridional plane."""
    centres = corners.mean(axis=1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    r = np.hypot(centres[:, 0], centres[:, 1])
    along = np.sum(centres[:, :2] * normals[:, :2], axis=1) / np.where(r > 0.0, r, 1.0)
    return np.stack([r, centres[:, 2]], axis=-1), np.stack([along, normals[:, 2]], axis=-1)


def _from_segment(points: Array, a: Array, b: Array) -> tuple[Array, Array]:
    """Return distances of points (radial height, z) from a segment of the rim, and its outward normal."""
    step = b - a
    length = float(np.linalg.norm(step))
    if length == 0.0:
        return np.full(len(points), np.inf), np.zeros(2)
    fraction = np.clip((points - a) @ step / length**2, 0.0, 1.0)
    # The rim runs from front to back, so the outside is on its right.
    return np.linalg.norm(a + fraction[:, None] * step - points, axis=-1), np.array(
        [step[1], -step[0]]
    ) / length


def _distances(
    element: Element,
    meridian: SurfaceMeridian,
    side: int,
    vertices: Array,
    faces: NDArray[np.int64],
    is_member: NDArray[np.bool_],
) -> SurfaceDistances:
    """Return the distances of vertices, edge midpoints and facet centres that are assigned to one surface."""
    inside = np.ones(len(vertices), bool)
    inside[faces[~is_member]] = False
    own = faces[is_member]
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
        element=element.index + 1,
        surface=element.surfaces[side] + 1,
        points=len(distances),
        greatest_um=float(np.max(distances)) if len(distances) else None,
        rms_um=float(np.sqrt(np.mean(distances**2))) if len(distances) else None,
    )


Indices = NDArray[np.int64]


def merged(mesh: TriangleMesh) -> tuple[Array, Indices]:
    """Return vertices and faces after merging equal vertices and removing degenerate faces."""
    vertices = mesh.vertices_mm + 0.0  # no -0, which has other bits than 0
    keys = np.ascontiguousarray(vertices).view([("", np.uint64)] * 3).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[mesh.faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices[first], faces[whole]


def closed_bodies(vertices: Array, faces: Indices) -> tuple[int, int]:
    """Return the number of closed bodies and of open edges.

    Triangles that share an edge belong to the same body. If bodies touch, so that four or more triangles
    meet at an edge, each triangle is connected to the next one that bounds the same glass, which follows it
    in the direction of rotation into the glass.

    Parameters
    ----------
    vertices, faces
        Result of :func:`merged`; triangles are anticlockwise as seen from outside.

    Returns
    -------
    bodies : int
        Number of connected bodies.
    open_edges : int
        Number of edges at which triangles have no counterpart.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(faces):
        return 0, 0
    starts, ends = faces.T.reshape(-1), faces[:, [1, 2, 0]].T.reshape(-1)
    forward = starts < ends
    face = np.tile(np.arange(len(faces)), 3)
    apex = faces[:, [2, 0, 1]].T.reshape(-1)
    key = np.minimum(starts, ends) * len(vertices) + np.maximum(starts, ends)
    order = np.argsort(key, kind="stable")
    _, first, counts = np.unique(key[order], return_index=True, return_counts=True)
    balance = np.add.reduceat(np.where(forward[order], 1, -1), first)
    pairs = []
    # Largest number of triangles at one edge whose order is analysed; more count as one body.
    max_faces_at_edge = 64
    for count in np.unique(counts):
        rows = order[first[counts == count][:, None] + np.arange(count)]
        if count <= 2 or count > max_faces_at_edge:
            pairs += [face[rows[:, [0, i]]] for i in range(1, count)]
        else:
            pairs.append(_adjacent_around_edges(vertices, rows, starts, ends, apex, forward, face))
    links = np.concatenate([np.empty((0, 2), np.int64), *pairs])
    graph = coo_array((np.ones(len(links), bool), (links[:, 0], links[:, 1])), shape=(len(faces),) * 2)
    return int(connected_components(graph, directed=False)[0]), int(np.count_nonzero(balance))


def _adjacent_around_edges(
    vertices: Array,
    half_edges: Indices,
    starts: Indices,
    ends: Indices,
    apex: Indices,
    forward: NDArray[np.bool_],
    face: Indices,
) -> Indices:
    """Return pairs of triangles that bound the same glass; `half_edges` has shape (edges, triangles)."""
    low = np.minimum(starts, ends)[half_edges[:, 0]]
    high = np.maximum(starts, ends)[half_edges[:, 0]]
    axis = vertices[high] - vertices[low]
    arms = vertices[apex[half_edges]] - vertices[low][:, None]
    along = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-300)
    first = np.cross(along, arms[:, 0])
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    second = np.cross(along, first)
    angle = np.arctan2(np.einsum("eni,ei->en", arms, second), np.einsum("eni,ei->en", arms, first))
    # For a triangle whose edge has the direction of the axis, the glass is towards smaller angles.
    rotation = (angle[:, :, None] - angle[:, None, :]) % (2.0 * np.pi)
    # Facets of touching bodies may be divided along different diagonals and overlap slightly.
    same_angle = 0.1
    rotation[rotation < same_angle] = 2.0 * np.pi
    along_axis = forward[half_edges]
    rotation[~(along_axis[:, :, None] & ~along_axis[:, None, :])] = np.inf
    partner = np.argmin(rotation, axis=2)
    rows, columns = np.nonzero(np.isfinite(np.min(rotation, axis=2)))
    pairs = half_edges[rows, columns], half_edges[rows, partner[rows, columns]]
    return np.stack([face[pairs[0]], face[pairs[1]]], axis=-1)
