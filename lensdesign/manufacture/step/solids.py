"""Boundary representations of rotationally symmetric glass bodies by OCP: a meridian rotated about the axis.

Planes and spheres are native surfaces. Other conics have a rational quadratic Bezier meridian, which is exact
(Farin, Curves and Surfaces for CAGD, 5th ed., chapter 12). Even aspheres have a spline meridian of degree 5
with as many knots as the allowed error requires. OCP is imported inside the functions.
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

EXACT = ("plane", "sphere", "conic")
"""Shapes that a file represents exactly, without a spline."""

SPLINE_DEGREE = 5


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


def conic_bezier(meridian: SurfaceMeridian) -> tuple[Array, Array]:
    """Return control points and weights of a conic's meridian, from the vertex to its end.

    With q = sqrt(1 - (1 + k) c^2 r^2) at the end, the tangents of end and vertex meet at the height
    r / (1 + q). The weight of that point is sqrt((1 + q) / 2): the cosine of half the eccentric angle on an
    ellipse, 1 on a parabola, a hyperbolic cosine on a hyperbola. It is at least sqrt(1/2), reached at the
    equator, so one Bezier segment suffices for every conic.

    Returns
    -------
    points : ndarray, shape (3, 2)
        Radial height and z in mm.
    weights : ndarray, shape (3,)
        Weights of the control points.
    """
    section, r = meridian.section, meridian.end_mm
    c, conic, equator = section.curvature, section.conic, section.edge_radius_mm
    # The meridian uses the same angle; another formula would differ by rounding near the equator.
    q = (
        math.cos(math.asin(min(1.0, r / equator)))
        if math.isfinite(equator)
        else math.sqrt(1.0 - (1.0 + conic) * c * c * r * r)
    )
    vertex, end = meridian.points([0.0, 1.0])
    points = np.array([vertex, [r / (1.0 + q), vertex[1]], end])
    return points, np.array([1.0, math.sqrt(0.5 * (1.0 + q)), 1.0])


def asphere_spline(meridian: SurfaceMeridian, error_mm: float = 1e-7) -> tuple[Array, Array]:
    """Return knots and control points of a spline of degree 5 that approximates an asphere's meridian.

    The spline interpolates the meridian and its mirror image, so that the surface is as smooth at the vertex
    as elsewhere (four continuous derivatives). It has as many equal intervals as its measured error requires.

    Parameters
    ----------
    meridian
        Meridian from the vertex to its end.
    error_mm
        Largest allowed distance between spline and meridian in mm (default: 1e-7).

    Returns
    -------
    knots : ndarray
        Knots from 0 to 1; those at the ends are repeated six times.
    points : ndarray, shape (len(knots) - 6, 2)
        Radial height and z of the control points in mm.

    Raises
    ------
    InputError
        If 2000 intervals do not suffice.
    """
    intervals, error = 8, math.inf
    max_intervals = 2000
    while intervals <= max_intervals:
        knots, points = _half_spline(meridian, intervals)
        error = _spline_error(meridian, knots, points)
        if error <= error_mm:
            return knots, points
        intervals += intervals // 2
    raise InputError(
        f"the asphere cannot be approximated within {error_mm:g} mm by {max_intervals} spline "
        f"intervals: {error:.3g} mm reached"
    )


def _half_spline(meridian: SurfaceMeridian, intervals: int) -> tuple[Array, Array]:
    from scipy.interpolate import make_interp_spline

    degree = SPLINE_DEGREE
    half = meridian.points(np.linspace(0.0, 1.0, intervals + 1))
    # Sag is measured from the vertex so that a distant vertex does not cost precision.
    half[:, 1] -= meridian.vertex_z_mm
    half[0], half[-1, 0] = 0.0, meridian.end_mm
    whole = np.concatenate([half[:0:-1] * [-1.0, 1.0], half])
    spline = make_interp_spline(np.linspace(-1.0, 1.0, len(whole)), whole, k=degree)
    middle = int(np.argmin(np.abs(spline.t)))
    spline = spline.insert_knot(spline.t[middle], degree - 1)
    points = np.array(spline.c[middle - 1 :])
    knots = np.concatenate([np.zeros(degree + 1), spline.t[middle + degree :]])
    points[0], points[1, 1], points[-1] = 0.0, 0.0, half[-1]
    points[:, 1] += meridian.vertex_z_mm
    return knots, points


def _spline_error(meridian: SurfaceMeridian, knots: Array, points: Array) -> float:
    from scipy.interpolate import BSpline

    inner = np.unique(knots)
    t = (inner[:-1, None] + np.diff(inner)[:, None] * (np.arange(32) + 0.5) / 32.0).ravel()
    found = BSpline(knots, points, SPLINE_DEGREE)(t)
    return float(np.max(meridian.distances(found)))


def _optical_edge(meridian: SurfaceMeridian, index: int) -> Any:
    """Return the meridian of an optical surface as a TopoDS_Edge in the plane y = 0."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge

    shape = meridian.surface.shape
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

    radius = 1.0 / meridian.surface.curvature
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
