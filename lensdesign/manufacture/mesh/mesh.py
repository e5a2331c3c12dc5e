"""Triangle meshes of the glass, closed and of known error, for printing, viewing and CAD.

Half of the chord error allowed goes to the meridian, whose rings lie closer where it curves more, and half to
the azimuth. The distance of the facets from the glass is then measured, and the mesh made finer until it
holds.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from lensdesign.common.memory import check_memory
from lensdesign.errors import InputError, atomic_path
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.lens.solid import Element
from lensdesign.manufacture.mesh.bodies import LensMesh, PerturbedBodies, perturbed_bodies
from lensdesign.manufacture.mesh.freeform import freeform_mesh
from lensdesign.manufacture.mesh.rings import (
    BALANCE,
    MOST_TRIANGLES,
    azimuths,
    meridian_chord_errors,
    ring_density,
    sloping_radius_mm,
)
from lensdesign.manufacture.mesh.symmetric import symmetric_mesh
from lensdesign.manufacture.mesh.writing import MESH_SUFFIXES, encode_meshes

EDGE_ERROR_MM = 1e-2
"""Largest distance of the ground edge's facets from its cylinder, unless the surfaces have a coarser one."""


TRIANGLE_BYTES = 450
"""Most bytes of a triangle while a mesh is made and encoded, measured."""


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
        Any lens with a glass element.
    chord_error_um
        Greatest distance allowed between a facet of an optical surface and the glass. Facets of the ground
        edge may stand off by as much, or by 10 um if that is more.
    element
        Which body of glass, from 0; those of a cemented group count singly.
    surface_perturbations
        Deltas of single surfaces, by index from 0; single values only. The ground edge stays centred on the
        axis of the lens.
    pose
        Pose of the whole lens.
    measured
        Whether surfaces have their measured figures rather than their nominal shape.

    Returns
    -------
    LensMesh

    Raises
    ------
    InputError
        If the element does not exist or does not close; if the chord error is not above 0, asks for more
        than 20 million triangles, or is so coarse that facets of the two surfaces would cross; if
        perturbations hold several trials, or a surface ends inside the ground edge.
    """
    bodies = perturbed_bodies(lens, surface_perturbations, measured)
    count = len(bodies.elements)
    if not 0 <= element < count:
        raise InputError(f"element = {element}: there is no such element; allowed: 0 to {count - 1}")
    _refuse_size(bodies.elements, chord_error_um)
    return _posed(_body_mesh(bodies, element, chord_error_um), pose)


def write_mesh(
    lens: Lens,
    path: str | os.PathLike[str],
    chord_error_um: float = 0.1,
    report: Callable[[str], None] = warnings.warn,
    surface_perturbations: Mapping[int, SurfacePerturbation] | None = None,
    pose: Pose | None = None,
    measured: bool = False,
    statement: str = "",
) -> LensMesh:
    """Write the glass of a lens as a mesh file.

    The bodies have the edges of the lens as it is given.
    :func:`lensdesign.analysis.outline.drawn_outline` gives the lens with those of its drawing.

    Parameters
    ----------
    lens
        Any lens with a glass element.
    path
        File to write; its suffix names the format: .stl (binary), .ply, .obj or .3mf (with units and
        glasses) in mm, or .glb in metres, as glTF demands. Several elements go into one file: as one body
        each in .glb and .3mf, side by side elsewhere.
    chord_error_um, surface_perturbations, pose, measured
        As :func:`lens_mesh` takes them.
    report
        Told in one sentence of each surface whose measured figure is left out.
    statement
        Remark that goes into the file: the header of an STL file (its first 67 characters), a comment of a
        PLY or OBJ file, the ``extras`` of the scene in a GLB file, the description of a 3MF file.

    Returns
    -------
    LensMesh
        Of all elements together, in mm.

    Raises
    ------
    InputError
        As :func:`lens_mesh`, before anything is written; also if the suffix is unknown or the file cannot
        be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise InputError(
            f"cannot write {path}: unknown suffix {suffix!r}; allowed: {', '.join(MESH_SUFFIXES)}"
        )
    bodies = perturbed_bodies(lens, surface_perturbations, measured)
    _refuse_size(bodies.elements, chord_error_um)
    parts = [_posed(_body_mesh(bodies, e, chord_error_um), pose) for e in range(len(bodies.elements))]
    whole = _together(parts)
    glasses = [str(lens.surfaces[e.surfaces[0]].material) for e in bodies.elements]
    data = encode_meshes(suffix, [p.mesh for p in parts], glasses, whole.mesh, statement)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    for number, surface in enumerate(lens.surfaces, start=1):
        if surface.figure is not None and not measured:
            report(f"surface {number}: nominal shape written, its measured figure left out")
    return whole


