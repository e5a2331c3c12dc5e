"""Closed triangle meshes of the glass with a known error, for printing, viewing and CAD.

Half of the allowed chord error is assigned to the meridian, whose rings are closer where it curves more, and
half to the azimuth. The distance of the facets from the glass is then measured, and the mesh is refined until
the measured error meets the limit.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.memory import check_memory
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.lens.solid import Element, smallest_gap
from lensdesign.manufacture.mesh.bodies import LensMesh, PerturbedBodies, perturbed_bodies
from lensdesign.manufacture.mesh.freeform import freeform_mesh
from lensdesign.manufacture.mesh.rings import (
    BALANCE,
    MAX_TRIANGLES,
    azimuths,
    balanced_profile,
    cumulative_ring_count,
    edge_error,
    equal_area_circumradius,
    meridian_chord_errors,
    revolve,
    ring_chord_radius_mm,
    ring_parameters,
)
from lensdesign.manufacture.mesh.writing import MESH_SUFFIXES, encode_meshes


def lens_mesh(
    lens: Lens,
    chord_error_um: float = 0.1,
    element: int = 0,
    surface_perturbations: Mapping[int, SurfacePerturbation] | None = None,
    pose: Pose | None = None,
    measured: bool = False,
) -> LensMesh:
    """Mesh one element of a lens.

    Parameters
    ----------
    lens
        A lens with at least one glass element.
    chord_error_um
        Largest allowed distance between a facet of an optical surface and the glass in um (default: 0.1).
        Facets of the ground edge may deviate by the same distance, or by 10 um if that is larger.
    element
        Index of the glass body, from 0; each body of a cemented group counts (default: the first).
    surface_perturbations
        Deviations of single surfaces by surface index from 0; scalars only (default: none). The ground edge
        stays centred on the axis of the lens.
    pose
        Pose of the whole lens (default: aligned).
    measured
        Whether surfaces have their measured figures instead of their nominal shapes (default: False).

    Returns
    -------
    LensMesh
        The mesh in mm and its measured errors.

    Raises
    ------
    InputError
        If the element does not exist or does not close; if the chord error is not above 0, requires more
        than 20 million triangles, or is so coarse that facets of the two surfaces would cross; if
        perturbations hold several trials; or if a surface ends inside the ground edge.
    """
    bodies = perturbed_bodies(lens, surface_perturbations, measured)
    count = len(bodies.elements)
    if not 0 <= element < count:
        raise InputError(f"element = {element}: there is no such element; allowed: 0 to {count - 1}")
    _check_size(bodies.elements, chord_error_um)
    return _posed(_body_mesh(bodies, element, chord_error_um), pose)


def write_mesh(
    lens: Lens,
    path: str | os.PathLike[str],
    chord_error_um: float = 0.1,
    warn: Callable[[str], None] = warnings.warn,
    surface_perturbations: Mapping[int, SurfacePerturbation] | None = None,
    pose: Pose | None = None,
    measured: bool = False,
    statement: str = "",
) -> LensMesh:
    """Write the glass of a lens to a mesh file.

    The bodies have the edges that `lens` defines. :func:`lensdesign.analysis.outline.drawn_outline` returns
    the lens with the edges of its drawing.

    Parameters
    ----------
    lens
        A lens with at least one glass element.
    path
        File to write. Its suffix selects the format: .stl (binary), .ply, .obj or .3mf (with units and
        glasses) in mm, or .glb in metres, as glTF requires. All elements are written to one file: as
        separate bodies in .glb and .3mf, as one mesh in the other formats.
    chord_error_um
        Largest allowed distance between a facet of an optical surface and the glass in um.
    surface_perturbations, pose, measured
        Perturbations of surfaces, pose of the lens, and whether measured figures replace the nominal shapes;
        see :func:`lens_mesh`.
    warn
        Called with one sentence for each surface whose measured figure is omitted (default: a Python
        warning).
    statement
        Comment in the file (default: none): the header of an STL file (its first 67 characters), a comment
        of a PLY or OBJ file, the ``extras`` of the scene in a GLB file, the description of a 3MF file.

    Returns
    -------
    LensMesh
        All elements together, in mm.

    Raises
    ------
    InputError
        If :func:`lens_mesh` rejects the lens or the chord error, the suffix is unknown, or the file cannot
        be written. An existing file then stays unchanged.

    Examples
    --------
    >>> from lensdesign import load_design, write_mesh
    >>> mesh = write_mesh(load_design("designs/paper_singlet.toml"), "lens.stl", chord_error_um=5.0)
    >>> round(mesh.volume_mm3, 1), mesh.chord_error_um < 5.0
    (2197.5, True)
    """
    suffix = Path(path).suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise InputError(
            f"cannot write {path}: unknown suffix {suffix!r}; allowed: {', '.join(MESH_SUFFIXES)}"
        )
    bodies = perturbed_bodies(lens, surface_perturbations, measured)
    _check_size(bodies.elements, chord_error_um)
    meshes = [_posed(_body_mesh(bodies, e, chord_error_um), pose) for e in range(len(bodies.elements))]
    whole = _concatenate(meshes)
    glasses = [str(lens.surfaces[e.surfaces[0]].material) for e in bodies.elements]
    data = encode_meshes(suffix, [m.mesh for m in meshes], glasses, whole.mesh, statement)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    for index, surface in enumerate(lens.surfaces, start=1):
        if surface.figure is not None and not measured:
            warn(f"surface {index}: the nominal shape was written, without the measured figure")
    return whole


def _concatenate(meshes: Sequence[LensMesh]) -> LensMesh:
    """Return several bodies as one mesh."""
    import trimesh

    if len(meshes) == 1:
        return meshes[0]
    return LensMesh(
        trimesh.util.concatenate([m.mesh for m in meshes]),
        max(m.chord_error_um for m in meshes),
        max(m.edge_error_um for m in meshes),
        sum(m.volume_mm3 for m in meshes),
        sum(m.exact_volume_mm3 for m in meshes),
    )


def _body_mesh(bodies: PerturbedBodies, index: int, chord_error_um: float) -> LensMesh:
    """Mesh one body; refine the mesh until the measured error meets the limit."""
    element = bodies.elements[index]
    allowed_mm = error_mm = 1e-3 * chord_error_um
    while True:
        count = _azimuths(bodies.elements, error_mm, allowed_mm)
        if bodies.symmetric(index):
            result = _symmetric_mesh(element, error_mm, count)
        else:
            result = freeform_mesh(bodies, index, error_mm, count)
        if result.chord_error_um <= chord_error_um:
            return result
        error_mm *= max(0.25, 0.97 * chord_error_um / result.chord_error_um)


def _posed(body: LensMesh, pose: Pose | None) -> LensMesh:
    """Move a mesh, in place, to the pose of the lens."""
    if pose is not None:
        rotation, shift = pose.transform()
        if len(rotation) != 1:
            raise InputError(
                f"pose holds {len(rotation)} trials; a mesh represents one lens, so give scalars"
            )
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation[0], shift[0]
        body.mesh.apply_transform(matrix)
    return body


def _check_size(elements: Sequence[Element], chord_error_um: float) -> None:
    """Raise an error if the chord error is invalid, or needs too many triangles or too much memory."""
    setting = f"chord_error_um = {chord_error_um:g}"
    if not (math.isfinite(chord_error_um) and chord_error_um > 0.0):
        raise InputError(f"{setting}: must be above 0")
    error_mm = 1e-3 * chord_error_um
    triangles = 0.0
    for element in elements:
        densities = (
            cumulative_ring_count(meridian_chord_errors(m), m.end_mm)[1][-1]
            for m in (element.front, element.back)
        )
        rings = sum(densities) / math.sqrt(BALANCE * error_mm) + 2.0
        triangles += 2.0 * rings * _azimuths(elements, error_mm, error_mm)
    if triangles > MAX_TRIANGLES:
        raise InputError(
            f"{setting} would need {triangles:.3g} triangles; allowed: at most "
            f"{MAX_TRIANGLES:.3g}, so give a larger chord error"
        )
    bytes_per_triangle = 450  # measured maximum while a mesh is created and encoded
    check_memory(
        bytes_per_triangle * triangles,
        f"{setting}: a mesh of {triangles:.3g} triangles",
        "give a larger chord error",
    )


def _azimuths(elements: Sequence[Element], error_mm: float, allowed_mm: float) -> int:
    """Return the number of meridians; it is equal for all elements so that cemented surfaces match."""
    slopes = max(ring_chord_radius_mm(m) for e in elements for m in (e.front, e.back))
    # Largest distance of the ground edge's facets from its cylinder, unless the chord error is larger.
    edge_error_mm = 1e-2
    # Facets of the edge deviate by two thirds of their sagitta.
    edge = azimuths(max(e.outer_mm for e in elements), 1.45 * max(edge_error_mm, allowed_mm))
    return max(edge, azimuths(slopes, BALANCE * error_mm))


def _symmetric_mesh(element: Element, error_mm: float, count: int) -> LensMesh:
    """Mesh one body of revolution with `count` meridians, for facets within `error_mm` of its surfaces."""
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
            f"surfaces would cross at a radial height of {r:.6g} mm; give a smaller value"
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
    return ring_parameters(errors, cumulative_ring_count(errors, end_mm), end_mm, error_mm)


def _measured_error(meridian: SurfaceMeridian, profile: Array, count: int, has_rim: bool) -> float:
    """Return the largest distance of facets from the surface, at 231 points of every facet of one sector.

    All sectors are equal. Points beyond the end of the meridian are compared with its tangent there. If a
    flat ring or bevel follows (`has_rim`), only its inner edge can deviate.
    """
    points = _sector_points(profile, count)
    radial = np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]], axis=-1)
    beyond = radial[:, 0] > meridian.end_mm
    greatest = float(np.max(meridian.distances(radial[~beyond]), initial=0.0))
    if has_rim:
        inner = meridian.end_mm * equal_area_circumradius(count) * math.cos(math.pi / count)
        return max(greatest, float(meridian.distances(np.array([[inner, profile[-1, 1]]]))[0]))
    tangent, off = meridian.tangents(1.0), radial[beyond] - meridian.points(1.0)
    across = off[:, 0] * tangent[1] - off[:, 1] * tangent[0]
    return max(greatest, float(np.max(np.abs(across), initial=0.0) / np.linalg.norm(tangent)))


def _sector_points(profile: Array, count: int, divisions: int = 20) -> Array:
    """Return points on all facets of one sector of a surface, shape (n, 3)."""
    angle, factor = 2.0 * math.pi / count, equal_area_circumradius(count)
    r, z = factor * profile[:, 0], profile[:, 1]
    one = np.stack([r, np.zeros(len(profile)), z], axis=-1)
    other = np.stack([r * math.cos(angle), r * math.sin(angle), z], axis=-1)
    corners = np.concatenate(
        [
            np.stack([one[:-1], one[1:], other[1:]], axis=1),
            np.stack([one[:-1], other[:-1], other[1:]], axis=1),
        ]
    )
    i, j = np.meshgrid(np.arange(divisions + 1), np.arange(divisions + 1))
    weights = np.stack([i, j, divisions - i - j], axis=-1)[i + j <= divisions] / divisions
    return (weights @ corners).reshape(-1, 3)
