"""Eikonal tiles of one lens, turned by what a slightly different lens adds to their paths.

To first order in the change, at a hundredth of what tiles of their own would take to make: paths change,
amplitudes and the directions within a tile do not.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavesim.calibration.lens_changes import path_change
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.engines.tiles.operator import TileOperator, add_tiles_back, carried_tiles
from wavesim.scene.engine import Cost, Engine, Neglected
from wavesim.scene.scene import Scene

Turned = tuple[TileOperator, NDArray[np.complexfloating]]


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

    def _made(self, dtype: np.dtype[Any]) -> tuple[Turned, ...]:
        grid, wavenumber = self.near.plane.grid, self.scene.wavenumber_per_mm
        return tuple(
            (operator, np.exp(1j * wavenumber * path_change(self.scene, tile, carrier, grid)).astype(dtype))
            for tile, carrier, operator in self.near.tile_operators(dtype)
        )

    def _forward(self, values: Any) -> Any:
        scaled = values * values.real.dtype.type(self.scene.object_grid.cell)
        result = np.zeros(self.near.plane.grid.shape, scaled.dtype)
        operators, turns = zip(*self._turned(scaled.dtype), strict=True)
        for operator, turn, carried in zip(operators, turns, carried_tiles(operators, scaled), strict=True):
            alone = np.zeros_like(result)
            operator.add(carried, alone)
            result += turn * alone
        beyond = self.near.plane.beyond
        return result if beyond is None else beyond.forward(result.astype(complex)).astype(scaled.dtype)

    def _adjoint(self, values: Any) -> Any:
        dtype, beyond = values.dtype, self.near.plane.beyond
        field = values if beyond is None else beyond.adjoint(values.astype(complex)).astype(dtype)
        result = np.zeros(self.scene.object_grid.shape, dtype)
        operators, turns = zip(*self._turned(dtype), strict=True)
        add_tiles_back(operators, (turn.conj() * field for turn in turns), result)
        return result * result.real.dtype.type(self.near.plane.grid.cell)

    def cost(self) -> Cost:
        return self.near.cost()

    def neglected(self) -> tuple[Neglected, ...]:
        return self.near.neglected()

    def settings(self) -> dict[str, Any]:
        return self.near.settings()
