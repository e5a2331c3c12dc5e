"""The scene of a lens's ghost: light reflected by the last surface, then by the first one."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

from lensdesign.errors import InputError
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.ghosts import ghost_system
from wavesim.scene.scene import Scene


@dataclass(frozen=True)
class GhostScene(Scene):
    """A scene for the light that the outer surfaces of the lens reflect, with both reflectances set to 1.

    Only engines that trace rays accept it. Light at angles beyond half the exit grid's band is omitted: its
    interference fringes with the direct light are finer than two pixels.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.coating != "ideal":
            raise InputError(
                f"coating = {self.coating!r}: must be ideal, because a ghost has its own reflectance"
            )

    @cached_property
    def system(self) -> CompiledSystem:
        """The surfaces in the order of the ghost's path."""
        straight = compile_system(self.lens, self.wavelength_um, self.pose, self.surface_perturbations)
        return ghost_system(straight, 0, straight.surfaces - 1)

    @property
    def steepest_sine(self) -> float:
        """Sine of the largest angle to the axis behind the lens; steeper light is omitted."""
        index = abs(float(self.system.index[0, -1]))
        # Fraction of the exit grid's band that a ghost may use. The intensity of two interfering fields has
        # twice the bandwidth of a field.
        band_fraction = 0.5
        return band_fraction * 0.5e-3 * self.wavelength_um / (index * self.exit_grid.pitch_mm)


def ghost_of(scene: Scene) -> GhostScene:
    """Return the scene of the ghost's light, with the same grids and lens."""
    own = {f.name: getattr(scene, f.name) for f in fields(Scene)}
    return GhostScene(**(own | {"coating": "ideal"}))
