"""Residual of a tile's field beyond the Fourier transform of its object, and a short expansion of it.

The light of object point c + d at sensor point s differs from that of c by a factor exp(-i k p(s).d) R(s, d).
The first part is the Fourier kernel. The residual R = a'/a exp(i k (V' - V + p.d)) contains the rest: the
quadratic and cubic terms of V in d, and the change of amplitude. It is sampled by rays from points of the
tile that are aimed at the sensor points of the rays from c. A sum of few terms sum_r u_r(s) v_r(d)
approximates it: its mean over the footprint, or as many of its singular vectors as the allowed error
requires. All tiles of a hierarchy share the tile factors v_r(d), and the coefficients of the sensor factors
u_r(s) are polynomials in the tile's centre.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.engines.eikonal.ray_maps import OverObject, Region, fit_over_object
from wavesim.rays.maps import (
    RayMap,
    RayMapError,
    SmoothMap,
    fit_map,
    sample_points,
    solve,
    total_order_terms,
)
from wavesim.rays.ray_bundles import inverses, shoot, trace_bundle
from wavesim.scene.scene import Scene

ComplexArray = NDArray[np.complex128]
Quadratic = Literal["mean", "low-rank"]

NODES = 5
"""Points along each side of a tile from which rays are aimed; the exponent of R is of fourth order in d."""

FINE_NODES = 14
SAMPLE_ORDER, FACTOR_ORDER = {True: 48, False: 14}, {True: 40, False: 12}
"""Orders of the rays' sampling, and of the polynomials for u_r(s), on a line and on a plane."""

MAX_RANK = 32


@dataclass(frozen=True, eq=False)
class Separable:
    """R(s, d) as a sum of products.

    Attributes
    ----------
    sensor_factors : SmoothMap or None
        u_r(s) of all terms; None for the single factor 1.
    logarithm : ndarray, shape (nodes[, nodes])
        Logarithm of a factor that all v_r(d) share, at Chebyshev points of the tile (y, x).
    tile_nodes : ndarray, shape (rank, nodes[, nodes])
        The other factor of v_r(d), at Chebyshev points of the tile.
    spans_mm : ndarray, shape (d, 2)
        Extent of the tile about c, in the order (y, x).
    relative_error : float
        Root of the mean of |R - sum|^2 over tile and footprint.
    """

    sensor_factors: SmoothMap | None
    logarithm: ComplexArray
    tile_nodes: ComplexArray
    spans_mm: Array
    relative_error: float

    @property
    def rank(self) -> int:
        """Number of terms."""
        return len(self.tile_nodes)

    def tile_factors(self, offsets_mm: list[Array]) -> ComplexArray:
        """Return v_r(d) on the grid of offsets (y, or y and x), shape (rank, ny[, nx])."""
        return np.asarray(np.exp(self.shared_logarithm(offsets_mm)) * self.own_tile_factors(offsets_mm))

    def shared_logarithm(self, offsets_mm: list[Array]) -> ComplexArray:
        """Return the logarithm of the common factor of all v_r(d) on the offsets, shape (ny[, nx])."""
        return self._at(self.logarithm[None], offsets_mm)[0]

    def own_tile_factors(self, offsets_mm: list[Array]) -> ComplexArray:
        """Return the other factor of v_r(d) on the grid of offsets, shape (rank, ny[, nx])."""
        return self._at(self.tile_nodes, offsets_mm)

    def _at(self, values: ComplexArray, offsets_mm: list[Array]) -> ComplexArray:
        positions = [_scaled(o, span) for o, span in zip(offsets_mm, self.spans_mm, strict=True)]
        return _along_axes([_interpolation(values.shape[1], p) for p in positions], values)


