"""Errors at the aperture's edge of a field that rays carry."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import SamplingError
from wavesim.engines.eikonal.flat_tiles import Tile
from wavesim.fields.field import Grid
from wavesim.rays.maps import RayMap
from wavesim.rays.ray_bundles import shoot
from wavesim.scene.scene import Scene


def shared_spans(
    scene: Scene, tiles: Sequence[Tile], carriers: Sequence[RayMap], axes: Sequence[Array]
) -> list[NDArray[np.intp]]:
    """Return the samples of a plane inside the footprints of each tile and of all its neighbours.

    This applies to sharp edges; edges with Fresnel diffraction are computed for each tile. The result has the
    form of :meth:`RayMap.row_spans` for each tile.

    Raises
    ------
    SamplingError
        If neighbouring footprints overlap too little.
    """
    # Width of the region, in Fresnel zones on the stop, within which tiles share one footprint if edges are
    # sharp. Where the object as a whole sends no light, the fields of its tiles cancel each other. Edges that
    # are finer than diffraction allows would disturb this cancellation.
    shared_zones = 2.5
    width = shared_zones * _zone_mm(scene, float(scene.system.vertex[0, scene.lens.stop_index, 2]))
    groups = [_group(scene.object_grid, tile, width) for tile in tiles]
    common: dict[tuple[int, ...], NDArray[np.intp]] = {}
    for group, carrier in zip(groups, carriers, strict=True):
        spans = carrier.row_spans(axes)
        if group in common:
            first = np.maximum(common[group][:, 0], spans[:, 0])
            spans = np.column_stack([first, np.maximum(np.minimum(common[group][:, 1], spans[:, 1]), first)])
        common[group] = spans
    # Least fraction of its footprint that a tile must share with its neighbours.
    least_shared = 0.7
    for group, carrier in zip(groups, carriers, strict=True):
        own, shared = (int(np.sum(s[:, 1] - s[:, 0])) for s in (carrier.row_spans(axes), common[group]))
        if shared < least_shared * own:
            raise SamplingError(
                f"plane z = {carrier.plane_z_mm:g} mm: neighbouring tiles illuminate different parts of it, "
                "since it lies near an image of the object; choose plane_z_mm nearer to the lens"
            )
    return [common[group] for group in groups]


def _group(grid: Grid, tile: Tile, width_mm: float) -> tuple[int, ...]:
    counts = [max(1, math.ceil(2.0 * half / width_mm)) for half in grid.half_widths_mm]
    middles = [0.5 * (part.start + part.stop) for part in tile.part]
    return tuple(int(m * c / n) for m, c, n in zip(middles, counts, grid.shape, strict=True))


def _zone_mm(scene: Scene, z_mm: float) -> float:
    """Return the radius of the first Fresnel zone of an object point on a plane."""
    return math.sqrt(1e-3 * scene.wavelength_um * (z_mm - scene.object_grid.z_mm))


def edge_error(scene: Scene, tile: Tile, carrier: RayMap) -> tuple[float, float]:
    """Return the relative errors of the field from a moving footprint, and from a sharp edge.

    Both follow from fractions of the evenly lit footprint near its rim: the strip by which the footprints of
    the tile's points differ from the centre's, and the first Fresnel zone between the lens and the plane.
    """
    moved = []
    for corner in ([o[end] for o in tile.offsets_mm] for end in (0, -1)):
        point = np.array(tile.centre_mm)
        point[1] += corner[0]
        if len(corner) == 2:
            point[0] += corner[1]
        points = np.broadcast_to(point, carrier.pupil.rim.shape)
        end = shoot(scene, points, carrier.pupil.rim, carrier.plane_z_mm, clip=False).position
        axes = [1] if carrier.pupil.is_line else [1, 0]
        moved.append(np.mean(np.linalg.norm(end[:, axes] - carrier.rim_mm, axis=1)))
    # Fraction of the displacement between the footprints of a tile's ends and of its centre that counts as
    # lost. The mean point of a tile is half as far away, and edges with diffraction differ by less than sharp
    # ones. The second value is measured.
    lost_strip = {"sharp": 0.5, "drawn": 0.2}
    strip = lost_strip["sharp" if carrier.edge is None else "drawn"] * float(np.nanmax(moved))
    apart = max(carrier.plane_z_mm - float(scene.system.vertex[0, 0, 2]), 0.0)
    zone = math.sqrt(1e-3 * scene.wavelength_um * apart)
    per_mm = rim_fraction_per_mm(carrier.rim_mm)
    return tuple(min(1.0, math.sqrt(per_mm * width)) for width in (strip, 0.1 * zone))  # type: ignore[return-value]


def drawn_error(scene: Scene, tile: Tile, carrier: RayMap, sharp: float) -> float:
    """Return the relative error of an edge with Fresnel diffraction, from the error of a sharp edge.

    Light beyond the band of the object grid before the rim still has a sharp edge.
    """
    if carrier.edge is None:
        return sharp
    resolved = carrier.edge.resolved_to(tile.width_mm)
    limit = 0.5e-3 * scene.wavelength_um / tile.pitch_mm
    cut = float(np.mean(np.any(np.abs(carrier.maps.at(carrier.rim_mm)[2:]) > limit, axis=0)))
    # Energy that diffraction moves beyond x = 1 from a sharp edge, as a fraction of all that it moves; beyond
    # x it is this fraction over x. The x is that of :mod:`wavesim.rays.edge_diffraction`.
    far_energy = 0.35
    unresolved = min(1.0, far_energy / resolved + cut)
    # Error of Fresnel's edge as a multiple of the squared error of a sharp edge: the next order in wavelength
    # over distance. Measured on twins of the paper's lens.
    second_order = 0.5
    return min(sharp, math.hypot(second_order * sharp**2, sharp * math.sqrt(unresolved)))


def rim_fraction_per_mm(rim_mm: Array) -> float:
    """Return the fraction of the footprint in a strip along its rim, per mm of the strip's width."""
    if rim_mm.shape[1] == 1:
        return 2.0 / float(np.ptp(rim_mm))
    y, x = rim_mm.T
    following = np.roll(rim_mm, -1, axis=0)
    area = 0.5 * abs(float(np.sum(y * following[:, 1] - x * following[:, 0])))
    return float(np.sum(np.linalg.norm(following - rim_mm, axis=1))) / area
