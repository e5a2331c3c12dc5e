"""How rays behind a slightly different lens, or on a sensor that sits elsewhere, differ from a tile's.

A ray's path is stationary: to first order a change of the lens changes the path from an object point to a
sensor point by what the changed lens's rays show there, and nothing else. A tile's field is multiplied by
i k times that of its centre; away from it the path changes by the change of the direction in which rays leave
the object, times the distance from the centre.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.poses import rotation_matrix
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.engines.tiles.operator import Tile, TileOperator, add_tiles, add_tiles_back, at_once
from wavesim.fields.field import Field, Grid
from wavesim.rays.maps import RayMap, SmoothMap, fit_map, sample_points
from wavesim.rays.ray_bundles import RayBundle, trace_bundle
from wavesim.runtime.threads import one_blas_thread
from wavesim.scene.engine import Cost, Engine, ErrorTerm, Operator
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


class TurnedTiles(Engine):
    """Tiles near those of another engine.

    Parameters
    ----------
    near
        Whose scene has the same grids, but for the object's distance.
    scene
        With the changed lens.
    seat
        Of the sensor, off the grid of the tiles.

    Raises
    ------
    InputError
        If there is free space between the tiles' plane and a sensor that sits off the grid.
    """

    name = "turned-tiles"

    def __init__(self, near: EikonalTiles, scene: Scene, seat: SensorPose = ON_GRID) -> None:
        super().__init__(scene)
        if seat != ON_GRID and near.plane.beyond is not None:
            raise InputError(
                f"tiles turned to a sensor that sits at {seat}: must reach it without free space"
            )
        self.near, self.seat, self.plane = near, seat, near.plane
        self._operators: dict[np.dtype[Any], tuple[TileOperator, ...]] = {}

    def _turned(self, dtype: np.dtype[Any]) -> tuple[TileOperator, ...]:
        if dtype not in self._operators:
            grid, wavenumber = self.plane.grid, self.scene.wavenumber_per_mm
            self._operators[dtype] = tuple(
                operator.turned(carrier, ray_changes(self.scene, tile, carrier, grid, self.seat), wavenumber)
                for tile, carrier, operator in self.near.tile_operators(dtype)
            )
        return self._operators[dtype]

    def tile_operators(self, dtype: np.dtype[Any]) -> Iterator[tuple[Tile, RayMap, TileOperator]]:
        """Each tile, the rays that carried it, and what carries fields of a type now."""
        for (tile, carrier, _), operator in zip(
            self.near.tile_operators(dtype), self._turned(dtype), strict=True
        ):
            yield tile, carrier, operator

    def _forward(self, values: Any) -> Any:
        scaled = values * values.real.dtype.type(self.scene.object_grid.cell)
        result = np.zeros(self.plane.grid.shape, scaled.dtype)
        add_tiles(self._turned(scaled.dtype), scaled, result)
        beyond = self.plane.beyond
        return result if beyond is None else beyond.forward(result.astype(complex)).astype(scaled.dtype)

    def _adjoint(self, values: Any) -> Any:
        dtype, beyond = values.dtype, self.plane.beyond
        field = values if beyond is None else beyond.adjoint(values.astype(complex)).astype(dtype)
        result = np.zeros(self.scene.object_grid.shape, dtype)
        add_tiles_back(self._turned(dtype), field, result)
        return result * result.real.dtype.type(self.plane.grid.cell)

    def cost(self) -> Cost:
        return self.near.cost()

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        return self.near.error_terms()

    def settings(self) -> dict[str, Any]:
        return self.near.settings()


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
