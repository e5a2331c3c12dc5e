"""What a small change of the lens, or of where the sensor sits, does to the field behind it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavesim.calibration.joint.ray_changes import ON_GRID, Seat, ray_changes
from wavesim.calibration.joint.turned_tiles import TurnedTiles
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.engines.tiles.operator import Tile, at_once
from wavesim.fields.field import Field
from wavesim.rays.maps import RayMap
from wavesim.scene.engine import Engine, Operator
from wavesim.scene.scene import Scene

ComplexArray = NDArray[np.complexfloating[Any, Any]]


class Changed(NamedTuple):
    """A scene whose lens, object or sensor is slightly changed, and by how much of its parameter."""

    scene: Scene
    step: float
    seat: Seat = ON_GRID


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
    if not isinstance(engine, EikonalTiles | TurnedTiles):
        now = engine.forward(lit).values
        return [(make(one.scene).forward(_at(lit, one.scene)).values - now) / one.step for one in changed]
    grid, wavenumber = engine.plane.grid, engine.scene.wavenumber_per_mm
    axes = grid.y_mm, grid.x_mm
    results = [np.zeros(grid.shape, lit.values.dtype) for _ in changed]
    for tile, carrier, alone in _tile_fields(engine, lit):
        own = None
        if isinstance(engine, TurnedTiles):
            own = ray_changes(engine.scene, tile, carrier, grid, engine.seat).on_axes(axes)
        for one, result in zip(changed, results, strict=True):
            found = ray_changes(one.scene, tile, carrier, grid, one.seat).on_axes(axes)
            path, *cosines = (found if own is None else found - own).astype(alone.real.dtype)
            turned = path * alone[0]
            for cosine, moment in zip(cosines, alone[1:], strict=True):
                turned -= cosine * moment
            result += result.dtype.type(1j * wavenumber / one.step) * turned
    if engine.plane.beyond is None:
        return list(results)
    return [np.asarray(engine.plane.beyond.forward(one.astype(complex)), lit.values.dtype) for one in results]


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
