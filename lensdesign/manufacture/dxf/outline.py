"""Outline of the glass in section as a DXF file: exact curves on named layers, read back and measured.

The x axis of the file is the optical axis, from the front vertex of the lens along the light. The y axis is
the radial height, on both sides of the axis. A sphere is one arc, a plane one line, another conic one
rational quadratic spline, which is exact, and an asphere one spline of degree 5.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.solid import Element, closed_elements
from lensdesign.manufacture.drawing.primitives import plain
from lensdesign.manufacture.dxf.dxf_files import CENTRE_LINE, new_document, read_document, save_document
from lensdesign.manufacture.meridian_curves import EXACT, SPLINE_DEGREE, asphere_spline, conic_bezier

DXF_SUFFIX = ".dxf"

AXIS_LAYER = "AXIS"

EXACT_MM, SPLINE_MM = 1e-9, 1e-6
"""Largest allowed deviation of a curve that was read back: of an exact one, and of a spline."""

Curve = Literal["line", "arc", "spline"]


@dataclass(frozen=True)
class OutlineCurve:
    """Curve of one optical surface, as read back from a DXF file.

    Attributes
    ----------
    layer
        Layer of the curve, such as `ELEMENT_1_SURFACE_2`.
    curve
        Kind of the curve.
    deviation_mm
        Largest distance of the curve from the section of the exact surface in mm.
    """

    layer: str
    curve: Curve
    deviation_mm: float


@dataclass(frozen=True)
class OutlineReport:
    """Contents of a DXF outline, as read back.

    Attributes
    ----------
    bytes
        Size of the file in bytes.
    elements
        Number of glass elements.
    curves
        Curves of the optical surfaces, front to back.
    """

    bytes: int
    elements: int
    curves: tuple[OutlineCurve, ...]

    @property
    def largest_deviation_mm(self) -> float:
        """Largest distance of a curve from the exact surface in mm."""
        return max(curve.deviation_mm for curve in self.curves)


@dataclass(frozen=True)
class _Section:
    """Section of one element, and the beginning of the names of its layers."""

    name: str
    body: Element

    @property
    def sides(self) -> tuple[tuple[str, SurfaceMeridian], ...]:
        """Layer and meridian of the front and of the back surface."""
        meridians = zip(self.body.surfaces, (self.body.front, self.body.back), strict=True)
        return tuple((f"{self.name}_SURFACE_{index + 1}", meridian) for index, meridian in meridians)


def write_outline(
    lens: Lens,
    path: str | os.PathLike[str],
    warn: Callable[[str], None] = warnings.warn,
    statement: str = "",
) -> OutlineReport:
    """Write the outline of each glass element in section to a DXF file in mm.

    The file contains both optical surfaces, the edge with flat rings and flange, the bevels and the axis,
    each on its own layer. A body that is not rotationally symmetric has two sections, in the planes x = 0
    (layers `..._YZ_...`) and y = 0 (`..._XZ_...`). The file is read back and measured before it replaces an
    existing one. The same lens yields identical bytes. The bodies have the edges that `lens` defines;
    :func:`lensdesign.analysis.outline.drawn_outline` returns the lens with the edges of its drawing.

    Parameters
    ----------
    lens
        A lens with at least one glass element.
    path
        File to write, .dxf.
    warn
        Called with one sentence for each surface whose measured figure is omitted (default: a Python
        warning).
    statement
        Text of the property `outline` of the file (default: none).

    Returns
    -------
    OutlineReport
        Measured deviations of the curves.

    Raises
    ------
    InputError
        If the suffix is not .dxf, an element does not close or cannot be approximated, the file cannot be
        written, or the file read back deviates from the lens. No file is written then.

    Examples
    --------
    >>> from lensdesign import load_design, write_outline
    >>> report = write_outline(load_design("designs/paper_singlet.toml"), "outline.dxf")
    >>> [(curve.layer, curve.curve) for curve in report.curves]
    [('ELEMENT_1_SURFACE_1', 'arc'), ('ELEMENT_1_SURFACE_2', 'spline')]
    >>> report.largest_deviation_mm < 1e-9
    True
    """
    if Path(path).suffix.lower() != DXF_SUFFIX:
        raise InputError(f"cannot write {path}: the name must end in {DXF_SUFFIX}")
    elements = closed_elements(lens)
    sections = [section for element in elements for section in _sections(element)]
    with atomic_path(path) as temporary:
        _write(sections, lens.title, statement, temporary)
        curves = _measured_curves(sections, temporary)
        size = temporary.stat().st_size
    for index, surface in enumerate(lens.surfaces, start=1):
        if surface.figure is not None:
            warn(f"surface {index}: the nominal shape was written, without the measured figure")
    return OutlineReport(size, len(elements), curves)


def _sections(element: Element) -> list[_Section]:
    name = f"ELEMENT_{element.index + 1}"
    if element.rotational:
        return [_Section(name, element)]
    y_z, x_z = element.sections[0], element.sections[len(element.sections) // 4]
    return [_Section(f"{name}_YZ", y_z), _Section(f"{name}_XZ", x_z)]


def _write(sections: list[_Section], title: str, statement: str, path: Path) -> None:
    outlines = [section.body.outline() for section in sections]
    points = np.concatenate(outlines)
    margin_mm = 0.2 * float(np.max(points[:, 0]))
    dashes_mm = tuple(margin_mm * length for length in (1.0, 0.15, 0.15, 0.15))
    document = new_document({"title": plain(title), "outline": plain(statement)}, dashes_mm)
    space, thick, thin = document.modelspace(), 50, 25  # line weights in hundredths of a mm
    document.layers.add(AXIS_LAYER, linetype=CENTRE_LINE, lineweight=thin)
    ends_mm = float(np.min(points[:, 1])) - margin_mm, float(np.max(points[:, 1])) + margin_mm
    space.add_line((ends_mm[0], 0.0), (ends_mm[1], 0.0), {"layer": AXIS_LAYER})
    for section in sections:
        for layer, meridian in section.sides:
            document.layers.add(layer, lineweight=thick)
            _add_surface(space, meridian, layer)
        edge, chamfer = f"{section.name}_EDGE", f"{section.name}_CHAMFER"
        document.layers.add(edge, lineweight=thick)
        corners = _rim(section.body)
        for ((r0, z0), (r1, z1)), is_edge in zip(
            pairwise(corners), _between_edges(section.body, corners), strict=True
        ):
            is_bevel = not is_edge and abs(r1 - r0) > EXACT_MM and abs(z1 - z0) > EXACT_MM
            layer = chamfer if is_bevel else edge
            if layer not in document.layers:
                document.layers.add(layer, lineweight=thick)
            for side in (1.0, -1.0):
                space.add_line((z0, side * r0), (z1, side * r1), {"layer": layer})
    save_document(document, path)


def _between_edges(body: Element, corners: Array) -> list[bool]:
    """Return which lines between successive corners belong to the edge or the flange."""
    return [bool(start and end) for start, end in pairwise(body.on_edge(corners))]


def _rim(body: Element) -> Array:
    """Return radial height and z of the rim's corners, without those that coincide."""
    corners = body.rim
    corners[[0, -1], 0] = body.front.end_mm, body.back.end_mm
    is_new = np.linalg.norm(np.diff(corners, axis=0), axis=-1) > EXACT_MM
    return corners[np.append(True, is_new)]


