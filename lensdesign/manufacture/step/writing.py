"""STEP files of the glass for CAD: exact solids that are read back and measured after writing."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.solid import Element, closed_elements
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances
from lensdesign.manufacture.meridian_curves import EXACT
from lensdesign.manufacture.step.freeform import freeform_solid, surface_error_mm
from lensdesign.manufacture.step.semantic_tolerances import SemanticTolerances, semantic_tolerances
from lensdesign.manufacture.step.solids import element_solid, rim_corners, subshapes
from lensdesign.manufacture.step.step_files import (
    STEP_SUFFIXES,
    ocp_errors,
    read_semantic_tolerances,
    read_solids,
    require_ocp,
    silent_ocp,
    write_solids,
)

POINTS_ALONG, POINTS_AROUND = 513, 16
"""Number of points along the meridian and around the axis at which a surface is measured."""


@dataclass(frozen=True)
class StepBody:
    """A glass body, as read back from a STEP file.

    Attributes
    ----------
    name
        Name of the product in the file.
    surface_errors_mm
        Largest distance of the front and of the back surface from the exact surface in mm.
    volume_mm3, exact_volume_mm3
        Volume of the solid and of the exact body in mm^3.
    """

    name: str
    surface_errors_mm: tuple[float, float]
    volume_mm3: float
    exact_volume_mm3: float


@dataclass(frozen=True)
class StepReport:
    """Contents of a STEP file, as read back.

    Attributes
    ----------
    bytes
        Size of the file in bytes.
    bodies
        Glass bodies, front to back.
    tolerances
        Semantic tolerances of each body; empty for a file without them.
    """

    bytes: int
    bodies: tuple[StepBody, ...]
    tolerances: tuple[SemanticTolerances, ...] = ()

    @property
    def solids(self) -> int:
        """Number of solids."""
        return len(self.bodies)

    @property
    def largest_error_mm(self) -> float:
        """Largest distance of an optical surface from the exact one in mm."""
        return max(max(body.surface_errors_mm) for body in self.bodies)

    @property
    def volume_mm3(self) -> float:
        """Volume of all solids in mm^3."""
        return math.fsum(body.volume_mm3 for body in self.bodies)

    @property
    def exact_volume_mm3(self) -> float:
        """Volume of the exact bodies in mm^3."""
        return math.fsum(body.exact_volume_mm3 for body in self.bodies)


def write_step(
    lens: Lens,
    path: str | os.PathLike[str],
    warn: Callable[[str], None] = warnings.warn,
    statement: str = "",
    tolerances: Sequence[DrawingTolerances] = (),
) -> StepReport:
    """Write the glass of a lens to a STEP file (mm) with one named solid for each element.

    The file has the application protocol 214. With `tolerances` it has 242 and contains them as semantic
    tolerances, which other programs read (:mod:`lensdesign.manufacture.step.semantic_tolerances`).

    Planes, spheres and conics are exact; aspheres are splines within 1e-7 mm. The file is read back and
    measured before it replaces an existing one. The same lens yields identical bytes. The bodies have the
    edges that `lens` defines; :func:`lensdesign.analysis.outline.drawn_outline` returns the lens with the
    edges of its drawing.

    Parameters
    ----------
    lens
        A lens with at least one glass element.
    path
        File to write, .step or .stp.
    warn
        Called with one sentence for each surface whose measured figure is omitted (default: a Python
        warning).
    statement
        Comment in the description of the file's header (default: none).
    tolerances
        Tolerances of the sheet of each element (default: none).

    Returns
    -------
    StepReport
        Measured errors and volumes of the solids, and their tolerances as read back.

    Raises
    ------
    InputError
        If the suffix is not allowed, OCP is missing, an element does not close or cannot be approximated,
        the file cannot be written, or the file read back deviates from the lens. No file is written then.

    Examples
    --------
    >>> from lensdesign import load_design, write_step
    >>> report = write_step(load_design("designs/paper_singlet.toml"), "lens.step")
    >>> report.solids, report.largest_error_mm < 1e-7
    (1, True)
    """
    suffix = Path(path).suffix.lower()
    if suffix not in STEP_SUFFIXES:
        raise InputError(
            f"cannot write {path}: unknown suffix {suffix!r}; allowed: {', '.join(STEP_SUFFIXES)}"
        )
    elements = closed_elements(lens)
    require_ocp()
    names = [product_name(lens, element) for element in elements]
    if tolerances and len(tolerances) != len(elements):
        raise InputError(
            f"tolerances are given for {len(tolerances)} elements, but the lens has {len(elements)}"
        )
    stated = tuple(map(semantic_tolerances, elements, tolerances))
    with silent_ocp(), atomic_path(path) as temporary:
        solids = [_checked_solid(element) for element in elements]
        with ocp_errors(f"cannot write {path}"):
            write_solids(solids, names, lens.title, temporary, statement, stated)
            bodies = _measured_bodies(elements, names, read_solids(temporary))
            found = _checked_tolerances(names, stated, temporary) if stated else ()
        size = temporary.stat().st_size
    for index, surface in enumerate(lens.surfaces, start=1):
        if surface.figure is not None:
            warn(f"surface {index}: the nominal shape was written, without the measured figure")
    return StepReport(size, bodies, found)


def product_name(lens: Lens, element: Element) -> str:
    """Return `element 1 (surfaces 1 and 2), N-BK7`; a glass without a name is `n = 1.5`."""
    glass = lens.surfaces[element.surfaces[0]].material
    return f"{element.name}, {glass if isinstance(glass, str) else f'n = {glass:.10g}'}"


def _checked_tolerances(
    names: list[str], stated: tuple[SemanticTolerances, ...], path: Path
) -> tuple[SemanticTolerances, ...]:
    """Return the tolerances of a file; an error names a body whose tolerances are not those stated."""
    found = tuple(read_semantic_tolerances(path))
    if len(found) != len(stated):
        raise InputError(f"{len(found)} parts with tolerances read back instead of {len(stated)}")
    for name, own, other in zip(names, stated, found, strict=True):
        if not own.agrees(other):
            raise InputError(f"{name}: tolerances read back differ: {other}, not {own}")
    return found


def _checked_solid(element: Element) -> Any:
    """Return the solid of an element; an error names the element."""
    from OCP.BRepCheck import BRepCheck_Analyzer

    with ocp_errors(element.name):
        solid = (element_solid if element.rotational else freeform_solid)(element)
        if not BRepCheck_Analyzer(solid).IsValid():
            raise InputError("OCP reports that the solid is not valid")
    return solid


def _measured_bodies(elements: list[Element], names: list[str], solids: list[Any]) -> tuple[StepBody, ...]:
    if len(solids) != len(elements):
        raise InputError(f"{len(solids)} solids read back instead of {len(elements)}")
    return tuple(
        _measured_body(element, name, solid)
        for element, name, solid in zip(elements, names, solids, strict=True)
    )


def _measured_body(element: Element, name: str, solid: Any) -> StepBody:
    """Measure a solid that was read back; raise an error if it deviates from the element."""
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.TopAbs import TopAbs_ShapeEnum

    shells = subshapes(solid, TopAbs_ShapeEnum.TopAbs_SHELL)
    faces = subshapes(solid, TopAbs_ShapeEnum.TopAbs_FACE)
    if not BRepCheck_Analyzer(solid).IsValid() or len(shells) != 1 or not shells[0].Closed():
        raise InputError(f"{element.name} is not a valid closed solid when read back")
    if len(faces) != len(rim_corners(element)) + 1:
        raise InputError(f"{element.name} has {len(faces)} faces when read back")
    meridians = (element.front, element.back)
    error_mm = face_error_mm if element.rotational else freeform_error_mm
    errors = [error_mm(face, m) for face, m in zip((faces[0], faces[-1]), meridians, strict=True)]
    for index, meridian, error in zip(element.surfaces, meridians, errors, strict=True):
        exact = element.rotational and meridian.section.kind in EXACT
        allowed = 1e-9 if exact else 1e-6  # the file holds 13 digits; splines deviate by up to 1e-7 mm
        if not error <= allowed:
            raise InputError(
                f"surface {index + 1} is {error:.3g} mm off when read back; allowed: {allowed:g} mm"
            )
    body = StepBody(name, (errors[0], errors[1]), _volume_mm3(solid), element.volume_mm3)
    tolerance = sum(_area_bound_mm2(m) * error for m, error in zip(meridians, errors, strict=True))
    if not abs(body.volume_mm3 - body.exact_volume_mm3) <= 1e-9 * body.exact_volume_mm3 + tolerance:
        raise InputError(
            f"{element.name} has a volume of {body.volume_mm3:.12g} mm^3 when read back, not "
            f"{body.exact_volume_mm3:.12g} mm^3"
        )
    return body


def _area_bound_mm2(meridian: SurfaceMeridian) -> float:
    """Return an upper bound of the area of a surface in mm^2."""
    points = meridian.points(np.linspace(0.0, 1.0, POINTS_ALONG))
    length = float(np.sum(np.abs(np.diff(points, axis=0))))
    return 2.0 * math.pi * meridian.end_mm * length


def face_error_mm(face: Any, meridian: SurfaceMeridian) -> float:
    """Return the largest distance in mm of a face, its boundary and its rim from a surface of revolution.

    Parameters
    ----------
    face
        Face of OCP.
    meridian
        Meridian of the exact surface.
    """
    inside, boundary = _radial(_face_points(face)), _radial(_boundary_points(face))
    points = np.concatenate([inside[inside[:, 0] <= np.max(boundary[:, 0])], boundary])
    rim_error = abs(float(np.max(points[:, 0])) - meridian.end_mm)
    vertex_error = float(np.linalg.norm(points - meridian.points(0.0), axis=1).min())
    return max(float(np.max(meridian.distances(points))), rim_error, vertex_error)


def freeform_error_mm(face: Any, meridian: SurfaceMeridian) -> float:
    """Return the largest distance in mm of a face from a surface that is not a surface of revolution."""
    inside, boundary = _face_points(face), _boundary_points(face)
    rim_error = abs(float(np.max(np.hypot(boundary[:, 0], boundary[:, 1]))) - meridian.end_mm)
    vertex_error = float(np.linalg.norm(inside - [0.0, 0.0, meridian.vertex_z_mm], axis=1).min())
    return max(surface_error_mm(np.concatenate([inside, boundary]), meridian), rim_error, vertex_error)


def _face_points(face: Any) -> Array:
    """Return points over a face's parameter range, which exceeds the boundary of a plane."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.BRepTools import BRepTools
    from OCP.TopoDS import TopoDS

    face = TopoDS.Face(face)
    surface = BRepAdaptor_Surface(face)
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    around, along = np.linspace(u0, u1, POINTS_AROUND + 1), np.linspace(v0, v1, POINTS_ALONG)
    return _xyz([surface.Value(float(u), float(v)) for u in around for v in along])


def _boundary_points(face: Any) -> Array:
    """Return points along a face's edges, including its seam."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepAdaptor import BRepAdaptor_Curve
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopoDS import TopoDS

    points = []
    for shape in subshapes(face, TopAbs_ShapeEnum.TopAbs_EDGE):
        edge = TopoDS.Edge(shape)
        if not BRep_Tool.Degenerated_s(edge):
            curve = BRepAdaptor_Curve(edge)
            parameters = np.linspace(curve.FirstParameter(), curve.LastParameter(), POINTS_ALONG)
            points += [curve.Value(float(t)) for t in parameters]
    return _xyz(points)


def _xyz(points: list[Any]) -> Array:
    return np.array([(p.X(), p.Y(), p.Z()) for p in points])


def _radial(points: Array) -> Array:
    """Return radial height and z of points."""
    return np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]], axis=-1)


def _volume_mm3(solid: Any) -> float:
    """Return the volume by adaptive Gauss-Kronrod quadrature: the error of OCP's default is 1e-7."""
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    properties = GProp_GProps()
    BRepGProp.VolumePropertiesGK_s(solid, properties, 1e-10, False, False, False, False, False)
    return float(properties.Mass())
