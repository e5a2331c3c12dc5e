"""Ray maps of all points of a field on one plane, as polynomials in object point and sensor point.

Neighbouring object points share their rays. At nodes all over the field, polynomials in the sensor point
represent path V, amplitude a, object-side cosines p and the position of the aperture's edge. Their
coefficients are polynomials in the object point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.rays.maps import RayMapError, SmoothMap, check_no_fold, on_square, solve, total_order_terms
from wavesim.rays.ray_bundles import RayBundle, open_pupil, trace_bundle
from wavesim.scene.scene import Scene

REACH = 1.05
"""Relative distance to the aperture's edge up to which rays are fitted; interpolation needs rays beyond 1."""

SENSOR_ORDERS, OBJECT_ORDERS = (12, 16, 20, 24), (4, 6, 8, 10)
SLOPE_ORDER = 2
"""Order of the polynomials for the slopes of directions over the field, which grow evenly towards its
border."""

ARMS = 72


@dataclass(frozen=True)
class Region:
    """The part of the object plane from which light comes: a disc, or the box of a small grid within it.

    Attributes
    ----------
    centre_mm : (y, x)
    half_mm : ndarray, shape (2,)
        Radius of the disc twice, or half sides (y, x) of the box.
    is_disc : bool
    """

    centre_mm: tuple[float, float]
    half_mm: Array
    is_disc: bool

    def nodes(self, order: int, shift: float = 0.0) -> Array:
        """Return points (y, x) for polynomials of a total order, denser towards the border, shape (n, 2)."""
        if self.is_disc:
            rings, arms = order // 2 + 2, 2 * order + 3
            radius = np.cos(0.5 * np.pi * np.arange(rings) / (rings - 0.5))
            angle = 2.0 * np.pi * (np.arange(arms) + shift) / arms
            grid = np.stack(np.meshgrid(radius, angle, indexing="ij"), axis=-1).reshape(-1, 2)
            unit = grid[:, :1] * np.column_stack([np.sin(grid[:, 1]), np.cos(grid[:, 1])])
        else:
            side = np.cos(np.pi * (np.arange(order + 2) + 0.5 * shift) / (order + 1 + shift))
            unit = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
        return np.asarray(self.centre_mm + self.half_mm * unit)

    def scaled(self, points_mm: Array) -> Array:
        """Return points (y, x) in units of the half sides."""
        return np.asarray((points_mm - np.array(self.centre_mm)) / self.half_mm)


def region_of_object(scene: Scene) -> Region:
    """Return the object grid's box, or the lens's field where that is smaller."""
    grid, radius = scene.object_grid, scene.lens.half_field_mm
    half = np.array(grid.half_widths_mm)
    corner = math.hypot(*(abs(c) + h for c, h in zip(grid.centre_mm[::-1], half, strict=True)))
    if corner > radius and np.all(half >= 0.7 * radius):
        return Region((0.0, 0.0), np.full(2, radius), True)
    return Region((grid.centre_mm[1], grid.centre_mm[0]), half, False)


@dataclass(frozen=True, eq=False)
class OverObject:
    """Smooth maps whose coefficients are polynomials of a total order in the object point.

    Attributes
    ----------
    region : Region
    order : int
    middles : ndarray, shape (3, 2)
        Centre of the sensor box: at the centre of the region, and its change with a unit of y and of x.
    half_width : ndarray, shape (2,)
        Half-width of the sensor box.
    coefficients : ndarray, shape (terms, functions, n, n)
        Real or complex.
    """

    region: Region
    order: int
    middles: Array
    half_width: Array
    coefficients: NDArray

    def middle(self, point_mm: tuple[float, float]) -> Array:
        """Return the centre (y, x) of the sensor box of one object point (y, x)."""
        return np.asarray(box_middles(self.middles, self.region.scaled(np.array([point_mm])))[0])

    def at(self, point_mm: tuple[float, float]) -> SmoothMap:
        """Return the map of one object point (y, x)."""
        unit = self.region.scaled(np.array([point_mm]))
        weights = total_order_terms(unit, self.order)[0]
        values = np.tensordot(weights, self.coefficients, axes=1)
        return SmoothMap(box_middles(self.middles, unit)[0], self.half_width, values)


def box_middles(middles: Array, unit: Array) -> Array:
    """Return the centres of the sensor boxes of object points in units of the region, shape (n, 2)."""
    return np.asarray(middles[0] + unit @ middles[1:])


