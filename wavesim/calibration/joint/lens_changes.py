"""What a small change of the lens, or of where the sensor sits, does to the field behind it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from wavesim.calibration.joint.ray_changes import ON_GRID, SensorPose, ray_changes
from wavesim.calibration.joint.turned_tiles import TurnedTiles
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.engines.tiles.operator import Tile, at_once
from wavesim.fields.field import Field
from wavesim.rays.maps import RayMap, SmoothMap
from wavesim.scene.engine import Engine, Operator
from wavesim.scene.scene import Scene

ComplexArray = NDArray[np.complexfloating[Any, Any]]
PathSlopes = Sequence[Sequence[SmoothMap]]


class Changed(NamedTuple):
    """A scene whose lens, object or sensor is slightly changed, and by how much of its parameter."""

    scene: Scene
    step: float
    seat: SensorPose = ON_GRID


def path_slopes(
    engine: EikonalTiles | TurnedTiles, dtype: DTypeLike, changed: Sequence[Changed]
) -> PathSlopes:
    """How paths and directions of each tile's rays change for a unit of each parameter.

    Parameters
    ----------
    engine
        Of the scene as it is.
    dtype
        Of fields.
    changed
        The same scene with a small step of each parameter.

    Returns
    -------
    sequence of sequence of SmoothMap
        For each tile, and for each parameter.

    Raises
    ------
    InputError
        If the rays of a changed lens do not arrive.
    """
    grid, found = engine.plane.grid, []
    for tile, carrier, _ in engine.tile_operators(np.dtype(dtype)):
        own = None
        if isinstance(engine, TurnedTiles):
            own = ray_changes(engine.scene, tile, carrier, grid, engine.seat)
        moved = [ray_changes(one.scene, tile, carrier, grid, one.seat, own) for one in changed]
        found.append(
            [
                replace(m, coefficients=m.coefficients / one.step)
                for m, one in zip(moved, changed, strict=True)
            ]
        )
    return found


def by_rays(engine: EikonalTiles | TurnedTiles, lit: Field, slopes: PathSlopes) -> list[ComplexArray]:
    """Change of the field on the exit grid for a unit of each parameter.

    Parameters
    ----------
    engine
        Of the scene as it is.
    lit
        The light behind the object.
    slopes
        Of the tiles' rays, of this scene or one that is near.
    """
    grid, wavenumber = engine.plane.grid, engine.scene.wavenumber_per_mm
    axes = grid.y_mm, grid.x_mm
    results = [np.zeros(grid.shape, lit.values.dtype) for _ in slopes[0]]
    for (_, _, alone), maps in zip(_tile_fields(engine, lit), slopes, strict=True):
        alone *= alone.dtype.type(1j * wavenumber)
        for one, result in zip(maps, results, strict=True):
            path, *cosines = one.along(axes).single().each()
            result += path * alone[0]
            for cosine, moment in zip(cosines, alone[1:], strict=True):
                result -= cosine * moment
    if engine.plane.beyond is None:
        return results
    return [np.asarray(engine.plane.beyond.forward(one.astype(complex)), lit.values.dtype) for one in results]


def by_engines(
    engine: Operator, lit: Field, changed: Sequence[Changed], make: Callable[[Scene], Engine]
) -> list[ComplexArray]:
    """The same where rays do not tell, by engines that `make` makes of the changed scenes."""
    now = engine.forward(lit).values
    return [(make(one.scene).forward(_at(lit, one.scene)).values - now) / one.step for one in changed]


def _tile_fields(
    engine: EikonalTiles | TurnedTiles, field: Field
) -> Iterator[tuple[Tile, RayMap, ComplexArray]]:
    """Each tile, the rays that carry it, and fields of it alone on the plane on which tiles are summed.

    Of its object, and of that times y and times x from the tile's centre (mm), shape (3, ny, nx).
    """
    scaled = field.values * field.values.real.dtype.type(engine.scene.object_grid.cell)
    for tile, carrier, operator in engine.tile_operators(scaled.dtype):
        y_mm, x_mm = (offsets.astype(scaled.real.dtype) for offsets in tile.offsets_mm)
        part = scaled[operator.part]
        moments = part, part * y_mm[:, None], part * x_mm
        alone = np.zeros((3, *engine.plane.grid.shape), scaled.dtype)
        carried = at_once([partial(operator.carried, moment) for moment in moments])
        for one, result in zip(carried, alone, strict=True):
            operator.add(one, result)
        yield tile, carrier, alone


def _at(lit: Field, scene: Scene) -> Field:
    return Field(scene.object_grid, lit.values, lit.wavelength_um, lit.index)
