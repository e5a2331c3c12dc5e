"""Smooth maps over a plane behind a lens, for the light of one object point.

Polynomials through a modest number of rays give path, object-side direction and amplitude at every sensor
point of the footprint, for any tilt, decenter or perturbation of the lens. The order of the polynomials
increases until they agree with further rays that were not fitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.linalg import lstsq

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from wavesim.rays.edge_diffraction import Edge, light_edge
from wavesim.rays.kernel import row_ends
from wavesim.rays.ray_bundles import STEP, FoldError, OpenPupil, RayBundle, open_pupil, shoot, trace_bundle
from wavesim.scene.scene import Scene

LINE_ORDERS, PLANE_ORDERS = (12, 20, 32, 48, 72, 120, 200), (8, 12, 16, 20, 26)
RIM_ARMS = 360

BLOCK = 8192
"""Scattered points at which polynomials are evaluated at a time."""


class RayMapError(InputError):
    """Polynomials do not fit the rays with the required accuracy."""


@dataclass(frozen=True, eq=False)
class SmoothMap:
    """Polynomials of one or two variables over a box, as products of Chebyshev polynomials.

    Attributes
    ----------
    middle, half_width : ndarray, shape (d,)
        Centre and half-width of the box.
    coefficients : ndarray, shape (functions, order + 1) or (functions, order + 1, order + 1)
        Real or complex coefficients.
    """

    middle: Array
    half_width: Array
    coefficients: NDArray

    def at(self, points: Array) -> NDArray:
        """Return the values at scattered points, shape (functions, n) for points of shape (n, d)."""
        parts = [self._at(points[i : i + BLOCK]) for i in range(0, max(len(points), 1), BLOCK)]
        return np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]

    def _at(self, points: Array) -> NDArray:
        scaled = (points - self.middle) / self.half_width
        basis = [chebyshev.chebvander(column, self.coefficients.shape[1] - 1) for column in scaled.T]
        if len(basis) == 1:
            return np.asarray(self.coefficients @ basis[0].T)
        return np.stack([np.sum((basis[0] @ c) * basis[1], axis=1) for c in self.coefficients])

    def on_axes(self, axes: Sequence[Array]) -> NDArray:
        """Return the values on a line or a grid of two axes, shape (functions, ny) or (functions, ny, nx)."""
        return np.stack(list(self.along(axes).each()))

    def along(self, axes: Sequence[Array]) -> MapOnAxes:
        """Return the polynomials' terms along the axes of a line or a grid."""
        order = self.coefficients.shape[1] - 1
        terms = (
            chebyshev.chebvander((axis - middle) / half, order)
            for axis, middle, half in zip(axes, self.middle, self.half_width, strict=True)
        )
        return MapOnAxes(self.coefficients, tuple(terms))


@dataclass(frozen=True, eq=False)
class MapOnAxes:
    """Polynomials with their terms along the axes of a line or a grid.

    Attributes
    ----------
    coefficients : ndarray
        As in :class:`SmoothMap`.
    terms : tuple of ndarray, shape (samples, order + 1)
        Chebyshev terms along y (and x).
    """

    coefficients: NDArray
    terms: tuple[NDArray, ...]

    def each(self) -> Iterator[Any]:
        """Yield the values of one function after the other, to limit the memory."""
        y, *x = self.terms
        for c in self.coefficients:
            yield y @ c @ x[0].T if x else y @ c

    def single(self) -> MapOnAxes:
        """Return the same in float32."""
        terms = tuple(one.astype(np.float32) for one in self.terms)
        return MapOnAxes(self.coefficients.astype(np.float32), terms)