def _add_surface(space: Any, meridian: SurfaceMeridian, layer: str) -> None:
    """Add the section of an optical surface from one rim to the other."""
    attributes = {"layer": layer}
    shape, (r, z) = meridian.section, meridian.points(1.0)
    if shape.kind == "plane":
        space.add_line((z, -r), (z, r), attributes)
        return
    # The centre of a flatter sphere is so far away that an arc would lose digits.
    if shape.kind == "sphere" and abs(shape.curvature) >= 1e-6:
        radius = 1.0 / shape.curvature
        half_deg = math.degrees(math.asin(min(1.0, meridian.end_mm / abs(radius))))
        vertex_deg = 180.0 if radius > 0.0 else 0.0
        centre = (meridian.vertex_z_mm + radius, 0.0)
        space.add_arc(
            centre, abs(radius), vertex_deg - half_deg, vertex_deg + half_deg, dxfattribs=attributes
        )
        return
    knots, points, weights, degree = _half_curve(meridian)
    spline = space.add_spline(degree=degree, dxfattribs=attributes)
    mirrored = np.concatenate([points[:0:-1] * [-1.0, 1.0], points])
    spline.control_points = [(z, r, 0.0) for r, z in mirrored]
    spline.knots = np.concatenate([-knots[:degree:-1], np.zeros(degree), knots[degree + 1 :]]) + knots[-1]
    if weights is not None:
        spline.dxf.flags |= spline.RATIONAL
        spline.weights = np.concatenate([weights[:0:-1], weights])


