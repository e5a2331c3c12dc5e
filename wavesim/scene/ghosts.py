"""Scenes of a lens's ghosts: light that one surface reflects, and then another one in front of it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

from lensdesign.errors import InputError
from lensdesign.raytrace.compiled import CompiledSystem
from lensdesign.raytrace.ghosts import ghost_system
from wavesim.scene.polarization import SCALAR
from wavesim.scene.scene import Scene


@dataclass(frozen=True)
class GhostScene(Scene):
    """A scene for the light that two surfaces of the lens reflect.

    With the coating ``ideal``, both reflectances are 1. Otherwise the field has the reflections and
    transmissions of the coatings. Only engines that trace rays accept it. Light at angles beyond half the
    exit grid's band is omitted: its interference fringes with the direct light are finer than two pixels.

    Attributes
    ----------
    front_index, back_index : int
        Indices, from 0, of the surfaces that reflect; the light is reflected at `back_index` first. Default:
        the outer surfaces.
    """

    front_index: int = 0
    back_index: int = -1

    @cached_property
    def system(self) -> CompiledSystem:
        """The surfaces in the order of the ghost's path."""
        straight = super().system
        return ghost_system(straight, self.front_index, self.back_index % straight.surfaces)

    @property
    def steepest_sine(self) -> float:
        """Sine of the largest angle to the axis behind the lens; steeper light is omitted."""
        index = abs(float(self.system.index[0, -1]))
        # Fraction of the exit grid's band that a ghost may use. The intensity of two interfering fields has
        # twice the bandwidth of a field.
        band_fraction = 0.5
        return band_fraction * 0.5e-3 * self.wavelength_um / (index * self.exit_grid.pitch_mm)


def ghost_of(scene: Scene) -> GhostScene:
    """Return the scene of light that both outer surfaces reflect completely, with the same grids and lens."""
    own = {f.name: getattr(scene, f.name) for f in fields(Scene)}
    return GhostScene(**(own | {"coating": "ideal", "polarization": SCALAR}))


def coated_ghosts(scene: Scene) -> tuple[GhostScene, ...]:
    """Return the scenes of all ghosts between surfaces of the lens that reflect light.

    Raises
    ------
    InputError
        If fewer than two surfaces reflect light, because their coatings are ideal.
    """
    own = {f.name: getattr(scene, f.name) for f in fields(Scene)} | {"polarization": SCALAR}
    coatings = scene.system.coatings
    found = tuple(
        GhostScene(**own, front_index=front, back_index=back)
        for back in range(1, len(coatings))
        for front in range(back)
        if not (coatings[front].is_ideal or coatings[back].is_ideal)
    )
    if not found:
        raise InputError(
            "ghosts: ideal coatings reflect no light; state the coatings of the design, or use "
            "coating = 'bare'"
        )
    return found