def fit_map(points: Array, values: NDArray, order: int) -> SmoothMap:
    """Fit polynomials of a total order to values (functions, n) at points (n, d), by least squares."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half_width = 0.5 * (low + high), 0.5 * (high - low)
    scaled = (points - middle) / half_width
    if points.shape[1] == 1:
        return SmoothMap(middle, half_width, solve(chebyshev.chebvander(scaled[:, 0], order), values.T).T)
    coefficients = on_square(solve(total_order_terms(scaled, order), values.T).T, order)
    return SmoothMap(middle, half_width, coefficients)


def total_order_terms(unit: Array, order: int) -> Array:
    """Return the Chebyshev products of a total order at points (n, 2) in the unit square, (n, terms)."""
    first, second = _orders(order)
    y, x = (chebyshev.chebvander(column, order) for column in unit.T)
    return np.asarray(y[:, first] * x[:, second])


def on_square(coefficients: NDArray, order: int) -> NDArray:
    """Return coefficients (..., terms) of a total order as those of a :class:`SmoothMap`, (..., n, n)."""
    result = np.zeros((*coefficients.shape[:-1], order + 1, order + 1), coefficients.dtype)
    first, second = _orders(order)
    result[..., first, second] = coefficients
    return result


def _orders(order: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the orders in both variables of the terms of a total order."""
    first, second = np.nonzero(np.add.outer(np.arange(order + 1), np.arange(order + 1)) <= order)
    return first, second


def solve(basis: Array, values: NDArray) -> NDArray:
    """Return the least-squares solution of basis @ x = values."""
    return np.asarray(lstsq(basis, values, lapack_driver="gelsy", check_finite=False)[0])


@dataclass(frozen=True, eq=False)
class RayMap:
    """Rays of one object point on one plane, as smooth maps.

    Attributes
    ----------
    plane_z_mm : float
        z of the plane.
    pupil : OpenPupil
        Open part of the stop for this point.
    maps : SmoothMap
        Functions of y, or y and x: path V in mm, amplitude in mm^(-d/2), then object-side cosines in the same
        order.
    rim_mm : ndarray, shape (arms, d)
        Border of the footprint; its two ends on a line.
    caustics : int
        Number of caustics that the light has touched.
    bundle : RayBundle
        The fitted rays.
    traced : OpenPupil
        Part of the stop that they pass: the open part, and its shadow where the edge was requested.
    border_mm : ndarray, shape (arms, d)
        Border of the region that they reach.
    edge : Edge or None
        Diffraction at the rim, where it was requested.
    stop : SmoothMap or None
        Stop coordinates, y or y and x, where the edge was requested.
    jones : SmoothMap or None
        Complex components of the field relative to that of scalar waves, for light with a polarization.
    """

    plane_z_mm: float
    pupil: OpenPupil
    maps: SmoothMap
    rim_mm: Array
    caustics: int
    bundle: RayBundle
    traced: OpenPupil
    border_mm: Array
    edge: Edge | None = None
    stop: SmoothMap | None = None
    jones: SmoothMap | None = None

    @property
    def resolves_edge(self) -> bool:
        """True if two orders describe the edge, and rays reach its shadow."""
        if self.edge is None:
            return False
        lit = self.pupil.reach
        bent = float(np.max(np.abs(self.edge.bend) * lit))
        # Largest second-order coefficient of the edge relative to the first, at the centre of the light;
        # above it two orders do not describe the edge.
        most_bent = 2.0
        return bent <= most_bent and bool(
            np.all(self.traced.reach - lit > 0.9 * (self.edge.shadow.reach - lit))
        )

    def row_spans(self, axes: Sequence[Array]) -> NDArray[np.intp]:
        """Return the samples of a grid inside the border, as :func:`row_spans`."""
        return row_spans(self.border_mm, axes)


def row_spans(border_mm: Array, axes: Sequence[Array]) -> NDArray[np.intp]:
    """Return the samples of a grid inside a border: first and end per row, shape (rows, 2); one row on a
    line.

    Rows outside have an end that equals their first. A row that leaves the border and enters it again counts
    as inside in between.

    Parameters
    ----------
    border_mm
        Points (y) or (y, x) along the border, shape (arms, d).
    axes
        Axes y (and x) of the grid, in mm.
    """
    if len(axes) == 1:
        low, high = border_mm.min(), border_mm.max()
        return np.array([[np.searchsorted(axes[0], low), np.searchsorted(axes[0], high, side="right")]])
    y, x = axes
    low, high = row_ends(np.ascontiguousarray(border_mm), np.ascontiguousarray(y))
    first, end = np.searchsorted(x, low), np.searchsorted(x, high, side="right")
    return np.column_stack([first, np.maximum(end, first)])