@dataclass(frozen=True, eq=False)
class Residual:
    """Samples of ln R(s, d) for one tile.

    Attributes
    ----------
    sensor_mm : ndarray, shape (n, d)
        Sensor points.
    weights : ndarray, shape (n,)
        Fraction of the light of an even spectrum at each sensor point, 0 in the shadow behind the rim; their
        sum is 1.
    logarithm : complex ndarray, shape (n, nodes[, nodes])
        Values at the Chebyshev points of the tile, borders included.
    spans_mm : ndarray, shape (d, 2)
        Extent of the tile about c.
    """

    sensor_mm: Array
    weights: Array
    logarithm: ComplexArray
    spans_mm: Array

    @cached_property
    def mean(self) -> ComplexArray:
        """Mean of the logarithm over the footprint, shape (nodes[, nodes])."""
        return np.asarray(np.tensordot(self.weights, self.logarithm, axes=1))

    @cached_property
    def neglected_waves(self) -> tuple[float, float]:
        """Path beyond the mean at the tile's worst point, in waves: rms over the footprint, and largest."""
        waves = (self.logarithm - self.mean).imag[self.weights > 0.0] / (2.0 * np.pi)
        square = np.tensordot(self.weights[self.weights > 0.0], waves**2, axes=1)
        return float(np.sqrt(square.max())), float(np.abs(waves).max())

    @cached_property
    def fine(self) -> tuple[ComplexArray, Array]:
        """R over its mean at Gauss points of the tile, shape (n, m), and their weights."""
        points, weights = np.polynomial.legendre.leggauss(FINE_NODES)
        matrices = [_interpolation(NODES, points)] * len(self.spans_mm)
        values = _along_axes(matrices, self.logarithm - self.mean).reshape(len(self.weights), -1)
        gauss = 0.5 * weights
        if len(self.spans_mm) == 2:
            gauss = np.multiply.outer(gauss, gauss).ravel()
        return np.exp(values), gauss

    def mean_error(self) -> float:
        """Return the relative error of the exit field if R is replaced by its mean."""
        values, gauss = self.fine
        return float(np.sqrt(self.weights @ np.abs(values - 1.0) ** 2 @ gauss))

    def mean_term(self) -> Separable:
        """Return the expansion by the mean of ln R over the footprint only."""
        one = np.ones((1,) + (1,) * len(self.spans_mm), complex)
        return Separable(None, self.mean, one, self.spans_mm, self.mean_error())

    @cached_property
    def _singular(self) -> tuple[Array, ComplexArray]:
        """Singular values, and right vectors as rows."""
        values, gauss = self.fine
        lit = self.weights > 0.0
        scaled = np.sqrt(self.weights[lit])[:, None] * values[lit] * np.sqrt(gauss)
        return np.linalg.svd(np.linalg.qr(scaled, mode="r"), full_matrices=False)[1:]

    @cached_property
    def _errors(self) -> Array:
        """Relative errors of 0, 1, ... terms."""
        rest = np.cumsum(self._singular[0][::-1] ** 2)[::-1]
        return np.asarray(np.sqrt(np.append(rest, 0.0) / rest[0]))

    def error_of(self, rank: int) -> float:
        """Return the relative error of a number of terms."""
        return float(self._errors[rank])

    def rank_for(self, error: float) -> int:
        """Return the smallest number of terms with at most a relative error."""
        return max(1, int(np.argmax(self._errors <= error)))

    def low_rank(self, error: float) -> Separable:
        """Return the shortest expansion with at most a relative error, of at most `MAX_RANK` terms.

        Raises
        ------
        RayMapError
            If polynomials cannot represent its factors over the footprint.
        """
        rank = min(self.rank_for(error), MAX_RANK)
        right = self._singular[1]
        values, gauss = self.fine
        # The factors also cover points without weight, in the shadow behind the rim.
        factors = (values * np.sqrt(gauss) @ right[:rank].conj().T).T
        sensor = fit_map(self.sensor_mm, factors, FACTOR_ORDER[len(self.spans_mm) == 1])
        tile = right[:rank] / np.sqrt(gauss)
        missed = values - sensor.at(self.sensor_mm).T @ tile
        rest = float(np.sqrt(self.weights @ np.abs(missed) ** 2 @ gauss))
        if rest > self.error_of(rank) + error:
            raise RayMapError(
                f"{rank} terms over a tile leave a relative error of {rest:.2g} (allowed: {error:.2g}): "
                "make tiles narrower"
            )
        return Separable(sensor, self.mean, at_tile_nodes(tile, len(self.spans_mm)), self.spans_mm, rest)


def at_tile_nodes(factors: ComplexArray, dimensions: int) -> ComplexArray:
    """Convert tile factors, shape (rank, m), from the Gauss points of `Residual.fine` to Chebyshev points."""
    points = np.polynomial.legendre.leggauss(FINE_NODES)[0]
    to_nodes = np.asarray(np.linalg.inv(_interpolation(FINE_NODES, points)), float)
    factors = factors.reshape(len(factors), *(FINE_NODES,) * dimensions)
    return _along_axes([to_nodes] * dimensions, factors)


