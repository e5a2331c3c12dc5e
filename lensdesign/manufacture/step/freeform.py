"""A body that is none of revolution as a solid: two spline surfaces about the axis, and the cylinder between.

Each optical surface is a tensor spline of degree 5 over azimuth and share of the radius, with as many equal
intervals as its measured error asks for; the edge is ruled between their rims. OCP is imported where used.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.solid import Element

DEGREE = 5
ERROR_MM = 1e-7
"""Largest distance of a spline surface from the exact one."""

FEWEST_INTERVALS, MOST_INTERVALS = 32, 256


def freeform_solid(element: Element) -> Any:
    """The body as a closed solid (a TopoDS_Shape); its faces are front surface, edge and back surface.

    Raises
    ------
    InputError
        If it has flats, bevels or a flange, which would follow a rim that is not level, or a surface cannot
        be followed.
    """
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeSolid, BRepBuilderAPI_Sewing
    from OCP.BRepLib import BRepLib
    from OCP.TopoDS import TopoDS

    if any(len(end) for end in element.ends) or element.edge.flange is not None:
        raise InputError(
            "a STEP file has flat rings, bevels and flanges of bodies of revolution only; leave them out"
        )
    sides = tuple(zip(element.surfaces, (element.front, element.back), strict=True))
    intervals = max(_intervals(meridian, index) for index, meridian in sides)
    (around, along, front), (_, _, back) = (surface_spline(meridian, intervals) for _, meridian in sides)
    rims = np.stack([front[:, -1], back[:, -1]], axis=1)
    sewing = BRepBuilderAPI_Sewing(1e-6)
    for poles, knots, degree in (
        (front, along, DEGREE),
        (rims, np.array([0.0, 0.0, 1.0, 1.0]), 1),
        (back, along, DEGREE),
    ):
        sewing.Add(BRepBuilderAPI_MakeFace(_surface(poles, around, knots, degree), 1e-7).Face())
    sewing.Perform()
    solid = BRepBuilderAPI_MakeSolid(TopoDS.Shell(sewing.SewedShape())).Solid()
    BRepLib.OrientClosedSolid_s(solid)
    return solid


def surface_error_mm(points: Array, meridian: SurfaceMeridian) -> float:
    """Largest distance of points, shape (n, 3), from a surface, to first order in that distance."""
    z, by_x, by_y = meridian.surface.shape.sag_and_slopes(points[:, 0], points[:, 1])
    off = (points[:, 2] - meridian.vertex_z_mm - z) / np.sqrt(1.0 + by_x**2 + by_y**2)
    return float(np.max(np.abs(off)))


def surface_spline(meridian: SurfaceMeridian, intervals: int) -> tuple[Array, Array, Array]:
    """Knots round the axis and along the radius, both from 0 to 1, and control points in mm.

    Along the radius the surface is interpolated over whole diameters, so that it is as smooth at the vertex
    as elsewhere; round the axis over three turns, of which the middle one is kept.
    """
    from scipy.interpolate import make_interp_spline

    shares = np.linspace(-1.0, 1.0, 2 * intervals + 1)[:, None]
    turns = np.linspace(-1.0, 2.0, 3 * intervals + 1)
    x, y = (meridian.end_mm * shares * part(2.0 * math.pi * turns) for part in (np.cos, np.sin))
    # The outermost points lie on the rim, whatever rounding says.
    edge = meridian.surface.shape.edge_radius_mm * (1.0 - 1e-15)
    within = np.minimum(1.0, edge / np.maximum(np.hypot(x, y), 1e-300))
    points = np.stack([x, y, meridian.surface.shape.sag(within * x, within * y)], axis=-1)
    along, points = _cut(make_interp_spline(shares[:, 0], points, k=DEGREE), 0.0, 1.0)
    around, poles = _cut(make_interp_spline(turns, np.moveaxis(points, 1, 0), k=DEGREE), 0.0, 1.0)
    poles[:, 0] = 0.0
    poles[-1] = poles[0]
    poles[..., 2] += meridian.vertex_z_mm
    return around, along, poles


def _cut(spline: Any, start: float, end: float) -> tuple[Array, Array]:
    """Knots and control points of the part of a spline between two of its knots."""
    for at in (start, end):
        held = int(np.count_nonzero(np.abs(spline.t - at) < 1e-12))
        if held < DEGREE:
            at = float(spline.t[np.argmin(np.abs(spline.t - at))])
            spline = spline.insert_knot(at, DEGREE - held)
    first, last = (int(np.argmax(np.abs(spline.t - at) < 1e-12)) for at in (start, end))
    inner = spline.t[first + DEGREE : last]
    knots = np.concatenate([np.full(DEGREE + 1, start), inner, np.full(DEGREE + 1, end)])
    return knots, np.array(spline.c[first - 1 : last])


def _intervals(meridian: SurfaceMeridian, index: int) -> int:
    """How many a surface needs, round the axis as along its radius."""
    from scipy.interpolate import BSpline

    intervals, error = FEWEST_INTERVALS, math.inf
    while intervals <= MOST_INTERVALS:
        around, along, poles = surface_spline(meridian, intervals)
        by_turn = BSpline.design_matrix(np.linspace(0.0, 1.0, 7 * intervals + 3), around, DEGREE).toarray()
        by_share = BSpline.design_matrix(np.linspace(0.0, 1.0, 7 * intervals + 3), along, DEGREE).toarray()
        rim = by_turn @ poles[:, -1]
        inside = np.einsum("ui,ijk,tj->utk", by_turn, poles, by_share[:-1], optimize=True)
        reach = np.abs(np.hypot(rim[:, 0], rim[:, 1]) - meridian.end_mm)
        error = max(surface_error_mm(inside.reshape(-1, 3), meridian), float(np.max(reach)))
        if error <= ERROR_MM:
            return intervals
        intervals *= 2
    raise InputError(
        f"surface {index + 1} cannot be followed within {ERROR_MM:g} mm by {MOST_INTERVALS} intervals: "
        f"{error:.3g} mm reached"
    )


def _surface(poles: Array, around: Array, along: Array, degree: int) -> Any:
    """A Geom_BSplineSurface of degree 5 round the axis."""
    from OCP.collections import Array1_double, Array1_int, Array2_gp_Pnt
    from OCP.Geom import Geom_BSplineSurface
    from OCP.gp import gp_Pnt

    net = Array2_gp_Pnt(1, poles.shape[0], 1, poles.shape[1])
    for i, j in np.ndindex(*poles.shape[:2]):
        net.SetValue(i + 1, j + 1, gp_Pnt(*map(float, poles[i, j])))
    arguments = []
    for knots in (around, along):
        values, counts = np.unique(knots, return_counts=True)
        own, many = Array1_double(1, len(values)), Array1_int(1, len(values))
        for number, (value, count) in enumerate(zip(values, counts, strict=True), start=1):
            own.SetValue(number, float(value))
            many.SetValue(number, int(count))
        arguments.append((own, many))
    (u, many_u), (v, many_v) = arguments
    return Geom_BSplineSurface(net, u, v, many_u, many_v, DEGREE, degree)
