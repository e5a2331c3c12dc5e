"""What goes wrong at the aperture's edge when rays carry the field."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import SamplingError
from wavesim.engines.tiles.operator import Tile
from wavesim.fields.field import Grid
from wavesim.rays.maps import RayMap
from wavesim.rays.ray_bundles import shoot
from wavesim.scene.scene import Scene

SHARED_ZONES = 2.5
"""Where edges are sharp, tiles whose centres lie within so many Fresnel zones of the stop share one edge.

Their fields cancel each other where the whole object sends no light; edges finer than light can draw them
would cut pieces out of that.
"""

LEAST_SHARED = 0.7
"""Share of its footprint that a tile must have in common with its neighbours."""


UNTOLD = 0.35
"""Of the energy that diffraction moves at a sharp edge, what goes farther from it than 1, in x of
:mod:`wavesim.rays.edges`; farther than x: so much over x."""

MOVED = {"sharp": 0.5, "drawn": 0.2}
"""Of the way by which footprints of a tile's ends differ from the centre's, what counts as lost: its mean
point is half as far away, and edges that light draws differ by less than sharp ones. The second measured."""

SECOND_ORDER = 0.5
"""Error of Fresnel's edge, as a multiple of the squared error of a sharp one: the next order in
wavelength over distances. Measured on twins of the paper's lens."""


def shared_spans(
    scene: Scene, tiles: Sequence[Tile], carriers: Sequence[RayMap], axes: Sequence[Array]
) -> list[NDArray[np.intp]]:
    """Samples of a plane inside the footprints of each tile and of all its neighbours, one for each tile.

    For edges that are sharp; those that Fresnel integrals draw are each tile's own.

    As :meth:`RayMap.row_spans`.

    Raises
    ------
    SamplingError
        If neighbouring footprints have too little in common.
    """
    width = SHARED_ZONES * _zone_mm(scene, float(scene.system.vertex[0, scene.lens.stop_index, 2]))
    groups = [_group(scene.object_grid, tile, width) for tile in tiles]
    common: dict[tuple[int, ...], NDArray[np.intp]] = {}
    for group, carrier in zip(groups, carriers, strict=True):
        spans = carrier.row_spans(axes)
        if group in common:
            first = np.maximum(common[group][:, 0], spans[:, 0])
            spans = np.column_stack([first, np.maximum(np.minimum(common[group][:, 1], spans[:, 1]), first)])
        common[group] = spans
    for group, carrier in zip(groups, carriers, strict=True):
        own, left = (int(np.sum(s[:, 1] - s[:, 0])) for s in (carrier.row_spans(axes), common[group]))
        if left < LEAST_SHARED * own:
            raise SamplingError(
                f"plane z = {carrier.plane_z_mm:g} mm: neighbouring tiles light different parts of it: it "
                "lies near an image of the object; choose plane_z_mm nearer to the lens"
            )
    return [common[group] for group in groups]


def _group(grid: Grid, tile: Tile, width_mm: float) -> tuple[int, ...]:
    counts = [max(1, math.ceil(2.0 * half / width_mm)) for half in grid.half_widths_mm]
    middles = [0.5 * (part.start + part.stop) for part in tile.part]
    return tuple(int(m * c / n) for m, c, n in zip(middles, counts, grid.shape, strict=True))


def _zone_mm(scene: Scene, z_mm: float) -> float:
    """Radius of the first Fresnel zone of an object point, on a plane."""
    return math.sqrt(1e-3 * scene.wavelength_um * (z_mm - scene.object_grid.z_mm))


def edge_error(scene: Scene, tile: Tile, carrier: RayMap) -> tuple[float, float]:
    """Relative errors of the field: from a footprint that moves over a tile, and from a sharp edge.

    Both are shares of the footprint near its rim, taken for evenly lit: the strip by which the footprints of
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
    strip = MOVED["sharp" if carrier.edge is None else "drawn"] * float(np.nanmax(moved))
    apart = max(carrier.plane_z_mm - float(scene.system.vertex[0, 0, 2]), 0.0)
    zone = math.sqrt(1e-3 * scene.wavelength_um * apart)
    share = rim_share(carrier.rim_mm)
    return tuple(min(1.0, math.sqrt(share * width)) for width in (strip, 0.1 * zone))  # type: ignore[return-value]


def drawn_error(scene: Scene, tile: Tile, carrier: RayMap, sharp: float) -> float:
    """Relative error of the field from an edge that Fresnel integrals draw, of that of a sharp edge.

    Light that the object grid ends before it comes to the rim has a sharp edge all the same.
    """
    if carrier.edge is None:
        return sharp
    told = carrier.edge.told(tile.width_mm)
    held = 0.5e-3 * scene.wavelength_um / tile.pitch_mm
    cut = float(np.mean(np.any(np.abs(carrier.maps.at(carrier.rim_mm)[2:]) > held, axis=0)))
    untold = min(1.0, UNTOLD / told + cut)
    return min(sharp, math.hypot(SECOND_ORDER * sharp**2, sharp * math.sqrt(untold)))


def rim_share(rim_mm: Array) -> float:
    """Share of the footprint in a strip along its rim, per mm of its width."""
    if rim_mm.shape[1] == 1:
        return 2.0 / float(np.ptp(rim_mm))
    y, x = rim_mm.T
    turned = np.roll(rim_mm, -1, axis=0)
    area = 0.5 * abs(float(np.sum(y * turned[:, 1] - x * turned[:, 0])))
    return float(np.sum(np.linalg.norm(turned - rim_mm, axis=1))) / area
