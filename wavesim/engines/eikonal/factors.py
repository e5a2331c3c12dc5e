"""Expansion of the residual beyond the Fourier kernel, for all tiles of a field.

It has the form of :mod:`wavesim.engines.eikonal.residual`, but all tiles share the tile factors v_r(d), and
the coefficients of the sensor factors u_r(s) are polynomials in the tile's centre.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.engines.eikonal.ray_maps import OverObject, Region, fit_over_object, object_terms, solve
from wavesim.engines.eikonal.residual import MAX_RANK, Separable, at_tile_nodes, tile_residual
from wavesim.rays.maps import RayMap, RayMapError
from wavesim.scene.scene import Scene


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
    logarithm: NDArray[np.complex128]
    tile_nodes: NDArray[np.complex128]
    spans_mm: Array
    relative_error: float

    def at(self, point_mm: tuple[float, float]) -> Separable:
        """Return the expansion of the tile about an object point (y, x)."""
        unit = self.sensor.region.scaled(np.array([point_mm]))
        shared = np.tensordot(object_terms(unit, self.sensor.order)[0], self.logarithm, axes=1)
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
        f"{len(found.tile_nodes)} terms over tiles of {1e3 * float(np.max(np.ptp(spans_mm, axis=1))):.3g} um "
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
    logarithm = solve(object_terms(region.scaled(points), order), means.reshape(len(points), -1))
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
) -> NDArray[np.complex128]:
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
