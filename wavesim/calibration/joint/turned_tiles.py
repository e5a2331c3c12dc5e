"""Eikonal tiles of one lens, turned by what a slightly different lens adds to their paths and directions.

To first order in the change, at a hundredth of what tiles of their own would take to make: amplitudes do not
change, nor what a tile's path has beyond its first order.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from wavesim.calibration.joint.lens_changes import ray_changes
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.engines.tiles.operator import TileOperator, add_tiles, add_tiles_back
from wavesim.scene.engine import Cost, Engine, Neglected
from wavesim.scene.scene import Scene


class TurnedTiles(Engine):
    """Tiles near those of another engine.

    Parameters
    ----------
    near
        Whose scene has the same grids, but for the object's distance.
    scene
        With the changed lens.
    """

    name = "turned-tiles"

    def __init__(self, near: EikonalTiles, scene: Scene) -> None:
        super().__init__(scene)
        self.near = near
        self._turned = cache(self._made)

    def _made(self, dtype: np.dtype[Any]) -> tuple[TileOperator, ...]:
        z_mm, wavenumber = self.near.plane.grid.z_mm, self.scene.wavenumber_per_mm
        return tuple(
            operator.turned(carrier, ray_changes(self.scene, tile, carrier, z_mm), wavenumber)
            for tile, carrier, operator in self.near.tile_operators(dtype)
        )

    def _forward(self, values: Any) -> Any:
        scaled = values * values.real.dtype.type(self.scene.object_grid.cell)
        result = np.zeros(self.near.plane.grid.shape, scaled.dtype)
        add_tiles(self._turned(scaled.dtype), scaled, result)
        beyond = self.near.plane.beyond
        return result if beyond is None else beyond.forward(result.astype(complex)).astype(scaled.dtype)

    def _adjoint(self, values: Any) -> Any:
        dtype, beyond = values.dtype, self.near.plane.beyond
        field = values if beyond is None else beyond.adjoint(values.astype(complex)).astype(dtype)
        result = np.zeros(self.scene.object_grid.shape, dtype)
        add_tiles_back(self._turned(dtype), field, result)
        return result * result.real.dtype.type(self.near.plane.grid.cell)

    def cost(self) -> Cost:
        return self.near.cost()

    def neglected(self) -> tuple[Neglected, ...]:
        return self.near.neglected()

    def settings(self) -> dict[str, Any]:
        return self.near.settings()
