"""The scene of a lens's ghost: light that its last surface reflects, then its first one, before it leaves."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

from lensdesign.errors import InputError
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.ghosts import ghost_system
from wavesim.scene.scene import Scene

BAND_SHARE = 0.5
"""Of the exit grid's band, that a ghost may take: the intensity of two fields has the bands of both."""


@dataclass(frozen=True)
class GhostScene(Scene):
    """As a scene, but for light that both reflections send through the lens, all of it.

    Engines that follow rays carry it; those that go from surface to surface cannot. Light that leaves at
    steeper angles than half the exit grid's band is left out: samples do not hold its fringes with the
    straight light, which are finer than two pixels.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.coating != "ideal":
            raise InputError(f"coating = {self.coating!r}: a ghost's share is stated; must be ideal")

    @cached_property
    def system(self) -> CompiledSystem:
        """The surfaces in the order in which light meets them."""
        straight = compile_system(self.lens, self.wavelength_um, self.pose, self.surface_perturbations)
        return ghost_system(straight, 0, straight.surfaces - 1)

    @property
    def steepest_sine(self) -> float:
        """Of the angle to the axis behind the lens."""
        index = abs(float(self.system.index[0, -1]))
        return BAND_SHARE * 0.5e-3 * self.wavelength_um / (index * self.exit_grid.pitch_mm)


def ghost_of(scene: Scene) -> GhostScene:
    """The same scene for the ghost's light."""
    return GhostScene(**{f.name: getattr(scene, f.name) for f in fields(Scene)})
