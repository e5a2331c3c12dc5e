"""No lens: free space from the object to the exit grid.

It gives what a sensor in the same position would record of the object without the lens (the paper's Fig. 5e).
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np

from wavesim.engines.surfaces.grids import check_grid_size
from wavesim.fields.propagator import FreeSpacePropagator
from wavesim.scene.engine import Cost, Engine, ErrorTerm
from wavesim.scene.scene import Scene


class NoLens(Engine):
    """Free space over the geometric distance between both grids, with the index in front of the lens.

    Parameters
    ----------
    scene
        Grids and wavelength. The lens contributes only the index in front of it.
    force
        Whether to run even above the limits of memory and time.
    """

    name = "no-lens"

    def __init__(self, scene: Scene, *, force: bool = False) -> None:
        super().__init__(scene)
        self._force = force

    @cached_property
    def _transfer(self) -> FreeSpacePropagator:
        scene = self.scene
        index = float(scene.system.index[0, 0])
        return FreeSpacePropagator(scene.object_grid, scene.exit_grid, scene.wavelength_um, index)

    @cached_property
    def _prepared(self) -> FreeSpacePropagator:
        check_grid_size(self.name, self._transfer.samples, self.cost(), self._force)
        return self._transfer

    def _forward(self, values: Any) -> Any:
        return self._prepared.forward(np.asarray(values, complex))

    def _adjoint(self, values: Any) -> Any:
        return self._prepared.adjoint(np.asarray(values, complex))

    def cost(self) -> Cost:
        return Cost(self._transfer.seconds, 0.0, self._transfer.peak_bytes)

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        return (ErrorTerm("the lens", math.nan),)

    def settings(self) -> dict[str, Any]:
        return {}