def tile_residual(scene: Scene, point_mm: tuple[float, float], spans_mm: Array, carrier: RayMap) -> Residual:
    """Compare rays from a tile's points with rays from c that meet the same sensor points.

    Parameters
    ----------
    scene
        Lens and object plane.
    point_mm
        The point c, (x, y).
    spans_mm
        Extent of the tile about c, shape (d, 2), in the order (y, x).
    carrier
        Ray map of c.

    Raises
    ------
    RayMapError
        If rays from the tile's border cannot be aimed at the footprint of c.
    """
    d, order = len(spans_mm), SAMPLE_ORDER[len(spans_mm) == 1]
    pupil = sample_points(carrier.traced, order)
    base = trace_bundle(scene, np.asarray(point_mm), pupil, carrier.plane_z_mm)
    grids = np.meshgrid(*[_scale_back(_nodes(NODES), span) for span in spans_mm], indexing="ij")
    offsets = np.stack([g.ravel() for g in grids], axis=-1)
    n, m = len(pupil), len(offsets)
    points = np.asarray(point_mm) + np.repeat(_as_xy(offsets), n, axis=0)
    stop = np.tile(pupil, (m, 1))
    inverse = np.tile(inverses(base.jacobian), (m, 1, 1))
    target = np.tile(base.sensor_mm, (m, 1))
    axes = [1] if d == 1 else [1, 0]
    aim_steps = 5
    aimed_mm = 1e-6
    for _ in range(aim_steps):
        end = shoot(scene, points, stop, carrier.plane_z_mm, clip=False)
        miss = np.where(end.ok[:, None], target - end.position[:, axes], 0.0)
        if np.max(np.abs(miss)) < 0.1 * aimed_mm:
            break
        stop = stop + _as_xy(np.einsum("nij,nj->ni", inverse, miss))
    aimed = trace_bundle(scene, points, stop, carrier.plane_z_mm)
    miss = target - aimed.sensor_mm
    good = (aimed.ok & (np.abs(miss).max(axis=1) < aimed_mm)).reshape(m, n).all(axis=0) & base.ok
    lit = carrier.pupil.inwards(pupil) > 0.0
    reached, all_lit = np.count_nonzero(good & lit), np.count_nonzero(lit)
    if reached < 0.7 * all_lit:
        raise RayMapError(
            f"only {reached} of {all_lit} sensor points in the footprint of "
            f"({point_mm[0]:g}, {point_mm[1]:g}) mm are reached from its whole tile: make tiles narrower"
        )
    path = (aimed.path_mm + np.sum(aimed.slopes * miss, axis=1)).reshape(m, n) - base.path_mm
    phase = scene.wavenumber_per_mm * (path + offsets @ base.cosines.T)
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.log(aimed.amplitude.reshape(m, n) / base.amplitude) + 1j * phase
    cell = np.abs(np.linalg.det(base.cosine_jacobian)) * _stop_cells(pupil, carrier)
    weights = np.where(lit, cell, 0.0)[good]
    return Residual(
        base.sensor_mm[good],
        weights / weights.sum(),
        logarithm[:, good].T.reshape(-1, *(NODES,) * d),
        spans_mm,
    )


@dataclass(frozen=True, eq=False)
class FactorsOverObject:
    """Expansion of the residual of all tiles.

    Attributes
    ----------
    sensor : OverObject
        Sensor factors u_r(s), complex.
    logarithm : ndarray, shape (terms, nodes, nodes)
        Logarithm of the common factor of all tile factors, as polynomials in the tile's centre.
    tile_nodes : ndarray, shape (rank, nodes, nodes)
        The other factors of the tile factors.
    spans_mm : ndarray, shape (2, 2)
        Extent of every tile about its centre.
    relative_error : float
        Largest relative error of the expansion in the probed tiles.
    """

    sensor: OverObject
    logarithm: ComplexArray
    tile_nodes: ComplexArray
    spans_mm: Array
    relative_error: float

    def at(self, point_mm: tuple[float, float]) -> Separable:
        """Return the expansion of the tile about an object point (y, x)."""
        unit = self.sensor.region.scaled(np.array([point_mm]))
        shared = np.tensordot(total_order_terms(unit, self.sensor.order)[0], self.logarithm, axes=1)
        return Separable(
            self.sensor.at(point_mm), shared, self.tile_nodes, self.spans_mm, self.relative_error
        )


def factors_over_object(
    scene: Scene,
    region: Region,
    spans_mm: Array,
    mapper: Callable[[tuple[float, float]], RayMap],
    error: float,
) -> FactorsOverObject:
    """Return the shortest expansion that meets the error limit over a whole region.

    Parameters
    ----------
    scene, region
        Scene, and region of the object plane.
    spans_mm
        Extent of the tiles about their centres, shape (2, 2).
    mapper
        Ray maps of object points (x, y).
    error
        Allowed relative error.

    Raises
    ------
    RayMapError
        If more than 32 terms are needed, or polynomials cannot represent the factors; tiles are then too
        wide.
    """
    # The first accurate order in the object point is used. The lower one needs less than half of the rays.
    object_orders = (2, 4)
    for order in object_orders:
        found = _factors_of_order(order, scene, region, spans_mm, mapper, error)
        if found.relative_error <= error:
            return found
        if len(found.tile_nodes) == MAX_RANK:  # a higher order would not help
            break
    raise RayMapError(
        f"{len(found.tile_nodes)} terms over tiles of {1e3 * float(np.max(np.ptp(spans_mm, axis=1))):.3g} µm "
        f"leave a relative error of {found.relative_error:.2g} (allowed: {error:.2g}): make tiles narrower"
    )


