"""The light behind an object, for which engines predict their errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

from lensdesign.errors import InputError
from wavesim.fields.field import Field
from wavesim.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class Light:
    """The known part of the light behind an object.

    Attributes
    ----------
    field : Field
        Field on the object grid of the scene.
    even : float
        Fraction of the energy that fills the aperture evenly, whatever the field's spectrum. It is 0 where
        the field is the light itself, and larger where an unknown object scatters the light.

    Raises
    ------
    InputError
        If the fraction is not from 0 to 1.
    """

    field: Field
    even: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.even <= 1.0:
            raise InputError(f"even = {self.even!r}: must be from 0 to 1")

    def on(self, scene: Scene) -> Light:
        """Return the same light at the position of a scene's object, on a shifted grid of equal shape."""
        field = self.field
        return replace(self, field=Field(scene.object_grid, field.values, scene.wavelength_um, field.index))

    def validate_same_scene(self, scene: Scene) -> None:
        """Check that a scene has the grid and the wavelength of this light.

        Raises
        ------
        InputError
            If the field does not lie on the scene's object grid, or has another wavelength.
        """
        field = self.field
        if (field.grid, field.wavelength_um) != (scene.object_grid, scene.wavelength_um):
            raise InputError(
                f"light on the grid {field.grid}, of {field.wavelength_um:g} µm: must be the scene's, "
                f"{scene.object_grid}, of {scene.wavelength_um:g} µm"
            )
