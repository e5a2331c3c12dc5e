"""STEP files of the glass for CAD: exact solids, read back and measured before they are handed over."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, atomic_path
from lensdesign.lens.lens import Lens
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.solid import Element, closed_elements
from lensdesign.manufacture.step.freeform import freeform_solid, surface_error_mm
from lensdesign.manufacture.step.occ import (
    STEP_SUFFIXES,
    ocp_errors,
    parts_of,
    read_solids,
    require_ocp,
    silent_ocp,
    write_solids,
)
from lensdesign.manufacture.step.solids import EXACT, element_solid, rim_corners

CONIC_ERROR_MM = 1e-9
"""Largest distance allowed between a plane, sphere or conic of the file and the exact surface."""

ASPHERE_FILE_ERROR_MM = 1e-6
"""The same for an even asphere."""

VOLUME_ERROR = 1e-9
"""Largest relative error allowed of a volume, beyond what the surfaces' errors may make of it."""

ALONG, ROUND = 513, 16
"""Points along the meridian and round the axis at which a surface is measured."""


@dataclass(frozen=True)
class StepBody:
    """One body of glass, as read back from a STEP file.

    Attributes
    ----------
    name
        Of the product in the file.
    surface_errors_mm
        Largest distance from the exact surface, of the front and of the back surface.
    volume_mm3, exact_volume_mm3
        Volume of the solid, and of the glass.
    """

    name: str
    surface_errors_mm: tuple[float, float]
    volume_mm3: float
    exact_volume_mm3: float


@dataclass(frozen=True)
class StepReport:
    """A STEP file, as read back.

    Attributes
    ----------
    bytes
        Size of the file.
    bodies
        What it holds, front to back.
    """

    bytes: int
    bodies: tuple[StepBody, ...]

    @property
    def solids(self) -> int:
        """Number of solids."""
        return len(self.bodies)

    @property
    def largest_error_mm(self) -> float:
        """Largest distance of an optical surface from the exact one."""
        return max(max(body.surface_errors_mm) for body in self.bodies)

    @property
    def volume_mm3(self) -> float:
        """Volume of all solids."""
        return math.fsum(body.volume_mm3 for body in self.bodies)

    @property
    def exact_volume_mm3(self) -> float:
        """Volume of the glass."""
        return math.fsum(body.exact_volume_mm3 for body in self.bodies)


def write_step(
    lens: Lens,
    path: str | os.PathLike[str],
    report: Callable[[str], None] = warnings.warn,
    statement: str = "",
) -> StepReport:
    """Write the glass of a lens as a STEP file (AP214, mm), one named solid for each element.

    Planes, spheres and conics are exact; even aspheres are splines within 1e-7 mm. The file is read back and
    measured before it gets its name. The same lens gives the same bytes. The bodies have the edges of the
    lens as it is given; :func:`lensdesign.analysis.outline.drawn_outline` gives it those of its drawing.

    Parameters
    ----------
    lens
        Any lens with a glass element.
    path
        File to write, .step or .stp.
    report
        Told in one sentence of each surface whose measured figure is left out.
    statement
        Remark that goes into the description of the file's header.

    Returns
    -------
    StepReport

    Raises
    ------
    InputError
        If the suffix is another, OCP is missing, an element does not close or cannot be followed, the file
        cannot be written, or what is read back departs from the lens. No file is written then.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in STEP_SUFFIXES:
        raise InputError(
            f"cannot write {path}: unknown suffix {suffix!r}; allowed: {', '.join(STEP_SUFFIXES)}"
        )
    elements = closed_elements(lens)
    require_ocp()
    names = [product_name(lens, element) for element in elements]
    with silent_ocp(), atomic_path(path) as temporary:
        solids = [_checked_solid(element) for element in elements]
        with ocp_errors(f"cannot write {path}"):
            write_solids(solids, names, lens.title, temporary, statement)
            bodies = _measured_bodies(elements, names, read_solids(temporary))
        size = temporary.stat().st_size
    for number, surface in enumerate(lens.surfaces, start=1):
        if surface.figure is not None:
            report(f"surface {number}: nominal shape written, its measured figure left out")
    return StepReport(size, bodies)


def product_name(lens: Lens, element: Element) -> str:
    """`element 1 (surfaces 1 and 2), N-BK7`; a glass known by its index alone is `n = 1.5`."""
    glass = lens.surfaces[element.surfaces[0]].material
    return f"{element.name}, {glass if isinstance(glass, str) else f'n = {glass:.10g}'}"


def _checked_solid(element: Element) -> Any:
    """The solid of an element, refused by name if OCP cannot make it."""
    from OCP.BRepCheck import BRepCheck_Analyzer

    with ocp_errors(element.name):
        solid = (element_solid if element.rotational else freeform_solid)(element)
        if not BRepCheck_Analyzer(solid).IsValid():
            raise InputError("OCP finds its solid not valid")
    return solid


def _measured_bodies(elements: list[Element], names: list[str], solids: list[Any]) -> tuple[StepBody, ...]:
    if len(solids) != len(elements):
        raise InputError(f"{len(solids)} solids read back instead of {len(elements)}")
    return tuple(
        _measured_body(element, name, solid)
        for element, name, solid in zip(elements, names, solids, strict=True)
    )


def _measured_body(element: Element, name: str, solid: Any) -> StepBody:
    """Measure a solid that was read back, and refuse it if it is not the element's."""
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.TopAbs import TopAbs_ShapeEnum

    shells = parts_of(solid, TopAbs_ShapeEnum.TopAbs_SHELL)
    faces = parts_of(solid, TopAbs_ShapeEnum.TopAbs_FACE)
    if not BRepCheck_Analyzer(solid).IsValid() or len(shells) != 1 or not shells[0].Closed():
        raise InputError(f"{element.name} is no valid closed solid when read back")
    if len(faces) != len(rim_corners(element)) + 1:
        raise InputError(f"{element.name} has {len(faces)} faces when read back")
    meridians = (element.front, element.back)
    measured = face_error_mm if element.rotational else freeform_error_mm
    errors = [measured(face, m) for face, m in zip((faces[0], faces[-1]), meridians, strict=True)]
    for index, meridian, error in zip(element.surfaces, meridians, errors, strict=True):
        exact = element.rotational and meridian.shape.kind in EXACT
        allowed = CONIC_ERROR_MM if exact else ASPHERE_FILE_ERROR_MM
        if not error <= allowed:
            raise InputError(
                f"surface {index + 1} is {error:.3g} mm off when read back; allowed: {allowed:g} mm"
            )
    body = StepBody(name, (errors[0], errors[1]), _volume_mm3(solid), element.volume_mm3)
    area = sum(_area_bound_mm2(m) * error for m, error in zip(meridians, errors, strict=True))
    if not abs(body.volume_mm3 - body.exact_volume_mm3) <= VOLUME_ERROR * body.exact_volume_mm3 + area:
        raise InputError(
            f"{element.name} has a volume of {body.volume_mm3:.12g} mm^3 when read back, not "
            f"{body.exact_volume_mm3:.12g} mm^3"
        )
    return body


