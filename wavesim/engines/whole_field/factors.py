"""What tiles leave out beside the Fourier kernel, all over a field: one set of tile factors.

As :mod:`wavesim.engines.tiles.residual` has it for one tile, but with tile factors v_r(d) that serve every
tile, and sensor factors u_r(s) whose coefficients are polynomials in the tile's centre.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.engines.tiles.residual import MAX_RANK, Separable, at_tile_nodes, tile_residual
from wavesim.engines.whole_field.ray_maps import OverObject, Region, fit_over_object, object_terms, solve
from wavesim.rays.maps import RayMap, RayMapError
from wavesim.scene.scene import Scene

SENSOR_ORDER = 12
OBJECT_ORDERS = (2, 4)
"""In the object point; the first that follows is taken. The lower one asks for less than half of the rays."""

SPECTRUM_SHARE = 0.5
"""Of the error allowed, what terms left out may take; the rest is for polynomials."""


@dataclass(frozen=True, eq=False)
class FactorsOverObject:
    """The expansion of all tiles.

    Attributes
    ----------
    sensor : OverObject
        u_r(s), complex.
    logarithm : ndarray, shape (terms, nodes, nodes)
        Of the factor that all tile factors share, as polynomials in the tile's centre.
    tile_nodes : ndarray, shape (rank, nodes, nodes)
        The rest of the tile factors.
    spans_mm : ndarray, shape (2, 2)
        Of every tile about its centre.
    relative_error : float
        Of the expansion, in the worst of the tiles looked at.
    """

    sensor: OverObject
    logarithm: NDArray[np.complex128]
    tile_nodes: NDArray[np.complex128]
    spans_mm: Array
    relative_error: float

    def at(self, point_mm: tuple[float, float]) -> Separable:
        """The expansion of the tile about an object point (y, x)."""
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
    """The shortest expansion that holds all over a region.

    Parameters
    ----------
    scene, region
        The field.
    spans_mm
        From where to where tiles extend about their centres, shape (2, 2).
    mapper
        Ray maps of object points (x, y).
    error
        Relative error allowed.

    Raises
    ------
    RayMapError
        If more than 32 terms are needed, or polynomials cannot follow the factors: tiles are too wide.
    """
    for order in OBJECT_ORDERS:
        found = _factors_of_order(order, scene, region, spans_mm, mapper, error)
        if found.relative_error <= error:
            return found
        if len(found.tile_nodes) == MAX_RANK:  # not for want of a higher order
            break
    raise RayMapError(
        f"{len(found.tile_nodes)} terms over tiles of {1e3 * float(np.max(np.ptp(spans_mm, axis=1))):.3g} um "
        f"leave a relative error of {found.relative_error:.2g}, {error:.2g} is allowed: make tiles narrower"
    )


def _factors_of_order(
    order: int,
    scene: Scene,
    region: Region,
    spans_mm: Array,
    mapper: Callable[[tuple[float, float]], RayMap],
    error: float,
) -> FactorsOverObject:
    """As :func:`factors_over_object`, by polynomials of one order, whose error may be more than allowed."""
    points = region.nodes(order)
    places = [(float(x), float(y)) for y, x in points]
    residuals = [tile_residual(scene, place, spans_mm, mapper(place)) for place in places]
    values, shares = [r.fine[0] for r in residuals], residuals[0].fine[1]
    basis = _shared_basis([r.weights for r in residuals], values, shares, SPECTRUM_SHARE * error)
    tile = basis / np.sqrt(shares)
    factors = [(v * np.sqrt(shares) @ basis.conj().T).T for v in values]
    sensor = fit_over_object(region, (order, SENSOR_ORDER), points, [r.sensor_mm for r in residuals], factors)
    means = np.stack([r.mean for r in residuals])
    logarithm = solve(object_terms(region.scaled(points), order), means.reshape(len(points), -1))
    left = 0.0
    for residual, value, (x, y) in zip(residuals, values, places, strict=True):
        missed = value - sensor.at((y, x)).at(residual.sensor_mm).T @ tile
        left = max(left, float(np.sqrt(residual.weights @ np.abs(missed) ** 2 @ shares)))
    return FactorsOverObject(
        sensor, logarithm.reshape(-1, *means.shape[1:]), at_tile_nodes(tile, 2), spans_mm, left
    )


def _shared_basis(
    weights: Sequence[Array], values: Sequence[NDArray], shares: Array, error: float
) -> NDArray[np.complex128]:
    """Orthonormal rows, over Gauss points of the tile, that leave no tile a larger error."""
    scaled = [np.sqrt(w)[:, None] * v * np.sqrt(shares) for w, v in zip(weights, values, strict=True)]
    strength, vectors = np.linalg.eigh(sum(s.conj().T @ s for s in scaled))
    rows = vectors[:, np.argsort(strength)[::-1]].conj().T[:MAX_RANK]
    kept = [np.cumsum(np.sum(np.abs(s @ rows.conj().T) ** 2, axis=0)) for s in scaled]
    left = np.max(
        [
            np.sqrt(np.maximum(1.0 - k / np.sum(np.abs(s) ** 2), 0.0))
            for k, s in zip(kept, scaled, strict=True)
        ],
        axis=0,
    )
    enough = np.nonzero(left <= error)[0]
    return np.asarray(rows[: int(enough[0]) + 1 if len(enough) else MAX_RANK])
