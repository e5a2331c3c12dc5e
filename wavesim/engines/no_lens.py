"""No lens: free space from the object to the exit grid, or to recording planes right behind the object.

They give what a sensor in the same position would record of the object without the lens (the paper's
Fig. 5e).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lensdesign.errors import InputError
from wavesim.engines.surfaces.grids import check_grid_size
from wavesim.fields.field import Field, Grid
from wavesim.fields.propagator import FreeSpacePropagator
from wavesim.scene.engine import Cost, Engine, ErrorTerm
from wavesim.scene.scene import Scene


class NoLens(Engine):
    """Free space over the geometric distance between both grids, with the index in front of the lens.

    Parameters
    ----------
    scene
        Grids and wavelength. The lens contributes only the index in front of it, and the cover glass of
        the sensor.
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
        ends = scene.object_grid, scene.exit_grid, scene.wavelength_um, index
        return FreeSpacePropagator(*ends, plate=scene.system.cover_glass)

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


@dataclass(frozen=True)
class FreeSpace:
    """Identity operator on the samples of the object plane, for recording planes behind it.

    It describes in-line holograms and lensless cameras. It needs no scene, so it is not in the registry; it
    has the interface that a reconstruction needs from an engine.

    Attributes
    ----------
    object_grid : Grid
        Grid of the object.
    """

    object_grid: Grid

    @property
    def exit_grid(self) -> Grid:
        """The grid of the object."""
        return self.object_grid

    @property
    def scene(self) -> FreeSpace:
        """The object itself, which holds both grids."""
        return self

    def forward(self, field: Field) -> Field:
        """Return the field unchanged.

        Raises
        ------
        InputError
            If the field does not lie on the grid.
        """
        if field.grid != self.object_grid:
            raise InputError(f"the field's grid {field.grid} is not that of free space, {self.object_grid}")
        return field

    def adjoint(self, field: Field) -> Field:
        """Return the field unchanged, as :meth:`forward`."""
        return self.forward(field)