@dataclass(frozen=True, eq=False)
class _Node:
    """Rays of one object point, those beyond the edge of the aperture included."""

    point_mm: Array
    bundle: RayBundle
    edge: Array
    caustics: int

    @cached_property
    def values(self) -> Array:
        """Path, amplitude, cosines (y, x) and squared relative distance to the edge, shape (5, n)."""
        b = self.bundle
        return np.concatenate([b.path_mm[None], b.amplitude[None], b.cosines.T, self.edge[None]])


def _node(scene: Scene, point_mm: Array, plane_z_mm: float, order: int, shift: float = 0.0) -> _Node:
    point = np.array([point_mm[1], point_mm[0]])
    pupil = open_pupil(scene, (float(point[0]), float(point[1])), plane_z_mm, ARMS)
    rings, arms = order // 2 + 5, 2 * order + 8
    radius = REACH * np.cos(0.5 * np.pi * (np.arange(rings) + 0.5 * (1.0 + shift)) / (rings + 0.5 * shift))
    angle = 2.0 * np.pi * (np.arange(arms) + shift) / arms
    grid = np.stack(np.meshgrid(radius, angle, indexing="ij"), axis=-1).reshape(-1, 2)
    bundle = trace_bundle(scene, point, pupil.points(grid[:, 0], grid[:, 1]), plane_z_mm)
    caustics = check_no_fold(bundle, (float(point[0]), float(point[1])), plane_z_mm)
    return _Node(np.asarray(point_mm), bundle, grid[:, 0] ** 2, caustics)


@dataclass(frozen=True, eq=False)
class MapsOverObject:
    """Maps of a whole field.

    Attributes
    ----------
    carriers : OverObject
        Maps of path V in mm, amplitude in 1/mm, cosines p along y and x, and the squared relative distance to
        the aperture's edge.
    slopes : ndarray, shape (terms, 2, 2)
        Polynomials of order `SLOPE_ORDER` in the object point for :meth:`slopes_per_mm`.
    caustics : int
        Number of caustics that the light has touched.
    errors : (path, amplitude, direction)
        Largest differences from rays that were not fitted: waves, relative, waves over the reach of a tile.
    edge_error_mm : float
        Mean distance of the modelled edge of the aperture from that of rays that were not fitted, at the
        worst of the checked object points. It is large where the open part of the stop has corners.
    """

    carriers: OverObject
    slopes: Array
    caustics: int
    errors: tuple[float, float, float]
    edge_error_mm: float

    def slopes_per_mm(self, points_mm: Array) -> Array:
        """Return the largest `|dp_i / ds_j|` over the footprints of object points, in the order (y, x)."""
        terms = total_order_terms(self.carriers.region.scaled(points_mm), SLOPE_ORDER)
        return np.asarray(np.max(np.tensordot(terms, self.slopes, axes=1), axis=0))


def maps_over_object(
    scene: Scene, region: Region, plane_z_mm: float, reach_mm: float, tolerance: float
) -> MapsOverObject:
    """Trace the rays of a whole region, and fit its maps.

    Parameters
    ----------
    scene
        Lens, wavelength, coating.
    region
        Region of the object plane that emits light.
    plane_z_mm
        Plane behind the lens.
    reach_mm
        Largest distance of a tile's points from its centre.
    tolerance
        Allowed path error in waves, and relative error of the amplitude, at rays that were not fitted.

    Raises
    ------
    RayMapError
        If polynomials do not follow the rays so closely: near a caustic, or where the open part of the stop
        has corners.
    FoldError
        If rays fold on the plane.
    """
    checks = [_node(scene, point, plane_z_mm, 10, 0.37) for point in _held_out(region)]
    limits = np.array([tolerance, 10.0 * tolerance, tolerance])
    best: MapsOverObject | None = None
    for sensor_order, object_order in zip(SENSOR_ORDERS, OBJECT_ORDERS, strict=True):
        nodes = [_node(scene, p, plane_z_mm, sensor_order) for p in region.nodes(object_order)]
        if len({n.caustics for n in nodes}) > 1:
            raise RayMapError(
                f"plane z = {plane_z_mm:g} mm: light of parts of the field has touched different numbers of "
                "caustics; choose another plane"
            )
        inside = [n.bundle.ok for n in nodes]
        carriers = fit_over_object(
            region,
            (object_order, sensor_order),
            np.array([n.point_mm for n in nodes]),
            [n.bundle.sensor_mm[ok] for n, ok in zip(nodes, inside, strict=True)],
            [n.values[:, ok] for n, ok in zip(nodes, inside, strict=True)],
        )
        errors, edge_mm = _errors(carriers, checks, scene, reach_mm)
        best = MapsOverObject(
            carriers, _slopes(region, nodes), nodes[0].caustics, (errors[0], errors[1], errors[2]), edge_mm
        )
        if np.all(np.array(errors) < limits):
            return best
    assert best is not None
    raise RayMapError(
        f"the rays of the field are too rough on the plane z = {plane_z_mm:g} mm: the errors of polynomials "
        f"are {best.errors[0]:.2g} waves of path, {best.errors[1]:.2g} of the amplitude and "
        f"{best.errors[2]:.2g} waves by direction "
        f"(allowed: {limits[0]:.2g}, {limits[1]:.2g}, {limits[2]:.2g}); allow a larger error, "
        "stop the lens down, or go farther from the caustic"
    )


