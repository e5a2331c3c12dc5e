"""Meridians of optical surfaces as curves of CAD files: rational quadratic for conics, splines for aspheres.

The rational quadratic Bezier curve of a conic is exact (Farin, Curves and Surfaces for CAGD, 5th ed., chapter
12). Aspheres have a spline of degree 5 with as many knots as the allowed error requires.
"""

from __future__ import annotations

import math

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.meridian import SurfaceMeridian

EXACT = ("plane", "sphere", "conic")
"""Shapes that a file represents exactly, without a spline."""

SPLINE_DEGREE = 5


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