def moved(border: Array, by: float) -> Array:
    """Move points of a closed border, shape (n, d), outwards from their centre, but not beyond the centre."""
    middle = border.mean(axis=0)
    radii = np.linalg.norm(border - middle, axis=1, keepdims=True)
    return np.asarray(middle + (border - middle) * np.maximum(1.0 + by / radii, 0.0))


def inside_border(border: Array, axes: Sequence[Array]) -> NDArray[np.bool_]:
    """Return the mask of the grid points, with increasing axes y (and x), inside a closed border."""
    spans, column = row_spans(border, axes), np.arange(len(axes[-1]))
    mask = (column >= spans[:, :1]) & (column < spans[:, 1:])
    return np.asarray(mask[0] if len(axes) == 1 else mask)


def sample_points(pupil: OpenPupil, order: int, shift: float = 0.0) -> Array:
    """Return stop points for polynomials of an order, denser towards the rim, shape (n, 2)."""
    inside = 1.0 - 2.0 * STEP
    if pupil.is_line:
        count = 2 * order + 2
        position = np.cos(np.pi * (np.arange(count) + 0.5 + shift) / (count + 2.0 * shift))
        return pupil.points(inside * np.abs(position), np.sign(position) * 0.5 * np.pi)
    rings, arms = order // 2 + 4, 2 * order + 8
    # Chebyshev points over the diameter, as far as they differ by more than a turn.
    radius = np.cos(0.5 * np.pi * (np.arange(rings) + 0.5 * (1.0 + shift)) / (rings + 0.5 * shift))
    angle = 2.0 * np.pi * (np.arange(arms) + shift) / arms
    grid = np.stack(np.meshgrid(inside * radius, angle, indexing="ij"), axis=-1).reshape(-1, 2)
    return pupil.points(grid[:, 0], grid[:, 1])


def ray_map(
    scene: Scene, point_mm: tuple[float, float], plane_z_mm: float, reach_mm: float, *, edge: bool = False
) -> RayMap:
    """Trace rays of an object point, and fit maps of path, amplitude and direction over its footprint.

    Parameters
    ----------
    scene
        Lens, wavelength and coating; its object grid defines the object plane.
    point_mm
        Object point (x, y).
    plane_z_mm
        z of the plane behind the lens.
    reach_mm
        Extent of the object about the point, for which the direction p must be accurate.
    edge
        Whether to describe the diffraction at the rim, and to extend the maps into its shadow.

    Raises
    ------
    InputError
        If no ray passes the lens.
    FoldError
        If the rays fold on the plane.
    RayMapError
        If polynomials do not fit the rays to 1e-4 waves.
    """
    pupil = open_pupil(scene, point_mm, plane_z_mm, RIM_ARMS)
    drawn = light_edge(scene, point_mm, pupil, plane_z_mm) if edge else None
    traced = pupil if drawn is None else _with_shadow(scene, point_mm, drawn, plane_z_mm)
    orders = LINE_ORDERS if pupil.is_line else PLANE_ORDERS
    wavelength_mm = 1e-3 * scene.wavelength_um
    errors = np.full(3, np.inf)
    path_tolerance_waves = 1e-4
    # Largest relative error of the amplitude at rays that were not fitted.
    amplitude_tolerance = 1e-4
    for order in orders:
        bundle = trace_bundle(scene, np.asarray(point_mm), sample_points(traced, order), plane_z_mm)
        caustics = check_no_fold(bundle, point_mm, plane_z_mm)
        check = trace_bundle(scene, np.asarray(point_mm), sample_points(traced, order, 0.37), plane_z_mm)
        fitted = _carried(bundle)[:, bundle.ok]
        both = fit_map(bundle.sensor_mm[bundle.ok], np.concatenate([fitted, _stop_of(bundle)]), order)
        maps = replace(both, coefficients=both.coefficients[: len(fitted)])
        difference = np.abs(maps.at(check.sensor_mm) - _carried(check))[:, check.ok]
        jones, mixing_error = _fitted_jones(bundle, check, order)
        errors = np.array(
            [
                difference[0].max() / wavelength_mm,
                max((difference[1] / check.amplitude[check.ok]).max(), mixing_error),
                difference[2:].max() * reach_mm / wavelength_mm,
            ]
        )
        if np.all(errors < [path_tolerance_waves, amplitude_tolerance, path_tolerance_waves]):
            borders = [border_of(scene, point_mm, part, plane_z_mm) for part in (pupil, traced)]
            stop = None if drawn is None else replace(both, coefficients=both.coefficients[len(fitted) :])
            return RayMap(
                plane_z_mm, pupil, maps, borders[0], caustics, bundle, traced, borders[1], drawn, stop, jones
            )
    raise RayMapError(
        f"the rays from ({point_mm[0]:g}, {point_mm[1]:g}) mm are too rough on the plane z = {plane_z_mm:g} "
        f"mm: the errors of polynomials of order {orders[-1]} are {errors[0]:.2g} waves of path, "
        f"{errors[1]:.2g} of the amplitude and {errors[2]:.2g} waves by direction "
        f"(allowed: {path_tolerance_waves:g}, {amplitude_tolerance:g}, {path_tolerance_waves:g}); "
        "stop the lens down, or go farther from the caustic"
    )


