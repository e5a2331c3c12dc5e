"""The operator of lensless recording: the object plane is the first plane, and recording planes lie behind
it.

It describes in-line holograms and lensless cameras (the paper's Fig. 5e). Without a lens there is no scene,
so it is not in the registry; it has the interface that a reconstruction needs from an engine.
"""

from __future__ import annotations

from dataclasses import dataclass

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid


@dataclass(frozen=True)
class FreeSpace:
    """Identity operator on the samples of the object plane.

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