def _area_bound_mm2(meridian: SurfaceMeridian) -> float:
    """No less than the area of a surface."""
    points = meridian.points(np.linspace(0.0, 1.0, ALONG))
    length = float(np.sum(np.abs(np.diff(points, axis=0))))
    return 2.0 * math.pi * meridian.end_mm * length


def face_error_mm(face: Any, meridian: SurfaceMeridian) -> float:
    """Largest distance of a face and its boundary from a surface, and of its rim from the surface's.

    Parameters
    ----------
    face
        A face of OCP.
    meridian
        Of the surface that it should be.
    """
    inside, boundary = _radial(_face_points(face)), _radial(_boundary_points(face))
    points = np.concatenate([inside[inside[:, 0] <= np.max(boundary[:, 0])], boundary])
    reach = abs(float(np.max(points[:, 0])) - meridian.end_mm)
    gap = float(np.linalg.norm(points - meridian.points(0.0), axis=1).min())
    return max(float(np.max(meridian.distances(points))), reach, gap)


def freeform_error_mm(face: Any, meridian: SurfaceMeridian) -> float:
    """As :func:`face_error_mm`, of a surface that is none of revolution."""
    inside, boundary = _face_points(face), _boundary_points(face)
    reach = abs(float(np.max(np.hypot(boundary[:, 0], boundary[:, 1]))) - meridian.end_mm)
    gap = float(np.linalg.norm(inside - [0.0, 0.0, meridian.vertex_z_mm], axis=1).min())
    return max(surface_error_mm(np.concatenate([inside, boundary]), meridian), reach, gap)


def _face_points(face: Any) -> Array:
    """Points over a face's range of parameters; of a plane, also beyond its boundary."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.BRepTools import BRepTools
    from OCP.TopoDS import TopoDS

    face = TopoDS.Face(face)
    surface = BRepAdaptor_Surface(face)
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    around, along = np.linspace(u0, u1, ROUND + 1), np.linspace(v0, v1, ALONG)
    return _xyz([surface.Value(float(u), float(v)) for u in around for v in along])


def _boundary_points(face: Any) -> Array:
    """Points along a face's edges, its seam among them."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepAdaptor import BRepAdaptor_Curve
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopoDS import TopoDS

    points = []
    for shape in parts_of(face, TopAbs_ShapeEnum.TopAbs_EDGE):
        edge = TopoDS.Edge(shape)
        if not BRep_Tool.Degenerated_s(edge):
            curve = BRepAdaptor_Curve(edge)
            range_ = np.linspace(curve.FirstParameter(), curve.LastParameter(), ALONG)
            points += [curve.Value(float(t)) for t in range_]
    return _xyz(points)


def _xyz(points: list[Any]) -> Array:
    return np.array([(p.X(), p.Y(), p.Z()) for p in points])


def _radial(points: Array) -> Array:
    """Radial height and z."""
    return np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]], axis=-1)


def _volume_mm3(solid: Any) -> float:
    """Volume by adaptive Gauss-Kronrod quadrature; OCP's ordinary integrator is off by 1e-7 and more."""
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    properties = GProp_GProps()
    BRepGProp.VolumePropertiesGK_s(solid, properties, 1e-10, False, False, False, False, False)
    return float(properties.Mass())