def _held_out(region: Region) -> Array:
    """Return points between the nodes, towards the border."""
    # Number of object points at which the polynomials are checked against rays that were not fitted.
    held_out = 7
    turn = 2.0 * np.pi * np.arange(held_out) * 0.381966
    share = np.sqrt((np.arange(held_out) + 0.5) / held_out)
    return np.asarray(region.centre_mm + region.half_mm * (share * np.stack([np.sin(turn), np.cos(turn)])).T)


def fit_over_object(
    region: Region,
    orders: tuple[int, int],
    points_mm: Array,
    sensor_mm: Sequence[Array],
    values: Sequence[NDArray],
) -> OverObject:
    """Fit polynomials in the sensor point at every node, then in the object point to their coefficients.

    Parameters
    ----------
    region
        The field.
    orders
        Total orders in the object point and in the sensor point.
    points_mm
        Object points (y, x), shape (nodes, 2).
    sensor_mm, values
        Sensor points, shape (n, 2), and values, shape (functions, n), for every node.
    """
    object_order, sensor_order = orders
    unit = region.scaled(points_mm)
    spans = np.array([[s.min(axis=0), s.max(axis=0)] for s in sensor_mm])
    plane = np.column_stack([np.ones(len(unit)), unit])
    middles = solve(plane, spans.mean(axis=1))
    half_width = np.max(np.abs(spans - (plane @ middles)[:, None]), axis=(0, 1))
    solutions = []
    for at, carried, place in zip(sensor_mm, values, unit, strict=True):
        relative = (at - box_middles(middles, place[None])) / half_width
        solutions.append(solve(total_order_terms(relative, sensor_order), carried.T))
    over = solve(total_order_terms(unit, object_order), np.stack(solutions).reshape(len(unit), -1))
    over = np.moveaxis(over.reshape(len(over), len(solutions[0]), -1), 2, 1)
    return OverObject(region, object_order, middles, half_width, on_square(over, sensor_order))


def _errors(
    carriers: OverObject, checks: list[_Node], scene: Scene, reach_mm: float
) -> tuple[tuple[float, float, float], float]:
    """Return errors of path, amplitude and direction (:class:`MapsOverObject`), and of the edge in mm."""
    wavelength_mm = 1e-3 * scene.wavelength_um
    worst = np.zeros(4)
    for node in checks:
        inside = node.bundle.ok & (node.edge <= 1.0)
        carrier = carriers.at((float(node.point_mm[0]), float(node.point_mm[1])))
        off = np.abs(carrier.at(node.bundle.sensor_mm[inside]) - node.values[:, inside])
        each = [
            off[0].max() / wavelength_mm,
            (off[1] / node.bundle.amplitude[inside]).max(),
            off[2:4].max() * reach_mm / wavelength_mm,
            off[4, node.edge[inside] > 0.9].mean(),
        ]
        worst = np.maximum(worst, each)
    # The square of a share falls by 2 over half a footprint.
    edge_mm = 0.5 * worst[3] * float(np.max(carriers.half_width))
    return (float(worst[0]), float(worst[1]), float(worst[2])), float(edge_mm)


def _slopes(region: Region, nodes: list[_Node]) -> Array:
    """Return the polynomials of :class:`MapsOverObject` for the slopes, as an upper bound at all nodes."""
    largest = []
    for node in nodes:
        b = node.bundle
        inside = b.ok & (node.edge <= 1.0)
        slopes = np.abs(b.cosine_jacobian[inside] @ np.linalg.inv(b.jacobian[inside]))
        largest.append(slopes.max(axis=0).ravel())
    terms = total_order_terms(region.scaled(np.array([node.point_mm for node in nodes])), SLOPE_ORDER)
    over = solve(terms, np.array(largest))
    over[0] += np.max(largest - terms @ over, axis=0)
    return over.reshape(-1, 2, 2)