def _fitted_jones(bundle: RayBundle, check: RayBundle, order: int) -> tuple[SmoothMap | None, float]:
    """Return the map of the field's components, and its largest error at rays that were not fitted."""
    if bundle.jones is None or check.jones is None:
        return None, 0.0
    fitted = fit_map(bundle.sensor_mm[bundle.ok], bundle.jones[bundle.ok].T, order)
    return fitted, float(np.max(np.abs(fitted.at(check.sensor_mm[check.ok]) - check.jones[check.ok].T)))


def _with_shadow(scene: Scene, point_mm: tuple[float, float], edge: Edge, plane_z_mm: float) -> OpenPupil:
    """Return the open part of the stop with the part of its shadow that rays reach without folding."""
    order = (LINE_ORDERS if edge.pupil.is_line else PLANE_ORDERS)[0]
    # Fractions of the shadow that are tried, until rays reach it.
    shadow_fractions = (1.0, 0.5, 0.25, 0.1)
    for fraction in shadow_fractions:
        reach = edge.pupil.reach + fraction * (edge.shadow.reach - edge.pupil.reach)
        wider = OpenPupil(edge.pupil.centre, reach, edge.pupil.angles)
        bundle = trace_bundle(scene, np.asarray(point_mm), sample_points(wider, order), plane_z_mm)
        if not np.all(bundle.ok):
            continue
        try:
            check_no_fold(bundle, point_mm, plane_z_mm)
        except FoldError:
            continue
        return wider
    return edge.pupil


def border_of(scene: Scene, point_mm: tuple[float, float], pupil: OpenPupil, plane_z_mm: float) -> Array:
    """Return where rays through a pupil's rim meet a plane, for one object point (x, y), shape (arms, d)."""
    points = np.broadcast_to(np.asarray(point_mm, float), pupil.rim.shape)
    ends = shoot(scene, points, pupil.rim, plane_z_mm, clip=False).position
    return ends[:, [1] if pupil.is_line else [1, 0]]


def _stop_of(bundle: RayBundle) -> Array:
    """Return the stop coordinates, y (and x), of the rays that arrive."""
    return bundle.pupil[bundle.ok][:, [1] if bundle.sensor_mm.shape[1] == 1 else [1, 0]].T


def _carried(bundle: RayBundle) -> Array:
    return np.concatenate([bundle.path_mm[None], bundle.amplitude[None], bundle.cosines.T])


def check_no_fold(bundle: RayBundle, point_mm: tuple[float, float], plane_z_mm: float) -> int:
    """Return the number of caustics that the light has touched.

    Raises
    ------
    FoldError
        If the map from stop to plane folds, or parts of the light have touched different numbers.
    """
    determinant, caustics = bundle.determinant[bundle.ok], bundle.caustics[bundle.ok]
    sign = np.sign(determinant)
    if not len(sign):
        raise InputError(f"no ray from ({point_mm[0]:g}, {point_mm[1]:g}) mm reaches z = {plane_z_mm:g} mm")
    if np.any(sign != sign[0]) or sign[0] == 0.0 or np.any(caustics != caustics[0]):
        raise FoldError(
            f"the rays from ({point_mm[0]:g}, {point_mm[1]:g}) mm fold on the plane z = {plane_z_mm:g} mm: "
            "several rays reach one sensor point there; choose a plane before or behind the caustic"
        )
    return int(caustics[0])
