"""Eikonal tiles of one lens, turned by what a slightly different lens adds to their paths and directions.

So does a sensor that sits a little off the grid to which they go. To first order in the change, at a
hundredth of what tiles of their own would take to make: amplitudes do not change, nor what a tile's path has
beyond its first order.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from lensdesign.errors import InputError
from wavesim.calibration.joint.ray_changes import ON_GRID, SensorPose, ray_changes
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.engines.tiles.operator import Tile, TileOperator, add_tiles, add_tiles_back
from wavesim.rays.maps import RayMap
from wavesim.scene.engine import Cost, Engine, ErrorTerm
from wavesim.scene.scene import Scene


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

    def neglected(self) -> tuple[ErrorTerm, ...]:
        return self.near.neglected()

    def settings(self) -> dict[str, Any]:
        return self.near.settings()