def _half_curve(meridian: SurfaceMeridian) -> tuple[Array, Array, Array | None, int]:
    """Return knots, control points, weights (None: all 1) and degree of a meridian, from the vertex."""
    if meridian.section.kind in EXACT:
        points, weights = conic_bezier(meridian)
        return np.repeat([0.0, 1.0], 3), points, weights, 2
    knots, points = asphere_spline(meridian)
    # Whole numbers keep knots of a program that rounds them.
    return np.round(knots / knots[SPLINE_DEGREE + 1]), points, None, SPLINE_DEGREE


def _measured_curves(sections: list[_Section], path: Path) -> tuple[OutlineCurve, ...]:
    """Read a file back and measure its curves; raise an error if one deviates from its surface."""
    space, found = read_document(path).modelspace(), list[OutlineCurve]()
    for section in sections:
        for layer, meridian in section.sides:
            entities = [entity for entity in space if entity.dxf.layer == layer]
            if len(entities) != 1:
                raise InputError(f"layer {layer} has {len(entities)} curves when read back instead of 1")
            curve, points = _points(entities[0])
            points[:, 0] = np.abs(points[:, 0])
            off_rim = np.linalg.norm(points[[0, -1]] - meridian.points(1.0), axis=-1)
            deviation = float(np.max(np.append(meridian.distances(points), off_rim)))
            allowed = EXACT_MM if meridian.section.kind in EXACT else SPLINE_MM
            if not deviation <= allowed:
                raise InputError(
                    f"layer {layer} is {deviation:.3g} mm off its surface when read back; allowed: "
                    f"{allowed:g} mm"
                )
            found.append(OutlineCurve(layer, curve, deviation))
    return tuple(found)


def _points(entity: Any) -> tuple[Curve, Array]:
    """Return the kind of an entity, and points (y, x) along it, shape (n, 2)."""
    from scipy.interpolate import BSpline

    count = 2049
    kind = entity.dxftype()
    if kind == "LINE":
        start, end = (np.array([point.y, point.x]) for point in (entity.dxf.start, entity.dxf.end))
        return "line", start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)
    if kind == "ARC":
        start_deg = entity.dxf.start_angle
        angles = np.radians(start_deg + np.linspace(0.0, (entity.dxf.end_angle - start_deg) % 360.0, count))
        centre, radius = entity.dxf.center, entity.dxf.radius
        return "arc", np.stack([centre.y + radius * np.sin(angles), centre.x + radius * np.cos(angles)], -1)
    weights = np.array(entity.weights) if len(entity.weights) else np.ones(len(entity.control_points))
    poles = np.array(entity.control_points)[:, 1::-1]
    knots = np.array(entity.knots)
    weighted = np.column_stack([poles * weights[:, None], weights])
    found = BSpline(knots, weighted, entity.dxf.degree)(np.linspace(knots[0], knots[-1], count))
    return "spline", found[:, :2] / found[:, 2:]
