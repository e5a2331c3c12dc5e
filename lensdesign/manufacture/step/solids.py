"""Boundary representations of rotationally symmetric glass bodies by OCP: a meridian rotated about the axis.

Planes and spheres are native surfaces; other meridians are those of
:mod:`lensdesign.manufacture.meridian_curves`. OCP is imported inside the functions.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.solid import Element
from lensdesign.manufacture.meridian_curves import EXACT, SPLINE_DEGREE, asphere_spline, conic_bezier


def element_solid(element: Element) -> Any:
    """Return one glass body as a closed solid (a TopoDS_Shape).

    Its faces are, in this order, the front surface, one face for each segment of the rim, the back surface.

    Raises
    ------
    InputError
        If an asphere cannot be approximated, or the rim is too short for a solid.
    """
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeWire
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeRevol
    from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt

    axis = gp_Ax1(gp_Pnt(0.0, 0.0, 0.0), gp_Dir(0.0, 0.0, 1.0))
    wire = BRepBuilderAPI_MakeWire()
    front, back = (0.0, element.front.vertex_z_mm), (0.0, element.back.vertex_z_mm)
    wire.Add(_optical_edge(element.front, element.surfaces[0]))
    for start, end in pairwise(rim_corners(element)):
        wire.Add(_straight_edge(start, end))
    wire.Add(_optical_edge(element.back, element.surfaces[1]))
    wire.Add(_straight_edge(back, front))
    face = BRepBuilderAPI_MakeFace(wire.Wire(), True).Face()
    return BRepPrimAPI_MakeRevol(face, axis).Shape()


def rim_corners(element: Element) -> Array:
    """Return radial height and z of the rim's corners without those that coincide for the kernel.

    Raises
    ------
    InputError
        If the whole rim is too short.
    """
    first, *between, last = np.asarray(element.rim, float)
    kept = [first]
    # Shortest edge of a solid: ten times the length that the kernel treats as zero.
    shortest_edge_mm = 1e-6
    for corner in between:
        if min(math.dist(corner, kept[-1]), math.dist(corner, last)) > shortest_edge_mm:
            kept.append(corner)
    if len(kept) == 1 and math.dist(first, last) <= shortest_edge_mm:
        raise InputError(
            f"its edge is {math.dist(first, last):.3g} mm long; a solid needs more than {shortest_edge_mm:g} "
            "mm, so raise thickness_mm or lower semi_diameter_mm"
        )
    return np.array([*kept, last])


def _optical_edge(meridian: SurfaceMeridian, index: int) -> Any:
    """Return the meridian of an optical surface as a TopoDS_Edge in the plane y = 0."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge

    shape = meridian.section
    if shape.kind == "plane":
        return _straight_edge((0.0, meridian.vertex_z_mm), meridian.points(1.0))
    # A file holds 13 digits: beyond a radius of 1 m the centre of an arc would be too imprecise.
    if shape.kind == "sphere" and abs(shape.curvature) >= 1e-3:
        return _arc(meridian)
    if shape.kind in EXACT:
        return BRepBuilderAPI_MakeEdge(_bezier_curve(*conic_bezier(meridian))).Edge()
    try:
        knots, points = asphere_spline(meridian)
    except InputError as error:
        raise InputError(f"surface {index + 1}: {error}") from error
    return BRepBuilderAPI_MakeEdge(_spline_curve(knots, points)).Edge()


def _arc(meridian: SurfaceMeridian) -> Any:
    """Return the arc of a sphere's meridian, from the vertex."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge
    from OCP.gp import gp_Ax2, gp_Circ, gp_Dir

    radius = 1.0 / meridian.section.curvature
    side = math.copysign(1.0, radius)
    to_vertex, normal = gp_Dir(0.0, 0.0, -side), gp_Dir(0.0, -side, 0.0)
    frame = gp_Ax2(_point((0.0, meridian.vertex_z_mm + radius)), normal, to_vertex)
    angle = math.asin(min(1.0, meridian.end_mm / abs(radius)))
    return BRepBuilderAPI_MakeEdge(gp_Circ(frame, abs(radius)), 0.0, angle).Edge()


def _straight_edge(start: Any, end: Any) -> Any:
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge

    return BRepBuilderAPI_MakeEdge(_point(start), _point(end)).Edge()


def _point(rz_mm: Any) -> Any:
    from OCP.gp import gp_Pnt

    return gp_Pnt(float(rz_mm[0]), 0.0, float(rz_mm[1]))


def _points(points: Array) -> Any:
    from OCP.collections import Array1_gp_Pnt

    result = Array1_gp_Pnt(1, len(points))
    for index, point in enumerate(points, start=1):
        result.SetValue(index, _point(point))
    return result


def _numbers(values: Array) -> Any:
    from OCP.collections import Array1_double

    result = Array1_double(1, len(values))
    for index, value in enumerate(values, start=1):
        result.SetValue(index, float(value))
    return result


def _bezier_curve(points: Array, weights: Array) -> Any:
    from OCP.Geom import Geom_BezierCurve

    return Geom_BezierCurve(_points(points), _numbers(weights))


def _spline_curve(knots: Array, points: Array) -> Any:
    from OCP.collections import Array1_int
    from OCP.Geom import Geom_BSplineCurve

    values, counts = np.unique(knots, return_counts=True)
    multiplicities = Array1_int(1, len(counts))
    for index, count in enumerate(counts, start=1):
        multiplicities.SetValue(index, int(count))
    return Geom_BSplineCurve(_points(points), _numbers(values), multiplicities, SPLINE_DEGREE)


def subshapes(shape: Any, kind: Any) -> list[Any]:
    """Return all subshapes of one kind (of TopAbs_ShapeEnum)."""
    from OCP.TopExp import TopExp_Explorer

    explorer, found = TopExp_Explorer(shape, kind), []
    while explorer.More():
        found.append(explorer.Current())
        explorer.Next()
    return found
