"""Solid of a body without rotational symmetry: two spline surfaces and the cylinder between them.

Each optical surface is a tensor-product spline of degree 5 over azimuth and normalized radius, with as many
equal intervals as its measured error requires. The edge is a ruled surface between the rims. OCP is imported
inside the functions.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.solid import Element
from lensdesign.manufacture.meridian_curves import SPLINE_DEGREE

MIN_INTERVALS, MAX_INTERVALS = 32, 256


def freeform_solid(element: Element) -> Any:
    """Return the body as a closed solid (a TopoDS_Shape) with the faces front surface, edge, back surface.

    Raises
    ------
    InputError
        If the body has flat rings, bevels or a flange, or if a surface cannot be approximated.
    """
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeSolid, BRepBuilderAPI_Sewing
    from OCP.BRepLib import BRepLib
    from OCP.TopoDS import TopoDS

    if any(len(end) for end in element.ends) or element.edge.flange is not None:
        raise InputError(
            "a STEP file supports flat rings, bevels and flanges for bodies of revolution only; remove them"
        )
    sides = tuple(zip(element.surfaces, (element.front, element.back), strict=True))
    intervals = max(_intervals(meridian, index) for index, meridian in sides)
    (around, along, front), (_, _, back) = (surface_spline(meridian, intervals) for _, meridian in sides)
    rims = np.stack([front[:, -1], back[:, -1]], axis=1)
    sewing = BRepBuilderAPI_Sewing(1e-6)
    for poles, knots, degree in (
        (front, along, SPLINE_DEGREE),
        (rims, np.array([0.0, 0.0, 1.0, 1.0]), 1),
        (back, along, SPLINE_DEGREE),
    ):
        sewing.Add(BRepBuilderAPI_MakeFace(_surface(poles, around, knots, degree), 1e-7).Face())
    sewing.Perform()
    solid = BRepBuilderAPI_MakeSolid(TopoDS.Shell(sewing.SewedShape())).Solid()
    BRepLib.OrientClosedSolid_s(solid)
    return solid


def surface_error_mm(points: Array, meridian: SurfaceMeridian) -> float:
    """Return the largest distance of points, shape (n, 3), from a surface in mm, to first order."""
    z, by_x, by_y = meridian.surface.shape.sag_and_slopes(points[:, 0], points[:, 1])
    off = (points[:, 2] - meridian.vertex_z_mm - z) / np.sqrt(1.0 + by_x**2 + by_y**2)
    return float(np.max(np.abs(off)))


def surface_spline(meridian: SurfaceMeridian, intervals: int) -> tuple[Array, Array, Array]:
    """Return knots around the axis and along the radius, both from 0 to 1, and control points in mm.

    Along the radius the surface is interpolated over whole diameters, so that it is as smooth at the vertex
    as elsewhere. Around the axis it is interpolated over three revolutions; the middle one is used.
    """
    from scipy.interpolate import make_interp_spline

    fractions = np.linspace(-1.0, 1.0, 2 * intervals + 1)[:, None]
    azimuths = np.linspace(-1.0, 2.0, 3 * intervals + 1)
    x, y = (meridian.end_mm * fractions * axis(2.0 * math.pi * azimuths) for axis in (np.cos, np.sin))
    # Rounding must not move the outermost points beyond the rim.
    edge = meridian.surface.shape.edge_radius_mm * (1.0 - 1e-15)
    within = np.minimum(1.0, edge / np.maximum(np.hypot(x, y), 1e-300))
    points = np.stack([x, y, meridian.surface.shape.sag(within * x, within * y)], axis=-1)
    along, points = _restrict(make_interp_spline(fractions[:, 0], points, k=SPLINE_DEGREE), 0.0, 1.0)
    around, poles = _restrict(
        make_interp_spline(azimuths, np.moveaxis(points, 1, 0), k=SPLINE_DEGREE), 0.0, 1.0
    )
    poles[:, 0] = 0.0
    poles[-1] = poles[0]
    poles[..., 2] += meridian.vertex_z_mm
    return around, along, poles


def _restrict(spline: Any, start: float, end: float) -> tuple[Array, Array]:
    """Return knots and control points of a spline restricted to the range between two of its knots."""
    for knot in (start, end):
        multiplicity = int(np.count_nonzero(np.abs(spline.t - knot) < 1e-12))
        if multiplicity < SPLINE_DEGREE:
            knot = float(spline.t[np.argmin(np.abs(spline.t - knot))])
            spline = spline.insert_knot(knot, SPLINE_DEGREE - multiplicity)
    first, last = (int(np.argmax(np.abs(spline.t - knot) < 1e-12)) for knot in (start, end))
    inner = spline.t[first + SPLINE_DEGREE : last]
    knots = np.concatenate([np.full(SPLINE_DEGREE + 1, start), inner, np.full(SPLINE_DEGREE + 1, end)])
    return knots, np.array(spline.c[first - 1 : last])


def _intervals(meridian: SurfaceMeridian, index: int) -> int:
    """Return the number of intervals that a surface needs, both around the axis and along its radius."""
    from scipy.interpolate import BSpline

    intervals, error = MIN_INTERVALS, math.inf
    # Largest distance of a spline surface from the exact one.
    error_mm = 1e-7
    while intervals <= MAX_INTERVALS:
        around, along, poles = surface_spline(meridian, intervals)
        azimuth_basis = BSpline.design_matrix(
            np.linspace(0.0, 1.0, 7 * intervals + 3), around, SPLINE_DEGREE
        ).toarray()
        radius_basis = BSpline.design_matrix(
            np.linspace(0.0, 1.0, 7 * intervals + 3), along, SPLINE_DEGREE
        ).toarray()
        rim = azimuth_basis @ poles[:, -1]
        inside = np.einsum("ui,ijk,tj->utk", azimuth_basis, poles, radius_basis[:-1], optimize=True)
        reach = np.abs(np.hypot(rim[:, 0], rim[:, 1]) - meridian.end_mm)
        error = max(surface_error_mm(inside.reshape(-1, 3), meridian), float(np.max(reach)))
        if error <= error_mm:
            return intervals
        intervals *= 2
    raise InputError(
        f"surface {index + 1} cannot be approximated within {error_mm:g} mm by {MAX_INTERVALS} intervals: "
        f"{error:.3g} mm reached"
    )


def _surface(poles: Array, around: Array, along: Array, degree: int) -> Any:
    """Return a Geom_BSplineSurface of degree 5 around the axis."""
    from OCP.collections import Array1_double, Array1_int, Array2_gp_Pnt
    from OCP.Geom import Geom_BSplineSurface
    from OCP.gp import gp_Pnt

    net = Array2_gp_Pnt(1, poles.shape[0], 1, poles.shape[1])
    for i, j in np.ndindex(*poles.shape[:2]):
        net.SetValue(i + 1, j + 1, gp_Pnt(*map(float, poles[i, j])))
    arguments = []
    for knots in (around, along):
        values, counts = np.unique(knots, return_counts=True)
        distinct, multiplicities = Array1_double(1, len(values)), Array1_int(1, len(values))
        for index, (value, count) in enumerate(zip(values, counts, strict=True), start=1):
            distinct.SetValue(index, float(value))
            multiplicities.SetValue(index, int(count))
        arguments.append((distinct, multiplicities))
    (u, multiplicities_u), (v, multiplicities_v) = arguments
    return Geom_BSplineSurface(net, u, v, multiplicities_u, multiplicities_v, SPLINE_DEGREE, degree)
