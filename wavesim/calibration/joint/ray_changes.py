"""How rays behind a slightly different lens, or on a sensor that sits elsewhere, differ from a tile's.

A ray's path is stationary: to first order a change of the lens changes the path from an object point to a
sensor point by what the changed lens's rays show there, and nothing else. A tile's field is multiplied by
i k times that of its centre; away from it the path changes by the change of the direction in which rays leave
the object, times the distance from the centre.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.poses import rotation_matrix
from wavesim.engines.tiles.operator import Tile
from wavesim.fields.field import Grid
from wavesim.rays.maps import RayMap, SmoothMap, fit_map, sample_points
from wavesim.rays.ray_bundles import RayBundle, trace_bundle
from wavesim.runtime.threads import one_blas_thread
from wavesim.scene.scene import Scene

ORDER = 10
"""Of the polynomials through changes of path, which are smooth."""


class SensorPose(NamedTuple):
    """How a sensor sits off the grid of an engine: farther along z, aside, and tilted about its middle.

    Tilts are those of :class:`wavesim.scene.Placement`.
    """

    distance_mm: float = 0.0
    shift_mm: tuple[float, float] = (0.0, 0.0)
    tilt_deg: tuple[float, float] = (0.0, 0.0)


ON_GRID = SensorPose()


def ray_changes(
    scene: Scene,
    tile: Tile,
    carrier: RayMap,
    grid: Grid,
    seat: SensorPose = ON_GRID,
    before: SmoothMap | None = None,
) -> SmoothMap:
    """How a scene's rays differ from those that carry a tile.

    Parameters
    ----------
    scene
        With the changed lens.
    tile, carrier
        Part of the object, and the rays of its centre as they were.
    grid
        Of the plane to which they go.
    seat
        Of the sensor, off that grid.
    before
        Changes that there are already, which are taken out.

    Returns
    -------
    SmoothMap
        On the sensor: how much longer the path from the tile's centre is (mm), and changes of the cosines
        along y and x with which rays leave it.

    Raises
    ------
    InputError
        If no ray arrives.
    """
    with one_blas_thread():
        pupil = sample_points(carrier.traced, ORDER)
        rays = trace_bundle(scene, np.asarray(tile.centre_mm), pupil, grid.z_mm)
        if not np.any(rays.ok):
            raise InputError("no ray of the changed lens arrives: the change is too large")
        there, path_mm = _on_seat(rays, float(scene.system.index[0, -1]), grid, seat)
        here = there[rays.ok]
        changes = np.concatenate([path_mm[None], rays.cosines.T])[:, rays.ok]
        changes -= carrier.maps.at(here)[[0, 2, 3]]
        if before is not None:
            changes -= before.at(here)
        return fit_map(here, changes, ORDER)


def _on_seat(rays: RayBundle, index: float, grid: Grid, seat: SensorPose) -> tuple[Array, Array]:
    """Where rays meet the sensor, (y, x) in its own frame about the grid's middle, and their paths (mm)."""
    if seat == ON_GRID:
        return rays.sensor_mm, rays.path_mm
    across = rays.slopes[:, ::-1] / index
    heading = np.column_stack([across, np.sqrt(1.0 - np.sum(across**2, axis=1))])
    begin = np.pad(rays.sensor_mm[:, ::-1] - grid.centre_mm, ((0, 0), (0, 1)))
    begin -= [*seat.shift_mm, seat.distance_mm]
    turned = rotation_matrix(*np.deg2rad(seat.tilt_deg))
    normal = turned[:, 2]
    length = -(begin @ normal) / (heading @ normal)
    own = (begin + length[:, None] * heading) @ turned[:, :2] + grid.centre_mm
    return own[:, ::-1], rays.path_mm + index * length
