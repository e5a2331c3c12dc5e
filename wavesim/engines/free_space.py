"""Free space alone: object and first plane are one, and only recording planes lie at distances.

What an in-line hologram or a lensless camera (the paper's Fig. 5e) records. No lens, thus no scene of one:
it is none of the registry's engines, and does what a reconstruction asks of one.
"""

from __future__ import annotations

from dataclasses import dataclass

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid


@dataclass(frozen=True)
class FreeSpace:
    """The identity, on the samples of the object's plane.

    Attributes
    ----------
    object_grid : Grid
        Where the object is.
    """

    object_grid: Grid

    @property
    def exit_grid(self) -> Grid:
        """The object's own."""
        return self.object_grid

    @property
    def scene(self) -> FreeSpace:
        """Its grids."""
        return self

    def forward(self, field: Field) -> Field:
        """The field itself.

        Raises
        ------
        InputError
            If it does not lie on the grid.
        """
        if field.grid != self.object_grid:
            raise InputError(f"the field's grid {field.grid} is not that of free space, {self.object_grid}")
        return field

    def adjoint(self, field: Field) -> Field:
        """As :meth:`forward`."""
        return self.forward(field)