def _together(parts: Sequence[LensMesh]) -> LensMesh:
    """Several bodies as one mesh, side by side."""
    import trimesh

    if len(parts) == 1:
        return parts[0]
    return LensMesh(
        trimesh.util.concatenate([p.mesh for p in parts]),
        max(p.chord_error_um for p in parts),
        max(p.edge_error_um for p in parts),
        sum(p.volume_mm3 for p in parts),
        sum(p.exact_volume_mm3 for p in parts),
    )


def _body_mesh(bodies: PerturbedBodies, number: int, chord_error_um: float) -> LensMesh:
    """Mesh of one body, finer until the measured error holds."""
    element = bodies.elements[number]
    asked_mm = error_mm = 1e-3 * chord_error_um
    while True:
        count = _azimuths(bodies.elements, error_mm, asked_mm)
        if bodies.symmetric(number):
            result = symmetric_mesh(element, error_mm, count)
        else:
            result = freeform_mesh(bodies, number, error_mm, count)
        if result.chord_error_um <= chord_error_um:
            return result
        error_mm *= max(0.25, 0.97 * chord_error_um / result.chord_error_um)


def _posed(part: LensMesh, pose: Pose | None) -> LensMesh:
    if pose is not None:
        rotation, shift = pose.transform()
        if len(rotation) != 1:
            raise InputError(
                f"pose holds {len(rotation)} trials; a mesh is of one lens, so give single values"
            )
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation[0], shift[0]
        part.mesh.apply_transform(matrix)
    return part


def _refuse_size(elements: Sequence[Element], chord_error_um: float) -> None:
    said = f"chord_error_um = {chord_error_um:g}"
    if not (math.isfinite(chord_error_um) and chord_error_um > 0.0):
        raise InputError(f"{said}: must be above 0")
    error_mm = 1e-3 * chord_error_um
    triangles = 0.0
    for element in elements:
        densities = (
            ring_density(meridian_chord_errors(m), m.end_mm)[1][-1] for m in (element.front, element.back)
        )
        rings = sum(densities) / math.sqrt(BALANCE * error_mm) + 2.0
        triangles += 2.0 * rings * _azimuths(elements, error_mm, error_mm)
    if triangles > MOST_TRIANGLES:
        raise InputError(
            f"{said} would need {triangles:.3g} triangles; allowed: at most "
            f"{MOST_TRIANGLES:.3g}, so ask for a larger chord error"
        )
    check_memory(
        TRIANGLE_BYTES * triangles,
        f"{said}: a mesh of {triangles:.3g} triangles",
        "give a larger chord error",
    )


def _azimuths(elements: Sequence[Element], error_mm: float, asked_mm: float) -> int:
    """Number of meridians, the same for all elements so that cemented surfaces fit."""
    slopes = max(sloping_radius_mm(m) for e in elements for m in (e.front, e.back))
    # Facets of the edge stand off by two thirds of their sagitta.
    edge = azimuths(max(e.outer_mm for e in elements), 1.45 * max(EDGE_ERROR_MM, asked_mm))
    return max(edge, azimuths(slopes, BALANCE * error_mm))
