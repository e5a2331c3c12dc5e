"""What a small change of the lens does to the field behind it.

A ray's path is stationary: to first order a change of the lens changes the path from an object point to a
sensor point by what the changed lens's rays show there, and nothing else. A tile's field is multiplied by
i k times that of its centre; away from it the path changes by the change of the direction in which rays leave
the object, times the distance from the centre.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.engines.tiles.operator import Tile
from wavesim.fields.field import Field
from wavesim.rays.maps import RayMap, SmoothMap, fit_map, sample_points
from wavesim.rays.ray_bundles import trace_bundle
from wavesim.runtime.threads import one_blas_thread
from wavesim.scene.engine import Engine, Operator
from wavesim.scene.scene import Scene

ComplexArray = NDArray[np.complexfloating[Any, Any]]

ORDER = 10
"""Of the polynomials through changes of path, which are smooth."""


class Changed(NamedTuple):
    """A scene with a slightly changed lens or object, and by how much of its parameter."""

    scene: Scene
    step: float


def lens_changes(
    engine: Operator, lit: Field, changed: Sequence[Changed], make: Callable[[Scene], Engine]
) -> list[ComplexArray]:
    """Change of the field on the exit grid for a unit of each parameter.

    Parameters
    ----------
    engine
        Of the scene as it is.
    lit
        The light behind the object.
    changed
        The same scene with a small step of each parameter.
    make
        Makes engines, where rays do not tell.

    Raises
    ------
    InputError
        If the rays of a changed lens do not arrive.
    """
    if not isinstance(engine, EikonalTiles):
        now = engine.forward(lit).values
        return [(make(one.scene).forward(_at(lit, one.scene)).values - now) / one.step for one in changed]
    grid, wavenumber = engine.plane.grid, engine.scene.wavenumber_per_mm
    results = [np.zeros(grid.shape, lit.values.dtype) for _ in changed]
    for tile, carrier, alone in engine.tile_fields(lit):
        for one, result in zip(changed, results, strict=True):
            found = ray_changes(one.scene, tile, carrier, grid.z_mm).on_axes((grid.y_mm, grid.x_mm))
            path, *cosines = found.astype(alone.real.dtype)
            turned = path * alone[0]
            for cosine, moment in zip(cosines, alone[1:], strict=True):
                turned -= cosine * moment
            result += result.dtype.type(1j * wavenumber / one.step) * turned
    if engine.plane.beyond is None:
        return list(results)
    return [np.asarray(engine.plane.beyond.forward(one.astype(complex)), lit.values.dtype) for one in results]


def ray_changes(scene: Scene, tile: Tile, carrier: RayMap, plane_z_mm: float) -> SmoothMap:
    """How a scene's rays differ from those that carry a tile.

    Returns
    -------
    SmoothMap
        On the sensor plane of that z: how much longer the path from the tile's centre is (mm), and changes
        of the cosines along y and x with which rays leave it.

    Raises
    ------
    InputError
        If no ray arrives.
    """
    with one_blas_thread():
        rays = trace_bundle(
            scene, np.asarray(tile.centre_mm), sample_points(carrier.traced, ORDER), plane_z_mm
        )
        if not np.any(rays.ok):
            raise InputError("no ray of the changed lens arrives: the change is too large")
        there = rays.sensor_mm[rays.ok]
        now = np.concatenate([rays.path_mm[None], rays.cosines.T])[:, rays.ok]
        return fit_map(there, now - carrier.maps.at(there)[[0, 2, 3]], ORDER)


def _at(lit: Field, scene: Scene) -> Field:
    return Field(scene.object_grid, lit.values, lit.wavelength_um, lit.index)