def _factors_of_order(
    order: int,
    scene: Scene,
    region: Region,
    spans_mm: Array,
    mapper: Callable[[tuple[float, float]], RayMap],
    error: float,
) -> FactorsOverObject:
    """Return the expansion with polynomials of one order; its error may exceed the limit."""
    points = region.nodes(order)
    centres = [(float(x), float(y)) for y, x in points]
    residuals = [tile_residual(scene, centre, spans_mm, mapper(centre)) for centre in centres]
    values, quadrature = [r.fine[0] for r in residuals], residuals[0].fine[1]
    # Fraction of the allowed error for omitted terms; the rest is for polynomials.
    spectrum_fraction = 0.5
    basis = _shared_basis([r.weights for r in residuals], values, quadrature, spectrum_fraction * error)
    tile = basis / np.sqrt(quadrature)
    factors = [(v * np.sqrt(quadrature) @ basis.conj().T).T for v in values]
    sensor_order = 12
    sensor = fit_over_object(region, (order, sensor_order), points, [r.sensor_mm for r in residuals], factors)
    means = np.stack([r.mean for r in residuals])
    logarithm = solve(total_order_terms(region.scaled(points), order), means.reshape(len(points), -1))
    largest_error = 0.0
    for residual, value, (x, y) in zip(residuals, values, centres, strict=True):
        missed = value - sensor.at((y, x)).at(residual.sensor_mm).T @ tile
        largest_error = max(
            largest_error, float(np.sqrt(residual.weights @ np.abs(missed) ** 2 @ quadrature))
        )
    return FactorsOverObject(
        sensor, logarithm.reshape(-1, *means.shape[1:]), at_tile_nodes(tile, 2), spans_mm, largest_error
    )


def _shared_basis(
    weights: Sequence[Array], values: Sequence[NDArray], quadrature: Array, error: float
) -> ComplexArray:
    """Return the fewest orthonormal rows that meet the error limit for all tiles.

    Columns are the Gauss points of a tile, with the weights `quadrature`.
    """
    scaled = [np.sqrt(w)[:, None] * v * np.sqrt(quadrature) for w, v in zip(weights, values, strict=True)]
    strength, vectors = np.linalg.eigh(sum(s.conj().T @ s for s in scaled))
    rows = vectors[:, np.argsort(strength)[::-1]].conj().T[:MAX_RANK]
    represented = [np.cumsum(np.sum(np.abs(s @ rows.conj().T) ** 2, axis=0)) for s in scaled]
    error_by_rank = np.max(
        [
            np.sqrt(np.maximum(1.0 - k / np.sum(np.abs(s) ** 2), 0.0))
            for k, s in zip(represented, scaled, strict=True)
        ],
        axis=0,
    )
    enough = np.nonzero(error_by_rank <= error)[0]
    return np.asarray(rows[: int(enough[0]) + 1 if len(enough) else MAX_RANK])


def _stop_cells(pupil: Array, carrier: RayMap) -> Array:
    """Return the relative area of the stop for each point of the Chebyshev sampling."""
    radius = np.linalg.norm(pupil - carrier.traced.centre, axis=1) / carrier.traced.reach.max()
    measure = np.sqrt(np.maximum(1.0 - radius**2, 1e-4))
    return measure if carrier.pupil.is_line else measure * radius


def _as_xy(values: Array) -> Array:
    """Return points (y) or (y, x) as (x, y)."""
    return np.column_stack([values[:, 1] if values.shape[1] == 2 else np.zeros(len(values)), values[:, 0]])


def _nodes(count: int) -> Array:
    """Return the Chebyshev points of [-1, 1], borders included, ascending."""
    return np.asarray(-np.cos(np.pi * np.arange(count) / (count - 1)))


def _scaled(offsets: Array, span: Array) -> Array:
    half = 0.5 * (span[1] - span[0])
    return (offsets - 0.5 * (span[0] + span[1])) / (half if half > 0.0 else 1.0)


def _scale_back(nodes: Array, span: Array) -> Array:
    return np.asarray(0.5 * (span[0] + span[1]) + 0.5 * (span[1] - span[0]) * nodes)


def _interpolation(nodes: int, at: Array) -> Array:
    """Return the matrix from values at Chebyshev points to values elsewhere."""
    if nodes == 1:
        return np.ones((len(at), 1))
    basis = chebyshev.chebvander(_nodes(nodes), nodes - 1)
    return np.asarray(np.linalg.solve(basis.T, chebyshev.chebvander(at, nodes - 1).T).T)


def _along_axes(matrices: list[Array], values: NDArray) -> NDArray:
    """Apply one matrix to each axis of values but the first."""
    for axis, matrix in enumerate(matrices, start=1):
        values = np.moveaxis(np.tensordot(values, matrix, axes=(axis, 1)), -1, axis)
    return values
